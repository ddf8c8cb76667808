//! Numbers of many views in a few.

use std::fmt;

use serde::Serialize;

/// The median of numbers, the mean of the two in the middle if their count is even; `None` without any.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    let (upper, lower) = (values.len() / 2, values.len().checked_sub(1)? / 2);
    Some((values[lower] + values[upper]) / 2.0)
}

/// Where most of some numbers are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Range {
    /// 5th percentile.
    pub low: f64,
    pub median: f64,
    /// 95th percentile.
    pub high: f64,
}

impl Range {
    /// `None` without numbers. Percentiles are numbers that occur.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_unstable_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let at = |percent: usize| values[(percent * last + 50) / 100];
        Some(Self { low: at(5), median: at(50), high: at(95) })
    }
}

impl fmt::Display for Range {
    /// Median, and from the 5th to the 95th percentile, with the digits that are asked for.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(2);
        let Self { low, median, high } = *self;
        write!(f, "{median:.digits$} ({low:.digits$} to {high:.digits$})")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_ranges() {
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median([]), None);
        let range = Range::of((0..=100).rev().map(f64::from)).unwrap();
        assert_eq!(range, Range { low: 5.0, median: 50.0, high: 95.0 });
        assert_eq!((format!("{range:.0}"), Range::of([])), ("50 (5 to 95)".to_owned(), None));
    }
}

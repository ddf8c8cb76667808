//! Means and spreads over seeds.

use std::fmt;

use serde::Serialize;

/// A mean, and how far single values are from it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    pub mean: f64,
    /// Sample standard deviation: the root of the sum of squared distances from the mean over n − 1. `None` for a single
    /// value.
    pub deviation: Option<f64>,
}

impl Spread {
    /// Of `values`, of which there is at least one.
    pub fn of(values: &[f64]) -> Self {
        debug_assert!(!values.is_empty());
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Self { mean, deviation: (values.len() > 1).then(|| (squares / (count - 1.0)).sqrt()) }
    }
}

/// `mean ± deviation`, or the mean alone; both with the precision of the format, the mean with its sign.
impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(2);
        if f.sign_plus() {
            write!(f, "{:+.digits$}", self.mean)?;
        } else {
            write!(f, "{:.digits$}", self.mean)?;
        }
        self.deviation.map_or(Ok(()), |deviation| write!(f, " ± {deviation:.digits$}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_deviations_are_those_computed_by_hand() {
        // squared distances from 5: 9, 1, 1, 1, 0, 0, 4, 16
        let spread = Spread::of(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]);
        assert_eq!(spread.mean, 5.0);
        assert!((spread.deviation.unwrap() - (32.0f64 / 7.0).sqrt()).abs() < 1e-15);
        assert_eq!(Spread::of(&[3.0, 5.0, 4.0]), Spread { mean: 4.0, deviation: Some(1.0) });
        assert_eq!(Spread::of(&[7.5]), Spread { mean: 7.5, deviation: None });
    }

    #[test]
    fn they_are_written_with_equal_precision() {
        let spread = Spread { mean: 30.126, deviation: Some(0.25) };
        assert_eq!(format!("{spread:.1} {spread:+.2}"), "30.1 ± 0.2 +30.13 ± 0.25");
        assert_eq!(format!("{:+.2}", Spread { mean: -0.125, deviation: None }), "-0.12");
    }
}

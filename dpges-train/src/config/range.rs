//! Which values make sense.

use std::fmt::Display;
use std::ops::{Bound, RangeBounds};

use super::{Background, Config, ConfigError, Method};

/// Above 0.
pub const POSITIVE: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Unbounded);
/// Above 0, at most 1.
pub const POSITIVE_SHARE: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Included(1.0));

impl Config {
    /// # Errors
    /// [`ConfigError::Range`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.check_ranges()?;
        if self.data.background == Background::Transparent {
            let expected = "auto, black, white or r,g,b: only pictures of `dpges render` are transparent".to_owned();
            return Err(ConfigError::Range { key: "data.background", found: "transparent".to_owned(), expected });
        }
        let (surfels, gaussians) = (self.stages.surfels, self.stages.gaussians);
        if surfels + gaussians < 1.0 {
            return Ok(());
        }
        let (key, found) = ("stages.surfels + stages.gaussians", format!("{surfels} + {gaussians}"));
        Err(ConfigError::Range { key, found, expected: "a sum below 1".to_owned() })
    }

    /// Whether scenes of the method can have the colours that are asked for.
    ///
    /// # Errors
    /// [`ConfigError::Range`] naming `model.colour`.
    pub(super) fn check_colours(&self) -> Result<(), ConfigError> {
        let (colours, needs_harmonics) = (self.model.colour, self.train.method == Method::SortFree);
        let expected = match (colours.opacity_len() > 0, needs_harmonics && self.scene_model() == colours) {
            (true, _) => "sbN or shN: what opacities depend on follows from `train.method`",
            (false, true) => "sh0 to sh3 with `train.method = \"sortfree\"`: its opacities are harmonics too",
            (false, false) => return Ok(()),
        };
        let (key, found) = ("model.colour", colours.to_string());
        Err(ConfigError::Range { key, found, expected: expected.to_owned() })
    }
}

/// A number that a key may have.
pub trait Number: Copy + PartialOrd + Display {
    fn is_finite(self) -> bool {
        true
    }
}

impl Number for u32 {}
impl Number for u64 {}
impl Number for usize {}
impl Number for f64 {
    fn is_finite(self) -> bool {
        f64::is_finite(self)
    }
}

/// # Errors
/// [`ConfigError::Range`] if `value` is not finite or not in `range`.
pub fn check<T: Number>(key: &'static str, value: T, range: &impl RangeBounds<T>) -> Result<(), ConfigError> {
    if value.is_finite() && range.contains(&value) {
        return Ok(());
    }
    let expected = if value.is_finite() { phrase(range) } else { format!("a finite number, {}", phrase(range)) };
    Err(ConfigError::Range { key, found: value.to_string(), expected })
}

/// A range in words: "at least 1", "from 0 to 1", "above 0 and below 1".
pub fn phrase<T: Number>(range: &impl RangeBounds<T>) -> String {
    let low = match range.start_bound() {
        Bound::Included(low) => Some(format!("at least {low}")),
        Bound::Excluded(low) => Some(format!("above {low}")),
        Bound::Unbounded => None,
    };
    let high = match range.end_bound() {
        Bound::Included(high) => Some(format!("at most {high}")),
        Bound::Excluded(high) => Some(format!("below {high}")),
        Bound::Unbounded => None,
    };
    match (range.start_bound(), range.end_bound()) {
        (Bound::Included(low), Bound::Included(high)) => format!("from {low} to {high}"),
        _ => low.into_iter().chain(high).collect::<Vec<_>>().join(" and "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::keys;

    #[test]
    fn defaults_are_in_range_and_what_is_outside_is_refused_with_its_key() {
        Config::default().validate().unwrap();
        let mut refused = 0;
        for key in keys() {
            let Some(range) = key.range.map(|range| range()) else { continue };
            let (low, high) = (range.contains("at least") || range.contains("above"), range.contains("at most"));
            let both = range.contains("from") || range.contains("below");
            let whole = key.kind == "a whole number";
            // far outside: that a bound is exact is what `check` is tested for
            let below = (low || both).then_some(if whole { "0" } else { "-0.5" });
            let above = ((high || both) && key.name != "train.seed").then_some(if whole { "1000000" } else { "1e9" });
            for value in [below, above, (!whole).then_some("nan")].into_iter().flatten() {
                if whole && value == "0" && range.ends_with(" 0") {
                    continue;
                }
                let error = Config::with(&[&format!("{}={value}", key.name)]).unwrap_err();
                let ConfigError::Range { key: named, expected, .. } = error else { panic!("{error}") };
                assert_eq!((named, expected.ends_with(&range)), (key.name, true), "{value}: {expected}");
                refused += 1;
            }
        }
        assert!(refused > 80, "{refused}");
    }

    #[test]
    fn bounds_are_exact() {
        let is_in = |range: (Bound<f64>, Bound<f64>), value: f64| check("a.b", value, &range).is_ok();
        assert!(!is_in(POSITIVE, 0.0) && is_in(POSITIVE, 0f64.next_up()) && !is_in(POSITIVE, f64::INFINITY));
        assert!(is_in(POSITIVE_SHARE, 1.0) && !is_in(POSITIVE_SHARE, 1f64.next_up()));
        assert_eq!([0, 1, 3, 4].map(|value| check("a.b", value, &(1..=3usize)).is_ok()), [false, true, true, false]);
    }

    #[test]
    fn shares_of_stages_leave_steps_for_the_joint_one() {
        let mut config = Config::default();
        (config.stages.surfels, config.stages.gaussians) = (0.5, 0.5);
        let error = config.validate().unwrap_err().to_string();
        assert_eq!(error, "key `stages.surfels + stages.gaussians` is 0.5 + 0.5, expected a sum below 1");
    }

    #[test]
    fn ranges_in_words() {
        assert_eq!(phrase::<usize>(&(1..)), "at least 1");
        assert_eq!(phrase::<u64>(&..=9), "at most 9");
        assert_eq!(phrase(&(0.0..=1.0)), "from 0 to 1");
        assert_eq!(phrase(&(0.0..1.0)), "at least 0 and below 1");
        assert_eq!([POSITIVE, POSITIVE_SHARE].map(|range| phrase(&range)), ["above 0", "above 0 and at most 1"]);
        let error = check("a.b", f64::NAN, &POSITIVE_SHARE).unwrap_err().to_string();
        assert_eq!(error, "key `a.b` is NaN, expected a finite number, above 0 and at most 1");
    }
}

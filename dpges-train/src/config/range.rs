//! Which values make sense.

use std::fmt::Display;
use std::ops::{Bound, RangeBounds};

use super::{Config, ConfigError, Method};

/// Above 0.
pub const POSITIVE: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Unbounded);
/// Above 0, at most 1.
pub const POSITIVE_SHARE: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Included(1.0));
/// Above 0, below 1: what has a finite logit.
pub const OPACITY: (Bound<f64>, Bound<f64>) = (Bound::Excluded(0.0), Bound::Excluded(1.0));

impl Config {
    /// # Errors
    /// [`ConfigError::Range`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.check_ranges()?;
        let (surfels, gaussians) = (self.stages.surfels, self.stages.gaussians);
        if surfels + gaussians < 1.0 {
            return Ok(());
        }
        let (key, found) = ("stages.surfels + stages.gaussians", format!("{surfels} + {gaussians}"));
        Err(ConfigError::Range { key, found, expected: "a sum below 1".to_owned() })
    }
}

impl Config {
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
pub mod tests {
    use super::*;

    /// Values next to a range but outside it.
    pub trait Outside: Number {
        fn below(self) -> Option<Self>;
        fn above(self) -> Option<Self>;
        fn never() -> Vec<Self> {
            Vec::new()
        }
    }

    macro_rules! whole {
        ($($Type:ty),+) => {$(
            impl Outside for $Type {
                fn below(self) -> Option<Self> {
                    self.checked_sub(1)
                }
                fn above(self) -> Option<Self> {
                    self.checked_add(1)
                }
            }
        )+};
    }
    whole!(u32, u64, usize);

    impl Outside for f64 {
        fn below(self) -> Option<Self> {
            Some(self.next_down())
        }
        fn above(self) -> Option<Self> {
            Some(self.next_up())
        }
        fn never() -> Vec<Self> {
            vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY]
        }
    }

    pub fn outside<T: Outside>(range: &impl RangeBounds<T>) -> Vec<T> {
        let low = match range.start_bound() {
            Bound::Included(low) => low.below(),
            Bound::Excluded(low) => Some(*low),
            Bound::Unbounded => None,
        };
        let high = match range.end_bound() {
            Bound::Included(high) => high.above(),
            Bound::Excluded(high) => Some(*high),
            Bound::Unbounded => None,
        };
        low.into_iter().chain(high).chain(T::never()).collect()
    }

    #[test]
    fn defaults_are_in_range_and_each_value_outside_is_refused_with_its_key() {
        Config::default().validate().unwrap();
        let spoiled = Config::out_of_range();
        assert!(spoiled.len() > 100, "{}", spoiled.len());
        for (key, config) in spoiled {
            let ConfigError::Range { key: named, found, expected } = config.validate().unwrap_err() else { panic!() };
            assert_eq!(named, key);
            let range = super::super::key(key).range.unwrap()();
            assert!(expected.ends_with(&range), "{key} = {found}: {expected}");
        }
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
        let error = check("a.b", f64::NAN, &OPACITY).unwrap_err().to_string();
        assert_eq!(error, "key `a.b` is NaN, expected a finite number, above 0 and below 1");
    }
}

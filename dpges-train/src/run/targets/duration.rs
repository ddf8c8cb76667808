//! Lengths of time as options take them and messages say them.

use std::fmt;
use std::time::Duration;

/// Units, and how many seconds each has.
const UNITS: [(&str, f64); 3] = [("min", 60.0), ("s", 1.0), ("h", 3600.0)];
/// Longer than any training, s.
const MOST: f64 = 1e9;

/// A number with one of the units `s`, `min` and `h`, as in `90s`, `5min` or `1.5 h`; `None` if `text` has none of them.
///
/// # Errors
/// If the number is not positive, or too large.
pub fn with_unit(text: &str) -> Option<Result<Duration, String>> {
    let (number, seconds) = UNITS.iter().find_map(|(unit, seconds)| {
        let number = text.trim().strip_suffix(unit)?.trim().parse::<f64>().ok()?;
        Some((number, number * seconds))
    })?;
    if number.is_finite() && seconds > 0.0 && seconds <= MOST {
        return Some(Ok(Duration::from_secs_f64(seconds)));
    }
    Some(Err(format!("`{text}` is no length of time that can pass: write a positive number, as in 30min")))
}

/// A length of time.
///
/// # Errors
/// If `text` is none.
pub fn duration(text: &str) -> Result<Duration, String> {
    with_unit(text)
        .unwrap_or_else(|| Err(format!("`{text}` is no length of time: write it in s, min or h, as in 30min")))
}

/// A duration, shown in one or two units.
pub struct Seconds(pub f64);

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let whole = self.0.round() as u64;
        match whole {
            0..10 => write!(f, "{:.1} s", self.0),
            10..60 => write!(f, "{whole} s"),
            60..3600 => write!(f, "{} min {} s", whole / 60, whole % 60),
            _ => write!(f, "{} h {} min", whole / 3600, whole % 3600 / 60),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_written_in_two_units() {
        let texts = [3.21, 59.4, 61.0, 7322.0].map(|seconds| Seconds(seconds).to_string());
        assert_eq!(texts, ["3.2 s", "59 s", "1 min 1 s", "2 h 2 min"]);
    }

    #[test]
    fn times_have_units() {
        for (text, seconds) in [("90s", 90.0), ("5min", 300.0), ("1.5 h", 5400.0), (" 2 min ", 120.0)] {
            assert_eq!(duration(text).unwrap().as_secs_f64(), seconds, "{text}");
        }
        for text in ["5", "min", "5 m", "5 days", "", "fast"] {
            assert!(duration(text).unwrap_err().contains("s, min or h"), "{text}");
            assert!(with_unit(text).is_none(), "{text}");
        }
        for text in ["0s", "-3min", "infs", "NaNh", "1e12h"] {
            assert!(duration(text).unwrap_err().contains("positive"), "{text}");
        }
    }
}

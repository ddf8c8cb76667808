//! Durations as options take them and messages say them.

use std::fmt;
use std::time::Duration;

/// A positive duration, such as `90s`, `5min` or `1h 30min`.
///
/// # Errors
/// If `text` is none.
pub fn duration(text: &str) -> Result<Duration, String> {
    let found = humantime::parse_duration(text.trim()).ok().filter(|duration| !duration.is_zero());
    found.ok_or_else(|| format!("`{text}` is no positive duration: write it in s, min or h, such as 1h 30min"))
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
        for (text, seconds) in [("90s", 90), ("5min", 300), ("1h 30 min", 5400), (" 2 min ", 120)] {
            assert_eq!(duration(text).unwrap().as_secs(), seconds, "{text}");
        }
        for text in ["5", "min", "", "fast", "0s", "-3min", "NaNh"] {
            assert!(duration(text).unwrap_err().contains("no positive duration"), "{text}");
        }
    }
}

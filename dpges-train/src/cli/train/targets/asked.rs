//! What a run can be asked to reach.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use super::super::super::duration;

/// A size, a time or a speed.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    pub wanted: Wanted,
    /// As it was asked for.
    text: String,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wanted {
    /// Largest size of the scene file.
    Bytes(f64),
    /// Length of the training, with what is measured before.
    Time(Duration),
    /// Of the real-time renderer.
    FramesPerSecond(f64),
}

/// Units of sizes, bytes; longer names first where one ends with another.
const SIZES: [(&str, f64); 3] = [("kB", 1e3), ("MB", 1e6), ("GB", 1e9)];
const SPEED: &str = "fps";
const UNITS: &str = "kB, MB or GB (scene file), s, min or h (training), fps (real-time rendering)";

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = wanted(text.trim())?;
        Ok(Self { wanted, text: text.trim().to_owned() })
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

fn wanted(text: &str) -> Result<Wanted, String> {
    if let Some(time) = duration::with_unit(text) {
        return time.map(Wanted::Time);
    }
    let number = |unit: &str| text.strip_suffix(unit)?.trim().parse::<f64>().ok();
    let size = SIZES.iter().find_map(|(unit, bytes)| Some(Wanted::Bytes(number(unit)? * bytes)));
    let Some(wanted) = size.or_else(|| number(SPEED).map(Wanted::FramesPerSecond)) else {
        return Err(format!("`{text}` is no target: write a number and a unit: {UNITS}"));
    };
    let (Wanted::Bytes(value) | Wanted::FramesPerSecond(value)) = wanted else { return Ok(wanted) };
    if value.is_finite() && value > 0.0 {
        return Ok(wanted);
    }
    Err(format!("`{text}` cannot be reached: write a positive, finite number, as in 10MB, 5min or \"30 fps\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_times_and_speeds_are_read() {
        for (text, wanted) in [
            ("10MB", Wanted::Bytes(1e7)),
            ("500 kB", Wanted::Bytes(5e5)),
            ("1.5GB", Wanted::Bytes(1.5e9)),
            ("5min", Wanted::Time(Duration::from_secs(300))),
            ("90 s", Wanted::Time(Duration::from_secs(90))),
            ("2h", Wanted::Time(Duration::from_secs(7200))),
            ("30 fps", Wanted::FramesPerSecond(30.0)),
            ("59.94fps", Wanted::FramesPerSecond(59.94)),
        ] {
            let target: Target = text.parse().unwrap();
            assert_eq!((target.wanted, target.to_string().as_str()), (wanted, text));
        }
    }

    #[test]
    fn what_cannot_be_is_refused_with_the_units() {
        for text in ["1 GB fps", "fast", "10", "10 m", "MB", "", "10MiB", "5 dB"] {
            let error = text.parse::<Target>().unwrap_err();
            assert!(["kB, MB or GB", "s, min or h", "fps"].iter().all(|units| error.contains(units)), "{error}");
        }
        for text in ["0MB", "-1 GB", "0 fps", "NaN fps", "inf MB", "0min"] {
            assert!(text.parse::<Target>().unwrap_err().contains("positive"), "{text}");
        }
    }
}

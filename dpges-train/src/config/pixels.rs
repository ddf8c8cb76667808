//! A number of pixels, of pictures as they are or of pictures of one megapixel.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::declare::{text, value};

/// A number of pixels of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum PixelCount {
    /// Whatever the size of the picture (GES, DP-GES).
    Picture(usize),
    /// The same share of every picture.
    PerMegapixel(usize),
}

value!(
    PixelCount, "a string", toml::Value::is_str,
    "Npx" => "N pixels, whatever the size of the picture (GES, DP-GES).",
    "Npx/MP" => "N pixels of a picture of 1 megapixel: the number scales with the size of the pictures, and is rounded up."
);
text!(PixelCount);

impl PixelCount {
    /// The number in a picture of `pixels` px. Shares are rounded up: in small pictures, too, a threshold removes something.
    pub fn of(self, pixels: usize) -> usize {
        match self {
            Self::Picture(count) => count,
            Self::PerMegapixel(count) => (count as f64 * pixels as f64 / 1e6).ceil() as usize,
        }
    }
}

impl fmt::Display for PixelCount {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Picture(count) => write!(f, "{count}px"),
            Self::PerMegapixel(count) => write!(f, "{count}px/MP"),
        }
    }
}

impl FromStr for PixelCount {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let per_megapixel = text.strip_suffix("/MP");
        let count = per_megapixel.unwrap_or(text).strip_suffix("px").and_then(|count| count.trim().parse().ok());
        match (count, per_megapixel) {
            (Some(count), Some(_)) => Ok(Self::PerMegapixel(count)),
            (Some(count), None) => Ok(Self::Picture(count)),
            (None, _) => {
                Err(format!("`{text}` is neither a number of pixels such as 16px nor one per megapixel, 16px/MP"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_counts_are_read_back_and_others_refused() {
        for (text, count) in [("16px", PixelCount::Picture(16)), ("0px/MP", PixelCount::PerMegapixel(0))] {
            assert_eq!((text.parse(), count.to_string()), (Ok(count), text.to_owned()));
        }
        for text in ["", "16", "px", "-1px", "1.5px", "16/MP", "16px/KP", "manypx/MP"] {
            assert!(text.parse::<PixelCount>().unwrap_err().contains(&format!("`{text}` is neither")));
        }
    }

    #[test]
    fn counts_per_megapixel_remain_thresholds_in_small_pictures() {
        let of = |pixels| PixelCount::PerMegapixel(16).of(pixels);
        assert_eq!([1_000_000, 500_000, 62_500, 62_501, 250 * 250 / 4, 1].map(of), [16, 8, 1, 2, 1, 1]);
        assert_eq!(PixelCount::PerMegapixel(1).of(400 * 400), 1);
        assert_eq!((PixelCount::PerMegapixel(0).of(250), PixelCount::Picture(4).of(10)), (0, 4));
    }
}

//! The choice of a level of quality for a compressed scene: the best that fits into a size, or the one with the smallest file
//! that looks almost the same.

pub mod report;

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use dpges_core::scene::{Quality, SceneData};

use crate::config::Budget;
use crate::config::budget::MEGABYTE;

/// Why there is no compressed scene, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum CompressError {
    #[error(
        "no quality makes the scene as small as {largest} bytes: the smallest file has {smallest}; allow `--budget {}MB`, or \
         train a scene of fewer primitives",
        (*.smallest as f64 / 1e3).ceil() * 1e3 / MEGABYTE
    )]
    TooLarge { smallest: usize, largest: usize },
    #[error(
        "the highest quality loses {found:.4} dB, more than {allowed} dB; allow a larger loss, or keep the scene as it is"
    )]
    TooDifferent { found: f64, allowed: f64 },
    #[error(transparent)]
    Scene(#[from] dpges_core::Error),
}

/// A scene in the compressed format.
#[derive(Clone, Debug, PartialEq)]
pub struct Compressed {
    pub quality: Quality,
    /// Content of the file.
    pub bytes: Vec<u8>,
    path: PathBuf,
}

impl Compressed {
    /// For a file at `path`, which errors name and which is not written.
    ///
    /// # Errors
    /// The errors of [`SceneData::to_compressed`].
    pub fn new(scene: &SceneData, quality: &Quality, path: &Path) -> dpges_core::Result<Self> {
        let bytes = scene.to_compressed(quality, path)?;
        Ok(Self { quality: *quality, bytes, path: path.to_owned() })
    }

    /// The scene as a reader of the file sees it.
    ///
    /// # Errors
    /// The errors of [`SceneData::from_bytes`].
    pub fn scene(&self) -> dpges_core::Result<SceneData> {
        SceneData::from_bytes(&self.bytes, &self.path.to_string_lossy())
    }
}

/// The goal of a compression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    Quality(Quality),
    /// The best quality for a file of at most so many bytes.
    Bytes(usize),
    /// The smallest file that loses at most so many dB.
    Loss(f64),
}

/// The levels of quality, by name.
pub fn levels() -> impl TypedValueParser<Value = Quality> {
    let texts = [
        "16 bits per number: nearly without loss",
        "9 bits: for views from closer than the photographs",
        "7 bits",
        "5 to 6 bits: where size matters most",
    ];
    let values = Quality::LEVELS.iter().zip(texts).map(|((name, _), text)| PossibleValue::new(*name).help(text));
    PossibleValuesParser::new(values).map(|chosen| {
        let level = Quality::LEVELS.into_iter().find(|(name, _)| *name == chosen);
        level.expect("it is one of the possible values").1
    })
}

/// The bytes of a size such as `10MB`.
///
/// # Errors
/// A sentence.
pub fn bytes(text: &str) -> Result<usize, String> {
    match text.parse()? {
        Budget::Megabytes(size) => Ok((size * MEGABYTE).round() as usize),
        _ => Err("this is no size such as 10MB".to_owned()),
    }
}

/// A loss such as `0.1dB`.
///
/// # Errors
/// A sentence.
pub fn decibels(text: &str) -> Result<f64, String> {
    if bytes(text).is_ok() {
        return Err(format!("this is a size, which is a budget: write `--budget {text}`"));
    }
    let loss = text.strip_suffix("dB").and_then(|digits| digits.trim().parse::<f64>().ok());
    loss.filter(|loss| loss.is_finite() && *loss > 0.0).ok_or_else(|| "this is no loss such as 0.1dB".to_owned())
}

/// The PSNR of a scene, mean over some views, dB.
pub type Measure<'a> = dyn Fn(&SceneData) -> dpges_core::Result<f64> + 'a;

impl Goal {
    /// The compressed `scene`, and its PSNR before and after by `measure`, which a largest loss needs.
    ///
    /// # Errors
    /// [`CompressError`].
    ///
    /// # Panics
    /// If a largest loss comes without `measure`.
    pub fn reach(
        self,
        scene: &SceneData,
        path: &Path,
        measure: Option<&Measure>,
    ) -> Result<(Compressed, Option<[f64; 2]>), CompressError> {
        let before = measure.map(|measure| measure(scene)).transpose()?;
        let compressed = match self {
            Self::Quality(quality) => Compressed::new(scene, &quality, path)?,
            Self::Bytes(largest) => within_size(scene, largest, path)?,
            Self::Loss(allowed) => {
                let (measure, before) = measure.zip(before).expect("a loss is measured");
                let (compressed, after) = within_loss(scene, before, allowed, path, |candidate| {
                    let psnr = measure(&candidate.scene()?)?;
                    let (megabytes, bits) = (candidate.bytes.len() as f64 / MEGABYTE, candidate.quality.list());
                    tracing::info!("{megabytes:.3} MB: {psnr:.3} dB, {bits:?}");
                    Ok(psnr)
                })?;
                return Ok((compressed, Some([before, after])));
            }
        };
        let after = measure.map(|measure| measure(&compressed.scene()?)).transpose()?;
        Ok((compressed, before.zip(after).map(|(before, after)| [before, after])))
    }
}

/// The best level for a file of at most `largest` bytes.
///
/// # Errors
/// [`CompressError::TooLarge`] with the size of the lowest level, or [`CompressError::Scene`].
pub fn within_size(scene: &SceneData, largest: usize, path: &Path) -> Result<Compressed, CompressError> {
    let mut smallest = 0;
    for (_, quality) in Quality::LEVELS {
        let candidate = Compressed::new(scene, &quality, path)?;
        smallest = candidate.bytes.len();
        if smallest <= largest {
            return Ok(candidate);
        }
    }
    Err(CompressError::TooLarge { smallest, largest })
}

/// The lowest level whose pictures are worse by at most `allowed` dB. `measure` gives the PSNR of a compressed scene, `before`
/// is that of the scene itself. Returns the PSNR of the file as well.
///
/// # Errors
/// [`CompressError::TooDifferent`] if the highest level loses more, those of `measure`, or [`CompressError::Scene`].
pub fn within_loss(
    scene: &SceneData,
    before: f64,
    allowed: f64,
    path: &Path,
    mut measure: impl FnMut(&Compressed) -> dpges_core::Result<f64>,
) -> Result<(Compressed, f64), CompressError> {
    let mut found = f64::INFINITY;
    for (_, quality) in Quality::LEVELS.into_iter().rev() {
        let candidate = Compressed::new(scene, &quality, path)?;
        let after = measure(&candidate)?;
        found = before - after;
        if found <= allowed {
            return Ok((candidate, after));
        }
    }
    Err(CompressError::TooDifferent { found, allowed })
}

#[cfg(test)]
mod tests {
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;

    fn scene() -> SceneData {
        random(1, &Recipe { surfels: 200, gaussians: 300, ..Recipe::default() }).into_scene().0
    }

    fn size_of_level(level: usize) -> usize {
        Compressed::new(&scene(), &Quality::LEVELS[level].1, Path::new("out")).unwrap().bytes.len()
    }

    fn fitting(largest: usize) -> Result<Compressed, CompressError> {
        within_size(&scene(), largest, Path::new("out"))
    }

    #[test]
    fn sizes_are_budgets_and_losses_are_targets() {
        assert_eq!((bytes("10MB"), bytes("0.25MB")), (Ok(10_000_000), Ok(250_000)));
        assert_eq!((decibels("0.1dB"), decibels("2 dB")), (Ok(0.1), Ok(2.0)));
        assert!(decibels("2MB").unwrap_err().contains("write `--budget 2MB`"));
        for wrong in ["10", "0MB", "infMB", "auto", ""] {
            assert!(bytes(wrong).unwrap_err().contains("MB"), "{wrong}");
        }
        for wrong in ["0.1", "-1dB", "nandB", "dB", ""] {
            assert!(decibels(wrong).unwrap_err().contains("such as 0.1dB"), "{wrong}");
        }
    }

    #[test]
    fn the_best_quality_that_fits_is_taken() {
        assert_eq!(fitting(usize::MAX).unwrap().quality, Quality::HIGHEST);
        assert_eq!(fitting(size_of_level(0)).unwrap().quality, Quality::HIGHEST);
        let [high, medium] = [1, 2].map(size_of_level);
        let between = fitting((high + medium) / 2).unwrap();
        assert_eq!((between.quality, between.bytes.len()), (Quality::MEDIUM, medium));
        assert_eq!(between.scene().unwrap().gaussians.len(), 300);
    }

    #[test]
    fn what_does_not_fit_is_told_with_the_smallest_size() {
        let low = size_of_level(3);
        assert!(fitting(low).unwrap().bytes.len() <= low);
        let error = fitting(low - 1).unwrap_err();
        assert!(
            matches!(error, CompressError::TooLarge { smallest, largest } if smallest == low && largest == low - 1)
        );
        assert!(error.to_string().contains(&low.to_string()));
    }

    #[test]
    fn the_lowest_level_within_the_loss_is_taken() {
        let losses = Quality::LEVELS.map(|(_, quality)| quality).into_iter().zip([0.0, 0.1, 0.2, 0.3]);
        let psnr = |of: &Compressed| 40.0 - losses.clone().find(|(quality, _)| *quality == of.quality).unwrap().1;
        for (allowed, expected) in [(0.3, 3), (0.25, 2), (0.05, 0)] {
            let (found, after) =
                within_loss(&scene(), 40.0, allowed + 1e-9, Path::new("out"), |candidate| Ok(psnr(candidate))).unwrap();
            assert_eq!((found.quality, after), (Quality::LEVELS[expected].1, psnr(&found)));
        }
    }

    #[test]
    fn a_loss_that_no_level_keeps_is_told() {
        let measure = |_: &Compressed| Ok(39.5);
        let error = within_loss(&scene(), 40.0, 0.1, Path::new("out"), measure).unwrap_err();
        assert!(matches!(error, CompressError::TooDifferent { found, allowed } if found == 0.5 && allowed == 0.1));
        assert!(error.to_string().contains("0.5000 dB"), "{error}");
    }
}

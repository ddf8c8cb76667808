//! Settings that a dataset asks for, with a reason for each, and the command that has them.

use burn::tensor::Device;
use serde::Serialize;

use super::shell::quoted;
use super::targets::{StepTimes, TargetError};
use crate::config::Config;
use crate::config::duration::Seconds;
use crate::dataset::Dataset;
use crate::dataset::source::Source;
use crate::stage::{budget, mean_pixels};
use crate::views::exposure::brightness_spread;
use crate::views::exposure::state::LARGE_SPREAD;
use crate::views::pose::LARGE_PX;

/// The preset that decides about exposures and poses by the dataset.
pub const PRESET: &str = "recommended";
/// A run that is expected to take longer is recommended for smaller pictures, s.
const LONG_SECONDS: f64 = 3600.0;
/// Sides of recommended pictures are multiples of this, and not below [`LEAST_SIDE`], px.
const SIDE_STEP: f64 = 20.0;
const LEAST_SIDE: f64 = 160.0;

/// Settings and the command that are recommended for a dataset.
#[derive(Clone, Debug, Serialize)]
pub struct Recommendation {
    /// A shell's command line.
    pub command: String,
    /// Expected length of its steps, s.
    pub seconds: f64,
    /// Name of each setting, and its value with the reason.
    pub settings: Vec<(&'static str, String)>,
}

impl Recommendation {
    /// For `dataset`, read from `source` with each `key=value` of `options`, and a run of `config`, [`PRESET`] with them, on
    /// `device`, which is called `name`; it is timed for some seconds.
    ///
    /// # Errors
    /// [`TargetError`] of a photograph that cannot be read again, of steps that fail.
    pub fn new(
        source: &Source,
        options: &[String],
        dataset: &Dataset,
        config: &Config,
        device: &Device,
        name: &str,
    ) -> Result<Self, TargetError> {
        let (steps, whole_pixels) = (config.total_steps(), mean_pixels(dataset));
        let times = StepTimes::of_builtin(config, device)?;
        let seconds_for = |pixels: usize| steps as f64 * times.step(pixels);
        let mut command = format!("dpges train {} --preset {PRESET}", quoted(&source.to_string()));
        options.iter().for_each(|option| command += &format!(" --set {}", quoted(option)));
        let mut settings = Vec::new();
        let (side, whole) = (dataset.longest_side() as f64, seconds_for(whole_pixels));
        let share = (LONG_SECONDS / whole).min(1.0);
        let smaller = ((share.sqrt() * side / SIDE_STEP).floor() * SIDE_STEP).max(LEAST_SIDE);
        let mut pixels = whole_pixels;
        if share < 1.0 && smaller < side {
            command += &format!(" --max-resolution {smaller}");
            pixels = (whole_pixels as f64 * (smaller / side).powi(2)) as usize;
            let long = Seconds(whole);
            settings.push(("pictures", format!("{smaller} px: {steps} steps would take about {long} at {side} px")));
        } else {
            settings.push(("pictures", format!("{side} px, as they are")));
        }
        let primitives = budget(config, dataset) as f64 * pixels as f64 / whole_pixels as f64;
        settings.push(("primitives", format!("up to about {primitives:.0}: one for each different pixel")));
        settings.push(("exposure", exposure(dataset)?));
        settings.push(("poses", poses(dataset)));
        let masked = dataset.masked();
        if masked.masked_views > 0 {
            settings.push(("masks", format!("used: {masked}")));
        }
        let seconds = seconds_for(pixels);
        settings.push(("time", format!("about {} for {steps} steps on {name}", Seconds(seconds))));
        Ok(Self { command, seconds, settings })
    }
}

fn exposure(dataset: &Dataset) -> Result<String, TargetError> {
    Ok(match brightness_spread(dataset)? {
        Some(stops) if stops > LARGE_SPREAD => {
            format!("corrected: the same points differ by {stops:.2} stops between photographs")
        }
        Some(stops) => format!("as it is: the same points differ by {stops:.2} stops between photographs"),
        None => "as it is: no points say how bright photographs are".to_owned(),
    })
}

fn poses(dataset: &Dataset) -> String {
    match dataset.reprojection_px {
        Some(px) if px > LARGE_PX => format!("corrected: points are {px:.1} px from where photographs show them"),
        Some(px) => format!("as they are: points are {px:.1} px from where photographs show them"),
        None => "as they are: no keypoints say how exact they are (train.poses=on corrects them)".to_owned(),
    }
}

//! How the dataset of a run is read.

use super::{Alpha, Background, Config, DataConfig, DepthMaps};
use crate::dataset::source::{Source, SourceError};
use crate::dataset::{Dataset, DepthKind, LoadOptions};

impl DataConfig {
    /// The settings of `[data]` for a dataset in files.
    pub fn load_options(&self) -> LoadOptions {
        LoadOptions {
            background: match self.background {
                Background::Colour(colour) => Some(colour),
                Background::Auto | Background::Transparent => None,
            },
            image_scale: (self.image_scale > 1).then_some(self.image_scale),
            max_resolution: self.max_resolution,
            test_every: self.test_every,
            undistort: self.undistort,
            near: (self.near > 0.0).then_some(self.near),
            alpha_masks: self.alpha == Alpha::Mask,
            invert_masks: self.invert_masks,
            memory: self.memory.bytes(),
            depth: match self.depth {
                DepthMaps::None => None,
                DepthMaps::Metric => Some(DepthKind::Metric),
                DepthMaps::Relative => Some(DepthKind::Relative),
            },
            points: (!self.points.is_empty()).then(|| self.points.clone().into()),
        }
    }
}

impl Config {
    /// The dataset of a run, without the views that are kept for its decisions, and those of other blocks.
    ///
    /// # Errors
    /// [`SourceError`].
    pub fn load_for_training(&self, source: &Source) -> Result<Dataset, SourceError> {
        source.load_for_training(&self.data.load_options(), self.block(), self.validation_every())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Memory;
    use crate::dataset::MaxResolution;

    #[test]
    fn zeros_and_auto_leave_the_choice_to_the_dataset() {
        let options = DataConfig { max_resolution: MaxResolution(0), ..Default::default() }.load_options();
        let memory = Memory::Auto.bytes();
        assert_eq!(options, LoadOptions { memory, ..LoadOptions::default() });
        let data =
            DataConfig { background: Background::Colour([1.0; 3]), image_scale: 4, near: 0.5, ..Default::default() };
        let options = data.load_options();
        assert_eq!((options.background, options.image_scale, options.near), (Some([1.0; 3]), Some(4), Some(0.5)));
        assert_eq!((options.max_resolution, options.depth), (MaxResolution(1600), None));
        let data = DataConfig { depth: DepthMaps::Relative, ..Default::default() };
        assert_eq!((data.load_options().depth, data.load_options().points), (Some(DepthKind::Relative), None));
        let data = DataConfig { points: "scan.e57".into(), ..Default::default() };
        assert_eq!(data.load_options().points, Some("scan.e57".into()));
    }
}

//! How a dataset is read.

use super::DepthKind;
use crate::config::{Alpha, Background, DataConfig, DepthMaps};

#[derive(Clone, Debug, PartialEq)]
pub struct LoadOptions {
    /// Red, green, blue in 0..1. `None`: white for Blender images with alpha, else black.
    pub background: Option<[f64; 3]>,
    /// Read `images_2`, `images_4`, … as shipped instead of `images`.
    pub image_scale: Option<u32>,
    /// Largest length of the longer side of a picture, px. Larger pictures are downscaled.
    pub max_resolution: Option<usize>,
    /// Hold out every n-th view by name if the dataset stores no split. 0 holds none out and accepts a dataset without
    /// held-out views.
    pub test_every: usize,
    /// Whether photographs taken through a lens are resampled for a pinhole camera; otherwise the cameras have the lens.
    pub undistort: bool,
    /// World units. `None`: a tenth of the depth of the nearest points that the cameras see.
    pub near: Option<f64>,
    /// Whether alpha says which pixels count, those from one half, instead of how much of the background they show.
    pub alpha_masks: bool,
    /// Whether masks are black where pixels count, instead of white.
    pub invert_masks: bool,
    /// Most memory for photographs, bytes. Those beyond are read again from their files whenever they are needed.
    pub memory: usize,
    /// Read the depth maps of training views, which have values of this kind. `None` reads none.
    pub depth: Option<DepthKind>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            background: None,
            image_scale: None,
            max_resolution: None,
            test_every: 8,
            undistort: true,
            near: None,
            alpha_masks: false,
            invert_masks: false,
            memory: usize::MAX,
            depth: None,
        }
    }
}

impl DataConfig {
    /// The settings of `[data]` for a dataset in files.
    pub fn load_options(&self) -> LoadOptions {
        LoadOptions {
            background: match self.background {
                Background::Colour(colour) => Some(colour),
                Background::Auto | Background::Transparent => None,
            },
            image_scale: (self.image_scale > 1).then_some(self.image_scale),
            max_resolution: (self.max_resolution > 0).then_some(self.max_resolution),
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
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Memory;

    #[test]
    fn zeros_and_auto_leave_the_choice_to_the_dataset() {
        let options = DataConfig { max_resolution: 0, ..Default::default() }.load_options();
        let memory = Memory::Auto.bytes();
        assert_eq!(options, LoadOptions { memory, ..LoadOptions::default() });
        let data =
            DataConfig { background: Background::Colour([1.0; 3]), image_scale: 4, near: 0.5, ..Default::default() };
        let options = data.load_options();
        assert_eq!((options.background, options.image_scale, options.near), (Some([1.0; 3]), Some(4), Some(0.5)));
        assert_eq!((options.max_resolution, options.depth), (Some(1600), None));
        let data = DataConfig { depth: DepthMaps::Relative, ..Default::default() };
        assert_eq!(data.load_options().depth, Some(DepthKind::Relative));
    }
}

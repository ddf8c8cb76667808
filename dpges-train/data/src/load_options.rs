//! How a dataset is read.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::DepthKind;

/// The largest length of the longer side of a picture, px. Larger pictures are downsampled; 0 sets no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MaxResolution(pub usize);

impl MaxResolution {
    /// The longer side of a picture of which it was `longer`.
    pub fn of(self, longer: usize) -> usize {
        if self.0 == 0 { longer } else { longer.min(self.0) }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct LoadOptions {
    /// Red, green, blue in 0..1. `None`: white for Blender images with alpha, else black.
    pub background: Option<[f64; 3]>,
    /// Read `images_2`, `images_4`, … as shipped instead of `images`.
    pub image_scale: Option<u32>,
    pub max_resolution: MaxResolution,
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
    /// File of measured points, in the coordinates of the cameras, in place of those of the dataset.
    pub points: Option<PathBuf>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            background: None,
            image_scale: None,
            max_resolution: MaxResolution::default(),
            test_every: 8,
            undistort: true,
            near: None,
            alpha_masks: false,
            invert_masks: false,
            memory: usize::MAX,
            depth: None,
            points: None,
        }
    }
}

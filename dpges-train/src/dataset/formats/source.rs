//! A dataset as its files describe it, before a pixel is read: what the format readers hand to assembly.

use std::path::PathBuf;

use dpges_core::camera::CameraFromWorld;
use glam::DVec3;

use super::calibration::Calibration;
use crate::dataset::{Format, Tracks};

/// Which set a view belongs to; `Neither` for a view that the dataset's own lists leave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::dataset) enum Split {
    Train,
    Test,
    Neither,
}

/// One photograph: where it lies, how it was taken, what it is for.
#[derive(Clone, Debug)]
pub(in crate::dataset) struct Frame {
    pub name: String,
    pub image: PathBuf,
    /// The mask that the dataset names; after [`crate::dataset::image::masks::find`] the one that is there.
    pub mask: Option<PathBuf>,
    pub calibration: Calibration,
    pub camera_from_world: CameraFromWorld,
    pub split: Split,
    /// File that holds the pose, named in messages.
    pub described_in: PathBuf,
    /// The depth map that the dataset names; `None` if it lies where depth maps lie by default, or there is none.
    pub depth: Option<DepthFile>,
}

/// A depth map on disk.
#[derive(Clone, Debug)]
pub(in crate::dataset) struct DepthFile {
    pub path: PathBuf,
    /// World units of depth of a step of its values.
    pub unit: f64,
}

/// Points in the frame of the file, in f64: geo-referenced coordinates do not fit f32.
#[derive(Clone, Debug, Default)]
pub(in crate::dataset) struct RawPoints {
    pub positions: Vec<DVec3>,
    pub colours: Vec<[f32; 3]>,
    /// Indices into [`Source::frames`]; those of no point if unknown.
    pub seen_by: Tracks,
}

#[derive(Clone, Debug)]
pub(in crate::dataset) struct Source {
    pub format: Format,
    /// Sorted by name.
    pub frames: Vec<Frame>,
    pub points: RawPoints,
    /// The file to name where the views as a whole are at fault.
    pub described_in: PathBuf,
    /// Why there may be no held-out view.
    pub no_test_reason: &'static str,
}

//! A dataset as its files describe it, before a pixel is read: what the format readers hand to assembly.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use dpges_core::camera::{Camera, CameraFromWorld, Distortion, Lens};
use glam::DVec3;

use crate::error::{DatasetError, Result};
use crate::finding::{Kind, Notices};
use crate::image::codec::Header;
use crate::image::panorama::Face;
use crate::{Format, Tracks};

/// Difference between views of a photograph by which they are rounded: of rotations, of positions and intrinsics by their size.
const TWINS_ROUNDED: f64 = 1e-4;

/// Which set a view belongs to; `Neither` for a view that the dataset's own lists leave out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Split {
    Train,
    Test,
    Neither,
}

/// One photograph: where it lies, how it was taken, what it is for.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub name: String,
    pub image: PathBuf,
    /// The mask that the dataset names; once it is assembled the one that is there.
    pub mask: Option<PathBuf>,
    /// That took the photograph, in the coordinates of the files; its near plane is set when the dataset is assembled. Of a
    /// panorama that of a face.
    pub camera: Camera,
    /// Of a panorama the face; that in front until all faces are cut.
    pub panorama: Option<PanoramaPart>,
    /// Whether the files say of what size the picture is, and not the picture itself.
    pub is_sized: bool,
    /// Once it was read.
    pub header: Option<Header>,
    pub split: Split,
    /// File that holds the pose, named in messages.
    pub described_in: PathBuf,
    /// The depth map that the dataset names; once it is assembled the one that is there, `None` if there is none.
    pub depth: Option<DepthFile>,
}

/// A face of a panorama.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PanoramaPart {
    pub face: Face,
    /// Width and height of the panorama, px.
    pub size: [usize; 2],
}

impl PanoramaPart {
    /// The front of a panorama of this size, and its camera.
    pub fn front(size: [usize; 2], pose: CameraFromWorld) -> (Self, Camera) {
        (Self { face: Face::Front, size }, Face::Front.camera(&pose, size[0], 0.0))
    }
}

impl Frame {
    /// Width and height of the photograph by its camera, px.
    pub fn size(&self) -> [usize; 2] {
        self.panorama.map_or([self.camera.width, self.camera.height], |part| part.size)
    }

    /// The camera of a photograph of another size.
    pub fn taken_at(&self, [width, height]: [usize; 2]) -> Camera {
        let Camera { camera_from_world, near, .. } = self.camera;
        match self.panorama {
            Some(_) => Camera { camera_from_world, ..Face::Front.camera(&camera_from_world, width, near) },
            None => self.camera.resized(width, height),
        }
    }

    /// The error of a file that this frame names and that is not there.
    pub fn missing(&self, path: PathBuf, words: &'static [&'static str; 2]) -> DatasetError {
        let (view, described_in) = (self.name.clone(), self.described_in.clone());
        DatasetError::Missing { words, path, view, described_in }
    }

    /// # Errors
    /// [`DatasetError::Aspect`] unless a file of size `found` (width and height, px) has the aspect of the photograph.
    pub fn check_aspect(&self, path: &Path, found: [usize; 2], words: &'static [&'static str; 2]) -> Result<()> {
        let camera = self.size();
        if is_resized(found, camera) {
            return Ok(());
        }
        let (path, described_in) = (path.to_owned(), self.described_in.clone());
        Err(DatasetError::Aspect { words, path, found, camera, described_in })
    }
}

/// The distortion of a lens; `None` if it bends no ray.
pub(super) fn lens(distortion: Distortion) -> Option<Lens> {
    (!distortion.is_pinhole()).then(|| Lens::new(distortion))
}

/// # Errors
/// [`DatasetError::Contradiction`] if two views of a photograph, name, file and camera, differ by more than rounding.
pub(super) fn check_twins(views: [(&str, &Path, &Camera); 2]) -> Result<()> {
    let [a, b] = views.map(|(.., camera)| camera);
    let rotation = (a.camera_from_world.rotation - b.camera_from_world.rotation).to_cols_array();
    let translations = [a, b].map(|camera| camera.camera_from_world.translation);
    let intrinsics = [a, b].map(|camera| [camera.fx, camera.fy, camera.cx, camera.cy]);
    let is_near = |a: f64, b: f64, unit: f64| (a - b).abs() <= TWINS_ROUNDED * unit;
    let are_alike = rotation.iter().all(|&difference| is_near(difference, 0.0, 1.0))
        && is_near((translations[0] - translations[1]).length(), 0.0, translations[0].length())
        && (0..4).all(|at| is_near(intrinsics[0][at], intrinsics[1][at], a.width.max(a.height) as f64))
        && (a.width, a.height, a.lens) == (b.width, b.height, b.lens);
    if are_alike {
        return Ok(());
    }
    let views = views.map(|(name, path, camera)| (name.to_owned(), path.to_owned(), camera.centre()));
    Err(DatasetError::Contradiction { image: views[0].0.clone(), views: Box::new(views) })
}

/// Whether an image of size `found` (width and height, px) is a whole photograph of size `full` made smaller or larger, each
/// side rounded by up to a pixel.
fn is_resized(found: [usize; 2], full: [usize; 2]) -> bool {
    let scales = |axis: usize| [-1.0, 1.0].map(|rounding| (found[axis] as f64 + rounding) / full[axis] as f64);
    let ([low_x, high_x], [low_y, high_y]) = (scales(0), scales(1));
    found == full || low_x.max(low_y) < high_x.min(high_y)
}

/// A depth map on disk.
#[derive(Clone, Debug)]
pub(crate) struct DepthFile {
    pub path: PathBuf,
    /// World units of depth of a step of its values.
    pub unit: f64,
}

/// Points in the frame of the file, in f64: geo-referenced coordinates do not fit f32.
#[derive(Clone, Debug, Default)]
pub(crate) struct RawPoints {
    pub positions: Vec<DVec3>,
    pub colours: Vec<[f32; 3]>,
    /// Indices into [`Source::frames`]; those of no point if unknown.
    pub seen_by: Tracks,
}

#[derive(Clone, Debug)]
pub(crate) struct Source {
    pub format: Format,
    /// Sorted by name.
    pub frames: Vec<Frame>,
    pub points: RawPoints,
    /// Of each frame the median distance between points and where its photograph shows them, px of its camera; `None` where
    /// that is unknown. Empty if it is of all.
    pub reprojection_px: Vec<Option<f64>>,
    /// The file to name where the views as a whole are at fault.
    pub described_in: PathBuf,
    /// Why there may be no held-out view.
    pub no_test_reason: &'static str,
    /// Files of pictures that views name and that are not there.
    pub missing: Vec<PathBuf>,
    /// Files that were read, beside those of frames.
    pub used: Vec<PathBuf>,
    pub notices: Notices,
}

impl Source {
    /// Without views and points yet.
    pub fn new(format: Format, described_in: PathBuf, no_test_reason: &'static str) -> Self {
        let (frames, points, reprojection_px) = Default::default();
        let (missing, used, notices) = Default::default();
        Self { format, frames, points, reprojection_px, described_in, no_test_reason, missing, used, notices }
    }

    /// Keeps the first of the views of each photograph, and names the others.
    ///
    /// # Errors
    /// [`DatasetError::Contradiction`] if they differ.
    pub fn drop_twins(&mut self) -> Result<()> {
        let (mut at, mut twins) = (HashMap::new(), Vec::new());
        for frame in std::mem::take(&mut self.frames) {
            let index = *at.entry(frame.image.clone()).or_insert(self.frames.len());
            if let Some(first) = self.frames.get(index) {
                check_twins(
                    [first, &frame].map(|frame| (frame.name.as_str(), frame.described_in.as_path(), &frame.camera)),
                )?;
                twins.push(frame.name);
            } else {
                self.frames.push(frame);
            }
        }
        self.say_twins(&twins);
        Ok(())
    }

    /// Says that photographs were there twice.
    pub fn say_twins(&mut self, names: &[String]) {
        let what = "photographs are described twice, alike";
        self.notices.add_names(
            Kind::Aside,
            what,
            names,
            "one view of each is used, the one that is held out if one is",
        );
    }

    /// Says so if rotations of views, with their scales, were not quite those of a rigid motion.
    pub fn say_scaled(&mut self, views: &[(String, f64)]) {
        let names: Vec<String> = views.iter().map(|(name, scale)| format!("{name} (scale {scale:.3})")).collect();
        let what = "rotations of views were scaled or rounded";
        let advice = "they were made rotations; look whether positions have the same scale";
        self.notices.add_names(Kind::Changed, what, &names, advice);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resizing_may_round_but_not_crop() {
        for found in [[1237, 822], [618, 411], [619, 411], [309, 205], [310, 206], [155, 103]] {
            assert!(is_resized(found, [1237, 822]), "{found:?}");
        }
        for found in [[822, 1237], [618, 400], [1237, 800]] {
            assert!(!is_resized(found, [1237, 822]), "{found:?}");
        }
    }
}

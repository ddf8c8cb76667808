//! Decoding of the image file of a frame: its picture, undistorted if asked to and downsampled, and the camera that
//! took it or would have.

use std::sync::{Mutex, PoisonError};

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::{DMat3, DVec3};

use super::alpha::Alpha;
use super::codec;
use super::photograph::ImageInfo;
use super::{depth, masks, panorama, undistort};
use crate::error::{DatasetError, Result};
use crate::formats::source::{DepthFile, Frame, Split};
use crate::{DepthKind, DepthMap, LoadOptions, MaxResolution, Picture};

/// How frames are read.
#[derive(Debug)]
pub(crate) struct ImageDecoder {
    alpha: Alpha,
    invert_masks: bool,
    undistort: bool,
    max_resolution: MaxResolution,
    depth: Option<DepthKind>,
    pinholes: PerLens<Option<Camera>>,
    ignored: PerLens<Option<usize>>,
}

/// The cameras of a photograph.
struct Cameras {
    /// That took it.
    taken: Camera,
    /// That would have taken it, undistorted; `None` if it stays as it is.
    pinhole: Option<Camera>,
    /// The same made smaller: that of the picture.
    of_picture: Camera,
}

impl ImageDecoder {
    /// A decoder for pictures that have `background` behind them if they have alpha.
    pub fn new(options: &LoadOptions, background: [f64; 3]) -> Self {
        Self {
            alpha: if options.alpha_masks { Alpha::Mask } else { Alpha::Matte(background) },
            invert_masks: options.invert_masks,
            undistort: options.undistort,
            max_resolution: options.max_resolution,
            depth: options.depth,
            pinholes: PerLens::default(),
            ignored: PerLens::default(),
        }
    }

    /// The camera of a frame and what is known of its photograph, by the header of the image alone; `None` if its pixels have
    /// to be read for that, or for its depth map.
    ///
    /// # Errors
    /// [`DatasetError`] names the file at fault.
    pub fn survey(&self, frame: &Frame) -> Result<Option<(Camera, ImageInfo)>> {
        if frame.mask.is_some() || self.depth_file(frame).is_some() {
            return Ok(None);
        }
        let header = frame.header.map_or_else(|| codec::header(&frame.image), Ok)?;
        if header.has_alpha {
            return Ok(None);
        }
        let camera = self.cameras(frame, [header.width, header.height])?.of_picture;
        let area = camera.width * camera.height;
        let ignored =
            |camera: &Camera| camera.shown_pixels().map(|shown| shown.iter().filter(|shown| !**shown).count());
        let ignored_pixels = camera.lens.and_then(|_| self.ignored.of(&camera, ignored));
        if ignored_pixels == Some(area) {
            return Err(shows_nothing(frame));
        }
        let bytes = if ignored_pixels.is_some() { 4 * area } else { 3 * area };
        Ok(Some((camera, ImageInfo { bytes, ignored_pixels, has_transparency: false })))
    }

    /// The photograph of a frame and its camera.
    ///
    /// # Errors
    /// [`DatasetError`] names the file at fault.
    pub fn photograph(&self, frame: &Frame) -> Result<(Camera, Picture)> {
        let mut picture = codec::decode(&frame.image, self.alpha)?;
        if let Some(mask) = &frame.mask {
            let size = [picture.width, picture.height];
            picture.count_only(masks::read(mask, &frame.image, size, self.invert_masks)?);
        }
        let Cameras { taken, pinhole, of_picture: camera } = self.cameras(frame, [picture.width, picture.height])?;
        if let Some(part) = frame.panorama {
            picture = panorama::cut(&picture, part.face, camera.width);
        }
        if let Some(pinhole) = pinhole {
            picture = undistort::resample(&picture, &taken, &pinhole);
        }
        if [camera.width, camera.height] != [picture.width, picture.height] {
            picture = picture.downscaled(camera.width, camera.height);
        }
        if let Some(shown) = camera.shown_pixels() {
            if !shown.contains(&true) {
                return Err(shows_nothing(frame));
            }
            picture.count_only(shown);
        }
        if picture.counted.as_ref().is_some_and(|counted| !counted.contains(&true)) {
            return Err(DatasetError::NothingCounts { path: frame.image.clone(), view: frame.name.clone() });
        }
        Ok((camera, picture))
    }

    /// The depth map that belongs to a picture and its camera, if there is one and it is asked for.
    ///
    /// # Errors
    /// [`DatasetError`] names the file at fault.
    pub fn depth(&self, frame: &Frame, camera: &Camera, picture: &Picture) -> Result<Option<DepthMap>> {
        let asked = self.depth.zip(self.depth_file(frame));
        asked.map(|(kind, file)| depth::read(file, kind, frame, camera, picture)).transpose()
    }

    fn depth_file<'a>(&self, frame: &'a Frame) -> Option<&'a DepthFile> {
        frame.depth.as_ref().filter(|_| self.depth.is_some() && frame.split == Split::Train)
    }

    /// Cameras of a photograph of `width` × `height` px.
    fn cameras(&self, frame: &Frame, [width, height]: [usize; 2]) -> Result<Cameras> {
        let words = &["image", "image the camera was calibrated with"];
        frame.check_aspect(&frame.image, [width, height], words)?;
        let taken = frame.taken_at([width, height]);
        let mut pinhole = None;
        if self.undistort && taken.lens.is_some() {
            let found = self.pinholes.of(&taken, undistort::pinhole);
            let lacks_one = || DatasetError::Distortion { path: frame.described_in.clone(), view: frame.name.clone() };
            let found = found.ok_or_else(lacks_one)?;
            pinhole = Some(Camera { camera_from_world: taken.camera_from_world, ..found });
        }
        let of_picture = self.capped(pinhole.unwrap_or(taken));
        Ok(Cameras { taken, pinhole, of_picture })
    }

    fn capped(&self, camera: Camera) -> Camera {
        let longer = camera.width.max(camera.height);
        let limit = self.max_resolution.of(longer);
        let side = |side: usize| ((side as f64 * limit as f64 / longer as f64).round() as usize).max(1);
        camera.resized(side(camera.width), side(camera.height))
    }
}

fn shows_nothing(frame: &Frame) -> DatasetError {
    DatasetError::LensShowsNothing { path: frame.described_in.clone(), view: frame.name.clone() }
}

/// Results for cameras that differ in more than their poses: most photographs of a dataset share a lens.
#[derive(Debug)]
struct PerLens<T>(Mutex<Vec<(Camera, T)>>);

impl<T> Default for PerLens<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T: Copy> PerLens<T> {
    /// The result of `find` for `camera` at the origin.
    fn of(&self, camera: &Camera, find: impl FnOnce(&Camera) -> T) -> T {
        let at_origin = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
        let camera = Camera { camera_from_world: at_origin, ..*camera };
        let known = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = known().iter().find(|(of, _)| *of == camera) {
            return *found;
        }
        // others go on meanwhile, with other lenses
        let found = find(&camera);
        known().push((camera, found));
        found
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::fixtures::{self, Encoding, colmap_folder};
    use crate::formats::source::Source;
    use crate::{described, layout::Layout};

    fn read(folder: &Path, options: &LoadOptions) -> Source {
        described(&Layout::find(folder).unwrap(), options).unwrap()
    }

    #[test]
    fn what_a_header_says_is_what_the_photograph_is() {
        let lenses = [
            ((1, "PINHOLE"), vec![20.0, 20.0, 12.0, 8.0]),
            ((2, "SIMPLE_RADIAL"), vec![20.0, 12.0, 8.0, 0.1]),
            ((8, "SIMPLE_RADIAL_FISHEYE"), vec![8.0, 12.0, 8.0, -0.2]),
        ];
        for (model, params) in lenses {
            let mut scene = fixtures::scene(3);
            (scene.model, scene.params) = (model, params);
            let folder = colmap_folder(&scene, Encoding::Binary);
            for (undistort, max_resolution) in [(true, 0), (false, 0), (true, 12), (false, 13)] {
                let max_resolution = MaxResolution(max_resolution);
                let options = LoadOptions { undistort, max_resolution, test_every: 0, ..Default::default() };
                let source = read(folder.path(), &options);
                let decoder = ImageDecoder::new(&options, [0.0; 3]);
                for frame in &source.frames {
                    let (camera, info) = decoder.survey(frame).unwrap().unwrap();
                    let (expected, picture) = decoder.photograph(frame).unwrap();
                    assert_eq!((camera, info), (expected, ImageInfo::of(&picture)), "{model:?} {options:?}");
                    assert_ne!(camera.camera_from_world.translation, DVec3::ZERO);
                }
            }
        }
    }

    #[test]
    fn lenses_are_looked_at_once_whatever_the_pose() {
        let folder = colmap_folder(&fixtures::scene(3), Encoding::Binary);
        let options = LoadOptions { test_every: 0, ..Default::default() };
        let source = read(folder.path(), &options);
        let cameras = source.frames.iter().map(|frame| frame.camera);
        let (found, mut looks) = (PerLens::default(), 0);
        let mut width_of = |camera: &Camera| {
            found.of(camera, |camera| {
                looks += 1;
                camera.width
            })
        };
        for camera in cameras {
            assert_eq!((width_of(&camera), width_of(&camera.resized(12, 8))), (24, 12));
        }
        assert_eq!(looks, 2);
    }
}

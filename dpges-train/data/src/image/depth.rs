//! Depth maps beside photographs: 16-bit grey PNGs in which 0 means unknown.
//!
//! Depth is what it is for the camera that took the photograph ([`dpges_core::camera`]): camera-space z, or the distance from
//! the camera's centre through a fisheye lens and on a panorama.

use std::sync::Arc;

use dpges_core::camera::Camera;
use image::DynamicImage;

use super::codec::decoded;
use super::{panorama, undistort};
use crate::Picture;
use crate::error::{DatasetError, Result};
use crate::formats::source::{DepthFile, Frame};

/// Where the depth maps of views lie that do not name theirs, below the folder of the dataset.
pub(crate) const FOLDER: &str = "depths";
/// World units of a step of metric maps that do not say, those of a map in millimetres in a world in metres (nerfstudio).
pub(crate) const DEFAULT_UNIT: f64 = 1e-3;

/// The meaning of the values of a depth map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthKind {
    /// Depths.
    Metric,
    /// Disparities up to a scale and a shift: larger where depths are smaller.
    Relative,
}

/// The depth map of a view, pixel by pixel. It is kept as it is stored, and shared by the copies of a dataset, since maps
/// of all views are in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    pub kind: DepthKind,
    /// [height × width] of the picture of the view, row by row; 0 where nothing is known or the pixel does not count.
    pub steps: Arc<[u16]>,
    /// Size of one step: world units of depth; or, if relative, 1/65535.
    pub step: f64,
}

impl DepthMap {
    /// The map of positive `depths` [height × width], world units, in the finest steps that hold them all. A relative
    /// map has the disparities from 1/65535 for the farthest to 1 for the nearest.
    pub fn from_depths(kind: DepthKind, depths: &[f32]) -> Self {
        let most = f64::from(u16::MAX);
        let (near, far) = depths.iter().fold((f64::INFINITY, 0.0f64), |(near, far), &depth| {
            (near.min(f64::from(depth)), far.max(f64::from(depth)))
        });
        let step = if kind == DepthKind::Metric { far / most } else { 1.0 / most };
        let of = |depth: &f32| {
            let depth = f64::from(*depth);
            let steps = match kind {
                DepthKind::Metric => depth / step,
                DepthKind::Relative if far > near => {
                    1.0 + (most - 1.0) * (depth.recip() - far.recip()) / (near.recip() - far.recip())
                }
                DepthKind::Relative => most,
            };
            (steps.round() as u16).max(1)
        };
        Self { kind, steps: depths.iter().map(of).collect(), step }
    }

    /// The value at row-major pixel `pixel`: a depth in world units, or a relative disparity up to 1; `None` where nothing
    /// is known.
    pub fn value(&self, pixel: usize) -> Option<f64> {
        let steps = self.steps[pixel];
        (steps > 0).then(|| f64::from(steps) * self.step)
    }

    /// The map, which is of the photograph that `taken` took, for the `picture` that was made of it for `camera`.
    pub(crate) fn seen_by(&self, camera: &Camera, taken: &Camera, picture: &Picture) -> Self {
        let mut steps = sampled(&self.steps, [taken.width, taken.height], self.kind, camera, taken);
        picture.clear_ignored(&mut steps);
        Self { steps: steps.into(), ..*self }
    }
}

/// Reads the depth map of `frame` for its finished `picture` and the `camera` of that. Each pixel takes the value of the map
/// where it lies, without interpolation: between the depths on both sides of an edge there is nothing. Pixels that do not
/// count have unknown depth.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Decode`]; [`DatasetError::DepthType`] unless it is a 16-bit grey PNG, or an
/// 8-bit one if relative; [`DatasetError::Aspect`] unless it has the aspect of the photograph.
pub(crate) fn read(
    file: &DepthFile,
    kind: DepthKind,
    frame: &Frame,
    camera: &Camera,
    picture: &Picture,
) -> Result<DepthMap> {
    let path = &file.path;
    let map = match (decoded(path)?, kind) {
        (DynamicImage::ImageLuma16(map), _) => map,
        (map @ DynamicImage::ImageLuma8(_), DepthKind::Relative) => map.into_luma16(),
        (other, _) => {
            let found = format!("{:?}", other.color());
            let expected = match kind {
                DepthKind::Metric => "grey with 16 bits",
                DepthKind::Relative => "grey with 16 or 8 bits",
            };
            return Err(DatasetError::DepthType { path: path.clone(), found, expected });
        }
    };
    let (width, height) = (map.width() as usize, map.height() as usize);
    frame.check_aspect(path, [width, height], &["depth map", "map of this photograph"])?;
    let step = if kind == DepthKind::Metric { file.unit } else { 1.0 / f64::from(u16::MAX) };
    let mut steps = match frame.panorama {
        Some(part) => panorama::cut_depth(map.as_raw(), [width, height], kind, part.face, camera.width),
        None => sampled(map.as_raw(), [width, height], kind, camera, &frame.camera),
    };
    picture.clear_ignored(&mut steps);
    Ok(DepthMap { kind, steps: steps.into(), step })
}

/// [height × width] the steps that the pixels of the picture of `camera` have in the map, `steps` [rows × columns], of the
/// photograph that `taken` took. The camera is that one, or the pinhole camera that is made of it, at any size. Metric depths
/// become those of `camera`.
fn sampled(steps: &[u16], [columns, rows]: [usize; 2], kind: DepthKind, camera: &Camera, taken: &Camera) -> Vec<u16> {
    let straightens = taken.lens.is_some() && camera.lens.is_none();
    let is_distance = kind == DepthKind::Metric && straightens && taken.lens.is_some_and(|lens| lens.is_wide());
    let full = camera.resized(taken.width, taken.height);
    let at = |position: f64, of: usize, count: usize| {
        ((position / of as f64 * count as f64).max(0.0) as usize).min(count - 1)
    };
    let value = |pixel: usize| {
        let x = (pixel % camera.width) as f64 + 0.5;
        let y = (pixel / camera.width) as f64 + 0.5;
        // at full size, then on the photograph
        let (x, y) = (x * taken.width as f64 / camera.width as f64, y * taken.height as f64 / camera.height as f64);
        let (u, v) = if straightens { undistort::source_position(taken, &full, x, y) } else { (x, y) };
        let steps = steps[at(v, taken.height, rows) * columns + at(u, taken.width, columns)];
        if !is_distance || steps == 0 {
            return steps;
        }
        let z_of_distance = full.ray(x, y).map_or(1.0, |ray| ray.z / ray.length());
        ((f64::from(steps) * z_of_distance).round() as u16).max(1)
    };
    (0..camera.width * camera.height).map(value).collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use image::{GrayImage, ImageBuffer, Luma};

    use super::*;
    use crate::fixtures::{
        self, Encoding, assert_refused, colmap_folder, nerfstudio_frame, write_mask, write_transforms,
    };
    use crate::{BuiltinOptions, LoadOptions, MaxResolution, View, builtin, builtin_geometry, load};

    fn of_kind(kind: DepthKind) -> LoadOptions {
        LoadOptions { depth: Some(kind), ..LoadOptions::default() }
    }

    /// 1000 + 100 x + y in column x, row y; 0 in the first pixel.
    fn step(x: usize, y: usize) -> u16 {
        if (x, y) == (0, 0) { 0 } else { (1000 + 100 * x + y) as u16 }
    }

    fn write_map(path: &Path, width: usize, height: usize) {
        let map = ImageBuffer::from_fn(width as u32, height as u32, |x, y| Luma([step(x as usize, y as usize)]));
        fixtures::save(path, map);
    }

    /// Nine photographs of 24 × 16 px, of which the first and the last are held out, and a map beside each.
    fn colmap(width: usize, height: usize) -> tempfile::TempDir {
        let scene = fixtures::scene(9);
        let folder = colmap_folder(&scene, Encoding::Text);
        for image in &scene.images {
            write_map(&folder.path().join(FOLDER).join(&image.name), width, height);
        }
        folder
    }

    #[track_caller]
    fn refused(folder: &Path, parts: &[&str]) {
        assert_refused(folder, &of_kind(DepthKind::Metric), parts);
    }

    #[test]
    fn maps_beside_photographs_are_read_in_thousandths_for_training_views_alone() {
        let folder = colmap(24, 16);
        let data = load(folder.path(), &of_kind(DepthKind::Metric)).unwrap();
        for view in &data.train {
            let map = view.depth.as_ref().unwrap();
            assert_eq!((map.kind, map.steps.len()), (DepthKind::Metric, 24 * 16));
            assert_eq!(map.value(0), None);
            assert!((map.value(3 * 24 + 5).unwrap() - 1.503).abs() < 1e-12);
        }
        assert!(data.test.len() == 2 && data.test.iter().all(|view| view.depth.is_none()));
        let without = load(folder.path(), &LoadOptions::default()).unwrap();
        assert!(without.train.iter().all(|view| view.depth.is_none()));
        let relative = of_kind(DepthKind::Relative);
        let data = load(folder.path(), &relative).unwrap();
        let value = data.train[0].depth.as_ref().unwrap().value(3 * 24 + 5).unwrap();
        assert!((value - 1503.0 / 65535.0).abs() < 1e-12);
    }

    #[test]
    fn every_pixel_takes_the_value_of_the_map_where_it_lies() {
        let folder = colmap(24, 16);
        let halved = LoadOptions { max_resolution: MaxResolution(12), ..of_kind(DepthKind::Metric) };
        let map = load(folder.path(), &halved).unwrap().train[0].depth.clone().unwrap();
        assert_eq!(map.steps.len(), 12 * 8);
        // the middle of pixel (4, 3) is a corner between four pixels of the map
        assert_eq!(map.steps[3 * 12 + 4], step(9, 7));
        let folder = colmap(12, 8);
        let map = load(folder.path(), &of_kind(DepthKind::Metric)).unwrap().train[0].depth.clone().unwrap();
        assert_eq!((map.steps.len(), map.steps[3 * 24 + 5], map.steps[3 * 24 + 6]), (24 * 16, step(2, 1), step(3, 1)));
    }

    #[test]
    fn nothing_is_known_of_pixels_that_do_not_count() {
        let folder = colmap(24, 16);
        write_mask(&folder.path().join("masks/left/003.png"), [24, 16], 6);
        for memory in [0, usize::MAX] {
            let data = load(folder.path(), &LoadOptions { memory, ..of_kind(DepthKind::Metric) }).unwrap();
            let known = |name: &str, pixel: usize| {
                let view = data.train.iter().find(|view| view.name == name).unwrap();
                view.depth.as_ref().unwrap().value(pixel).is_some()
            };
            let in_row_3 = |name: &str| [5, 6].map(|x| known(name, 3 * 24 + x));
            assert_eq!((in_row_3("left/003.png"), in_row_3("left/002.png")), ([false, true], [true, true]));
        }
    }

    fn nerfstudio(folder: &Path, global: &str, of_frame: &str) {
        let frame = |index: usize| nerfstudio_frame(folder, &index.to_string(), [index, 3], of_frame);
        let frames: Vec<String> = (0..3).map(frame).collect();
        write_transforms(&folder.join("transforms.json"), &format!(r#"{global} "fl_x": 20.0"#), &frames);
    }

    #[test]
    fn frames_name_their_maps_and_the_file_their_unit() {
        let folder = tempfile::tempdir().unwrap();
        write_map(&folder.path().join("lidar/a.png"), 24, 16);
        let of_frame = r#""depth_file_path": "lidar/a.png","#;
        let value = || {
            let data = load(folder.path(), &of_kind(DepthKind::Metric)).unwrap();
            data.train[0].depth.as_ref().unwrap().value(5).unwrap()
        };
        nerfstudio(folder.path(), "", of_frame);
        assert!((value() - 1.5).abs() < 1e-12);
        nerfstudio(folder.path(), r#""depth_unit_scale_factor": 0.01,"#, of_frame);
        assert!((value() - 15.0).abs() < 1e-12);
        nerfstudio(folder.path(), r#""depth_unit_scale_factor": 0.0,"#, of_frame);
        refused(folder.path(), &["transforms.json: `depth_unit_scale_factor` is 0"]);
        nerfstudio(folder.path(), "", r#""depth_file_path": "lidar/gone.png","#);
        let parts =
            ["gone.png", "of view `images/1.png` is missing", "transforms.json", "remove its `depth_file_path`"];
        refused(folder.path(), &parts);
        // without maps it does not matter
        assert_eq!(load(folder.path(), &LoadOptions::default()).unwrap().train.len(), 2);
        // photographs in `images` have their maps in `depths`
        nerfstudio(folder.path(), "", "");
        refused(folder.path(), &["depths has no depth maps", "data.depth"]);
        write_map(&folder.path().join("depths/2.png"), 24, 16);
        let data = load(folder.path(), &of_kind(DepthKind::Metric)).unwrap();
        assert_eq!(data.train.iter().map(|view| view.depth.is_some()).collect::<Vec<_>>(), [false, true]);
    }

    #[test]
    fn dots_in_the_names_of_photographs_lead_to_their_own_maps() {
        for (extension, map) in [("", "v1.2.png"), ("", "v1.2.png.png"), (".png", "v1.2.png"), (".png", "v1.2.png.png")]
        {
            let folder = tempfile::tempdir().unwrap();
            let frame = |index: usize| {
                let frame = nerfstudio_frame(folder.path(), &format!("v1.{index}"), [index, 3], "");
                frame.replace(".png", extension)
            };
            let frames: Vec<String> = (0..3).map(frame).collect();
            write_transforms(&folder.path().join("transforms.json"), r#""fl_x": 20.0"#, &frames);
            write_map(&folder.path().join(FOLDER).join(map), 24, 16);
            // of a photograph that is not there
            write_map(&folder.path().join("depths/v1.png"), 24, 16);
            let data = load(folder.path(), &of_kind(DepthKind::Metric)).unwrap();
            let known: Vec<bool> = data.train.iter().map(|view| view.depth.is_some()).collect();
            assert_eq!(known, [false, true], "{extension:?}, {map}");
        }
    }

    #[test]
    fn maps_keep_the_lens_of_their_photographs_or_are_undistorted_with_them() {
        let lenses = [(r#""k1": 0.2,"#, false), (r#""camera_model": "OPENCV_FISHEYE", "k1": 0.01,"#, true)];
        for (lens, is_wide) in lenses {
            let folder = tempfile::tempdir().unwrap();
            write_map(&folder.path().join("depths/1.png"), 24, 16);
            nerfstudio(folder.path(), lens, "");
            let [bent, straight] = [false, true].map(|undistort| {
                let options = LoadOptions { undistort, ..of_kind(DepthKind::Metric) };
                load(folder.path(), &options).unwrap().train[0].clone()
            });
            assert!(bent.camera.lens.is_some_and(|lens| lens.is_wide() == is_wide) && straight.camera.lens.is_none());
            let expected: Vec<u16> = (0..24 * 16).map(|pixel| step(pixel % 24, pixel / 24)).collect();
            assert_eq!(bent.depth.unwrap().steps[..], expected);
            // where the lens shows what the pinhole camera has at (20.5, 12.5)
            let (u, v, _) = bent.camera.project(straight.camera.unproject(20.5, 12.5, 1.0)).unwrap();
            let ray = straight.camera.ray(20.5, 12.5).unwrap();
            let z_of_depth = if is_wide { 1.0 / ray.length() } else { 1.0 };
            let expected = (f64::from(step(u as usize, v as usize)) * z_of_depth).round() as u16;
            assert_eq!(straight.depth.unwrap().steps[12 * 24 + 20], expected);
        }
    }

    #[test]
    fn maps_of_the_built_in_scene_are_exact_through_its_lens_and_without_it() {
        let (train_views, test_views, points) = (1, 0, 0);
        let options = BuiltinOptions { train_views, test_views, points, supersampling: 1, ..Default::default() };
        let options = BuiltinOptions { fisheye: true, depth: Some(DepthKind::Metric), ..options };
        let view = builtin(&options).train.remove(0);
        let median_error = |view: &View| {
            let (depth, _) = builtin_geometry(&view.camera);
            let map = view.depth.as_ref().unwrap();
            let error = |(pixel, depth): (usize, &f32)| (map.value(pixel).unwrap() / f64::from(*depth) - 1.0).abs();
            let mut errors: Vec<f64> = depth.iter().enumerate().map(error).collect();
            errors.sort_by(f64::total_cmp);
            errors[errors.len() / 2]
        };
        assert!(median_error(&view) < 1e-3);
        // the corners are behind the camera
        let distance = view.depth.as_ref().unwrap().value(0).unwrap();
        let corner = view.camera.unproject(0.5, 0.5, distance);
        assert!((corner.distance(view.camera.centre()) - distance).abs() < 1e-9);
        assert!(view.camera.without_lens().depth(corner) < 0.0);
        let straight = view.undistorted().unwrap().unwrap();
        let error = median_error(&straight);
        assert!(straight.camera.lens.is_none() && error < 0.03, "{error}");
    }

    #[test]
    fn maps_of_another_size_or_type_are_refused() {
        let parts = ["depths/left/001.png", "24x20", "24x16", "images.txt", "use the map of this photograph"];
        refused(colmap(24, 20).path(), &parts);
        let folder = colmap(24, 16);
        let path = folder.path().join(FOLDER).join("left/003.png");
        fixtures::write_png(&path, 24, 16, [9; 3]);
        refused(folder.path(), &["left/003.png", "Rgb8", "16 bits"]);
        fixtures::save(&path, GrayImage::from_pixel(24, 16, Luma([51])));
        refused(folder.path(), &["L8"]);
        let relative = of_kind(DepthKind::Relative);
        let data = load(folder.path(), &relative).unwrap();
        assert!((data.train[2].depth.as_ref().unwrap().value(0).unwrap() - 0.2).abs() < 1e-6);
        std::fs::write(&path, "no picture").unwrap();
        refused(folder.path(), &["left/003.png"]);
    }

    #[test]
    fn the_built_in_scene_has_the_maps_of_its_depth() {
        let of = |kind| {
            let options = BuiltinOptions { width: 24, height: 24, train_views: 2, points: 0, ..Default::default() };
            builtin(&BuiltinOptions { depth: kind, ..options })
        };
        assert!(of(None).train.iter().all(|view| view.depth.is_none()));
        let (metric, relative) = (of(Some(DepthKind::Metric)), of(Some(DepthKind::Relative)));
        assert!(metric.test.iter().all(|view| view.depth.is_none()));
        for (metric, relative) in metric.train.iter().zip(&relative.train) {
            let (depth, _) = builtin_geometry(&metric.camera);
            let (z, r) = (metric.depth.as_ref().unwrap(), relative.depth.as_ref().unwrap());
            assert!((0..24 * 24).all(|pixel| (z.value(pixel).unwrap() - f64::from(depth[pixel])).abs() < 1e-4));
            // a scale and a shift make depths of the disparities
            let [near, far] =
                [depth.iter().copied().fold(f32::MAX, f32::min), depth.iter().copied().fold(0.0, f32::max)];
            let [near, far] = [near, far].map(|depth| f64::from(depth).recip());
            for (pixel, depth) in depth.iter().enumerate() {
                let share = (r.value(pixel).unwrap() - 1.0 / 65535.0) * 65535.0 / 65534.0;
                assert!((far + share * (near - far) - f64::from(*depth).recip()).abs() < 1e-4);
            }
        }
    }
}

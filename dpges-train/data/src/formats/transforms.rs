//! `transforms*.json`, which Blender, instant-ngp and nerfstudio datasets share.
//!
//! Poses map camera to world with OpenGL axes (y up, looking along −z). Intrinsics at the top level apply to all
//! frames, intrinsics in a frame to that frame.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use dpges_core::camera::{Camera, CameraFromWorld, Distortion, Projection};
use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;
use serde_json::{Map, Value};

use super::source::{DepthFile, Frame, PanoramaPart, Source, Split, lens};
use crate::error::{DatasetError, Result, not_json, read_text};
use crate::finding::Kind;
use crate::folder::Folder;
use crate::image::codec;
use crate::image::depth::DEFAULT_UNIT;

/// Largest entry of RᵀR / s² − I, where s is the scale of R, with which a pose is made a rotation; other poses are refused.
const MOST_SHEARED: f64 = 0.03;
/// The same, and the difference of s from 1, up to which that is not said.
const ROUNDED: f64 = 2e-3;
/// Difference of an entry of the last row of a pose from 0 0 0 1, by which it is rounded.
const LAST_ROW_ROUNDED: f64 = 1e-6;
/// The expectation of a pose, for messages.
pub(super) const ROTATION: &str = "a rotation without shear or mirroring";
/// Beginnings of keys of a lens that the others do not describe, and whole ones.
const LENS_WORDS: [&str; 9] = [
    "ftheta",
    "equirectangular",
    "latlong",
    "orthographic",
    "panorama",
    "spherical",
    "distortion",
    "fisheye_p",
    "omnidirectional",
];
const LENS_COEFFICIENTS: [&str; 8] = ["k5", "k6", "s1", "s2", "s3", "s4", "xi", "omega"];
/// Keys of focal lengths, and of fields of view that say the same.
const LENGTHS: [&str; 2] = ["fl_x", "fl_y"];
const ANGLES: [&str; 2] = ["camera_angle_x", "camera_angle_y"];
/// Difference between a focal length and that of an angle, as a share, up to which it is not said.
const MOST_APART: f64 = 0.01;

#[derive(Clone, Debug, Deserialize)]
pub(crate) struct Transforms {
    /// World units of depth of a step of the depth maps; 0.001 if absent.
    depth_unit_scale_factor: Option<f64>,
    /// Point cloud in the frame of the poses.
    pub ply_file_path: Option<String>,
    train_filenames: Option<Vec<String>>,
    val_filenames: Option<Vec<String>>,
    test_filenames: Option<Vec<String>>,
    frames: Vec<JsonFrame>,
    /// Those that are held out (ScanNet++).
    #[serde(default)]
    test_frames: Vec<JsonFrame>,
    /// [`Intrinsics`] of all frames.
    #[serde(flatten)]
    intrinsics: Map<String, Value>,
}

#[derive(Clone, Debug, Deserialize)]
struct JsonFrame {
    file_path: String,
    mask_path: Option<String>,
    /// 4×4 or 3×4, row by row.
    transform_matrix: Vec<Vec<f64>>,
    depth_file_path: Option<String>,
    /// Its own, which take the place of those of all.
    #[serde(flatten)]
    intrinsics: Map<String, Value>,
}

/// Lengths in px, angles in radians.
#[derive(Clone, Debug, Deserialize)]
struct Intrinsics {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    /// Horizontal and vertical field of view.
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    #[serde(flatten)]
    others: Map<String, Value>,
}

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Json`].
pub(crate) fn read_transforms(path: &Path) -> Result<Transforms> {
    parse(path, &read_text(path)?)
}

fn parse(path: &Path, text: &str) -> Result<Transforms> {
    let file: Transforms = serde_json::from_str(text).map_err(|error| {
        let reason = serde_json::from_str::<Value>(text).ok().and_then(|value| fault(&value));
        reason
            .map_or_else(|| not_json(path, text, &error), |reason| DatasetError::Json { path: path.to_owned(), reason })
    })?;
    for frames in [&file.frames, &file.test_frames] {
        if let Some(index) = frames.iter().position(|frame| name(&frame.file_path).is_empty()) {
            let what = format!("the `file_path` of frame {} of {}", index + 1, frames.len());
            return Err(DatasetError::malformed(path, what, "empty", "the path of a photograph"));
        }
    }
    Ok(file)
}

/// Why a file of JSON has no [`Transforms`], as far as its shape or its frames tell.
fn fault(file: &Value) -> Option<String> {
    if !file.is_object() {
        let found = if file.is_array() { "a list" } else { "a single value" };
        return Some(format!("it is {found}, expected an object with a list `frames`"));
    }
    let frames = file.get("frames")?.as_array()?;
    frames.iter().enumerate().find_map(|(index, frame)| {
        let error = JsonFrame::deserialize(frame).err()?;
        let name = frame.get("file_path").and_then(Value::as_str).map(|path| format!(" ({})", name(path)));
        let (number, count) = (index + 1, frames.len());
        Some(format!("frame {number} of {count}{}: {error}", name.unwrap_or_default()))
    })
}

/// The path a dataset gives a file, with `/` between its parts and without the leading `./`.
pub(super) fn name(file_path: &str) -> String {
    file_path.replace('\\', "/").trim_start_matches("./").to_owned()
}

/// The cameras of the file at `path` and their names, in its order; `None` if it is JSON without frames. Photographs need not be
/// there.
///
/// # Errors
/// As [`Transforms::frames`].
pub(crate) fn cameras(path: &Path) -> Result<Option<Vec<(String, Camera)>>> {
    let text = read_text(path)?;
    if !serde_json::from_str::<Value>(&text).is_ok_and(|file| file.get("frames").is_some()) {
        return Ok(None);
    }
    let file = parse(path, &text)?;
    let folder = Folder::read(path.parent().unwrap_or(path));
    let names = file.picture_names();
    let pictures = folder.pictures(&names.iter().map(String::as_str).collect::<Vec<_>>(), &[""]);
    let camera = |((frame, name), picture): ((&JsonFrame, String), Option<PathBuf>)| {
        let (camera_from_world, _) = camera_from_world(path, &name, &frame.transform_matrix)?;
        let intrinsics = file.intrinsics_of(frame, path)?;
        if picture.is_none() && (intrinsics.w.is_none() || intrinsics.h.is_none()) {
            let reason =
                format!("view `{name}` has no `w` and `h`, and its picture is not there: add its size in pixels");
            return Err(DatasetError::Json { path: path.to_owned(), reason });
        }
        let picture = picture.unwrap_or_else(|| folder.root.join(&name));
        let (camera, _) = intrinsics.camera(path, &name, &picture, camera_from_world)?;
        Ok((name, camera))
    };
    file.frames.iter().zip(names).zip(pictures).map(camera).collect::<Result<_>>().map(Some)
}

impl Transforms {
    /// The pictures that the frames name.
    pub fn picture_names(&self) -> Vec<String> {
        self.frames.iter().map(|frame| name(&frame.file_path)).collect()
    }

    /// With the frames in place of its own that it holds out itself, if it does.
    pub fn held_out(&self) -> Option<Self> {
        let frames = self.test_frames.clone();
        (!frames.is_empty()).then(|| Self { frames, ..self.clone() })
    }

    /// The lists of names of pictures to train on, to test on, and to validate on.
    pub fn listed(&self) -> [&Option<Vec<String>>; 3] {
        [&self.train_filenames, &self.test_filenames, &self.val_filenames]
    }

    /// Whether it has no more than Blender's: a field of view for all pictures.
    pub fn is_of_blender(&self) -> bool {
        let has = |key: &&str| self.intrinsics.contains_key(*key);
        self.ply_file_path.is_none() && !["camera_model", "w", "fl_x", "fl_y"].iter().any(has)
    }

    /// Those of `frame` in the file at `path`: its own before those of all.
    fn intrinsics_of(&self, frame: &JsonFrame, path: &Path) -> Result<Intrinsics> {
        let own = &frame.intrinsics;
        let mut all = self.inherited(own);
        all.extend(own.clone());
        serde_json::from_value(all.into()).map_err(|error| {
            let reason = format!("the intrinsics of view `{}`: {error}", name(&frame.file_path));
            DatasetError::Json { path: path.to_owned(), reason }
        })
    }

    /// Those of the file for a frame with its `own`: without lengths and angles where it has an angle alone, and with the principal
    /// point of a picture of its size.
    fn inherited(&self, own: &Map<String, Value>) -> Map<String, Value> {
        let mut all = self.intrinsics.clone();
        let has = |key: &&str| number(own, key).is_some();
        if ANGLES.iter().any(has) && !LENGTHS.iter().any(has) {
            all.retain(|key, _| !LENGTHS.iter().chain(&ANGLES).any(|focal| focal == key));
        }
        for (side, centre) in [("w", "cx"), ("h", "cy")] {
            let [own_side, side, at] = [number(own, side), number(&all, side), number(&all, centre)];
            if let (Some(own_side), Some(side), Some(at)) = (own_side, side, at)
                && own_side != side
            {
                all.insert(centre.to_owned(), (at * own_side / side).into());
            }
        }
        all
    }

    /// `fl_x` and `camera_angle_x` of the `frame`, or of the file if it has neither, where they contradict each other in a picture
    /// that is `width` px wide.
    fn contradiction(&self, frame: &JsonFrame, width: usize) -> Option<String> {
        let is_own = [LENGTHS, ANGLES].as_flattened().iter().any(|key| number(&frame.intrinsics, key).is_some());
        let block = if is_own { &frame.intrinsics } else { &self.intrinsics };
        let [Some(length), Some(angle)] = [LENGTHS[0], ANGLES[0]].map(|key| number(block, key)) else { return None };
        let from_angle = 0.5 * number(block, "w").unwrap_or(width as f64) / (0.5 * angle).tan();
        let is_said = (from_angle / length - 1.0).abs() > MOST_APART;
        is_said.then(|| format!("`fl_x` {length} px, `camera_angle_x` {angle}, that is {from_angle:.1} px"))
    }

    /// Adds the frames of the file at `path` whose pictures are in `folder` to `source`, all in `split`, sorted by name.
    ///
    /// # Errors
    /// [`DatasetError`] for unknown lenses, poses that are no rigid motions.
    pub fn add_frames(&self, folder: &Folder, path: &Path, split: Split, source: &mut Source) -> Result<()> {
        let unit = self.depth_unit_scale_factor.unwrap_or(DEFAULT_UNIT);
        if !(unit.is_finite() && unit > 0.0) {
            let what = "`depth_unit_scale_factor`".to_owned();
            return Err(DatasetError::malformed(path, what, unit, "a positive number"));
        }
        let names = self.picture_names();
        let pictures = folder.pictures(&names.iter().map(String::as_str).collect::<Vec<_>>(), &[""]);
        let file = |path: &str| folder.get(path).cloned().unwrap_or_else(|| folder.root.join(name(path)));
        let (mut scaled, mut contradictions) = (Vec::new(), Vec::new());
        for ((frame, name), image) in self.frames.iter().zip(names).zip(pictures) {
            let Some(image) = image else {
                source.missing.push(folder.root.join(name));
                continue;
            };
            let intrinsics = self.intrinsics_of(frame, path)?;
            let (camera_from_world, scale) = camera_from_world(path, &name, &frame.transform_matrix)?;
            scaled.extend(scale.map(|scale| (name.clone(), scale)));
            let (camera, panorama) = intrinsics.camera(path, &name, &image, camera_from_world)?;
            let contradiction = self.contradiction(frame, camera.width).filter(|_| panorama.is_none());
            contradictions.extend(contradiction.map(|found| format!("{name} ({found})")));
            source.frames.push(Frame {
                camera,
                panorama,
                name,
                image,
                mask: frame.mask_path.as_deref().map(file),
                is_sized: intrinsics.w.is_some() && intrinsics.h.is_some(),
                header: None,
                split,
                described_in: path.to_owned(),
                depth: frame.depth_file_path.as_deref().map(|path| DepthFile { path: file(path), unit }),
            });
        }
        source.frames.sort_by(|a, b| a.name.cmp(&b.name));
        source.say_scaled(&scaled);
        let what = "views have a focal length and an angle that contradict each other";
        let advice = "the length is used; remove the wrong one";
        source.notices.add_names(Kind::Intrinsics, what, &contradictions, advice);
        source.used.push(path.to_owned());
        Ok(())
    }
}

/// Negates the y and z columns (OpenGL to OpenCV axes) and inverts. Returns the scale of the rotation, too, if that is not quite
/// one.
fn camera_from_world(path: &Path, view: &str, matrix: &[Vec<f64>]) -> Result<(CameraFromWorld, Option<f64>)> {
    let malformed = |found: String, expected| {
        DatasetError::malformed(path, format!("the transform_matrix of view `{view}`"), found, expected)
    };
    if !(3..=4).contains(&matrix.len()) || matrix.iter().any(|row| row.len() != 4) {
        let columns: Vec<usize> = matrix.iter().map(Vec::len).collect();
        return Err(malformed(format!("of rows of {columns:?} numbers"), "3 or 4 rows of 4 numbers"));
    }
    if let Some(last) = matrix.get(3) {
        check_last_row(path, &format!("the transform_matrix of view `{view}`"), last)?;
    }
    let column = |j: usize| DVec3::new(matrix[0][j], matrix[1][j], matrix[2][j]);
    let world_from_camera = DMat3::from_cols(column(0), -column(1), -column(2));
    let centre = column(3);
    if !world_from_camera.is_finite() || !centre.is_finite() {
        return Err(malformed(format!("{matrix:?}"), "finite numbers"));
    }
    rigid(world_from_camera, centre).ok_or_else(|| malformed(format!("{matrix:?}"), ROTATION))
}

/// # Errors
/// [`DatasetError::Malformed`] for another last row of a pose of four rows than that of a motion, 0 0 0 1.
pub(super) fn check_last_row(path: &Path, of: &str, row: &[f64]) -> Result<()> {
    if row.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(found, expected)| (found - expected).abs() <= LAST_ROW_ROUNDED) {
        return Ok(());
    }
    let expected = "[0, 0, 0, 1] (is the matrix transposed?)";
    Err(DatasetError::malformed(path, format!("the last row of {of}"), format!("{row:?}"), expected))
}

/// The pose of a camera at `centre` whose OpenCV axes are the columns of a matrix, up to its scale, which is returned if it is not
/// quite one, or the matrix not quite a rotation. `None` if it is sheared or mirrored.
pub(super) fn rigid(world_from_camera: DMat3, centre: DVec3) -> Option<(CameraFromWorld, Option<f64>)> {
    let scale = world_from_camera.determinant().cbrt();
    let mut rotation = world_from_camera * scale.recip();
    let error = rotation.transpose() * rotation - DMat3::IDENTITY;
    let worst = error.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    if !(worst <= MOST_SHEARED && scale > 0.0) {
        return None;
    }
    // the nearest rotation (Higham)
    for _ in 0..4 {
        rotation = 0.5 * (rotation + rotation.inverse().transpose());
    }
    let rotation = DMat3::from_quat(DQuat::from_mat3(&rotation).normalize()).transpose();
    let is_said = worst > ROUNDED || (scale - 1.0).abs() > ROUNDED;
    Some((CameraFromWorld { rotation, translation: -(rotation * centre) }, is_said.then_some(scale)))
}

impl Intrinsics {
    /// Fills gaps: the size from the image, square pixels, a centred principal point. Of a panorama, which shows all directions
    /// whatever its focal lengths, the front.
    fn camera(
        &self,
        path: &Path,
        view: &str,
        image: &Path,
        camera_from_world: CameraFromWorld,
    ) -> Result<(Camera, Option<PanoramaPart>)> {
        let projection = self.projection(path, view)?;
        let (width, height) = match (self.w, self.h) {
            (Some(width), Some(height)) => (width.round() as usize, height.round() as usize),
            _ => {
                let header = codec::header(image)?;
                (header.width, header.height)
            }
        };
        let Some(projection) = projection else {
            let (front, camera) = PanoramaPart::front([width, height], camera_from_world);
            return Ok((camera, Some(front)));
        };
        let (w, h) = (width as f64, height as f64);
        let from_angle = |key: &str, angle: Option<f64>, side: f64| match angle {
            Some(angle) if !(angle > 0.0 && angle < PI) => {
                let expected = "an angle between 0 and π, in radians (is it in degrees?)";
                Err(DatasetError::malformed(path, format!("`{key}` of view `{view}`"), angle, expected))
            }
            _ => Ok(angle.map(|angle| 0.5 * side / (0.5 * angle).tan())),
        };
        let fx = self.fl_x.map_or_else(|| from_angle("camera_angle_x", self.camera_angle_x, w), |fl| Ok(Some(fl)))?;
        let fy = self.fl_y.map_or_else(|| from_angle("camera_angle_y", self.camera_angle_y, h), |fl| Ok(Some(fl)))?;
        let lacks_one = || DatasetError::NoFocalLength { path: path.to_owned(), view: view.to_owned() };
        let (fx, fy) = (fx.or(fy).ok_or_else(lacks_one)?, fy.or(fx).ok_or_else(lacks_one)?);
        let or_zero = |coefficient: Option<f64>| coefficient.unwrap_or(0.0);
        let distortion = Distortion {
            numerator: [self.k1, self.k2, self.k3, self.k4, None, None].map(or_zero),
            tangential: [self.p1, self.p2].map(or_zero),
            ..Distortion::new(projection)
        };
        let (cx, cy) = (self.cx.unwrap_or(0.5 * w), self.cy.unwrap_or(0.5 * h));
        let lens = lens(distortion);
        Ok((Camera { camera_from_world, fx, fy, cx, cy, width, height, near: 0.0, lens }, None))
    }

    /// That of the lens; `None` for panoramas.
    fn projection(&self, path: &Path, view: &str) -> Result<Option<Projection>> {
        let refused = |model: &str, reason| {
            let (path, model) = (path.to_owned(), model.to_owned());
            Err(DatasetError::CameraModel { path, camera: format!("view `{view}`"), model, reason })
        };
        let is_of_lens =
            |key: &str| LENS_WORDS.iter().any(|word| key.starts_with(word)) || LENS_COEFFICIENTS.contains(&key);
        if let Some((word, _)) =
            self.others.iter().find(|(key, value)| is_of_lens(&key.to_lowercase()) && !is_nothing(value))
        {
            return refused(word, "this word is understood by none of the models here");
        }
        let model = self.camera_model.as_deref().map(str::to_uppercase);
        match (model.as_deref(), self.is_fisheye.unwrap_or(false)) {
            (None, true) => Ok(Some(Projection::Equidistant)),
            (
                None | Some("SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "PERSPECTIVE"),
                false,
            ) => Ok(Some(Projection::Perspective)),
            (Some("OPENCV_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" | "FISHEYE" | "SIMPLE_FISHEYE"), _) => {
                Ok(Some(Projection::Equidistant))
            }
            (Some(model), true) => refused(model, "`is_fisheye` contradicts it"),
            (Some(model @ "EQUIRECTANGULAR"), _) => {
                let coefficients = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2];
                match coefficients.iter().flatten().any(|&coefficient| coefficient != 0.0) {
                    true => refused(model, "it has coefficients of distortion, which panoramas have not"),
                    false => Ok(None),
                }
            }
            (Some(model), _) => refused(model, "it is unknown here"),
        }
    }
}

/// The number that a block of intrinsics has under a key.
fn number(block: &Map<String, Value>, key: &str) -> Option<f64> {
    block.get(key)?.as_f64()
}

/// Whether a value says that there is no such thing.
fn is_nothing(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::Number(number) => number.as_f64() == Some(0.0),
        Value::Array(values) => values.iter().all(is_nothing),
        Value::String(text) => text.is_empty(),
        Value::Bool(true) | Value::Object(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::assert_says;

    fn pose(matrix: [[f64; 4]; 3]) -> Result<CameraFromWorld> {
        camera_from_world(Path::new("transforms.json"), "a", &matrix.map(|row| row.to_vec())).map(|(pose, _)| pose)
    }

    #[test]
    fn opengl_axes_become_opencv_axes() {
        // In OpenGL axes an identity pose looks along −z with y up.
        let found = pose([[1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 1.0, 4.0]]).unwrap();
        let expected = CameraFromWorld::look_at(DVec3::new(2.0, 3.0, 4.0), DVec3::new(2.0, 3.0, 0.0), DVec3::Y);
        assert!((found.rotation - expected.rotation).to_cols_array().iter().all(|e| e.abs() < 1e-15));
        assert!((found.translation - expected.translation).length() < 1e-15);
        assert!((found.centre() - DVec3::new(2.0, 3.0, 4.0)).length() < 1e-15);
    }

    #[test]
    fn poses_that_are_no_rigid_motion_are_refused() {
        let sheared = pose([[1.0, 0.2, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let mirrored = pose([[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let infinite = pose([[1.0, 0.0, 0.0, f64::INFINITY], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let short =
            camera_from_world(Path::new("transforms.json"), "a", &[vec![1.0; 4], vec![1.0; 3]]).map(|(pose, _)| pose);
        for (result, expected) in
            [(sheared, "without shear"), (mirrored, "mirroring"), (infinite, "finite"), (short, "3 or 4 rows")]
        {
            assert_says(result.unwrap_err(), &["transforms.json: the transform_matrix of view `a`", expected]);
        }
    }

    #[test]
    fn scaled_and_rounded_rotations_are_made_rotations_and_said() {
        let (sin, cos) = 0.3f64.sin_cos();
        let exact = [[cos, -sin, 0.0, 1.0], [sin, cos, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0]];
        let changed = |change: &dyn Fn(f64) -> f64| {
            exact.map(|row| [change(row[0]), change(row[1]), change(row[2]), row[3]].to_vec())
        };
        let read = |matrix: &[Vec<f64>]| camera_from_world(Path::new("transforms.json"), "a", matrix).unwrap();
        let (expected, none) = read(&changed(&|x| x));
        assert_eq!(none, None);
        for (matrix, scale) in [(changed(&|x| 0.5 * x), 0.5), (changed(&|x| (100.0 * x).round() / 100.0), 1.0)] {
            let (found, said) = read(&matrix);
            let apart = (found.rotation - expected.rotation).to_cols_array();
            assert!(apart.iter().all(|x| x.abs() < 5e-3) && (said.unwrap() - scale).abs() < 5e-3, "{said:?}");
            assert!(
                (found.rotation.transpose() * found.rotation - DMat3::IDENTITY)
                    .to_cols_array()
                    .iter()
                    .all(|x| x.abs() < 1e-12)
            );
            assert!((found.centre() - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-12);
        }
    }
}

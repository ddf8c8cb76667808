//! `transforms*.json`, which Blender and nerfstudio datasets share.
//!
//! Poses map camera to world with OpenGL axes (y up, looking along −z). Intrinsics at the top level apply to all
//! frames, intrinsics in a frame to that frame.

use std::path::{Path, PathBuf};

use dpges_core::camera::{Camera, CameraFromWorld, Distortion, Projection};
use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use super::source::{DepthFile, Frame, Split, lens};
use crate::dataset::error::{DatasetError, Result, read};
use crate::dataset::image::codec;
use crate::dataset::image::depth::DEFAULT_UNIT;

/// Largest entry of RᵀR − I with which a pose is made orthonormal; other poses are refused.
const ROTATION_TOLERANCE: f64 = 1e-3;

#[derive(Clone, Debug, Deserialize)]
pub(super) struct Transforms {
    #[serde(flatten)]
    intrinsics: Intrinsics,
    /// World units of depth of a step of the depth maps; 0.001 if absent.
    depth_unit_scale_factor: Option<f64>,
    /// Point cloud in the frame of the poses.
    pub ply_file_path: Option<String>,
    pub train_filenames: Option<Vec<String>>,
    pub val_filenames: Option<Vec<String>>,
    pub test_filenames: Option<Vec<String>>,
    frames: Vec<JsonFrame>,
}

#[derive(Clone, Debug, Deserialize)]
struct JsonFrame {
    file_path: String,
    mask_path: Option<String>,
    /// 4×4 or 3×4, row by row.
    transform_matrix: Vec<Vec<f64>>,
    depth_file_path: Option<String>,
    #[serde(flatten)]
    intrinsics: Intrinsics,
}

/// Lengths in px, angles in radians.
#[derive(Clone, Debug, Deserialize)]
struct Intrinsics {
    camera_model: Option<String>,
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
    /// Horizontal field of view.
    camera_angle_x: Option<f64>,
}

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Json`].
pub(super) fn read_transforms(path: &Path) -> Result<Transforms> {
    serde_json::from_slice(&read(path)?).map_err(|source| DatasetError::Json { path: path.to_owned(), source })
}

/// The path a dataset gives a file, without the leading `./`.
pub(super) fn name(file_path: &str) -> &str {
    file_path.trim_start_matches("./")
}

impl Transforms {
    /// The frames of the file at `path` in the dataset in folder `root`, all in `split`, sorted by name.
    ///
    /// # Errors
    /// [`DatasetError`] for missing images, unknown lenses, poses that are no rigid motions.
    pub fn frames(&self, root: &Path, path: &Path, split: Split) -> Result<Vec<Frame>> {
        let unit = self.depth_unit_scale_factor.unwrap_or(DEFAULT_UNIT);
        if !(unit.is_finite() && unit > 0.0) {
            let what = "`depth_unit_scale_factor`".to_owned();
            return Err(DatasetError::malformed(path, what, unit, "a positive number"));
        }
        let mut frames: Vec<Frame> = self
            .frames
            .iter()
            .map(|frame| {
                let name = name(&frame.file_path).to_owned();
                let image = image_path(root, path, &name)?;
                let intrinsics = frame.intrinsics.clone().or(&self.intrinsics);
                let camera = intrinsics.camera(path, &name, &image, &frame.transform_matrix)?;
                let mask = frame.mask_path.as_deref().map(|path| root.join(self::name(path)));
                let depth = frame.depth_file_path.as_ref().map(|file| DepthFile { path: root.join(file), unit });
                let described_in = path.to_owned();
                Ok(Frame { name, image, mask, camera, split, described_in, depth })
            })
            .collect::<Result<_>>()?;
        frames.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(frames)
    }
}

/// The image file. Blender scenes omit its extension.
fn image_path(root: &Path, described_in: &Path, name: &str) -> Result<PathBuf> {
    ["", ".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"]
        .iter()
        .map(|extension| root.join(format!("{name}{extension}")))
        .find(|path| path.is_file())
        .ok_or_else(|| DatasetError::missing_image(root.join(name), name, described_in))
}

/// Negates the y and z columns (OpenGL to OpenCV axes) and inverts.
fn camera_from_world(path: &Path, view: &str, matrix: &[Vec<f64>]) -> Result<CameraFromWorld> {
    let malformed = |found: String, expected| {
        DatasetError::malformed(path, format!("the transform_matrix of view `{view}`"), found, expected)
    };
    if matrix.len() < 3 || matrix.iter().any(|row| row.len() != 4) {
        let columns: Vec<usize> = matrix.iter().map(Vec::len).collect();
        return Err(malformed(format!("of rows of {columns:?} numbers"), "3 or 4 rows of 4 numbers"));
    }
    let column = |j: usize| DVec3::new(matrix[0][j], matrix[1][j], matrix[2][j]);
    let world_from_camera = DMat3::from_cols(column(0), -column(1), -column(2));
    let centre = column(3);
    if !world_from_camera.is_finite() || !centre.is_finite() {
        return Err(malformed(format!("{matrix:?}"), "finite numbers"));
    }
    let error = world_from_camera.transpose() * world_from_camera - DMat3::IDENTITY;
    let worst = error.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    if worst > ROTATION_TOLERANCE || world_from_camera.determinant() < 0.0 {
        return Err(malformed(format!("{matrix:?}"), "a rotation without scale, shear or mirroring"));
    }
    let rotation = DMat3::from_quat(DQuat::from_mat3(&world_from_camera).normalize()).transpose();
    Ok(CameraFromWorld { rotation, translation: -(rotation * centre) })
}

impl Intrinsics {
    /// The frame's own values, and those of the file where the frame has none.
    fn or(self, file: &Self) -> Self {
        Self {
            camera_model: self.camera_model.or_else(|| file.camera_model.clone()),
            w: self.w.or(file.w),
            h: self.h.or(file.h),
            fl_x: self.fl_x.or(file.fl_x),
            fl_y: self.fl_y.or(file.fl_y),
            cx: self.cx.or(file.cx),
            cy: self.cy.or(file.cy),
            k1: self.k1.or(file.k1),
            k2: self.k2.or(file.k2),
            k3: self.k3.or(file.k3),
            k4: self.k4.or(file.k4),
            p1: self.p1.or(file.p1),
            p2: self.p2.or(file.p2),
            camera_angle_x: self.camera_angle_x.or(file.camera_angle_x),
        }
    }

    /// Fills gaps: the size from the image, square pixels, a centred principal point.
    fn camera(&self, path: &Path, view: &str, image: &Path, matrix: &[Vec<f64>]) -> Result<Camera> {
        let projection = self.projection(path, view)?;
        let (width, height) = match (self.w, self.h) {
            (Some(width), Some(height)) => (width.round() as usize, height.round() as usize),
            _ => {
                let header = codec::header(image)?;
                (header.width, header.height)
            }
        };
        let (w, h) = (width as f64, height as f64);
        let from_angle = self.camera_angle_x.map(|angle| 0.5 * w / (0.5 * angle).tan());
        let fx = self
            .fl_x
            .or(from_angle)
            .ok_or_else(|| DatasetError::NoFocalLength { path: path.to_owned(), view: view.to_owned() })?;
        let or_zero = |coefficient: Option<f64>| coefficient.unwrap_or(0.0);
        let distortion = Distortion {
            numerator: [self.k1, self.k2, self.k3, self.k4, None, None].map(or_zero),
            tangential: [self.p1, self.p2].map(or_zero),
            ..Distortion::new(projection)
        };
        let (fy, cx, cy) = (self.fl_y.unwrap_or(fx), self.cx.unwrap_or(0.5 * w), self.cy.unwrap_or(0.5 * h));
        let (camera_from_world, lens) = (camera_from_world(path, view, matrix)?, lens(distortion));
        Ok(Camera { camera_from_world, fx, fy, cx, cy, width, height, near: 0.0, lens })
    }

    fn projection(&self, path: &Path, view: &str) -> Result<Projection> {
        let model = self.camera_model.as_deref().unwrap_or("OPENCV").to_uppercase();
        let reason = match model.as_str() {
            "SIMPLE_PINHOLE" | "PINHOLE" | "SIMPLE_RADIAL" | "RADIAL" | "OPENCV" | "PERSPECTIVE" => {
                return Ok(Projection::Perspective);
            }
            "OPENCV_FISHEYE" => return Ok(Projection::Equidistant),
            "EQUIRECTANGULAR" => "panoramas do not fit a pinhole camera",
            _ => "it is unknown here",
        };
        Err(DatasetError::CameraModel { path: path.to_owned(), camera: format!("view `{view}`"), model, reason })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixtures::assert_says;

    fn pose(matrix: [[f64; 4]; 3]) -> Result<CameraFromWorld> {
        camera_from_world(Path::new("transforms.json"), "a", &matrix.map(|row| row.to_vec()))
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
        let scaled = pose([[2.0, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0], [0.0, 0.0, 2.0, 0.0]]);
        let mirrored = pose([[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let infinite = pose([[1.0, 0.0, 0.0, f64::INFINITY], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
        let short = camera_from_world(Path::new("transforms.json"), "a", &[vec![1.0; 4], vec![1.0; 3]]);
        for (result, expected) in
            [(scaled, "without scale"), (mirrored, "mirroring"), (infinite, "finite"), (short, "3 or 4 rows")]
        {
            assert_says(result.unwrap_err(), &["transforms.json: the transform_matrix of view `a`", expected]);
        }
    }
}

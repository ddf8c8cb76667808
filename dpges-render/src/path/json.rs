//! Paths as files, in the convention of the `cameras.json` of 3DGS: a list of cameras with `id`, `img_name`, `width`,
//! `height`, `position` (the centre), `rotation` (rows of the rotation from camera to world axes, OpenCV), `fx`, `fy`.
//! `cx`, `cy` and `near` are added here; where a file has none, the principal point is the middle of the picture.

use std::io::Write;
use std::path::{Path, PathBuf};

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::atomic::write_atomically;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::CameraPath;

/// Why there is no path.
#[derive(Debug, thiserror::Error)]
pub enum PathError {
    #[error("a camera path needs at least one camera")]
    Empty,
    #[error("cannot read camera path {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error("camera path {path}: {reason}; expected a list of cameras as in the cameras.json of 3DGS")]
    File { path: PathBuf, reason: String },
    #[error(transparent)]
    Write(#[from] dpges_core::Error),
}

#[derive(Serialize, Deserialize)]
struct Entry {
    id: usize,
    img_name: String,
    width: usize,
    height: usize,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    fx: f64,
    fy: f64,
    cx: Option<f64>,
    cy: Option<f64>,
    near: Option<f64>,
}

impl Entry {
    fn new(id: usize, camera: &Camera) -> Self {
        // columns of the transpose are rows of the rotation to camera axes
        let rows = camera.camera_from_world.rotation.to_cols_array_2d();
        Self {
            id,
            img_name: format!("{id:05}"),
            width: camera.width,
            height: camera.height,
            position: camera.centre().to_array(),
            rotation: rows,
            fx: camera.fx,
            fy: camera.fy,
            cx: Some(camera.cx),
            cy: Some(camera.cy),
            near: Some(camera.near),
        }
    }

    fn camera(&self, near: f64) -> Result<Camera, String> {
        let rotation = DMat3::from_cols_array_2d(&self.rotation);
        let square = rotation * rotation.transpose();
        if !square.abs_diff_eq(DMat3::IDENTITY, 1e-3) || rotation.determinant() < 0.0 {
            return Err(format!("`rotation` of camera {} is no rotation", self.id));
        }
        let camera = Camera {
            camera_from_world: CameraFromWorld { rotation, translation: -(rotation * DVec3::from(self.position)) },
            fx: self.fx,
            fy: self.fy,
            cx: self.cx.unwrap_or(0.5 * self.width as f64),
            cy: self.cy.unwrap_or(0.5 * self.height as f64),
            width: self.width,
            height: self.height,
            near: self.near.unwrap_or(near),
            lens: None,
        };
        camera.validate().map_err(|error| format!("camera {}: {error}", self.id))?;
        Ok(camera)
    }
}

impl CameraPath {
    /// The key cameras as text of a `cameras.json`.
    pub fn to_json(&self) -> String {
        let entries: Vec<Entry> = self.keys().iter().enumerate().map(|(id, camera)| Entry::new(id, camera)).collect();
        serde_json::to_string_pretty(&entries).expect("numbers and names become JSON")
    }

    /// An open path from the text of a `cameras.json`. Cameras without a near plane have `near`.
    ///
    /// # Errors
    /// A message that names the problem.
    pub fn from_json(text: &str, near: f64) -> Result<Self, String> {
        let entries: Vec<Entry> = serde_json::from_str(text).map_err(|error| error.to_string())?;
        let keys = entries.iter().map(|entry| entry.camera(near)).collect::<Result<Vec<_>, _>>()?;
        Self::new(keys, false).map_err(|error| error.to_string())
    }

    /// # Errors
    /// [`PathError::Write`].
    pub fn save(&self, path: &Path) -> Result<(), PathError> {
        Ok(write_atomically(path, |file| file.write_all(self.to_json().as_bytes()))?)
    }

    /// Reads key cameras from `path`, see [`from_json`](Self::from_json).
    ///
    /// # Errors
    /// [`PathError::Read`], [`PathError::File`].
    pub fn load(path: &Path, near: f64) -> Result<Self, PathError> {
        let text = std::fs::read_to_string(path).map_err(|source| PathError::Read { path: path.to_owned(), source })?;
        Self::from_json(&text, near).map_err(|reason| PathError::File { path: path.to_owned(), reason })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;

    #[test]
    fn what_was_saved_is_loaded() {
        let path = CameraPath::new(vec![camera([4.0, 0.0, 1.0], 50.0), camera([0.0, 4.0, 1.5], 60.0)], false).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cameras.json");
        path.save(&file).unwrap();
        let loaded = CameraPath::load(&file, 0.5).unwrap();
        for (a, b) in path.keys().iter().zip(loaded.keys()) {
            let (a_pose, b_pose) = (a.camera_from_world, b.camera_from_world);
            assert!((a.centre() - b.centre()).length() < 1e-12 && (a.fx, a.near) == (b.fx, b.near));
            assert!(a_pose.rotation.abs_diff_eq(b_pose.rotation, 1e-12));
        }
    }

    /// A camera 5 before the origin that looks along +x, with z up.
    #[test]
    fn rotations_are_rows_from_camera_to_world() {
        let text = r#"[{"id": 3, "img_name": "a", "width": 40, "height": 20, "position": [-5, 0, 0],
            "rotation": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], "fy": 30, "fx": 30}]"#;
        let path = CameraPath::from_json(text, 0.25).unwrap();
        let camera = path.keys()[0];
        assert_eq!((camera.cx, camera.cy, camera.near), (20.0, 10.0, 0.25));
        let (x, y, depth) = camera.project(DVec3::new(0.0, 1.0, 1.0)).unwrap();
        assert!((x - 14.0).abs() < 1e-9 && (y - 4.0).abs() < 1e-9 && (depth - 5.0).abs() < 1e-9, "{x} {y} {depth}");
    }

    #[test]
    fn foreign_files_are_named_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cameras.json");
        for (text, reason) in [
            ("{}", "expected a sequence"),
            ("[]", "at least one camera"),
            (r#"[{"id": 0}]"#, "img_name"),
            (
                r#"[{"id": 7, "img_name": "", "width": 1, "height": 1, "position": [0, 0, 0],
                "rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 1, "fy": 1}]"#,
                "`rotation` of camera 7",
            ),
        ] {
            std::fs::write(&file, text).unwrap();
            let error = CameraPath::load(&file, 0.1).unwrap_err().to_string();
            assert!(error.contains("cameras.json") && error.contains(reason), "{error}");
        }
        assert!(matches!(CameraPath::load(&folder.path().join("none"), 0.1), Err(PathError::Read { .. })));
    }
}

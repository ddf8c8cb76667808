//! Cameras in files. Paths are written in the convention of the `cameras.json` of 3DGS: a list of cameras with `id`,
//! `img_name`, `width`, `height`, `position` (the centre), `rotation` (rows of the rotation from camera to world axes, OpenCV),
//! `fx`, `fy`. `cx`, `cy` and `near` are added here; where a file has none, the principal point is the middle of the picture.
//!
//! The `camera_path.json` of nerfstudio's viewer is read as well: `camera_path` of `camera_to_world` (16 numbers row by row,
//! OpenGL) and the vertical `fov` in degrees, for pictures of `render_width` × `render_height`.

use std::io::Write;
use std::path::{Path, PathBuf};

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::SceneInfo;
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
    #[error(
        "camera path {path}: {reason}; expected a list of cameras as in the cameras.json of 3DGS, or nerfstudio's camera_path"
    )]
    File { path: PathBuf, reason: String },
    #[error(transparent)]
    Write(#[from] dpges_core::Error),
}

#[derive(Serialize, Deserialize)]
struct Entry {
    id: usize,
    #[serde(default)]
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
    fn new(id: usize, name: &str, camera: &Camera) -> Self {
        // columns of the transpose are rows of the rotation to camera axes
        let rows = camera.camera_from_world.rotation.to_cols_array_2d();
        Self {
            id,
            img_name: name.to_owned(),
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

/// The file of nerfstudio's viewer.
#[derive(Deserialize)]
struct Track {
    camera_path: Vec<Pose>,
    render_width: f64,
    render_height: f64,
    #[serde(default)]
    camera_type: Option<String>,
}

#[derive(Deserialize)]
struct Pose {
    camera_to_world: Vec<f64>,
    fov: f64,
}

impl Track {
    fn cameras(self, near: f64) -> Result<Vec<Camera>, String> {
        let (width, height) = (self.render_width.round() as usize, self.render_height.round() as usize);
        if let Some(other) = self.camera_type.filter(|kind| !kind.eq_ignore_ascii_case("perspective")) {
            return Err(format!("`camera_type` is `{other}`, and only `perspective` is drawn"));
        }
        let camera = |(id, pose): (usize, Pose)| {
            let [x, y, z, centre] = columns(&pose.camera_to_world).ok_or_else(|| {
                format!("`camera_to_world` of camera {id} has {} numbers, not 16", pose.camera_to_world.len())
            })?;
            let rotation = [[x.x, -y.x, -z.x], [x.y, -y.y, -z.y], [x.z, -y.z, -z.z]];
            let focal = 0.5 * self.render_height / (0.5 * pose.fov.to_radians()).tan();
            let (img_name, near) = (String::new(), Some(near));
            let position = centre.to_array();
            Entry { id, img_name, width, height, position, rotation, fx: focal, fy: focal, cx: None, cy: None, near }
                .camera(0.0)
        };
        self.camera_path.into_iter().enumerate().map(camera).collect()
    }
}

/// The columns of three rows of four numbers.
fn columns(rows: &[f64]) -> Option<[DVec3; 4]> {
    let at = |row: usize, column: usize| rows.get(4 * row + column).copied();
    let column = |column| Some(DVec3::new(at(0, column)?, at(1, column)?, at(2, column)?));
    Some([column(0)?, column(1)?, column(2)?, column(3)?])
}

/// A camera and its name in its file.
pub type NamedCamera = (String, Camera);

/// `camera` of a file, in the coordinates of a scene. Files have the coordinates of the dataset; what is nearer to the origin
/// of the scene than to that of the dataset is in its coordinates already, as in files of earlier versions.
pub fn in_scene(camera: Camera, info: &SceneInfo) -> Camera {
    let (offset, centre) = (DVec3::from_array(info.offset), camera.centre());
    let shift = if centre.length() < (centre - offset).length() { DVec3::ZERO } else { offset };
    Camera { camera_from_world: camera.camera_from_world.recentred(shift), ..camera }
}

impl CameraPath {
    /// The key cameras as text of a `cameras.json`, in the coordinates that they have.
    pub fn to_json(&self) -> String {
        let named = |(id, camera): (usize, &Camera)| (format!("{id:05}"), *camera);
        to_json(&self.keys().iter().enumerate().map(named).collect::<Vec<_>>())
    }

    /// An open path from the text of a file. Cameras without a near plane have `near`.
    ///
    /// # Errors
    /// A message that names the problem.
    pub fn from_json(text: &str, near: f64) -> Result<Self, String> {
        let keys = named_cameras(text, near)?.into_iter().map(|(_, camera)| camera).collect();
        Self::new(keys, false).map_err(|error| error.to_string())
    }

    /// Writes the path of a scene, in the coordinates of its dataset.
    ///
    /// # Errors
    /// [`PathError::Write`].
    pub fn save(&self, path: &Path, info: &SceneInfo) -> Result<(), PathError> {
        let out = -DVec3::from_array(info.offset);
        let moved = |key: &Camera| Camera { camera_from_world: key.camera_from_world.recentred(out), ..*key };
        let moved = Self { keys: self.keys().iter().map(moved).collect(), closed: self.closed };
        Ok(write_atomically(path, |file| file.write_all(moved.to_json().as_bytes()))?)
    }

    /// Reads key cameras of a scene from `path`, see [`load_cameras`].
    ///
    /// # Errors
    /// [`PathError::Read`], [`PathError::File`].
    pub fn load(path: &Path, info: &SceneInfo) -> Result<Self, PathError> {
        Self::new(load_cameras(path, info)?.into_iter().map(|(_, camera)| camera).collect(), false)
    }
}

/// The cameras of the file at `path`, in its order, in the coordinates of a scene and with its near plane if they have none.
///
/// # Errors
/// [`PathError::Read`], [`PathError::File`].
pub fn load_cameras(path: &Path, info: &SceneInfo) -> Result<Vec<NamedCamera>, PathError> {
    let text = std::fs::read_to_string(path).map_err(|source| PathError::Read { path: path.to_owned(), source })?;
    cameras_from_json(&text, info).map_err(|reason| PathError::File { path: path.to_owned(), reason })
}

/// The same from the text of a file.
///
/// # Errors
/// A message that names the problem.
pub fn cameras_from_json(text: &str, info: &SceneInfo) -> Result<Vec<NamedCamera>, String> {
    let cameras = named_cameras(text.trim_start_matches('\u{feff}'), info.near)?;
    Ok(cameras.into_iter().map(|(name, camera)| (name, in_scene(camera, info))).collect())
}

/// `cameras` as text of a `cameras.json`, in the coordinates that they have.
pub fn to_json(cameras: &[NamedCamera]) -> String {
    let entries: Vec<Entry> =
        cameras.iter().enumerate().map(|(id, (name, camera))| Entry::new(id, name, camera)).collect();
    serde_json::to_string_pretty(&entries).expect("numbers and names become JSON")
}

/// Names are empty where the file has none.
fn named_cameras(text: &str, near: f64) -> Result<Vec<NamedCamera>, String> {
    if text.trim_start().starts_with('{') {
        let track: Track = serde_json::from_str(text).map_err(|error| error.to_string())?;
        return Ok(track.cameras(near)?.into_iter().map(|camera| (String::new(), camera)).collect());
    }
    let entries: Vec<Entry> = serde_json::from_str(text).map_err(|error| error.to_string())?;
    entries.into_iter().map(|entry| Ok((entry.img_name.clone(), entry.camera(near)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;

    fn info(offset: [f64; 3]) -> SceneInfo {
        SceneInfo { offset, near: 0.5, ..SceneInfo::default() }
    }

    #[test]
    fn what_was_saved_is_loaded_and_lies_where_the_dataset_does() {
        let path = CameraPath::new(vec![camera([4.0, 0.0, 1.0], 50.0), camera([0.0, 4.0, 1.5], 60.0)], false).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cameras.json");
        let info = info([448_251.0, 5_411_933.0, 213.0]);
        path.save(&file, &info).unwrap();
        let loaded = CameraPath::load(&file, &info).unwrap();
        for (a, b) in path.keys().iter().zip(loaded.keys()) {
            let (a_pose, b_pose) = (a.camera_from_world, b.camera_from_world);
            assert!((a.centre() - b.centre()).length() < 1e-8 && (a.fx, a.near) == (b.fx, b.near));
            assert!(a_pose.rotation.abs_diff_eq(b_pose.rotation, 1e-12));
        }
        // a file in the coordinates of the scene
        std::fs::write(&file, path.to_json()).unwrap();
        let loaded = CameraPath::load(&file, &info).unwrap();
        assert!((loaded.keys()[1].centre() - path.keys()[1].centre()).length() < 1e-12);
        std::fs::write(&file, path.to_json().replace("\"00001\"", "\"shot b.png\"")).unwrap();
        assert_eq!(load_cameras(&file, &info).unwrap()[1].0, "shot b.png");
    }

    /// A camera 5 before the origin that looks along +x, with z up.
    #[test]
    fn conventions_of_programs_show_the_same() {
        let text = r#"[{"id": 3, "img_name": "a", "width": 40, "height": 20, "position": [-5, 0, 0],
            "rotation": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], "fy": 30, "fx": 30}]"#;
        // tan(fov / 2) = 10 / 30
        let track = r#"{"camera_type": "perspective", "render_width": 40, "render_height": 20, "fps": 24, "camera_path":
            [{"camera_to_world": [0, 0, -1, -5, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1], "fov": 36.86989764584402, "aspect": 2}]}"#;
        for text in [text, track] {
            let path = CameraPath::from_json(text, 0.25).unwrap();
            let camera = path.keys()[0];
            assert_eq!((camera.cx, camera.cy, camera.near), (20.0, 10.0, 0.25));
            let (x, y, depth) = camera.project(DVec3::new(0.0, 1.0, 1.0)).unwrap();
            assert!((x - 14.0).abs() < 1e-9 && (y - 4.0).abs() < 1e-9 && (depth - 5.0).abs() < 1e-9, "{x} {y} {depth}");
        }
        let error = CameraPath::from_json(&track.replace("perspective", "equirectangular"), 0.25).unwrap_err();
        assert!(error.contains("equirectangular"), "{error}");
        assert!(
            CameraPath::from_json(&track.replace(", 0, 0, 0, 0, 1]", "]"), 0.25).unwrap_err().contains("11 numbers")
        );
    }

    #[test]
    fn foreign_files_are_named_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("cameras.json");
        for (text, reason) in [
            ("{}", "camera_path"),
            ("[]", "at least one camera"),
            (r#"[{"id": 0}]"#, "width"),
            (
                r#"[{"id": 7, "img_name": "", "width": 1, "height": 1, "position": [0, 0, 0],
                "rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 1, "fy": 1}]"#,
                "`rotation` of camera 7",
            ),
        ] {
            std::fs::write(&file, text).unwrap();
            let error = CameraPath::load(&file, &info([0.0; 3])).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
        assert!(matches!(CameraPath::load(&folder.path().join("none"), &info([0.0; 3])), Err(PathError::Read { .. })));
    }
}

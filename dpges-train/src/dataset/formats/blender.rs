//! NeRF-Synthetic scenes: `transforms_{train,val,test}.json`, one field of view, RGBA images, no points.

use std::path::Path;

use super::source::{RawPoints, Source, Split};
use super::transforms::read_transforms;
use crate::dataset::Format;
use crate::dataset::error::Result;

/// Trains on `transforms_train.json` and holds out `transforms_test.json`, or else `transforms_val.json`.
///
/// # Errors
/// [`crate::dataset::DatasetError`] from [`super::transforms`].
pub(in crate::dataset) fn read(root: &Path) -> Result<Source> {
    let train_path = root.join("transforms_train.json");
    let mut frames = read_transforms(&train_path)?.frames(root, &train_path, Split::Train)?;
    let held_out = ["transforms_test.json", "transforms_val.json"].map(|name| root.join(name));
    if let Some(path) = held_out.iter().find(|path| path.is_file()) {
        frames.extend(read_transforms(path)?.frames(root, path, Split::Test)?);
    }
    Ok(Source {
        format: Format::Blender,
        frames,
        points: RawPoints::default(),
        described_in: train_path,
        no_test_reason: "there is neither transforms_test.json nor transforms_val.json, or it lists no frames",
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixtures::{self, transform_matrix};
    use crate::dataset::{DatasetError, LoadOptions, load};

    fn write(folder: &Path, file: &str, names: &[&str]) {
        let frames: Vec<String> = names
            .iter()
            .enumerate()
            .map(|(index, name)| {
                fixtures::write_rgba(&folder.join(format!("{name}.png")), 20, 10, [255, 0, 0, 51]);
                let matrix = transform_matrix(&fixtures::pose(index, names.len()));
                format!(r#"{{"file_path": "./{name}", "rotation": 0.1, "transform_matrix": {matrix}}}"#)
            })
            .collect();
        let json = format!(r#"{{"camera_angle_x": 0.8, "frames": [{}]}}"#, frames.join(","));
        std::fs::write(folder.join(file), json).unwrap();
    }

    #[test]
    fn poses_field_of_view_alpha_and_split() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "transforms_train.json", &["train/r_0", "train/r_1", "train/r_2"]);
        write(folder.path(), "transforms_val.json", &["val/r_0"]);
        let data = load(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!((data.format, data.near, data.background), (Format::Blender, 0.01, [1.0; 3]));
        assert_eq!((data.train.len(), data.test.len(), data.points.positions.len()), (3, 1, 0));
        let camera = data.train[1].camera;
        let expected = fixtures::pose(1, 3);
        assert!((camera.camera_from_world.rotation - expected.rotation).to_cols_array().iter().all(|e| e.abs() < 1e-9));
        assert!((camera.centre() - expected.centre()).length() < 1e-9);
        assert!((camera.fx - 10.0 / 0.4f64.tan()).abs() < 1e-12);
        assert_eq!((camera.fy, camera.cx, camera.cy), (camera.fx, 10.0, 5.0));
        assert_eq!(data.train[0].picture().unwrap().rgb(4, 4), [1.0, 0.8, 0.8]);

        write(folder.path(), "transforms_test.json", &["test/r_0", "test/r_1"]);
        let black = LoadOptions { background: Some([0.0; 3]), ..Default::default() };
        let data = load(folder.path(), &black).unwrap();
        assert_eq!((data.test.len(), data.test[0].name.as_str()), (2, "test/r_0"));
        assert_eq!(data.train[0].picture().unwrap().rgb(4, 4), [0.2, 0.0, 0.0]);
    }

    #[test]
    fn missing_parts_are_named() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "transforms_train.json", &["train/r_0", "train/r_1"]);
        let error = load(folder.path(), &LoadOptions::default()).unwrap_err();
        assert!(matches!(error, DatasetError::NoTestViews { .. }));
        let message = error.to_string();
        assert!(message.contains("transforms_train.json") && message.contains("transforms_val.json"), "{message}");
        let all = LoadOptions { test_every: 0, ..Default::default() };
        assert_eq!(load(folder.path(), &all).unwrap().train.len(), 2);
        let scaled = LoadOptions { image_scale: Some(4), ..all.clone() };
        let message = load(folder.path(), &scaled).unwrap_err().to_string();
        assert!(message.contains("images_4") && message.contains("transforms_train.json"), "{message}");

        std::fs::remove_file(folder.path().join("train/r_1.png")).unwrap();
        let message = load(folder.path(), &all).unwrap_err().to_string();
        assert!(message.contains("train/r_1") && message.contains("transforms_train.json"), "{message}");
        std::fs::write(folder.path().join("transforms_train.json"), r#"{"frames": []}"#).unwrap();
        let message = load(folder.path(), &all).unwrap_err().to_string();
        assert!(message.contains("transforms_train.json: no views"), "{message}");
        std::fs::write(folder.path().join("transforms_train.json"), r#"{"frames": [NaN]}"#).unwrap();
        let message = load(folder.path(), &all).unwrap_err().to_string();
        assert!(message.contains("transforms_train.json") && message.contains("line 1"), "{message}");
    }
}

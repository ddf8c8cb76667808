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
    use crate::dataset::fixtures::{self, assert_refused, assert_says, transform_matrix, write_transforms};
    use crate::dataset::{DatasetError, LoadOptions, load};

    fn write(folder: &Path, file: &str, names: &[&str]) {
        let frame = |(index, name): (usize, &&str)| {
            fixtures::write_rgba(&folder.join(format!("{name}.png")), 20, 10, [255, 0, 0, 51]);
            let matrix = transform_matrix(&fixtures::pose(index, names.len()));
            format!(r#"{{"file_path": "./{name}", "rotation": 0.1, "transform_matrix": {matrix}}}"#)
        };
        let frames: Vec<String> = names.iter().enumerate().map(frame).collect();
        write_transforms(&folder.join(file), r#""camera_angle_x": 0.8"#, &frames);
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
        let (at, file) = (folder.path(), "transforms_train.json");
        write(at, file, &["train/r_0", "train/r_1"]);
        let error = load(at, &LoadOptions::default()).unwrap_err();
        assert!(matches!(error, DatasetError::NoTestViews { .. }));
        assert_says(error, &[file, "transforms_val.json"]);
        let all = LoadOptions { test_every: 0, ..Default::default() };
        assert_eq!(load(at, &all).unwrap().train.len(), 2);
        let scaled = LoadOptions { image_scale: Some(4), ..all.clone() };
        assert_refused(at, &scaled, &["images_4", file]);

        std::fs::remove_file(at.join("train/r_1.png")).unwrap();
        assert_refused(at, &all, &["train/r_1", file]);
        std::fs::write(at.join(file), r#"{"frames": []}"#).unwrap();
        assert_refused(at, &all, &["transforms_train.json: no views"]);
        std::fs::write(at.join(file), r#"{"frames": [NaN]}"#).unwrap();
        assert_refused(at, &all, &[file, "line 1"]);
    }
}

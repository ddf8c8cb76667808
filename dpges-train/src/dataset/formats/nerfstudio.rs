//! nerfstudio datasets (<https://docs.nerf.studio/quickstart/data_conventions.html>): `transforms.json` with
//! intrinsics for all or for each frame, lens distortion, and an optional point cloud in the frame of the poses.

use std::collections::BTreeSet;
use std::path::Path;

use super::source::{Frame, RawPoints, Source, Split};
use super::transforms::{Transforms, name, read_transforms};
use super::{ply, split};
use crate::dataset::error::Result;
use crate::dataset::{Format, LoadOptions};

/// Held-out frames are, in this order of preference: `test_filenames` of the file, its `val_filenames`, the frames of
/// `transforms_test.json` or `transforms_val.json` beside it, every n-th frame by name.
///
/// # Errors
/// [`crate::dataset::DatasetError`] from [`super::transforms`], and for a point cloud that cannot be read.
pub(in crate::dataset) fn read(root: &Path, options: &LoadOptions) -> Result<Source> {
    let path = root.join("transforms.json");
    let transforms = read_transforms(&path)?;
    let mut frames = transforms.frames(root, &path, Split::Train)?;
    let beside = ["transforms_test.json", "transforms_val.json"].map(|name| root.join(name));
    if let Some(split) = listed_split(&transforms) {
        frames.iter_mut().for_each(|frame| frame.split = split(&frame.name));
    } else if let Some(path) = beside.iter().find(|path| path.is_file()) {
        let held_out = read_transforms(path)?.frames(root, path, Split::Test)?;
        frames = with_held_out(frames, held_out);
    } else {
        let splits = split::every_nth(frames.len(), options.test_every);
        frames.iter_mut().zip(splits).for_each(|(frame, split)| frame.split = split);
    }
    let points = match &transforms.ply_file_path {
        Some(ply_path) => ply::points(&root.join(ply_path))?,
        None => RawPoints::default(),
    };
    Ok(Source {
        format: Format::Nerfstudio,
        frames,
        points,
        described_in: path,
        no_test_reason: "the file that lists held-out frames lists none that exist",
    })
}

/// The split by `train_filenames`, `test_filenames` and `val_filenames`. Frames in none of them are omitted, or are
/// training frames if there is no `train_filenames`.
fn listed_split(transforms: &Transforms) -> Option<impl Fn(&str) -> Split> {
    let set = |names: &Option<Vec<String>>| -> Option<BTreeSet<String>> {
        names.as_ref().map(|names| names.iter().map(|listed| name(listed).to_owned()).collect())
    };
    let (train, val) = (set(&transforms.train_filenames), set(&transforms.val_filenames));
    let (held_out, unused) = match set(&transforms.test_filenames) {
        Some(test) => (Some(test), val),
        None => (val, None),
    };
    (train.is_some() || held_out.is_some()).then_some(move |frame: &str| {
        let within = |set: &Option<BTreeSet<String>>| set.as_ref().is_some_and(|set| set.contains(frame));
        if within(&held_out) {
            Split::Test
        } else if within(&unused) || (train.is_some() && !within(&train)) {
            Split::Neither
        } else {
            Split::Train
        }
    })
}

/// Removes held-out frames from the training frames.
fn with_held_out(train: Vec<Frame>, held_out: Vec<Frame>) -> Vec<Frame> {
    let names: BTreeSet<&str> = held_out.iter().map(|frame| frame.name.as_str()).collect();
    let mut frames: Vec<Frame> = train.into_iter().filter(|frame| !names.contains(frame.name.as_str())).collect();
    frames.extend(held_out);
    frames.sort_by(|a, b| a.name.cmp(&b.name));
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixtures::{self, assert_refused, nerfstudio_frame, write_transforms};
    use crate::dataset::load;

    fn frame(folder: &Path, index: usize, extra: &str) -> String {
        nerfstudio_frame(folder, &format!("{index:02}"), [index, 10], extra)
    }

    const GLOBAL: &str = r#""camera_model": "OPENCV", "w": 24, "h": 16, "fl_x": 20.0, "fl_y": 21.0, "cx": 12.5,
        "cy": 8.0, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0"#;

    #[test]
    fn a_frame_overrides_the_intrinsics_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let own = frame(folder.path(), 2, r#""fl_x": 30.0, "cx": 11.0,"#);
        let frames = [frame(folder.path(), 0, ""), frame(folder.path(), 1, ""), own];
        write_transforms(&folder.path().join("transforms.json"), GLOBAL, &frames);
        let data = load(folder.path(), &LoadOptions { test_every: 2, ..Default::default() }).unwrap();
        assert_eq!((data.format, data.near, data.background), (Format::Nerfstudio, 0.2, [0.0; 3]));
        let camera = data.train[0].camera;
        assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (20.0, 21.0, 12.5, 8.0));
        assert!((camera.centre() - fixtures::pose(1, 10).centre()).length() < 1e-9);
        let camera = data.test[1].camera;
        assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (30.0, 21.0, 11.0, 8.0));
        assert!(data.points.positions.is_empty());
    }

    #[test]
    fn distorted_frames_are_undistorted() {
        let folder = tempfile::tempdir().unwrap();
        let write = |k1: &str| {
            let frames: Vec<_> = (0..3).map(|i| frame(folder.path(), i, k1)).collect();
            write_transforms(&folder.path().join("transforms.json"), r#""camera_angle_x": 1.0"#, &frames);
        };
        write(r#""k1": 0.2,"#);
        let camera = load(folder.path(), &LoadOptions::default()).unwrap().train[0].camera;
        assert!(camera.fx > 12.0 / 0.5f64.tan() && camera.cx == 12.0, "{camera:?}");
        write(r#""k1": 90.0,"#);
        assert_refused(folder.path(), &LoadOptions::default(), &["transforms.json", "cannot be undone"]);
    }

    #[test]
    fn held_out_frames_come_from_lists_or_files_or_every_eighth() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..10).map(|i| frame(folder.path(), i, "")).collect();
        let write =
            |file: &str, header: &str, frames: &[String]| write_transforms(&folder.path().join(file), header, frames);
        let sizes = || {
            let data = load(folder.path(), &LoadOptions::default()).unwrap();
            (data.train.len(), data.test.iter().map(|view| view.name[7..9].to_owned()).collect::<Vec<_>>().join(" "))
        };
        write("transforms.json", GLOBAL, &frames);
        assert_eq!(sizes(), (8, "00 08".to_owned()));
        write("transforms_val.json", GLOBAL, &frames[3..5]);
        assert_eq!(sizes(), (8, "03 04".to_owned()));
        write("transforms_test.json", GLOBAL, &frames[9..]);
        assert_eq!(sizes(), (9, "09".to_owned()));
        let lists = r#", "train_filenames": ["images/00.png", "./images/01.png"], "val_filenames": ["images/02.png"]"#;
        write("transforms.json", &format!("{GLOBAL}{lists}"), &frames);
        assert_eq!(sizes(), (2, "02".to_owned()));
        write("transforms.json", &format!(r#"{GLOBAL}, "test_filenames": ["gone.png"]"#), &frames);
        assert_refused(folder.path(), &LoadOptions::default(), &["transforms.json: no test views"]);
    }

    #[test]
    fn unusable_cameras_name_file_and_model() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..2).map(|i| frame(folder.path(), i, "")).collect();
        let cases = [
            (
                GLOBAL.replace("OPENCV", "FISHEYE624"),
                "camera model FISHEYE624 of view `images/00.png` is not supported: it is unknown here",
            ),
            (r#""w": 24, "h": 16"#.to_owned(), "view `images/00.png` has neither"),
            (GLOBAL.replace("20.0", "-20.0"), "view `images/00.png`: camera `fx` is -20"),
        ];
        for (header, expected) in cases {
            write_transforms(&folder.path().join("transforms.json"), &header, &frames);
            assert_refused(folder.path(), &LoadOptions::default(), &[&format!("transforms.json: {expected}")]);
        }
    }
}

//! nerfstudio datasets (<https://docs.nerf.studio/quickstart/data_conventions.html>): `transforms.json` with
//! intrinsics for all or for each frame, lens distortion, and an optional point cloud in the frame of the poses; and
//! NeRF-Synthetic scenes of Blender: `transforms_{train,val,test}.json`, one field of view, RGBA images, no points.

use std::collections::BTreeSet;
use std::path::Path;

use super::held_out::{self, Named};
use super::ply;
use super::source::{Source, Split};
use super::transforms::{Transforms, read_transforms};
use crate::error::{DatasetError, Result};
use crate::finding::Kind;
use crate::key::{key, parent};
use crate::layout::Layout;
use crate::{Format, LoadOptions};

/// Held-out frames are, in this order of preference: `test_filenames` of the file `train`, its `val_filenames`, the frames of the
/// file `held_out`, the `test_frames` of `train`, those that lists of names in the folder say, every n-th frame by name.
///
/// # Errors
/// [`crate::DatasetError`] from [`super::transforms`], and for a point cloud that cannot be read.
pub(crate) fn read(layout: &Layout, train: &Path, held_out: Option<&Path>, options: &LoadOptions) -> Result<Source> {
    let folder = &layout.folder;
    let transforms = read_transforms(train)?;
    let is_of_blender = layout.format() == Format::Blender && transforms.is_of_blender();
    let format = if is_of_blender { Format::Blender } else { Format::Nerfstudio };
    let mut source = Source::new(format, train.to_owned(), "the file that lists held-out frames lists none that exist");
    transforms.add_frames(folder, train, Split::Train, &mut source)?;
    source.drop_twins()?;
    let apart = || -> Result<_> {
        Ok(match held_out {
            Some(path) => Some((read_transforms(path)?, path)),
            None => transforms.held_out().map(|frames| (frames, train)),
        })
    };
    if transforms.listed().iter().any(|list| list.is_some()) {
        split_as_listed(&transforms, train, layout, &mut source)?;
    } else if let Some((frames, path)) = apart()? {
        frames.add_frames(folder, path, Split::Test, &mut source)?;
        // a view that is in both is held out
        source.frames.sort_by(|a, b| (&a.name, a.split == Split::Train).cmp(&(&b.name, b.split == Split::Train)));
        source.drop_twins()?;
    } else {
        let names: Vec<String> = source.frames.iter().map(|frame| frame.name.clone()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let splits = held_out::from_lists(&[&folder.root], &names, &mut source)?;
        let splits = splits.unwrap_or_else(|| held_out::every_nth(names.len(), options.test_every));
        source.frames.iter_mut().zip(splits).for_each(|(frame, split)| frame.split = split);
    }
    let cloud = |path: String| folder.get(&path).or_else(|| folder.get(parent(&key(&path)).1)).cloned().ok_or(path);
    let named = transforms.ply_file_path.map(cloud).transpose();
    source.points = match named {
        Ok(Some(path)) => {
            let points = ply::points(&path)?;
            source.used.push(path);
            points
        }
        Ok(None) => ply::beside(folder, &folder.root, &mut source.used)?,
        Err(path) => {
            let message = format!("the points that {} names are not there: {path}", train.display());
            source.notices.add(Kind::Missing, message, "restore the file, or remove `ply_file_path`");
            ply::beside(folder, &folder.root, &mut source.used)?
        }
    };
    Ok(source)
}

/// Splits the frames by `train_filenames`, `test_filenames` and `val_filenames`. Frames in none of them are omitted, or are
/// training frames if there is no `train_filenames`. Says which names are those of no frame.
///
/// # Errors
/// [`DatasetError::Malformed`] for a list of names none of which is that of a frame.
fn split_as_listed(transforms: &Transforms, path: &Path, layout: &Layout, source: &mut Source) -> Result<()> {
    let missing: Vec<String> = source.missing.iter().map(|path| layout.folder.key_of(path)).collect();
    let names = source.frames.iter().map(|frame| &frame.name).chain(&missing);
    let named = Named::new(names.map(String::as_str));
    let mut strangers = Vec::new();
    let view = source.frames.first().map_or("", |frame| &frame.name);
    let mut set = |list: &str, names: &Option<Vec<String>>| -> Result<Option<BTreeSet<usize>>> {
        let Some(names) = names else { return Ok(None) };
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let views = named.views(&names);
        if let Some(first) = names.first().filter(|_| views.iter().all(Option::is_none)) {
            let found = format!("`{first}` and others, none of which is the name of a view");
            return Err(DatasetError::malformed(path, format!("`{list}`"), found, format!("names such as `{view}`")));
        }
        strangers
            .extend(names.iter().zip(&views).filter(|(_, view)| view.is_none()).map(|(name, _)| (*name).to_owned()));
        Ok(Some(views.into_iter().flatten().collect()))
    };
    let [train, test, val] = transforms.listed();
    let train = set("train_filenames", train)?;
    let (test, val) = (set("test_filenames", test)?, set("val_filenames", val)?);
    let (held_out, unused) = if test.is_some() { (test, val) } else { (val, None) };
    let within = |set: &Option<BTreeSet<usize>>, frame: usize| set.as_ref().is_some_and(|set| set.contains(&frame));
    for (index, frame) in source.frames.iter_mut().enumerate() {
        frame.split = if within(&held_out, index) {
            Split::Test
        } else if within(&unused, index) || (train.is_some() && !within(&train, index)) {
            Split::Neither
        } else {
            Split::Train
        };
    }
    let what = format!("names in the lists of {} are those of no view", path.display());
    source.notices.add_names(Kind::Missing, &what, &strangers, "correct or remove them");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{
        self, assert_refused, assert_says, nerfstudio_frame, said, transform_matrix, write_transforms,
    };
    use crate::load;

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
        assert_eq!((data.format, data.near, data.background), (Format::Nerfstudio, 2.5e-3 * data.extent, [0.0; 3]));
        let camera = data.train[0].camera;
        assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (20.0, 21.0, 12.5, 8.0));
        assert!((camera.centre() - fixtures::pose(1, 10).centre()).length() < 1e-9);
        let camera = data.test[1].camera;
        assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (30.0, 21.0, 11.0, 8.0));
        assert!(data.points.positions.is_empty());
    }

    #[test]
    fn a_frame_with_an_angle_or_a_size_does_not_inherit_what_contradicts_it() {
        let folder = tempfile::tempdir().unwrap();
        let angle = 2.0 * (12.0f64 / 30.0).atan();
        let own = format!(r#""camera_angle_x": {angle},"#);
        let frames = [
            frame(folder.path(), 0, ""),
            frame(folder.path(), 1, &own),
            frame(folder.path(), 2, r#""w": 12, "h": 8,"#),
        ];
        fixtures::write_png(&folder.path().join("images/02.png"), 12, 8, [9; 3]);
        write_transforms(&folder.path().join("transforms.json"), GLOBAL, &frames);
        let data = load(folder.path(), &LoadOptions { test_every: 0, ..Default::default() }).unwrap();
        let [plain, angled, small] = [0, 1, 2].map(|at| data.train[at].camera);
        assert_eq!((plain.fx, plain.fy, plain.cx, plain.cy), (20.0, 21.0, 12.5, 8.0));
        assert!((angled.fx - 30.0).abs() < 1e-9 && angled.fy == angled.fx && angled.cx == 12.5, "{angled:?}");
        assert_eq!((small.width, small.cx, small.cy), (12, 6.25, 4.0));
        assert_eq!(said(&data), "");
    }

    #[test]
    fn lengths_and_angles_that_contradict_each_other_are_said() {
        let folder = tempfile::tempdir().unwrap();
        let angle = |length: f64| format!(r#""camera_angle_x": {}"#, 2.0 * (12.0 / length).atan());
        let own = [String::new(), r#""fl_x": 30.0,"#.to_owned(), format!(r#""fl_x": 20.0, {},"#, angle(40.0))];
        let frames: Vec<_> = own.iter().enumerate().map(|(index, own)| frame(folder.path(), index, own)).collect();
        let read = |length: f64| {
            write_transforms(&folder.path().join("transforms.json"), &format!("{GLOBAL}, {}", angle(length)), &frames);
            said(&load(folder.path(), &LoadOptions { test_every: 0, ..Default::default() }).unwrap())
        };
        let numbers = "`fl_x` 20 px, `camera_angle_x` 0.58";
        assert_says(read(20.1), &["contradict each other (1): images/02.png", numbers, "40.0 px"]);
        assert_says(read(40.0), &["contradict each other (2): images/00.png", numbers, "40.0 px"]);
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
    fn scannet_holds_out_frames_in_the_file_and_has_its_pictures_beside_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..4).map(|i| frame(folder.path(), i, "").replace("images/", "")).collect();
        let held_out = frame(folder.path(), 4, "").replace("images/", "");
        std::fs::create_dir(folder.path().join("nerfstudio")).unwrap();
        let file = folder.path().join("nerfstudio/transforms.json");
        write_transforms(&file, &format!(r#"{GLOBAL}, "test_frames": [{held_out}]"#), &frames);
        for named in [folder.path(), &folder.path().join("nerfstudio"), &file] {
            let data = load(named, &LoadOptions::default()).unwrap();
            assert_eq!((data.train.len(), data.test.len(), &data.test[0].name[..]), (4, 1, "04.png"), "{named:?}");
        }
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
        let lists = r#", "train_filenames": ["images/00.png", "./Images/01.png"],
            "val_filenames": ["images\\02.png", "images/20.png"]"#;
        write("transforms.json", &format!("{GLOBAL}{lists}"), &frames);
        assert_eq!(sizes(), (2, "02".to_owned()));
        let said = said(&load(folder.path(), &LoadOptions::default()).unwrap());
        assert_says(said, &["transforms.json are those of no view (1): images/20.png", "left out (7): images/03.png"]);
        let lists = r#", "train_filenames": ["00.png", "01.png"], "val_filenames": ["02.png"]"#;
        write("transforms.json", &format!("{GLOBAL}{lists}"), &frames);
        assert_eq!(sizes(), (2, "02".to_owned()));
        write("transforms.json", &format!(r#"{GLOBAL}, "test_filenames": ["gone.png"]"#), &frames);
        assert_refused(
            folder.path(),
            &LoadOptions::default(),
            &["transforms.json", "`test_filenames`", "`gone.png`", "`images/00.png`"],
        );
        write("transforms.json", &format!(r#"{GLOBAL}, "train_filenames": ["gone.png"]"#), &frames);
        assert_refused(folder.path(), &LoadOptions::default(), &["transforms.json", "`train_filenames`", "`gone.png`"]);
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

    /// RGBA pictures of 20 × 10 px without an extension, and their file in the layout of Blender.
    fn write_blender(folder: &Path, file: &str, names: &[&str]) {
        let frame = |(index, name): (usize, &&str)| {
            fixtures::write_rgba(&folder.join(format!("{name}.png")), 20, 10, [255, 0, 0, 51]);
            let matrix = transform_matrix(&fixtures::pose(index, names.len()));
            format!(r#"{{"file_path": "./{name}", "rotation": 0.1, "transform_matrix": {matrix}}}"#)
        };
        let frames: Vec<String> = names.iter().enumerate().map(frame).collect();
        write_transforms(&folder.join(file), r#""camera_angle_x": 0.8"#, &frames);
    }

    #[test]
    fn scenes_of_blender_have_a_field_of_view_alpha_and_a_split() {
        let folder = tempfile::tempdir().unwrap();
        write_blender(folder.path(), "transforms_train.json", &["train/r_0", "train/r_1", "train/r_2"]);
        write_blender(folder.path(), "transforms_val.json", &["val/r_0"]);
        let data = load(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!((data.format, data.background), (Format::Blender, [1.0; 3]));
        assert_eq!((data.train.len(), data.test.len(), data.points.positions.len()), (3, 1, 0));
        let camera = data.train[1].camera;
        let expected = fixtures::pose(1, 3);
        assert!((camera.camera_from_world.rotation - expected.rotation).to_cols_array().iter().all(|e| e.abs() < 1e-9));
        assert!((camera.centre() - expected.centre()).length() < 1e-9);
        assert!((camera.fx - 10.0 / 0.4f64.tan()).abs() < 1e-12);
        assert_eq!((camera.fy, camera.cx, camera.cy), (camera.fx, 10.0, 5.0));
        assert_eq!(data.train[0].picture().unwrap().rgb(4, 4), [1.0, 0.8, 0.8]);

        write_blender(folder.path(), "transforms_test.json", &["test/r_0", "test/r_1"]);
        let black = LoadOptions { background: Some([0.0; 3]), ..Default::default() };
        let data = load(folder.path(), &black).unwrap();
        assert_eq!((data.test.len(), data.test[0].name.as_str()), (2, "test/r_0"));
        assert_eq!(data.train[0].picture().unwrap().rgb(4, 4), [0.2, 0.0, 0.0]);
        assert_says(said(&data), &["transforms_val.json is not used"]);
    }

    #[test]
    fn a_scene_of_blender_may_have_one_file_and_points() {
        let folder = tempfile::tempdir().unwrap();
        let (at, file) = (folder.path(), "transform_train.json");
        let names: Vec<String> = (0..9).map(|index| format!("train/r_{index}")).collect();
        write_blender(at, file, &names.iter().map(String::as_str).collect::<Vec<_>>());
        let header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
        std::fs::write(at.join("points3d.ply"), format!("{header}end_header\n1 2 3\n")).unwrap();
        for path in [at.to_owned(), at.join(file)] {
            let data = load(&path, &LoadOptions::default()).unwrap();
            assert_eq!((data.train.len(), data.test.len()), (7, 2));
            assert_eq!((data.points.positions, data.points.colours), (vec![[1.0, 2.0, 3.0]], vec![[0.5; 3]]));
        }
        let scaled = LoadOptions { image_scale: Some(4), ..LoadOptions::default() };
        assert_refused(at, &scaled, &["images_4"]);
        std::fs::write(at.join(file), r#"{"frames": []}"#).unwrap();
        assert_refused(at, &LoadOptions::default(), &["transform_train.json: no views"]);
        std::fs::write(at.join(file), r#"{"frames": [NaN]}"#).unwrap();
        assert_refused(at, &LoadOptions::default(), &[file, "line 1"]);
    }

    #[test]
    fn words_of_instant_ngp_are_understood_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..2).map(|i| frame(folder.path(), i, "")).collect();
        let path = folder.path().join("transforms.json");
        let read = |header: &str| {
            write_transforms(&path, header, &frames);
            load(&path, &LoadOptions { undistort: false, ..LoadOptions::default() })
        };
        let of = |header: &str| read(header).unwrap().train[0].camera;
        let fisheye = of(r#""is_fisheye": true, "fl_x": 12.0, "k1": 0.05, "aabb_scale": 16"#);
        assert!(fisheye.lens.is_some_and(|lens| lens.is_wide()));
        let same = of(r#""camera_model": "opencv_fisheye", "fl_x": 12.0, "k1": 0.05, "k5": 0.0"#);
        assert_eq!(fisheye, same);
        let angle = 2.0 * (8.0f64 / 20.0).atan();
        for header in [r#""fl_y": 20.0"#.to_owned(), format!(r#""camera_angle_y": {angle}, "is_fisheye": false"#)] {
            let camera = of(&header);
            assert!((camera.fx - 20.0).abs() < 1e-12 && camera.fy == camera.fx && camera.lens.is_none(), "{header}");
        }
        for (words, named) in [
            (r#""equirectangular": true"#, "equirectangular"),
            (r#""ftheta_p0": 0.0, "ftheta_p1": 0.006"#, "ftheta_p1"),
            (r#""distortion_params": [0, 0.1]"#, "distortion_params"),
            (r#""camera_model": "PINHOLE", "is_fisheye": true"#, "`is_fisheye` contradicts it"),
        ] {
            assert_says(read(&format!(r#""fl_x": 20.0, {words}"#)).unwrap_err(), &["transforms.json", named]);
        }
    }

    #[test]
    fn last_rows_other_than_those_of_a_motion_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..2).map(|i| frame(folder.path(), i, "")).collect();
        for last in ["[1, 2, 3, 1]", "[0, 0, 0, 2]"] {
            let frames = [frames[0].clone(), frames[1].replace("[0, 0, 0, 1]", last)];
            write_transforms(&folder.path().join("transforms.json"), GLOBAL, &frames);
            let parts = ["transforms.json: the last row", "view `images/01.png`", "is the matrix transposed?"];
            assert_refused(folder.path(), &LoadOptions::default(), &parts);
        }
    }

    #[test]
    fn intrinsics_in_other_units_are_refused_by_name_and_rare_ones_said() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..2).map(|i| frame(folder.path(), i, "")).collect();
        let sized = r#""w": 240, "h": 160, "#;
        let read = |header: &str| {
            write_transforms(&folder.path().join("transforms.json"), header, &frames);
            load(folder.path(), &LoadOptions { test_every: 0, ..Default::default() })
        };
        for (header, parts) in [
            (r#""camera_angle_x": 39.6"#.to_owned(), ["`camera_angle_x`", "39.6", "in degrees?"]),
            (r#""camera_angle_y": 3.5"#.to_owned(), ["`camera_angle_y`", "3.5", "in radians"]),
            (r#""camera_angle_x": -0.7"#.to_owned(), ["`camera_angle_x`", "-0.7", "in radians"]),
            (format!(r#"{sized}"fl_x": 200, "cx": 0, "cy": 0"#), ["principal point", "0, 0", "240x160"]),
            (format!(r#"{sized}"fl_x": 200, "cx": 0.5, "cy": 0.5"#), ["principal point", "0.5, 0.5", "normalised?"]),
            (format!(r#"{sized}"fl_x": 0.9"#), ["focal length", "0.9", "normalised?"]),
            (r#""fl_x": 200, "cx": 320, "cy": 240"#.to_owned(), ["320, 240", "24x16", "`w` and `h`"]),
        ] {
            assert_says(read(&header).unwrap_err(), &[&["transforms.json", "`images/00.png`"][..], &parts].concat());
        }
        assert_eq!(said(&read(r#""camera_angle_x": 2.9"#).unwrap()), "");
        let outside = read(&format!(r#"{sized}"fl_x": 200, "cx": 300, "cy": 80"#)).unwrap();
        assert_says(said(&outside), &["principal point", "outside", "images/00.png"]);
        let short = read(&format!(r#"{sized}"fl_x": 8"#)).unwrap();
        assert_says(said(&short), &["focal length", "images/00.png"]);
    }

    #[test]
    fn a_photograph_has_one_view_and_one_pose() {
        let folder = tempfile::tempdir().unwrap();
        let frames: Vec<_> = (0..10).map(|i| frame(folder.path(), i, "")).collect();
        let other = frames[4].replace("images/04", "images/03");
        let write = |file: &str, frames: &[String]| write_transforms(&folder.path().join(file), GLOBAL, frames);
        let read = || load(folder.path(), &LoadOptions::default());
        write("transforms.json", &[frames.as_slice(), &frames[3..4]].concat());
        let data = read().unwrap();
        assert_eq!((data.train.len(), data.test.len()), (8, 2));
        assert_says(said(&data), &["twice", "(1): images/03.png"]);
        write("transforms.json", &[frames.as_slice(), std::slice::from_ref(&other)].concat());
        assert_refused(folder.path(), &LoadOptions::default(), &["03.png", "transforms.json", "poses"]);
        write("transforms.json", &frames);
        write("transforms_val.json", &frames[3..4]);
        let data = read().unwrap();
        assert_eq!((data.train.len(), data.test.len()), (9, 1));
        assert_says(said(&data), &["twice", "(1): images/03.png"]);
        write("transforms_val.json", &[other]);
        assert_refused(folder.path(), &LoadOptions::default(), &["03.png", "transforms.json", "transforms_val.json"]);
    }

    #[test]
    fn faults_of_json_name_the_frame() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let frame = frame(folder.path(), 0, "");
        let of = |second: &str| format!(r#"{{{GLOBAL}, "frames": [{frame}, {second}]}}"#);
        for (text, parts) in [
            (" \n".to_owned(), ["is empty", "export"]),
            (format!("[{frame}]"), ["a list", "`frames`"]),
            (of(r#"{"transform_matrix": [[1]]}"#), ["frame 2 of 2", "`file_path`"]),
            (of(r#"{"file_path": "b.png"}"#), ["frame 2 of 2 (b.png)", "`transform_matrix`"]),
            (of(r#"{"file_path": "b.png", "transform_matrix": null}"#), ["frame 2 of 2 (b.png)", "null"]),
            (of(r#"{"file_path": "", "transform_matrix": [[1, 0, 0, 0]]}"#), ["frame 2 of 2", "is empty"]),
        ] {
            std::fs::write(&path, text).unwrap();
            let error = load(folder.path(), &LoadOptions::default()).unwrap_err().to_string();
            assert_says(&error, &[&["transforms.json"][..], &parts].concat());
            assert!(!error.contains("NaN"), "{error}");
        }
        std::fs::write(&path, of(r#"{"file_path": "b.png", "transform_matrix": [[NaN]]}"#)).unwrap();
        assert_refused(folder.path(), &LoadOptions::default(), &["line 2", "NaN"]);
    }
}

//! Runs on photographs that do not fit into memory.

use std::path::Path;

use dpges_core::camera::CameraFromWorld;
use image::{DynamicImage, GrayImage, RgbImage};

use super::fixtures::{STAGES, config, device, finished, options};
use super::masked_tests::overpainted;
use super::*;
use crate::dataset::{LoadOptions, MaxResolution, SAMPLED_VIEWS, View, builtin, load};
use crate::eval::evaluate;

/// Saves an image, and makes the folder that it goes to.
fn save(path: &Path, image: impl Into<DynamicImage>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.into().save(path).unwrap();
}

/// Three rows of a matrix with OpenGL axes.
fn world_from_camera(pose: &CameraFromWorld) -> [[f64; 4]; 3] {
    let (rotation, centre) = (pose.rotation, pose.centre());
    [0, 1, 2].map(|row| [rotation.row(0)[row], -rotation.row(1)[row], -rotation.row(2)[row], centre[row]])
}

/// Training and held-out views as a nerfstudio dataset: `images/`, `masks/` where pictures have them, `transforms.json`.
fn export(root: &Path, data: &Dataset) {
    let file = |view: &View| format!("images/{}.png", view.name);
    let frame = |view: &View| {
        let (picture, camera) = (view.picture().unwrap(), view.camera);
        let (width, height) = (picture.width as u32, picture.height as u32);
        save(&root.join(file(view)), RgbImage::from_raw(width, height, picture.bytes.clone()).unwrap());
        if let Some(counted) = &picture.counted {
            let white = counted.iter().map(|&counts| if counts { 255 } else { 0 }).collect();
            let mask = GrayImage::from_raw(width, height, white).unwrap();
            save(&root.join(format!("masks/{}.png", view.name)), mask);
        }
        format!(
            r#"{{"file_path": "{}", "w": {width}, "h": {height}, "fl_x": {}, "fl_y": {}, "cx": {}, "cy": {},
            "transform_matrix": {:?}}}"#,
            file(view),
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            world_from_camera(&camera.camera_from_world)
        )
    };
    let frames: Vec<String> = data.train.iter().chain(&data.test).map(frame).collect();
    let held_out: Vec<String> = data.test.iter().map(|view| format!("{:?}", file(view))).collect();
    let json = format!(r#"{{"test_filenames": [{}], "frames": [{}]}}"#, held_out.join(","), frames.join(","));
    std::fs::write(root.join("transforms.json"), json).unwrap();
}

#[test]
fn where_photographs_are_kept_changes_no_bit_of_a_run() {
    let data = builtin(&options(24, [6, 2], 300));
    let folder = tempfile::tempdir().unwrap();
    export(folder.path(), &data);
    // the first and the last have masks
    let masked = overpainted(&data, 200, true);
    let some = |views: &[View]| vec![views[0].clone(), views[5].clone()];
    export(&folder.path().join("masked"), &Dataset { train: some(&masked.train), ..masked.clone() });
    std::fs::rename(folder.path().join("masked/masks"), folder.path().join("masks")).unwrap();

    let read = |memory: usize| {
        let options =
            LoadOptions { memory, near: Some(data.near), max_resolution: MaxResolution(20), ..Default::default() };
        let mut read = load(folder.path(), &options).unwrap();
        read.points = data.points.clone();
        read
    };
    let whole = read(usize::MAX);
    let names = |data: &Dataset| data.train.iter().map(|view| view.name.clone()).collect::<Vec<_>>();
    assert_eq!((whole.train.len(), whole.test.len(), whole.masked().masked_views), (6, 2, 2));
    let kept = |data: &Dataset| data.train.iter().chain(&data.test).filter(|view| view.photograph.is_kept()).count();
    assert_eq!((kept(&whole), kept(&read(0))), (8, 0));
    assert!((1..6).contains(&kept(&read(5000))));

    let runs: [&[&str]; 3] = [
        &STAGES,
        &["train.steps=60", "stages.gaussians=0.5", "refine.budget=700", "train.exposure=on"],
        &["train.steps=40", "train.method=mcmc", "refine.budget=300"],
    ];
    for set in runs {
        let expected = finished(set, whole.clone());
        for memory in [0, 5000] {
            let data = read(memory);
            assert_eq!(names(&data), names(&whole));
            assert!(finished(set, data) == expected, "{set:?} with {memory} bytes");
        }
    }

    let scene = Trainer::new(config(&["train.steps=4"]), Arc::new(whole.clone()), device()).unwrap().scene();
    let score = |data: &Dataset| {
        let found = evaluate(&scene, &data.test, &device()).unwrap();
        found.views.iter().map(|view| view.scores).collect::<Vec<_>>()
    };
    assert_eq!(score(&read(0)), score(&whole));
}

/// The photographs of more views than are sampled, in files that are read when they are needed, in this much memory.
fn many(folder: &tempfile::TempDir, train_views: usize, memory: usize) -> Dataset {
    let data = builtin(&options(12, [train_views, 2], 300));
    export(folder.path(), &data);
    let mut read = load(folder.path(), &LoadOptions { memory, near: Some(data.near), ..Default::default() }).unwrap();
    read.points = data.points;
    read
}

fn read_so_far(data: &Dataset) -> usize {
    data.train.iter().chain(&data.test).filter(|view| view.photograph.was_read()).count()
}

#[test]
fn a_run_begins_when_a_sample_of_many_photographs_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let data = Arc::new(many(&folder, 3 * SAMPLED_VIEWS, usize::MAX));
    assert_eq!(read_so_far(&data), 0);
    let mut trainer = Trainer::new(config(&["train.steps=2000"]), Arc::clone(&data), device()).unwrap();
    // one sample for the exposures, of views with enough points, and one for the sky
    let at_first = read_so_far(&data);
    assert!((1..=2 * SAMPLED_VIEWS).contains(&at_first), "{at_first}");
    (0..40).for_each(|_| drop(trainer.step().unwrap()));
    assert!(read_so_far(&data) > at_first);
    assert!(data.test.iter().all(|view| !view.photograph.was_read()));
}

#[test]
fn when_photographs_are_read_changes_no_bit_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let set = ["train.steps=100", "refine.budget=600", "model.environment=sh1", "train.exposure=auto"];
    let mut all = many(&folder, 80, usize::MAX);
    all.train.iter_mut().chain(&mut all.test).for_each(|view| view.repaint(|_| ()).unwrap());
    assert_eq!(read_so_far(&all), 82);
    let expected = finished(&set, all);
    for memory in [usize::MAX, 10_000, 0] {
        assert!(finished(&set, many(&folder, 80, memory)) == expected, "with {memory} bytes");
    }
}

#[test]
fn a_photograph_that_is_gone_ends_a_run_with_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let data = Arc::new(many(&folder, 3, 0));
    let mut trainer = Trainer::new(config(&["train.steps=9"]), data, device()).unwrap();
    for view in 0..3 {
        std::fs::remove_file(folder.path().join(format!("images/train_{view:03}.png"))).unwrap();
    }
    let failed = (0..9).find_map(|_| trainer.step().err()).unwrap().to_string();
    assert!(failed.contains("cannot read again the photograph") && failed.contains("train_00"), "{failed}");
}

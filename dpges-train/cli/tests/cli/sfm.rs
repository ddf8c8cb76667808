//! Photographs without cameras, with a COLMAP that only pretends: it copies a model that is already there.

use std::fmt::Write as _;
use std::path::Path;

use assert_cmd::Command;
use dpges_core::camera::CameraFromWorld;
use glam::DVec3;

use super::benchmark::colmap_image;
use super::{Folder, assert_contains, both, command, content, fails, folder, ok, said};

const PHOTOGRAPHS: usize = 8;

const COLMAP: &str = r#"#!/bin/sh
if [ "$1" = -h ]; then echo "COLMAP 3.8 (without CUDA)"; exit; fi
if [ "$2" = -h ]; then echo "  --SiftExtraction.use_gpu arg (=1)"; exit; fi
echo "$1" >> STAGE/calls
command=$1
while [ $# -gt 1 ]; do
  case $1 in --database_path) database=$2;; --output_path) models=$2;; esac
  shift
done
case $command in
  feature_extractor) touch "$database";;
  mapper) [ -e STAGE/broken ] && { echo "out of memory"; exit 1; }; cp -r STAGE/model "$models/0";;
esac
"#;

/// A folder with photographs in `room`, what COLMAP will find in `model`, and COLMAP in `bin`.
fn stage() -> Folder {
    let at = folder();
    for name in ["room", "model", "bin"] {
        std::fs::create_dir(at.join(name)).unwrap();
    }
    let mut images = String::new();
    for index in 0..PHOTOGRAPHS {
        let picture = image::RgbImage::from_fn(48, 32, |x, y| image::Rgb([x as u8 * 5, y as u8 * 7, index as u8 * 20]));
        picture.save(at.join(format!("room/{index}.png"))).unwrap();
        // the last has no place
        if index + 1 < PHOTOGRAPHS {
            let angle = index as f64 / PHOTOGRAPHS as f64 * std::f64::consts::TAU;
            let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0);
            let pose = CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z);
            images += &colmap_image(index, &pose, &format!("{index}.png"));
        }
    }
    let mut points = String::new();
    for index in 0..200u32 {
        let (turn, height) = (f64::from(index) * 2.4, f64::from(index) / 100.0 - 1.0);
        let radius = 0.8 * (1.0 - height * height).sqrt();
        let (x, y, z) = (radius * turn.cos(), radius * turn.sin(), 0.8 * height);
        writeln!(points, "{index} {x} {y} {z} 200 100 50 0.5 1 0 2 0 3 0").unwrap();
    }
    std::fs::write(at.join("model/cameras.txt"), "1 OPENCV 48 32 40 40 24 16 0.01 0 0 0\n").unwrap();
    std::fs::write(at.join("model/images.txt"), images).unwrap();
    std::fs::write(at.join("model/points3D.txt"), points).unwrap();
    // written by another process: what this one has open for writing while it starts others could not be run
    std::fs::write(at.join("script"), COLMAP.replace("STAGE", at.to_str().unwrap())).unwrap();
    Command::new("install").args(["-m", "755"]).args([at.join("script"), at.join("bin/colmap")]).assert().success();
    at
}

fn calls(at: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(at.join("calls")).unwrap_or_default();
    text.lines().map(str::to_owned).collect()
}

const ALL: [&str; 3] = ["feature_extractor", "exhaustive_matcher", "mapper"];

#[test]
fn photographs_are_trained_on_as_if_they_were_a_dataset() {
    let at = &stage();
    let train = ["train", "room", "--device=cpu", "--steps=6", "--budget=900", "--set=train.checkpoint_every=3"];
    let (summary, log) = both(at, &train);
    assert!(summary.contains("6 steps"), "{summary}");
    assert_contains(
        &log,
        &["features: looking for features", "mapping: done in", "7 of 8 photographs have a place, 200 points"],
    );
    assert!(log.contains("without a place, and so not used: 7.png"), "{log}");
    assert_eq!(calls(at), ALL);
    let origin = content(at.join("runs/room/run.json"));
    assert!(origin.contains("room_colmap"), "the run knows the dataset, not the photographs: {origin}");
    assert!(at.join("room_colmap/sparse/0/cameras.txt").is_file());

    let again = said(at, &[&train[..], &["--overwrite"]].concat());
    assert!(!again.contains("features:"), "{again}");
    ok(at, &["train", "room", "--resume"]);
    ok(at, &["eval", "runs/room", "--quiet"]);
    let report = ok(at, &["data", "room"]);
    assert!(report.contains("6 for training, 1 held out") && report.contains("! there are only 6"), "{report}");
    assert_eq!(calls(at), ALL, "it is done once");
    assert_eq!(std::fs::read_dir(at.join("room")).unwrap().count(), PHOTOGRAPHS, "the photographs are left alone");
}

#[test]
fn a_dataset_is_made_where_it_is_asked_for_and_after_a_failure_it_goes_on() {
    let at = &stage();
    std::fs::write(at.join("broken"), "").unwrap();
    let make = ["sfm", "room", "--out", "sets/room"];
    let message = fails(at, 1, &make);
    assert_contains(&message, &["mapping", "out of memory", "sets/room/sfm/mapping.log"]);
    let message = fails(at, 1, &["train", "sets/room", "--device=cpu"]);
    assert!(message.contains("repeat the command that began it"), "{message}");
    std::fs::remove_file(at.join("broken")).unwrap();
    let summary = ok(at, &make);
    assert_contains(&summary, &["7 of 8 have a place", "200", "next         dpges train"]);
    // COLMAP itself leaves out what it has done
    assert_eq!(calls(at), [ALL, ALL].concat());
    assert_contains(
        &ok(at, &[&make[..], &["--sfm-camera", "RADIAL"]].concat()),
        &["before; --overwrite makes it anew"],
    );
    ok(at, &[&make[..], &["--sfm-camera", "RADIAL", "--overwrite"]].concat());
    assert_eq!(calls(at).len(), 9);
}

#[test]
fn what_is_missing_is_named() {
    let at = &stage();
    std::fs::write(at.join("walk.mp4"), "").unwrap();
    for (args, parts) in [
        (&["sfm", "room"][..], ["COLMAP is not installed", "apt-get install colmap"]),
        (&["train", "room", "--device=cpu"], ["COLMAP is not installed", "apt-get install colmap"]),
        (&["sfm", "walk.mp4"], ["ffmpeg is not installed", "apt-get install ffmpeg"]),
    ] {
        let output = command(at).env("PATH", "").args(args).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        assert_contains(&String::from_utf8(output.stderr).unwrap(), &parts);
    }
    assert_contains(&fails(at, 2, &["sfm", "room", "--sfm", "meshroom"]), &["glomap"]);
}

#[test]
fn a_folder_of_something_else_says_what_was_looked_for() {
    let at = &stage();
    // with the photographs it would be a dataset
    std::fs::remove_dir_all(at.join("model")).unwrap();
    std::fs::create_dir(at.join("papers")).unwrap();
    std::fs::write(at.join("papers/thesis.txt"), "").unwrap();
    let commands: [&[&str]; 4] = [
        &["train", "papers", "--device=cpu"],
        &["data", "papers"],
        &["sfm", "papers"],
        &["compare", "papers", "--device=cpu", "--out=study"],
    ];
    for command in commands {
        let parts = [
            "papers is no dataset",
            "sparse/",
            "transforms.json",
            "JPEG, PNG or WebP",
            "found thesis.txt",
            "by COLMAP",
        ];
        assert_contains(&fails(at, 1, command), &parts);
    }
    let message = fails(at, 1, &["train", ".", "--device=cpu"]);
    assert!(message.contains("name what is in it") && message.contains("room"), "{message}");
    assert_eq!(calls(at), [""; 0]);
}

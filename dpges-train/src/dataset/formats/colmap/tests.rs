use std::path::Path;

use crate::dataset::fixtures::{self, Encoding, FixtureScene};
use crate::dataset::{Dataset, LoadOptions, load};
use dpges_core::camera::{Distortion, Projection};

fn written(scene: &FixtureScene, encoding: Encoding) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fixtures::write_colmap(folder.path(), scene, encoding);
    folder
}

fn loaded(folder: &Path) -> Dataset {
    load(folder, &LoadOptions::default()).unwrap()
}

fn message(folder: &Path) -> String {
    load(folder, &LoadOptions::default()).unwrap_err().to_string()
}

#[test]
fn binary_and_text_say_the_same() {
    let scene = fixtures::scene(10);
    let binary = loaded(written(&scene, Encoding::Binary).path());
    let text = loaded(written(&scene, Encoding::Text).path());
    assert_eq!(binary.points, text.points);
    for (a, b) in binary.train.iter().zip(&text.train).chain(binary.test.iter().zip(&text.test)) {
        assert_eq!((&a.name, a.camera, a.picture().unwrap()), (&b.name, b.camera, b.picture().unwrap()));
    }
    assert_eq!((binary.train.len(), text.test.len()), (8, 2));
}

#[test]
fn views_are_sorted_split_and_matched_to_tracks() {
    let scene = fixtures::scene(10);
    let data = loaded(written(&scene, Encoding::Binary).path());
    let names: Vec<&str> = data.test.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["left/000.png", "left/008.png"]);
    assert_eq!(data.train[0].name, "left/001.png");
    assert_eq!(data.train[0].picture().unwrap().bytes[..3], [1, 100, 200]);
    // Image 107 is left/001, the first that trains; image 100 is held out.
    let tracks: Vec<&[u32]> = data.points.seen_by.iter().collect();
    assert_eq!(tracks, [&[0][..], &[0], &[0, 1], &[0, 2], &[0, 3]]);
    assert_eq!(data.points.colours[1], [50.0 / 255.0, 1.0, 0.0]);
    assert_eq!(data.points.positions[1], [-0.2f64 as f32, 0.125, -0.2f64 as f32]);
    let expected = fixtures::pose(1, 10);
    assert!((data.train[0].camera.centre() - expected.centre()).length() < 1e-12);
}

#[test]
fn the_model_with_the_most_images_is_read() {
    let scene = fixtures::scene(12);
    let folder = written(&scene, Encoding::Binary);
    fixtures::write_model(&folder.path().join("sparse/1"), &fixtures::scene(4), Encoding::Text);
    fixtures::write_model(&folder.path().join("sparse/0"), &fixtures::scene(3), Encoding::Binary);
    assert_eq!(loaded(folder.path()).train.len(), 3);
    fixtures::write_model(&folder.path().join("sparse"), &scene, Encoding::Text);
    assert_eq!(loaded(folder.path()).train.len(), 10);
}

#[test]
fn distorted_models_are_undistorted() {
    let mut scene = fixtures::scene(3);
    let models: [((u32, &str), &[f64]); 4] = [
        ((2, "SIMPLE_RADIAL"), &[20.0, 12.0, 8.0, 0.1]),
        ((3, "RADIAL"), &[20.0, 12.0, 8.0, 0.1, 0.01]),
        ((4, "OPENCV"), &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.001]),
        ((6, "FULL_OPENCV"), &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.001, 0.0, 0.01, 0.0, 0.0]),
    ];
    for (model, params) in models {
        (scene.model, scene.params) = (model, params.to_vec());
        for encoding in [Encoding::Binary, Encoding::Text] {
            let camera = loaded(written(&scene, encoding).path()).train[0].camera;
            assert!(camera.fx > 20.5 && (camera.width, camera.height) == (24, 16), "{model:?} {camera:?}");
        }
    }
    (scene.model, scene.params) = ((0, "SIMPLE_PINHOLE"), vec![21.0, 12.0, 8.0]);
    assert_eq!(loaded(written(&scene, Encoding::Text).path()).train[0].camera.fx, 21.0);
}

#[test]
fn photographs_are_kept_as_they_are_if_asked_for() {
    let mut scene = fixtures::scene(3);
    let perspective = Distortion::new(Projection::Perspective);
    let fisheye = Distortion::new(Projection::Equidistant);
    let models: [((u32, &str), &[f64], Distortion); 10] = [
        (
            (2, "SIMPLE_RADIAL"),
            &[20.0, 12.0, 8.0, 0.1],
            Distortion { numerator: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], ..perspective },
        ),
        (
            (3, "RADIAL"),
            &[20.0, 12.0, 8.0, 0.1, 0.01],
            Distortion { numerator: [0.1, 0.01, 0.0, 0.0, 0.0, 0.0], ..perspective },
        ),
        (
            (4, "OPENCV"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002],
            Distortion { numerator: [0.1, 0.01, 0.0, 0.0, 0.0, 0.0], tangential: [0.001, 0.002], ..perspective },
        ),
        (
            (6, "FULL_OPENCV"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002, 0.003, 0.04, 0.05, 0.006],
            Distortion {
                numerator: [0.1, 0.01, 0.003, 0.0, 0.0, 0.0],
                denominator: [0.04, 0.05, 0.006],
                tangential: [0.001, 0.002],
                ..perspective
            },
        ),
        (
            (5, "OPENCV_FISHEYE"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002],
            Distortion { numerator: [0.1, 0.01, 0.001, 0.002, 0.0, 0.0], ..fisheye },
        ),
        ((7, "FOV"), &[20.0, 20.0, 12.0, 8.0, 0.9], Distortion::new(Projection::FieldOfView(0.9))),
        (
            (8, "SIMPLE_RADIAL_FISHEYE"),
            &[20.0, 12.0, 8.0, 0.1],
            Distortion { numerator: [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], ..fisheye },
        ),
        (
            (9, "RADIAL_FISHEYE"),
            &[20.0, 12.0, 8.0, 0.1, 0.01],
            Distortion { numerator: [0.1, 0.01, 0.0, 0.0, 0.0, 0.0], ..fisheye },
        ),
        (
            (10, "THIN_PRISM_FISHEYE"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002, 0.003, 0.004, 0.005, 0.006],
            Distortion {
                numerator: [0.1, 0.01, 0.003, 0.004, 0.0, 0.0],
                tangential: [0.001, 0.002],
                thin_prism: [0.005, 0.006],
                ..fisheye
            },
        ),
        (
            (11, "RAD_TAN_THIN_PRISM_FISHEYE"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.003, 0.004, 0.0001, 2e-5, 0.001, 0.002, 0.005, 6e-4, 0.007, 8e-4],
            Distortion {
                numerator: [0.1, 0.01, 0.003, 0.004, 0.0001, 2e-5],
                tangential: [0.002, 0.001],
                thin_prism: [0.005, 0.007],
                thin_prism_quartic: [6e-4, 8e-4],
                in_sequence: true,
                ..fisheye
            },
        ),
    ];
    for (model, params, distortion) in models {
        (scene.model, scene.params) = (model, params.to_vec());
        for encoding in [Encoding::Binary, Encoding::Text] {
            let folder = written(&scene, encoding);
            let options = LoadOptions { undistort: false, max_resolution: Some(12), ..LoadOptions::default() };
            let data = load(folder.path(), &options).unwrap();
            let camera = data.train[0].camera;
            assert_eq!(camera.lens.map(|lens| *lens.distortion()), Some(distortion), "{model:?}");
            assert_eq!((camera.fx, camera.cx, camera.cy, camera.width), (10.0, 6.0, 4.0, 12), "{model:?}");
            let straight = loaded(folder.path()).train[0].camera;
            assert!(straight.lens.is_none() && straight.fx != 20.0 && straight.width == 24, "{model:?} {straight:?}");
        }
    }
    (scene.model, scene.params) = ((7, "FOV"), vec![20.0, 20.0, 12.0, 8.0, 0.0]);
    assert!(loaded(written(&scene, Encoding::Text).path()).train[0].camera.lens.is_none());
    scene.params[4] = -0.5;
    let found = message(written(&scene, Encoding::Text).path());
    assert!(found.contains("images.txt") && found.contains("`lens` is"), "{found}");
}

#[test]
fn unknown_models_are_refused_by_name() {
    let mut scene = fixtures::scene(3);
    (scene.model, scene.params) = ((77, "EYE_OF_NEWT"), vec![20.0; 16]);
    let found = message(written(&scene, Encoding::Binary).path());
    assert!(found.contains("cameras.bin: camera model number 77 of camera 5"), "{found}");
    let found = message(written(&scene, Encoding::Text).path());
    assert!(found.contains("cameras.txt: camera model EYE_OF_NEWT of camera 5"), "{found}");
    assert!(found.contains("undistort"), "{found}");
    (scene.model, scene.params) = ((1, "PINHOLE"), vec![20.0; 3]);
    let found = message(written(&scene, Encoding::Text).path());
    assert!(found.contains("cameras.txt: the number of parameters of camera 5 (PINHOLE) is 3"), "{found}");
}

#[test]
fn truncated_files_are_named_at_any_length() {
    let scene = fixtures::scene(3);
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let folder = written(&scene, Encoding::Binary);
        let path = folder.path().join("sparse/0").join(name);
        let data = std::fs::read(&path).unwrap();
        for length in (0..data.len()).step_by(5) {
            std::fs::write(&path, &data[..length]).unwrap();
            let message = message(folder.path());
            assert!(message.contains(path.to_str().unwrap()) && message.contains("truncated"), "{length}: {message}");
        }
    }
}

#[test]
fn corrupt_counts_allocate_nothing() {
    let folder = written(&fixtures::scene(3), Encoding::Binary);
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join("sparse/0").join(name);
        let good = std::fs::read(&path).unwrap();
        let mut data = good.clone();
        data[..8].copy_from_slice(&(u64::MAX / 2).to_le_bytes());
        std::fs::write(&path, data).unwrap();
        let message = message(folder.path());
        assert!(message.contains(name) && message.contains("truncated or corrupt"), "{message}");
        std::fs::write(&path, good).unwrap();
    }
}

#[test]
fn malformed_text_names_file_and_line() {
    let folder = written(&fixtures::scene(3), Encoding::Text);
    let cases = [
        ("cameras.txt", "5 PINHOLE 24 16 twenty 20 12 8\n", "line 1"),
        ("images.txt", "# c\n107 1 0 0 0 0 0 0 5\n\n", "line 2"),
        ("images.txt", "7 1 0 0 0 0 0 0 5 a.png\n8 1 0 0 0 0 0 0 5 b.png\n", "line 2"),
        ("points3D.txt", "1 0 0 0 256 0 0 0.5\n", "line 1"),
    ];
    for (name, text, line) in cases {
        let path = folder.path().join("sparse/0").join(name);
        let good = std::fs::read(&path).unwrap();
        std::fs::write(&path, text).unwrap();
        let message = message(folder.path());
        assert!(message.contains(path.to_str().unwrap()) && message.contains(line), "{message}");
        std::fs::write(&path, good).unwrap();
    }
}

#[test]
fn a_model_without_points_or_views_or_files_says_what_to_do() {
    let mut scene = fixtures::scene(3);
    scene.points[2].position.y = f64::NAN;
    let found = message(written(&scene, Encoding::Text).path());
    assert!(found.contains("points3D.txt: the position of point 2 is"), "{found}");
    scene.points.clear();
    let found = message(written(&scene, Encoding::Binary).path());
    assert!(found.contains("points3D.bin holds no points") && found.contains("triangulator"), "{found}");

    let folder = written(&scene, Encoding::Binary);
    let model = folder.path().join("sparse/0");
    std::fs::remove_file(model.join("points3D.bin")).unwrap();
    let found = message(folder.path());
    assert!(found.contains("points3D.bin is missing"), "{found}");
    std::fs::remove_file(model.join("cameras.bin")).unwrap();
    let found = message(folder.path());
    assert!(found.contains("sparse holds no COLMAP model") && found.contains("found 0"), "{found}");

    scene = fixtures::scene(3);
    scene.images.clear();
    let found = message(written(&scene, Encoding::Binary).path());
    assert!(found.contains("images.bin: no views"), "{found}");
}

#[test]
fn a_camera_that_does_not_exist_is_named() {
    let folder = written(&fixtures::scene(3), Encoding::Text);
    let path = folder.path().join("sparse/0/cameras.txt");
    std::fs::write(&path, "6 PINHOLE 24 16 20 20 12 8\n").unwrap();
    let found = message(folder.path());
    assert!(found.contains("images.txt: the camera of image `left/000.png` is 5"), "{found}");
}

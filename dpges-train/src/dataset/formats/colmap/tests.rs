use std::path::Path;

use crate::dataset::fixtures::{self, Encoding, assert_refused, colmap_folder};
use crate::dataset::{Dataset, LoadOptions, load};
use dpges_core::camera::{Distortion, Projection};

fn loaded(folder: &Path) -> Dataset {
    load(folder, &LoadOptions::default()).unwrap()
}

#[track_caller]
fn refused(folder: &Path, parts: &[&str]) {
    assert_refused(folder, &LoadOptions::default(), parts);
}

#[test]
fn binary_and_text_say_the_same() {
    let scene = fixtures::scene(10);
    let binary = loaded(colmap_folder(&scene, Encoding::Binary).path());
    let text = loaded(colmap_folder(&scene, Encoding::Text).path());
    assert_eq!(binary.points, text.points);
    for (a, b) in binary.train.iter().zip(&text.train).chain(binary.test.iter().zip(&text.test)) {
        assert_eq!((&a.name, a.camera, a.picture().unwrap()), (&b.name, b.camera, b.picture().unwrap()));
    }
    assert_eq!((binary.train.len(), text.test.len()), (8, 2));
}

#[test]
fn views_are_sorted_split_and_matched_to_tracks() {
    let scene = fixtures::scene(10);
    let data = loaded(colmap_folder(&scene, Encoding::Binary).path());
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
    let folder = colmap_folder(&scene, Encoding::Binary);
    fixtures::write_model(&folder.path().join("sparse/1"), &fixtures::scene(4), Encoding::Text);
    fixtures::write_model(&folder.path().join("sparse/0"), &fixtures::scene(3), Encoding::Binary);
    assert_eq!(loaded(folder.path()).train.len(), 3);
    fixtures::write_model(&folder.path().join("sparse"), &scene, Encoding::Text);
    assert_eq!(loaded(folder.path()).train.len(), 10);
}

#[test]
fn photographs_are_kept_as_they_are_if_asked_for() {
    let mut scene = fixtures::scene(3);
    let perspective = Distortion::new(Projection::Perspective);
    let fisheye = Distortion::new(Projection::Equidistant);
    let bent = |base: Distortion, k: &[f64], tangential: [f64; 2]| {
        let numerator = std::array::from_fn(|i| k.get(i).copied().unwrap_or(0.0));
        Distortion { numerator, tangential, ..base }
    };
    let models: [((u32, &str), &[f64], Distortion); 10] = [
        ((2, "SIMPLE_RADIAL"), &[20.0, 12.0, 8.0, 0.1], bent(perspective, &[0.1], [0.0; 2])),
        ((3, "RADIAL"), &[20.0, 12.0, 8.0, 0.1, 0.01], bent(perspective, &[0.1, 0.01], [0.0; 2])),
        (
            (4, "OPENCV"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002],
            bent(perspective, &[0.1, 0.01], [0.001, 0.002]),
        ),
        (
            (6, "FULL_OPENCV"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002, 0.003, 0.04, 0.05, 0.006],
            Distortion { denominator: [0.04, 0.05, 0.006], ..bent(perspective, &[0.1, 0.01, 0.003], [0.001, 0.002]) },
        ),
        (
            (5, "OPENCV_FISHEYE"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002],
            bent(fisheye, &[0.1, 0.01, 0.001, 0.002], [0.0; 2]),
        ),
        ((7, "FOV"), &[20.0, 20.0, 12.0, 8.0, 0.9], Distortion::new(Projection::FieldOfView(0.9))),
        ((8, "SIMPLE_RADIAL_FISHEYE"), &[20.0, 12.0, 8.0, 0.1], bent(fisheye, &[0.1], [0.0; 2])),
        ((9, "RADIAL_FISHEYE"), &[20.0, 12.0, 8.0, 0.1, 0.01], bent(fisheye, &[0.1, 0.01], [0.0; 2])),
        (
            (10, "THIN_PRISM_FISHEYE"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.001, 0.002, 0.003, 0.004, 0.005, 0.006],
            Distortion { thin_prism: [0.005, 0.006], ..bent(fisheye, &[0.1, 0.01, 0.003, 0.004], [0.001, 0.002]) },
        ),
        (
            (11, "RAD_TAN_THIN_PRISM_FISHEYE"),
            &[20.0, 20.0, 12.0, 8.0, 0.1, 0.01, 0.003, 0.004, 0.0001, 2e-5, 0.001, 0.002, 0.005, 6e-4, 0.007, 8e-4],
            Distortion {
                thin_prism: [0.005, 0.007],
                thin_prism_quartic: [6e-4, 8e-4],
                in_sequence: true,
                ..bent(fisheye, &[0.1, 0.01, 0.003, 0.004, 0.0001, 2e-5], [0.002, 0.001])
            },
        ),
    ];
    for (model, params, distortion) in models {
        (scene.model, scene.params) = (model, params.to_vec());
        for encoding in [Encoding::Binary, Encoding::Text] {
            let folder = colmap_folder(&scene, encoding);
            let options = LoadOptions { undistort: false, max_resolution: Some(12), ..LoadOptions::default() };
            let data = load(folder.path(), &options).unwrap();
            let camera = data.train[0].camera;
            assert_eq!(camera.lens.map(|lens| *lens.distortion()), Some(distortion), "{model:?}");
            assert_eq!((camera.fx, camera.cx, camera.cy, camera.width), (10.0, 6.0, 4.0, 12), "{model:?}");
            let straight = loaded(folder.path()).train[0].camera;
            assert!(straight.lens.is_none() && (straight.width, straight.height) == (24, 16), "{model:?} {straight:?}");
            let is_zoomed = distortion.projection != Projection::Perspective || straight.fx > 20.0;
            assert!(straight.fx != 20.0 && is_zoomed, "{model:?} {straight:?}");
        }
    }
    (scene.model, scene.params) = ((0, "SIMPLE_PINHOLE"), vec![21.0, 12.0, 8.0]);
    assert_eq!(loaded(colmap_folder(&scene, Encoding::Text).path()).train[0].camera.fx, 21.0);
    (scene.model, scene.params) = ((7, "FOV"), vec![20.0, 20.0, 12.0, 8.0, 0.0]);
    assert!(loaded(colmap_folder(&scene, Encoding::Text).path()).train[0].camera.lens.is_none());
    scene.params[4] = -0.5;
    refused(colmap_folder(&scene, Encoding::Text).path(), &["images.txt", "`lens` is"]);
}

#[test]
fn unknown_models_are_refused_by_name() {
    let mut scene = fixtures::scene(3);
    (scene.model, scene.params) = ((77, "EYE_OF_NEWT"), vec![20.0; 16]);
    let of_number = ["cameras.bin: camera model number 77 of camera 5"];
    refused(colmap_folder(&scene, Encoding::Binary).path(), &of_number);
    let of_name = ["cameras.txt: camera model EYE_OF_NEWT of camera 5", "undistort"];
    refused(colmap_folder(&scene, Encoding::Text).path(), &of_name);
    (scene.model, scene.params) = ((1, "PINHOLE"), vec![20.0; 3]);
    let of_count = ["cameras.txt: the number of parameters of camera 5 (PINHOLE) is 3"];
    refused(colmap_folder(&scene, Encoding::Text).path(), &of_count);
}

#[test]
fn truncated_files_and_corrupt_counts_are_named_and_allocate_nothing() {
    let folder = colmap_folder(&fixtures::scene(3), Encoding::Binary);
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join("sparse/0").join(name);
        let good = std::fs::read(&path).unwrap();
        for length in (0..good.len()).step_by(5) {
            std::fs::write(&path, &good[..length]).unwrap();
            refused(folder.path(), &[path.to_str().unwrap(), "truncated"]);
        }
        let corrupt = [&(u64::MAX / 2).to_le_bytes(), &good[8..]].concat();
        std::fs::write(&path, corrupt).unwrap();
        refused(folder.path(), &[name, "truncated or corrupt"]);
        std::fs::write(&path, good).unwrap();
    }
}

#[test]
fn malformed_text_names_file_and_line() {
    let folder = colmap_folder(&fixtures::scene(3), Encoding::Text);
    let cases = [
        ("cameras.txt", "5 PINHOLE 24 16 twenty 20 12 8\n", "cameras.txt: line 1"),
        ("images.txt", "# c\n107 1 0 0 0 0 0 0 5\n\n", "images.txt: line 2"),
        ("images.txt", "7 1 0 0 0 0 0 0 5 a.png\n8 1 0 0 0 0 0 0 5 b.png\n", "images.txt: line 2"),
        ("points3D.txt", "1 0 0 0 256 0 0 0.5\n", "points3D.txt: line 1"),
        ("cameras.txt", "6 PINHOLE 24 16 20 20 12 8\n", "images.txt: the camera of image `left/000.png` is 5"),
    ];
    for (name, text, expected) in cases {
        let path = folder.path().join("sparse/0").join(name);
        let good = std::fs::read(&path).unwrap();
        std::fs::write(&path, text).unwrap();
        refused(folder.path(), &[folder.path().to_str().unwrap(), expected]);
        std::fs::write(&path, good).unwrap();
    }
}

#[test]
fn a_model_without_points_or_views_or_files_says_what_to_do() {
    let mut scene = fixtures::scene(3);
    scene.points[2].position.y = f64::NAN;
    let not_finite = ["points3D.txt: the position of point 2 is"];
    refused(colmap_folder(&scene, Encoding::Text).path(), &not_finite);
    scene.points.clear();
    let folder = colmap_folder(&scene, Encoding::Binary);
    refused(folder.path(), &["points3D.bin holds no points", "triangulator"]);
    let model = folder.path().join("sparse/0");
    std::fs::remove_file(model.join("points3D.bin")).unwrap();
    refused(folder.path(), &["points3D.bin is missing"]);
    std::fs::remove_file(model.join("cameras.bin")).unwrap();
    refused(folder.path(), &["sparse holds no COLMAP model", "found 0"]);

    scene = fixtures::scene(3);
    scene.images.clear();
    refused(colmap_folder(&scene, Encoding::Binary).path(), &["images.bin: no views"]);
}

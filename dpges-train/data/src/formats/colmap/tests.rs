use std::path::Path;

use crate::fixtures::{self, Encoding, assert_refused, assert_says, colmap_folder, said};
use crate::{Dataset, LoadOptions, MaxResolution, load};
use dpges_core::camera::{Camera, Distortion, Projection};
use glam::DVec3;

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
            let options = LoadOptions { undistort: false, max_resolution: MaxResolution(12), ..LoadOptions::default() };
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
    let of_count = ["cameras.txt: the number of parameters of camera 5 (PINHOLE) is 3, expected 4"];
    refused(colmap_folder(&scene, Encoding::Text).path(), &of_count);
    (scene.model, scene.params) = ((17, "EQUIRECTANGULAR"), vec![24.0, 16.0]);
    let parts = ["images.bin: view `left/000.png` is a panorama of 24x16 px", "twice as wide as high", "pad "];
    refused(colmap_folder(&scene, Encoding::Binary).path(), &parts);
    scene.params[0] = 32.0;
    let parts = ["cameras.bin: camera model EQUIRECTANGULAR of camera 5", "not the width and height"];
    refused(colmap_folder(&scene, Encoding::Binary).path(), &parts);
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
        ("images.txt", "7 1 0 0 0 0 0 0 5 a.png\n1.0 2.0\n", "images.txt: line 2"),
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
fn a_model_without_views_or_files_says_what_to_do() {
    let mut scene = fixtures::scene(3);
    let folder = colmap_folder(&scene, Encoding::Binary);
    let model = folder.path().join("sparse/0");
    std::fs::remove_file(model.join("cameras.bin")).unwrap();
    refused(folder.path(), &["sparse holds no COLMAP model", "found 0"]);
    scene.images.clear();
    refused(colmap_folder(&scene, Encoding::Binary).path(), &["images.bin: no views"]);
}

#[test]
fn points_may_be_missing_lost_or_in_another_file() {
    let mut scene = fixtures::scene(3);
    scene.points[2].position.y = f64::NAN;
    scene.points[3].position.x = 1e12;
    let data = loaded(colmap_folder(&scene, Encoding::Text).path());
    assert_eq!((data.points.positions.len(), data.points.seen_by.len()), (3, 3));
    assert_says(said(&data), &["2 of the points are not finite, or far from everything"]);
    let header =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let folder = colmap_folder(&scene, Encoding::Binary);
    let model = folder.path().join("sparse/0");
    std::fs::write(model.join("points3D.ply"), format!("{header}1 2 3\n")).unwrap();
    assert_says(said(&loaded(folder.path())), &["Aside: points are not used (1): sparse/0/points3D.ply"]);
    std::fs::remove_file(model.join("points3D.bin")).unwrap();
    assert_eq!(loaded(folder.path()).points.positions, [[1.0, 2.0, 3.0]]);
    std::fs::rename(model.join("points3D.ply"), folder.path().join("cloud.ply")).unwrap();
    let none = loaded(folder.path());
    assert!(none.points.positions.is_empty());
    assert_says(said(&none), &["Unused: points are not used (1): cloud.ply"]);
}

/// Lenses of COLMAP 4 bend rays as its formulas say (`src/colmap/sensor/models.h`).
#[test]
fn lenses_without_a_polynomial_show_points_where_their_formulas_do() {
    let division = |k: f64| {
        move |p: DVec3| {
            let across = p.x.hypot(p.y);
            let r = 2.0 / (p.z + (p.z * p.z - 4.0 * across * across * k).sqrt());
            [r * p.x, r * p.y]
        }
    };
    let eucm = |p: DVec3| {
        let rho = (1.1 * (p.x * p.x + p.y * p.y) + p.z * p.z).sqrt();
        [p.x, p.y].map(|x| x / (0.6 * rho + 0.4 * p.z))
    };
    let fisheye = |p: DVec3| {
        let across = p.x.hypot(p.y);
        [p.x, p.y].map(|x| x * across.atan2(p.z) / across)
    };
    type Formula<'a> = &'a dyn Fn(DVec3) -> [f64; 2];
    let cases: [((u32, &str), &[f64], Formula<'_>); 6] = [
        ((12, "SIMPLE_DIVISION"), &[20.0, 12.0, 8.0, -0.15], &division(-0.15)),
        ((12, "SIMPLE_DIVISION"), &[20.0, 12.0, 8.0, 0.1], &division(0.1)),
        ((13, "DIVISION"), &[20.0, 22.0, 12.0, 8.0, -0.4], &division(-0.4)),
        ((14, "SIMPLE_FISHEYE"), &[10.0, 12.0, 8.0], &fisheye),
        ((15, "FISHEYE"), &[10.0, 11.0, 12.0, 8.0], &fisheye),
        ((16, "EUCM"), &[10.0, 11.0, 12.0, 8.0, 0.6, 1.1], &eucm),
    ];
    for (model, params, formula) in cases {
        let mut scene = fixtures::scene(3);
        (scene.model, scene.params) = (model, params.to_vec());
        for encoding in [Encoding::Binary, Encoding::Text] {
            let options = LoadOptions { undistort: false, ..LoadOptions::default() };
            let camera = load(colmap_folder(&scene, encoding).path(), &options).unwrap().train[0].camera;
            let mut shown = 0;
            for at in 0..400 {
                let (x, y) = (f64::from(at % 20) * 1.2 + 0.3, f64::from(at / 20) * 0.8 + 0.3);
                let Some(ray) = camera.ray(x, y) else { continue };
                let [u, v] = formula(ray);
                let error = (camera.fx * u + camera.cx - x).hypot(camera.fy * v + camera.cy - y);
                assert!(error < 0.05, "{model:?}: {error} px at ({x}, {y})");
                shown += 1;
            }
            assert_eq!(shown, 400, "{model:?}");
        }
    }
    let mut scene = fixtures::scene(3);
    (scene.model, scene.params) = ((16, "EUCM"), vec![10.0, 11.0, 12.0, 8.0, f64::NAN, 1.1]);
    refused(colmap_folder(&scene, Encoding::Text).path(), &["EUCM"]);
}

#[test]
fn quaternions_and_lines_as_other_programs_leave_them() {
    let scene = fixtures::scene(3);
    let folder = colmap_folder(&scene, Encoding::Text);
    let expected = loaded(folder.path());
    let path = folder.path().join("sparse/0/images.txt");
    let text = std::fs::read_to_string(&path).unwrap();
    let scaled = |line: &str| {
        let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        words[1..5].iter_mut().for_each(|word| *word = (2.0 * word.parse::<f64>().unwrap()).to_string());
        words.join(" ")
    };
    // a mark, no lines of keypoints, and names of as many words as make triples
    let entries = text.lines().filter(|line| line.ends_with(".png")).map(scaled);
    let lines: Vec<String> = entries.map(|line| line.replace("left/", "left/a b ")).collect();
    std::fs::write(&path, format!("\u{feff}{}\n", lines.join("\n"))).unwrap();
    for image in &scene.images {
        let file = folder.path().join("images").join(&image.name);
        std::fs::rename(&file, file.with_file_name(format!("a b {}", &image.name[5..]))).unwrap();
    }
    let data = loaded(folder.path());
    assert_eq!(data.train[0].name, "left/a b 001.png");
    let apart = data.train[0].camera.camera_from_world.rotation - expected.train[0].camera.camera_from_world.rotation;
    assert!(apart.to_cols_array().iter().all(|x| x.abs() < 1e-12));
    assert_says(
        said(&data),
        &["Changed: rotations of views were scaled or rounded (3)", "left/a b 000.png (scale 2.000)"],
    );
}

#[test]
fn cameras_that_do_not_stand_where_their_keypoints_say_are_named() {
    let mut scene = fixtures::scene(10);
    let position = |index: u32| DVec3::new(0.05 * f64::from(index % 6), 0.1 - 0.04 * f64::from(index % 5), 0.0);
    scene.points = (0..30)
        .map(|index| fixtures::FixturePoint { position: position(index), rgb: [9; 3], track: vec![107, 114] })
        .collect();
    let camera = |pose| Camera::pinhole(pose, 20.0, [24, 16], 0.1);
    for image in &mut scene.images {
        let shown = |index: u32| camera(image.pose).project(position(index)).unwrap();
        // half a pixel beside where it is
        let keypoint = |index| (shown(index), u64::from(index));
        image.keypoints = (0..30).map(keypoint).map(|((x, y, _), point)| ([x + 0.3, y - 0.4], point)).collect();
    }
    let loaded_as = |scene: &fixtures::FixtureScene, encoding| loaded(colmap_folder(scene, encoding).path());
    let near = |data: &Dataset, px: f64| (data.reprojection_px.unwrap() - px).abs() < 1e-6;
    for encoding in [Encoding::Binary, Encoding::Text] {
        let exact = loaded_as(&scene, encoding);
        assert!(near(&exact, 0.5) && said(&exact).is_empty(), "{:?}: {}", exact.reprojection_px, said(&exact));
    }
    let off = scene.images.iter_mut().find(|image| image.name == "left/003.png").unwrap();
    off.pose = off.pose.moved(DVec3::new(0.0, 0.0, 0.2), DVec3::ZERO);
    let data = loaded_as(&scene, Encoding::Binary);
    assert!(near(&data, 0.5));
    assert_says(said(&data), &["OffPose", "others miss by 0.5 px (1): left/003.png (3.5 px)"]);
    let half = LoadOptions { max_resolution: MaxResolution(12), ..LoadOptions::default() };
    let folder = colmap_folder(&scene, Encoding::Binary);
    assert!(near(&load(folder.path(), &half).unwrap(), 0.25), "px of the pictures that are trained on");
    // keypoints of pictures of another size say nothing
    let wrong = |([x, y], point): &([f64; 2], u64)| ([4.0 * x, 4.0 * y], *point);
    scene.images.iter_mut().for_each(|image| image.keypoints = image.keypoints.iter().map(wrong).collect());
    let other = loaded_as(&scene, Encoding::Binary);
    assert_eq!((other.reprojection_px, said(&other)), (None, String::new()));
    assert_eq!(loaded_as(&fixtures::scene(10), Encoding::Text).reprojection_px, None);
}

/// The scene of three images as text with a replacement in one of its files.
fn edited(name: &str, edit: impl Fn(&str) -> String) -> tempfile::TempDir {
    let folder = colmap_folder(&fixtures::scene(3), Encoding::Text);
    let path = folder.path().join("sparse/0").join(name);
    std::fs::write(&path, edit(&std::fs::read_to_string(&path).unwrap())).unwrap();
    folder
}

#[test]
fn an_image_has_one_name_one_id_and_one_pose() {
    let contradiction = edited("images.txt", |text| text.replace("left/001.png", "left/002.png"));
    refused(contradiction.path(), &["left/002.png", "images.txt", "poses"]);
    let ids = edited("images.txt", |text| text.replace("\n107 ", "\n114 "));
    refused(ids.path(), &["images.txt", "id 114", "left/001.png", "left/002.png"]);
    let cameras = edited("cameras.txt", |text| format!("{text}\n{}\n", text.trim().replace("24 16 20", "24 16 30")));
    refused(cameras.path(), &["cameras.txt", "camera 5", "twice"]);
    let again = edited("images.txt", |text| {
        let line = text.lines().find(|line| line.ends_with("left/001.png")).unwrap();
        format!("{}\n\n{}\n\n", text.trim_end(), line.replacen("107", "900", 1))
    });
    let data = load(again.path(), &LoadOptions { test_every: 0, ..Default::default() }).unwrap();
    assert_eq!(data.train.len(), 3);
    assert_says(said(&data), &["twice", "(1): left/001.png"]);
}

#[test]
fn a_stray_file_of_the_other_encoding_is_not_mixed_in() {
    let folder = edited("images.txt", str::to_owned);
    std::fs::write(folder.path().join("sparse/0/cameras.bin"), [0; 8]).unwrap();
    assert_says(said(&loaded(folder.path())), &["sparse/0/cameras.bin"]);
    std::fs::remove_file(folder.path().join("sparse/0/cameras.txt")).unwrap();
    refused(folder.path(), &["cameras.txt is missing"]);
}

#[test]
fn quaternions_that_are_no_rotation_name_the_image() {
    for quaternion in ["0 0 0 0", "NaN 0 0 0"] {
        let folder = edited("images.txt", |text| {
            let line = text.lines().find(|line| line.ends_with("left/001.png")).unwrap();
            let rest: Vec<&str> = line.split_whitespace().skip(5).collect();
            text.replace(line, &format!("107 {quaternion} {}", rest.join(" ")))
        });
        refused(folder.path(), &["images.txt", "quaternion", "left/001.png", quaternion, "rotation"]);
    }
}

#[test]
fn an_undistorted_model_has_the_photographs_beside_it() {
    let scene = fixtures::scene(9);
    for (model, images) in [
        ("dense/0/sparse", "dense/0/images"),
        ("dense/sparse", "dense/images"),
        ("undistorted/sparse/0", "undistorted/images"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        fixtures::write_model(&at.join(model), &scene, Encoding::Binary);
        for image in &scene.images {
            fixtures::write_png(&at.join("images").join(&image.name), 24, 16, [7; 3]);
            fixtures::write_png(&at.join(images).join(&image.name), 24, 16, image.rgb);
            fixtures::write_png(&at.join("images_2").join(&image.name), 12, 8, [7; 3]);
        }
        for path in [at.to_owned(), at.join(model)] {
            let data = loaded(&path);
            assert_eq!(
                (said(&data), &data.train[0].picture().unwrap().bytes[..3]),
                (String::new(), &[1, 100, 200][..])
            );
        }
        let scaled = LoadOptions { image_scale: Some(2), ..LoadOptions::default() };
        let scaled_images = format!("{images}_2");
        assert_refused(at, &scaled, &[&scaled_images, "there are images;"]);
        for image in &scene.images {
            fixtures::write_png(&at.join(&scaled_images).join(&image.name), 12, 8, image.rgb);
        }
        let half = load(at, &scaled).unwrap();
        assert_eq!(
            (half.train[0].camera.width, &half.train[0].picture().unwrap().bytes[..3]),
            (12, &[1, 100, 200][..])
        );
    }
}

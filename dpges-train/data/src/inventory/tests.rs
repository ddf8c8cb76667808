//! Nothing in the folder of a dataset is lost in silence.

use std::path::{Path, PathBuf};

use crate::fixtures::{self, Encoding, assert_refused, assert_says, colmap_folder, said, write_mask, write_png};
use crate::{Dataset, LoadOptions, load};

const SIZE: [u32; 2] = [24, 16];

fn loaded(path: &Path) -> Dataset {
    load(path, &LoadOptions::default()).unwrap()
}

/// Nine views, of which two are held out, and a place for more.
fn dataset() -> (tempfile::TempDir, PathBuf) {
    let folder = colmap_folder(&fixtures::scene(9), Encoding::Text);
    let path = folder.path().to_owned();
    (folder, path)
}

fn moved(at: &Path, from: &str, to: &str) {
    std::fs::create_dir_all(at.join(to).parent().unwrap()).unwrap();
    std::fs::rename(at.join(from), at.join(to)).unwrap();
}

#[test]
fn models_and_photographs_are_found_where_other_programs_put_them() {
    for (model, images) in [
        ("sparse/0", "images"),
        ("sparse", "images"),
        ("colmap/sparse/0", "images"),
        (".", "images"),
        ("sparse/0", "input"),
        ("sparse/0", "."),
        (".", "."),
        ("Sparse/0", "Images"),
        ("dense/sparse", "dense/images"),
    ] {
        let (folder, scene) = (tempfile::tempdir().unwrap(), fixtures::scene(9));
        let at = folder.path();
        fixtures::write_model(&at.join(model), &scene, Encoding::Text);
        for image in &scene.images {
            write_png(&at.join(images).join(&image.name), 24, 16, image.rgb);
        }
        // by the folder, by a file of the cameras, and by a folder within
        let named = [at.to_owned(), at.join(model).join("images.txt"), at.join(model), at.join(images)];
        let usual = model == "sparse/0" && images == "images";
        for path in &named[..if usual { 4 } else { 2 }] {
            let data = loaded(path);
            assert_eq!((data.train.len(), data.test.len(), said(&data)), (7, 2, String::new()), "{path:?}");
        }
    }
}

#[test]
fn names_that_two_folders_have_are_said() {
    let mut scene = fixtures::scene(9);
    scene.images.iter_mut().for_each(|image| image.name = image.name.replace("left/", ""));
    let (folder, at) = (tempfile::tempdir().unwrap(), |name: &str, of: &str| format!("images/{of}/{name}"));
    fixtures::write_model(&folder.path().join("sparse/0"), &scene, Encoding::Text);
    for (index, image) in scene.images.iter().enumerate() {
        write_png(&folder.path().join(at(&image.name, "cam1")), 24, 16, image.rgb);
        if index < 2 {
            write_png(&folder.path().join(at(&image.name, "cam2")), 24, 16, image.rgb);
        }
        write_png(&folder.path().join("images_2").join(&image.name), 12, 8, image.rgb);
    }
    let data = loaded(folder.path());
    assert_says(said(&data), &["in several folders (2): 007.png (images/cam1, images/cam2), 008.png ("]);
}

#[cfg(unix)]
#[test]
fn links_to_nowhere_are_missing_photographs() {
    let (_folder, at) = dataset();
    let photograph = at.join("images/left/003.png");
    std::fs::remove_file(&photograph).unwrap();
    std::os::unix::fs::symlink("/nowhere.png", &photograph).unwrap();
    assert_says(said(&loaded(&at)), &["their views left out (1): images/left/003.png"]);
    std::fs::remove_file(&photograph).unwrap();
    // it is read, like a pipe, without an end
    std::os::unix::fs::symlink("/dev/zero", &photograph).unwrap();
    assert_says(said(&loaded(&at)), &["their views left out (1): images/left/003.png"]);
}

#[test]
fn a_folder_of_datasets_is_none() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["garden", "room"] {
        let scene = fixtures::scene(3);
        fixtures::write_model(&folder.path().join(name).join("sparse/0"), &scene, Encoding::Text);
        for image in &scene.images {
            write_png(&folder.path().join(name).join("images").join(&image.name), 24, 16, image.rgb);
        }
    }
    assert_refused(folder.path(), &LoadOptions::default(), &["garden, room"]);
}

#[test]
fn names_may_differ_in_case_separators_extensions_and_ways_to_write_a_letter() {
    // how the model calls images/left/ü_#.png
    for described in [
        "left/\u{fc}_#.PNG",
        "LEFT\\U\u{308}_#.jpg",
        "C:\\scans\\room\\images\\left\\\u{fc}_#.png",
        "/home/me/room/left/u\u{308}_#.jpeg",
    ] {
        let mut scene = fixtures::scene(3);
        let folder = colmap_folder(&scene, Encoding::Text);
        let at = folder.path();
        for (index, image) in scene.images.iter_mut().enumerate() {
            moved(at, &format!("images/{}", image.name), &format!("images/left/\u{fc}_{index}.png"));
            image.name = described.replace('#', &index.to_string());
        }
        fixtures::write_model(&at.join("sparse/0"), &scene, Encoding::Text);
        let data = loaded(at);
        assert_eq!((data.train.len() + data.test.len(), said(&data)), (3, String::new()), "{described}");
    }
}

#[test]
fn a_photograph_that_is_gone_is_not_mistaken_for_one_of_another_folder() {
    let (_folder, at) = dataset();
    write_png(&at.join("images/right/004.png"), 24, 16, [9; 3]);
    std::fs::remove_file(at.join("images/left/004.png")).unwrap();
    let data = loaded(&at);
    assert_eq!(data.train.len() + data.test.len(), 8);
    assert_says(said(&data), &["Missing: photographs are missing, and their views left out (1): images/left/004.png"]);
}

#[test]
fn masks_are_found_by_the_names_of_other_programs_or_said_to_belong_to_nothing() {
    for name in [
        "masks/left/001.png.png",
        "masks/left/001.png",
        "masks/left/001.png.mask.png",
        "masks/left/001_mask.png",
        "mask/left/001.PNG",
        "images/left/001.png.mask.png",
        "images/left/001_mask.png",
        "left/masks/001.png",
    ] {
        let (_folder, at) = dataset();
        write_mask(&at.join(name), SIZE, 6);
        let data = loaded(&at);
        let view = data.train.iter().find(|view| view.name == "left/001.png").unwrap();
        assert_eq!((view.photograph.ignored_pixels(), said(&data).as_str()), (Some(6 * 16), ""), "{name}");
    }
    let (_folder, at) = dataset();
    write_mask(&at.join("masks/left/001.png"), SIZE, 0);
    write_mask(&at.join("masks/left/stranger.png"), SIZE, 6);
    write_mask(&at.join("dynamic_masks/left/002.png"), SIZE, 6);
    let parts = [
        "masks of no photograph with a camera (2)",
        "dynamic_masks/left/002.png",
        "masks/left/stranger.png",
        "mask nothing",
    ];
    assert_says(said(&loaded(&at)), &parts);
}

#[test]
fn the_other_half_of_a_reconstruction_and_photographs_without_cameras_are_said() {
    let scene = fixtures::scene(9);
    let folder = colmap_folder(&scene, Encoding::Binary);
    let at = folder.path();
    let part = |range: std::ops::Range<usize>| {
        let mut part = fixtures::scene(9);
        part.images =
            part.images.into_iter().enumerate().filter(|(at, _)| range.contains(at)).map(|(_, image)| image).collect();
        part
    };
    fixtures::write_model(&at.join("sparse/0"), &part(0..2), Encoding::Binary);
    fixtures::write_model(&at.join("sparse/1"), &part(2..8), Encoding::Binary);
    fixtures::write_model(&at.join("distorted/sparse/0"), &part(2..6), Encoding::Binary);
    let data = loaded(at);
    assert_eq!(data.train.len() + data.test.len(), 6);
    let said = said(&data);
    assert_says(
        &said,
        &[
            "Unused: sparse/0 is not used, for sparse/1/images.bin has the cameras; 2 photographs",
            "Aside: distorted/sparse/0 is not used",
            "Unused: photographs without a camera are not used (1): images/left/000.png",
        ],
    );
}

#[test]
fn cameras_of_programs_that_are_not_read_are_named() {
    let files: [(&str, &[u8], &str); 6] = [
        ("blocks.xml", b"<BlocksExchange version='3.2'>", "ContextCapture"),
        ("model.nvm", b"NVM_V3\n", "VisualSFM"),
        ("poses_bounds.npy", b"\x93NUMPY\x01\0v\0{'descr': '<f8', 'shape': (28, 17), }", "LLFF"),
        ("cameras.json", br#"[{"id": 0, "img_name": "a"}]"#, "3DGS"),
        ("cameras/000.json", br#"{"t_00": 1}"#, "Polycam"),
        ("cameras.txt", b"1 PINHOLE 24 16 20 20 12 8", "in part"),
    ];
    for (name, content, program) in files {
        let (_folder, at) = dataset();
        std::fs::create_dir_all(at.join(name).parent().unwrap()).unwrap();
        std::fs::write(at.join(name), content).unwrap();
        assert_says(said(&loaded(&at)), &["Aside: cameras of", program, name]);
        std::fs::remove_dir_all(at.join("sparse")).unwrap();
        assert_refused(&at, &LoadOptions::default(), &[name, program, "dpges sfm"]);
    }
}

#[test]
fn depth_maps_lists_and_pictures_of_other_formats_are_said() {
    let (_folder, at) = dataset();
    write_png(&at.join("depth/left/001.png"), 24, 16, [9; 3]);
    std::fs::write(at.join("list.txt"), "left/001.png\nleft/002\n").unwrap();
    std::fs::write(at.join("notes.txt"), "a walk through the room\nleft/001.png\nby night\n").unwrap();
    for file in ["images/left/IMG_1.HEIC", "masks/left/001.png.npy", "stereo/depth_maps/left/001.png.geometric.bin"] {
        std::fs::create_dir_all(at.join(file).parent().unwrap()).unwrap();
        std::fs::write(at.join(file), "").unwrap();
    }
    write_png(&at.join("images/left/001_normal.png"), 24, 16, [9; 3]);
    let data = loaded(&at);
    assert_says(
        said(&data),
        &[
            "Unused: pictures or masks of formats that are not read (2): images/left/IMG_1.HEIC, masks/left/001.png.npy",
            "Aside: depth maps are not used (2): stereo/depth_maps/left/001.png.geometric.bin, depth/left/001.png",
            "Aside: lists of views are not used (1): list.txt",
        ],
    );
    assert_eq!(data.notices.0.len(), 3);
    std::fs::write(at.join("depth/left/002.npy"), "").unwrap();
    let options = LoadOptions { depth: Some(crate::DepthKind::Relative), ..Default::default() };
    std::fs::remove_file(at.join("depth/left/001.png")).unwrap();
    assert_refused(&at, &options, &["has no depth maps", "grey PNGs of 16 bits"]);
    fixtures::save(&at.join("depth/left/001.png"), image::ImageBuffer::from_pixel(24, 16, image::Luma([900u16])));
    assert_says(
        said(&load(&at, &options).unwrap()),
        &["Unused: depth maps of formats that are not read (2): ", "depth/left/002.npy"],
    );
}

//! Tiny datasets on disk for tests.

use std::fmt::Write as _;
use std::path::Path;

use dpges_core::camera::CameraFromWorld;
use glam::{DMat3, DQuat, DVec3};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, Rgb, RgbImage, Rgba, RgbaImage};
use tempfile::TempDir;

use super::{Dataset, LoadOptions, View, builtin_panorama, load};

/// Size and intrinsics of the photographs of [`scene`].
const WIDTH: u64 = 24;
const HEIGHT: u64 = 16;

pub(crate) struct FixtureImage {
    pub id: u32,
    pub name: String,
    pub pose: CameraFromWorld,
    pub rgb: [u8; 3],
    /// Position, px, and index of the point that it shows; beside keypoints that are no points.
    pub keypoints: Vec<([f64; 2], u64)>,
}

pub(crate) struct FixturePoint {
    pub position: DVec3,
    pub rgb: [u8; 3],
    pub track: Vec<u32>,
}

pub(crate) struct FixtureScene {
    /// Numeric id and name of the COLMAP model, and its parameters.
    pub model: (u32, &'static str),
    pub params: Vec<f64>,
    pub images: Vec<FixtureImage>,
    pub points: Vec<FixturePoint>,
}

#[derive(Clone, Copy)]
pub(crate) enum Encoding {
    Binary,
    Text,
}

/// Pose `index` of `count` on a circle around the origin.
pub(crate) fn pose(index: usize, count: usize) -> CameraFromWorld {
    let angle = index as f64 / count as f64 * std::f64::consts::TAU;
    CameraFromWorld::look_at(DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.0 + 0.1 * angle), DVec3::ZERO, DVec3::Z)
}

/// `count` PINHOLE photographs, each in its own colour, in an order that is not that of their names, and five points.
pub(crate) fn scene(count: usize) -> FixtureScene {
    let images = (0..count)
        .rev()
        .map(|index| FixtureImage {
            id: 100 + 7 * index as u32,
            name: format!("left/{index:03}.png"),
            pose: pose(index, count),
            rgb: [index as u8, 100, 200],
            keypoints: Vec::new(),
        })
        .collect();
    let points = (0..5u32)
        .map(|index| FixturePoint {
            position: DVec3::new(0.3 * f64::from(index) - 0.5, 0.125, -0.2 * f64::from(index)),
            rgb: [index as u8 * 50, 255, 0],
            track: vec![107, 107, 100 + 7 * (index % count as u32)],
        })
        .collect();
    FixtureScene { model: (1, "PINHOLE"), params: vec![20.0, 20.0, 12.0, 8.0], images, points }
}

/// Saves an image, and makes the folder that it goes to.
pub(crate) fn save(path: &Path, image: impl Into<DynamicImage>) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.into().save(path).unwrap();
}

pub(crate) fn write_png(path: &Path, width: u32, height: u32, rgb: [u8; 3]) {
    save(path, RgbImage::from_pixel(width, height, Rgb(rgb)));
}

pub(crate) fn write_rgba(path: &Path, width: u32, height: u32, rgba: [u8; 4]) {
    save(path, RgbaImage::from_pixel(width, height, Rgba(rgba)));
}

/// A mask that counts the columns from `from` on.
pub(crate) fn write_mask(path: &Path, [width, height]: [u32; 2], from: u32) {
    save(path, GrayImage::from_fn(width, height, |x, _| Luma([u8::from(x >= from)])));
}

/// Adds a segment to a JPEG, before all others.
pub(crate) fn insert_segment(path: &Path, marker: u8, content: &[u8]) {
    let plain = std::fs::read(path).unwrap();
    let length = (content.len() as u16 + 2).to_be_bytes();
    std::fs::write(path, [&plain[..2], &[0xff, marker], &length, content, &plain[2..]].concat()).unwrap();
}

/// Fails unless `message` has all `parts`.
#[track_caller]
pub(crate) fn assert_says(message: impl ToString, parts: &[&str]) {
    let message = message.to_string();
    for part in parts {
        assert!(message.contains(part), "`{part}` is not in: {message}");
    }
}

/// All that was said of a dataset as it was read.
pub(crate) fn said(data: &Dataset) -> String {
    data.notices.0.iter().map(|notice| format!("{:?}: {}\n", notice.kind, notice.message)).collect()
}

/// Fails unless the dataset cannot be read, for a reason that has all `parts`.
#[track_caller]
pub(crate) fn assert_refused(folder: &Path, options: &LoadOptions, parts: &[&str]) {
    assert_says(load(folder, options).unwrap_err(), parts);
}

/// Camera-to-world JSON with OpenGL axes.
pub(crate) fn transform_matrix(pose: &CameraFromWorld) -> String {
    let columns = DMat3::from_cols(pose.rotation.row(0), -pose.rotation.row(1), -pose.rotation.row(2));
    let rows: Vec<String> = (0..3)
        .map(|i| format!("[{}, {}, {}, {}]", columns.col(0)[i], columns.col(1)[i], columns.col(2)[i], pose.centre()[i]))
        .collect();
    format!("[{}, [0, 0, 0, 1]]", rows.join(", "))
}

/// A frame of a nerfstudio dataset, one of `count` around the origin, and its image `images/NAME.png` of 24 × 16 px. `extra`
/// are other entries, each with a comma after it.
pub(crate) fn nerfstudio_frame(folder: &Path, name: &str, [index, count]: [usize; 2], extra: &str) -> String {
    write_png(&folder.join(format!("images/{name}.png")), 24, 16, [index as u8 * 10, 0, 0]);
    let matrix = transform_matrix(&pose(index, count));
    format!(r#"{{"file_path": "images/{name}.png", {extra} "transform_matrix": {matrix}}}"#)
}

/// A file of transforms: `header` are its entries besides the frames.
pub(crate) fn write_transforms(path: &Path, header: &str, frames: &[String]) {
    std::fs::write(path, format!(r#"{{{header}, "frames": [{}]}}"#, frames.join(","))).unwrap();
}

/// Panoramas of `width` px at the places of the views of `data` as a nerfstudio dataset: `images/`, `depths/` in millimetres,
/// `transforms.json`.
pub(crate) fn export_panoramas(root: &Path, data: &Dataset, width: usize, supersampling: usize) {
    let file = |view: &View| format!("images/{}.png", view.name);
    let frame = |view: &View| {
        let pose = view.camera.camera_from_world;
        let (picture, distances) = builtin_panorama(&pose, width, supersampling);
        let [columns, rows] = [picture.width as u32, picture.height as u32];
        save(&root.join(file(view)), RgbImage::from_raw(columns, rows, picture.bytes).unwrap());
        let steps = distances.iter().map(|distance| (1e3 * distance).round() as u16).collect();
        let map = ImageBuffer::<Luma<u16>, _>::from_raw(columns, rows, steps).unwrap();
        save(&root.join(format!("depths/{}.png", view.name)), map);
        format!(r#"{{"file_path": "{}", "transform_matrix": {}}}"#, file(view), transform_matrix(&pose))
    };
    let frames: Vec<String> = data.train.iter().chain(&data.test).map(frame).collect();
    let held_out: Vec<String> = data.test.iter().map(|view| format!("{:?}", file(view))).collect();
    let header = format!(r#""camera_model": "EQUIRECTANGULAR", "test_filenames": [{}]"#, held_out.join(","));
    write_transforms(&root.join("transforms.json"), &header, &frames);
}

/// Peak signal-to-noise ratio of 8-bit values, dB.
pub(crate) fn psnr(a: &[u8], b: &[u8]) -> f64 {
    assert_eq!(a.len(), b.len());
    let square = a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>() / a.len() as f64;
    10.0 * (255.0f64.powi(2) / square).log10()
}

/// A folder with [`write_colmap`].
pub(crate) fn colmap_folder(scene: &FixtureScene, encoding: Encoding) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_colmap(folder.path(), scene, encoding);
    folder
}

/// `images/` and `sparse/0`.
pub(crate) fn write_colmap(root: &Path, scene: &FixtureScene, encoding: Encoding) {
    for image in &scene.images {
        write_png(&root.join("images").join(&image.name), WIDTH as u32, HEIGHT as u32, image.rgb);
    }
    write_model(&root.join("sparse/0"), scene, encoding);
}

/// `cameras`, `images` and `points3D` in `folder`.
pub(crate) fn write_model(folder: &Path, scene: &FixtureScene, encoding: Encoding) {
    std::fs::create_dir_all(folder).unwrap();
    match encoding {
        Encoding::Binary => write_binary(folder, scene),
        Encoding::Text => write_text(folder, scene),
    }
}

fn wxyz(pose: &CameraFromWorld) -> [f64; 4] {
    let q = DQuat::from_mat3(&pose.rotation);
    [q.w, q.x, q.y, q.z]
}

fn write_binary(folder: &Path, scene: &FixtureScene) {
    let mut cameras = 1u64.to_le_bytes().to_vec();
    cameras.extend([5u32, scene.model.0].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend([WIDTH, HEIGHT].iter().flat_map(|v| v.to_le_bytes()));
    cameras.extend(scene.params.iter().flat_map(|v| v.to_le_bytes()));
    std::fs::write(folder.join("cameras.bin"), cameras).unwrap();

    let mut images = (scene.images.len() as u64).to_le_bytes().to_vec();
    for image in &scene.images {
        images.extend(image.id.to_le_bytes());
        let translation = image.pose.translation.to_array();
        images.extend(wxyz(&image.pose).iter().chain(&translation).flat_map(|v| v.to_le_bytes()));
        images.extend(5u32.to_le_bytes());
        images.extend(image.name.as_bytes());
        images.push(0);
        let of_no_point = std::iter::repeat_n(&([1.5, 2.5], u64::MAX), image.id as usize % 3);
        let keypoints: Vec<_> = of_no_point.chain(&image.keypoints).collect();
        images.extend((keypoints.len() as u64).to_le_bytes());
        for (position, point) in keypoints {
            images.extend(position.iter().flat_map(|v| v.to_le_bytes()));
            images.extend(point.to_le_bytes());
        }
    }
    std::fs::write(folder.join("images.bin"), images).unwrap();

    let mut points = (scene.points.len() as u64).to_le_bytes().to_vec();
    for (id, point) in scene.points.iter().enumerate() {
        points.extend((id as u64).to_le_bytes());
        points.extend(point.position.to_array().iter().flat_map(|v| v.to_le_bytes()));
        points.extend(point.rgb);
        points.extend(0.5f64.to_le_bytes());
        points.extend((point.track.len() as u64).to_le_bytes());
        points.extend(point.track.iter().flat_map(|image| [*image, 0]).flat_map(u32::to_le_bytes));
    }
    std::fs::write(folder.join("points3D.bin"), points).unwrap();
}

fn write_text(folder: &Path, scene: &FixtureScene) {
    let mut cameras = format!("# Camera list\n5 {} {WIDTH} {HEIGHT}", scene.model.1);
    scene.params.iter().for_each(|value| write!(cameras, " {value}").unwrap());
    std::fs::write(folder.join("cameras.txt"), cameras + "\n").unwrap();

    let mut images = "# Image list with two lines of data per image:\n".to_owned();
    for image in &scene.images {
        let ([w, x, y, z], t) = (wxyz(&image.pose), image.pose.translation);
        writeln!(images, "{} {w} {x} {y} {z} {} {} {} 5 {}", image.id, t.x, t.y, t.z, image.name).unwrap();
        image.keypoints.iter().for_each(|([x, y], point)| write!(images, "{x} {y} {point} ").unwrap());
        writeln!(images, "{}", "1.5 2.5 -1 ".repeat(image.id as usize % 3)).unwrap();
    }
    std::fs::write(folder.join("images.txt"), images).unwrap();

    let mut points = "# 3D point list\n".to_owned();
    for (id, point) in scene.points.iter().enumerate() {
        let (p, [r, g, b]) = (point.position, point.rgb);
        write!(points, "{id} {} {} {} {r} {g} {b} 0.5", p.x, p.y, p.z).unwrap();
        point.track.iter().for_each(|image| write!(points, " {image} 0").unwrap());
        points.push('\n');
    }
    std::fs::write(folder.join("points3D.txt"), points).unwrap();
}

//! Reference data of `web/tests/browser.py`: an exported page, and pictures of its scene by this machine's
//! renderer.
#![cfg(all(feature = "export", feature = "native"))]

use std::f64::consts::TAU;
use std::path::Path;

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::lod::{Cell, INDEX, Index, Part};
use dpges_core::scene::{EnvironmentData, GaussianData, Peeling, Quality, Rendering, SceneData, SceneInfo, SurfelData};
use dpges_render::export::html::{Page, find_page, single_file, write_html};
use dpges_render::{CameraPath, Display, Headless, RenderOptions, Rgb8Image};
use glam::{DQuat, DVec3};
use image::ExtendedColorType::Rgb8;
use image::ImageEncoder;
use image::codecs::jpeg::JpegEncoder;
use serde_json::{Value, json};

const SURFELS: usize = 600;
const GAUSSIANS: usize = 300;

/// Numbers from 0 to 1 that look unordered.
fn noise(index: usize, stream: usize) -> f64 {
    let x = (index * 8 + stream) as f64;
    ((x * 12.9898).sin() * 43758.5453).rem_euclid(1.0)
}

/// Point `index` of `count`, spread evenly over the unit sphere.
fn on_sphere(index: usize, count: usize) -> [f64; 3] {
    let z = 1.0 - 2.0 * (index as f64 + 0.5) / count as f64;
    let angle = TAU * 0.618_034 * index as f64;
    let ring = (1.0 - z * z).sqrt();
    [ring * angle.cos(), ring * angle.sin(), z]
}

/// The quaternion (w, x, y, z) that turns z to `normal`.
fn quaternion_to(normal: [f64; 3]) -> [f64; 4] {
    let [x, y, z] = normal;
    let w = 1.0 + z;
    let length = (w * w + x * x + y * y).sqrt().max(1e-6);
    [w / length, -y / length, x / length, 0.0]
}

/// A sphere of coloured discs, which is seen through its rims, in a cloud of coloured Gaussians.
fn sphere_in_a_cloud() -> SceneData {
    let info =
        SceneInfo { background: [0.1, 0.12, 0.2], offset: [10.0, 0.0, -3.0], extent: 4.0, ..SceneInfo::default() };
    let mut surfels = SurfelData::neutral(info.colour_model, SURFELS);
    for row in 0..SURFELS {
        let at = on_sphere(row, SURFELS);
        for (axis, coordinate) in at.into_iter().enumerate() {
            surfels.positions[3 * row + axis] = coordinate as f32;
            surfels.colour.base[3 * row + axis] = (0.5 + 0.4 * coordinate + 0.1 * noise(row, axis)) as f32;
        }
        surfels.quaternions[4 * row..][..4].copy_from_slice(&quaternion_to(at).map(|number| number as f32));
        surfels.log_scales[2 * row..][..2].copy_from_slice(&[0.025f32.ln(), 0.04f32.ln()]);
        surfels.margins[row] = 0.05;
    }
    let mut gaussians = GaussianData::neutral(info.colour_model, GAUSSIANS);
    for row in 0..GAUSSIANS {
        let at = on_sphere(row, GAUSSIANS).map(|number| (number * (0.3 + 1.4 * noise(row, 3))) as f32);
        gaussians.positions[3 * row..][..3].copy_from_slice(&at);
        for axis in 0..3 {
            gaussians.log_scales[3 * row + axis] = (0.02 + 0.12 * noise(row, axis)).ln() as f32;
            gaussians.colour.base[3 * row + axis] = noise(row, 4 + axis) as f32;
        }
        gaussians.quaternions[4 * row..][..4].copy_from_slice(&[0, 1, 2, 3].map(|at| noise(row + 1, at) as f32 - 0.4));
        gaussians.opacities[row] = (0.2 + noise(row, 7)) as f32;
    }
    for detail in [&mut surfels.colour.detail, &mut gaussians.colour.detail] {
        for (index, number) in detail.iter_mut().enumerate() {
            *number = (2.0 * noise(index, 5) - 2.0) as f32;
        }
    }
    SceneData { info, surfels, gaussians, environment: None }
}

fn camera(scene: &SceneData, width: usize, height: usize) -> Camera {
    let extent = scene.info.extent;
    let eye = [0.5, -0.6, 0.35].map(|part| part * extent);
    let camera_from_world = CameraFromWorld::look_at(eye.into(), [0.0; 3].into(), [0.0, 0.0, 1.0].into());
    Camera::pinhole(camera_from_world, 0.9 * width as f64, [width, height], scene.info.near)
}

/// As the page takes it.
fn page_camera(camera: &Camera) -> Value {
    json!({
        "id": 0, "position": camera.centre().to_array(),
        "rotation": camera.camera_from_world.rotation.to_cols_array_2d(),
        "fx": camera.fx, "fy": camera.fy, "width": camera.width, "height": camera.height,
    })
}

fn jpeg(picture: &Rgb8Image) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, 85);
    encoder.write_image(&picture.bytes, picture.width as u32, picture.height as u32, Rgb8).unwrap();
    bytes
}

fn write_ppm(path: &Path, picture: &Rgb8Image) {
    let header = format!("P6 {} {} 255\n", picture.width, picture.height);
    std::fs::write(path, [header.as_bytes(), &picture.bytes].concat()).unwrap();
}

/// Writes `scene` in two levels of detail to `folder`: every second primitive, and two cells with one half each. Returns the
/// scene as the cells have it.
fn write_levels(folder: &Path, scene: &SceneData) -> SceneData {
    std::fs::create_dir_all(folder).unwrap();
    let half = |first: usize| {
        let rows = |count: usize| (first..count).step_by(2).collect::<Vec<_>>();
        SceneData {
            surfels: scene.surfels.select(&rows(scene.surfels.len())),
            gaussians: scene.gaussians.select(&rows(scene.gaussians.len())),
            ..scene.clone()
        }
    };
    let mut index = Index::new(scene.info.clone());
    let (mut pack, mut finest) = (Vec::new(), SceneData { environment: None, ..half(usize::MAX) });
    for (cell, level, first) in [(0, 1, 0), (1, 0, 0), (2, 0, 1)] {
        let bytes = half(first).to_compressed(&Quality::HIGH, "cell".as_ref()).unwrap();
        let stored = SceneData::from_bytes(&bytes, "cell").unwrap();
        let part = Part { file: "cells.pack".to_owned(), offset: pack.len() as u64, bytes: bytes.len() as u64 };
        let (parent, children) = if level == 0 { (Some(0), Vec::new()) } else { (None, vec![1, 2]) };
        let (surfels, gaussians) = (stored.surfels.len(), stored.gaussians.len());
        let (min, max, size) = ([-3.0; 3], [3.0; 3], 0.1);
        index.cells.push(Cell { level, min, max, parent, children, part, surfels, gaussians, size });
        pack.extend(bytes);
        if cell > 0 {
            finest.surfels.append(stored.surfels);
            finest.gaussians.append(stored.gaussians);
        }
    }
    std::fs::write(folder.join("cells.pack"), pack).unwrap();
    std::fs::write(folder.join(INDEX), serde_json::to_vec(&index).unwrap()).unwrap();
    finest
}

/// `DPGES_WEB_FIXTURE` names the folder; `DPGES_WEB_SCENE` another scene file than the made one.
#[test]
#[ignore = "web/tests/browser.py runs it, after it has built the page"]
fn export_a_page_and_pictures_of_its_scene() {
    let folder = std::env::var_os("DPGES_WEB_FIXTURE").expect("DPGES_WEB_FIXTURE names the folder to write to");
    let folder = Path::new(&folder);
    let scene = match std::env::var_os("DPGES_WEB_SCENE") {
        Some(path) => SceneData::load(Path::new(&path)).unwrap(),
        None => sphere_in_a_cloud(),
    };
    let device = Headless::new().unwrap();
    println!("native pictures by {}", device.adapter_name());
    let picture =
        |scene: &SceneData, camera: &Camera, options: &RenderOptions| device.picture(scene, camera, options).unwrap();

    let first = camera(&scene, 640, 360);
    let trained = RenderOptions::from(&scene.info);
    let poster = jpeg(&picture(&scene, &first, &trained));
    let turned = |turn: f64| {
        let eye = DQuat::from_axis_angle(DVec3::Z, turn) * first.centre();
        Camera { camera_from_world: CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z), ..first }
    };
    let views = [("front".to_owned(), first), ("from the left".to_owned(), turned(-1.2))];
    let path = CameraPath::new([0.0, 1.0, 2.0].map(turned).to_vec(), false).unwrap();
    let page = Page { title: "Test scene", poster_jpeg: Some(&poster), views: &views, path: Some(&path) };
    let built = find_page(None).unwrap();
    write_html(folder, &built, Some(&scene), &page).unwrap();
    let bytes = scene.to_bytes("scene".as_ref()).unwrap();
    std::fs::write(folder.join("single.html"), single_file(&built, &bytes, &page).unwrap()).unwrap();

    let mut references = Vec::new();
    let mut refer = |name: &str, file: &str, scene: &SceneData, camera: &Camera, options: RenderOptions| {
        write_ppm(&folder.join(format!("{name}.ppm")), &picture(scene, camera, &options));
        let RenderOptions { display, layer_count, modulation, peeling, background, .. } = options;
        let options = json!({
            "display": display, "layer_count": layer_count, "modulation": modulation, "peeling": peeling,
            "background": background,
        });
        references.push(json!({ "name": name, "scene": file, "camera": page_camera(camera), "options": options }));
    };

    let wide = camera(&scene, 320, 180);
    let shown = |display| RenderOptions { display, ..trained };
    let hard = RenderOptions { layer_count: 1, modulation: 100.0, background: [0.9, 0.5, 0.1], ..trained };
    for (name, options) in [
        ("image", trained),
        ("one_hard_layer", hard),
        ("five_layers", RenderOptions { layer_count: 5, modulation: 3.0, ..trained }),
        ("nearest", RenderOptions { layer_count: 4, modulation: 3.0, peeling: Peeling::Nearest, ..trained }),
        ("surfels", shown(Display::Surfels)),
        ("gaussians", shown(Display::Gaussians)),
        ("transmittance", shown(Display::Transmittance)),
        ("depth", shown(Display::Depth)),
        ("normal", shown(Display::Normal)),
    ] {
        refer(name, "scene.safetensors", &scene, &wide, options);
    }
    refer("odd_size", "scene.safetensors", &scene, &camera(&scene, 161, 203), trained);

    let (no_surfels, no_gaussians) = (scene.surfels.select(&[]), scene.gaussians.select(&[]));
    let blended = |rendering| SceneData {
        info: SceneInfo { rendering, ..scene.info.clone() },
        surfels: no_surfels.clone(),
        gaussians: scene.gaussians.clone(),
        environment: None,
    };
    let coefficients = (0..48).map(|at| (0.4 * noise(at, 9) - 0.2) as f32).collect();
    let sky = Some(EnvironmentData { coefficients });
    for (name, other) in [
        ("ellipsoids", blended(Rendering::Ellipsoids)),
        ("discs", blended(Rendering::Discs)),
        ("gaussians_alone", blended(Rendering::Peeled)),
        ("surfels_alone", SceneData { gaussians: no_gaussians.clone(), ..scene.clone() }),
        ("environment", SceneData { environment: sky.clone(), ..scene.clone() }),
        ("discs_before_environment", SceneData { environment: sky, ..blended(Rendering::Discs) }),
        ("nothing", SceneData { gaussians: no_gaussians, ..blended(Rendering::Peeled) }),
    ] {
        let file = format!("{name}.safetensors");
        other.save(&folder.join(&file)).unwrap();
        refer(name, &file, &other, &wide, trained);
    }
    let scene = SceneData { environment: None, ..scene };
    let finest = write_levels(&folder.join("levels"), &scene);
    refer("levels", "levels/index.json", &finest, &wide, trained);
    std::fs::write(folder.join("reference.json"), Value::from(references).to_string()).unwrap();
}

//! Loads a scene file and writes a picture: cargo run --release --example render [SCENE [PICTURE]]
use burn::tensor::DType;
use dpges_core::*;
use glam::DVec3;

fn main() -> std::result::Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().map_or_else(|| Ok(tiny()), |path| SceneData::load(path.as_ref()))?;
    let device = backend::device::cpu();
    let surfels = Surfels::from_data(&scene.surfels, &device, DType::F32);
    let gaussians = Gaussians::from_data(&scene.gaussians, &device, DType::F32);

    let eye = scene.info.extent * DVec3::new(0.6, -0.7, 0.4);
    let camera_from_world = CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z);
    let camera = Camera::pinhole(camera_from_world, 300.0, [320, 240], scene.info.near);
    let view = render(&surfels, &gaussians, &camera, &RenderOptions::from(&scene.info))?;

    let rows = view.composite.image.permute([1, 2, 0]).clamp(0.0, 1.0) * 255.0;
    let pixels: Vec<u8> = rows.into_data().iter::<f32>().map(|value| value.round() as u8).collect();
    let picture = arguments.next().unwrap_or_else(|| std::env::temp_dir().join("dpges.png").display().to_string());
    image::save_buffer(&picture, &pixels, camera.width as u32, camera.height as u32, image::ColorType::Rgb8)?;
    println!("{} surfels and {} Gaussians in {picture}", surfels.len(), gaussians.len());
    Ok(())
}

/// A red disc in the x-y plane with a blue ball over it.
fn tiny() -> SceneData {
    let colour = |red, green, blue| ColourData { base: vec![red, green, blue], ..ColourData::default() };
    let (red, blue) = (colour(1.5, -1.0, -1.0), colour(-1.0, -1.0, 1.5));
    let colour_model = ColourModel::SphericalBeta { lobes: 0 };
    let disc = SurfelData::neutral(colour_model, 1);
    let surfels = SurfelData { log_scales: vec![-1.5; 2], colour: red, margins: vec![0.1], ..disc };
    let (ball, positions) = (GaussianData::neutral(colour_model, 1), vec![0.0, 0.0, 0.4]);
    let gaussians = GaussianData { positions, log_scales: vec![-2.0; 3], opacities: vec![2.0], colour: blue, ..ball };
    SceneData {
        info: SceneInfo { colour_model, extent: 3.0, ..SceneInfo::default() },
        surfels,
        gaussians,
        environment: None,
    }
}

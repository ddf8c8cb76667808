//! A scene in an egui application of one's own: `cargo run -p dpges-render --features viewer --example embed -- SCENE`.

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::SceneData;
use dpges_render::{RasterRenderer, RenderOptions};
use eframe::{egui, wgpu};
use glam::DVec3;

/// Side of the picture, px.
const SIZE: usize = 600;
const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

struct Turntable {
    renderer: RasterRenderer,
    options: RenderOptions,
    view: wgpu::TextureView,
    picture: egui::TextureId,
    angle: f64,
}

impl eframe::App for Turntable {
    fn ui(&mut self, ui: &mut egui::Ui, _frame: &mut eframe::Frame) {
        ui.add(egui::Slider::new(&mut self.angle, 0.0..=std::f64::consts::TAU).text("angle"));
        let eye = 2.5 * DVec3::new(self.angle.cos(), self.angle.sin(), 0.5);
        let camera_from_world = CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z);
        let camera = Camera::pinhole(camera_from_world, SIZE as f64, [SIZE, SIZE], 0.01);
        self.renderer.submit(&self.view, &camera, &self.options).expect("there is a scene");
        self.renderer.finish_frame();
        ui.image((self.picture, egui::Vec2::splat(SIZE as f32)));
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scene = SceneData::load(std::env::args_os().nth(1).ok_or("name a scene file")?.as_ref())?;
    let create = move |context: &eframe::CreationContext<'_>| -> Result<Box<dyn eframe::App>, _> {
        let gpu = context.wgpu_render_state.clone().ok_or("eframe draws without wgpu")?;
        let (precision, depths) =
            (RasterRenderer::best_precision(&gpu.device), RasterRenderer::best_depths(&gpu.device));
        let mut renderer = RasterRenderer::new(&gpu.device, &gpu.queue, FORMAT, precision, depths)?;
        renderer.upload(&scene)?;
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: SIZE as u32, height: SIZE as u32, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        let picture = gpu.renderer.write().register_native_texture(&gpu.device, &view, wgpu::FilterMode::Linear);
        let options = RenderOptions::from(&scene.info);
        Ok(Box::new(Turntable { renderer, options, view, picture, angle: 0.0 }))
    };
    Ok(eframe::run_native("embedded", Default::default(), Box::new(create))?)
}

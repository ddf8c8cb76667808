//! A scene in an egui application of one's own: `cargo run -p dpges-render --features viewer --example embed -- SCENE`.

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::SceneData;
use dpges_render::{RenderOptions, Renderer};
use eframe::egui_wgpu::RenderState;
use eframe::{egui, wgpu};
use glam::DVec3;

type Error = Box<dyn std::error::Error + Send + Sync>;

struct Turntable {
    gpu: RenderState,
    renderer: Renderer,
    options: RenderOptions,
    distance: f64,
    angle: f64,
    texture: Option<egui::TextureId>,
}

impl eframe::App for Turntable {
    fn ui(&mut self, ui: &mut egui::Ui, _frame: &mut eframe::Frame) {
        ui.add(egui::Slider::new(&mut self.angle, 0.0..=std::f64::consts::TAU).text("angle"));
        let place = ui.available_rect_before_wrap();
        let [width, height] = [place.width(), place.height()].map(|points| (points as usize).max(1));
        let eye = self.distance * DVec3::new(self.angle.cos(), self.angle.sin(), 0.5);
        let camera_from_world = CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z);
        let (f, cx, cy) = (height as f64, 0.5 * width as f64, 0.5 * height as f64);
        let camera = Camera { camera_from_world, fx: f, fy: f, cx, cy, width, height, near: 0.01 };

        let texture = self.gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let view = texture.create_view(&Default::default());
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        self.renderer.render(&mut encoder, &view, &camera, &self.options).expect("the scene is uploaded");
        self.gpu.queue.submit([encoder.finish()]);
        self.renderer.finish_frame();

        let mut egui = self.gpu.renderer.write();
        self.texture.take().inspect(|last| egui.free_texture(last));
        let id = egui.register_native_texture(&self.gpu.device, &view, wgpu::FilterMode::Linear);
        self.texture = Some(id);
        ui.painter().image(id, place, egui::Rect::from_min_max([0.0; 2].into(), [1.0; 2].into()), egui::Color32::WHITE);
    }
}

fn main() -> Result<(), Error> {
    let scene = SceneData::load(std::env::args_os().nth(1).ok_or("name a scene file")?.as_ref())?;
    let create = move |context: &eframe::CreationContext<'_>| -> Result<Box<dyn eframe::App>, Error> {
        let gpu = context.wgpu_render_state.clone().ok_or("eframe draws without wgpu")?;
        let precision = Renderer::best_precision(&gpu.device);
        let mut renderer = Renderer::new(&gpu.device, &gpu.queue, wgpu::TextureFormat::Rgba8Unorm, precision)?;
        renderer.upload(&scene)?;
        let (options, distance) = (RenderOptions::from(&scene.info), 0.6 * scene.info.extent);
        Ok(Box::new(Turntable { gpu, renderer, options, distance, angle: 0.0, texture: None }))
    };
    Ok(eframe::run_native("embedded", Default::default(), Box::new(create))?)
}

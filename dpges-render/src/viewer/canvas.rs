//! The picture of the scene as a texture that egui shows, and as bytes.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use eframe::egui_wgpu::RenderState;
use egui::TextureId;

use crate::stream::{Levels, Loader, StreamError, StreamStatus};
use crate::texture::{size, texture};
use crate::{PassTime, RasterRenderer, RenderError, RenderOptions, Rgb8Image};

/// A format that egui shows without conversion; colours are display-referred.
const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

pub struct Canvas {
    state: RenderState,
    renderer: RasterRenderer,
    /// The cells that come and go, where the scene has levels of detail.
    loader: Option<Loader>,
    target: Option<Target>,
    /// The content of the target; `None` if it has to be drawn again.
    shown: Option<(Camera, RenderOptions)>,
}

struct Target {
    view: wgpu::TextureView,
    id: TextureId,
}

impl Canvas {
    pub fn new(state: &RenderState) -> Result<Self, RenderError> {
        let (precision, depths) =
            (RasterRenderer::best_precision(&state.device), RasterRenderer::best_depths(&state.device));
        let renderer = RasterRenderer::new(&state.device, &state.queue, FORMAT, precision, depths)?;
        Ok(Self { state: state.clone(), renderer, loader: None, target: None, shown: None })
    }

    pub fn upload(&mut self, scene: &SceneData) -> Result<(), RenderError> {
        self.shown = None;
        self.renderer.upload(scene)?;
        self.loader = None;
        Ok(())
    }

    /// Shows a scene in levels of detail. Calls `wake` whenever a part of it has come.
    pub fn stream(&mut self, levels: Levels, wake: impl Fn() + Send + Clone + 'static) -> Result<(), StreamError> {
        self.shown = None;
        self.loader = Some(Loader::new(levels, &mut self.renderer, wake)?);
        Ok(())
    }

    /// Goes on with the levels of detail for what `camera` sees, before it is drawn.
    pub fn advance(&mut self, camera: &Camera) -> Option<StreamStatus> {
        let loader = self.loader.as_mut()?;
        let before = loader.status().changes;
        loader.update(&mut self.renderer, camera);
        let status = loader.status();
        if status.changes != before {
            self.shown = None;
        }
        Some(status)
    }

    pub fn adapter_name(&self) -> String {
        self.state.adapter.get_info().name
    }

    /// Largest width and height of a picture, px.
    pub fn largest_size(&self) -> usize {
        self.state.device.limits().max_texture_dimension_2d as usize
    }

    /// Draws what `camera` sees, unless it is what the texture shows. Returns whether it was drawn.
    pub fn draw(&mut self, camera: &Camera, options: &RenderOptions) -> Result<bool, RenderError> {
        let wanted = (*camera, *options);
        if self.shown.as_ref() == Some(&wanted) {
            return Ok(false);
        }
        self.shown = None;
        let size = size(camera.width as u32, camera.height as u32);
        let target = match self.target.take() {
            Some(target) if target.view.texture().size() == size => target,
            other => self.make_target(size, other.map(|target| target.id)),
        };
        let target = self.target.insert(target);
        self.renderer.submit(&target.view, camera, options)?;
        self.renderer.finish_frame();
        self.shown = Some(wanted);
        Ok(true)
    }

    /// The texture that was drawn last, and the camera it was drawn from.
    pub fn texture(&self) -> Option<(TextureId, &Camera)> {
        Some((self.target.as_ref()?.id, &self.shown.as_ref()?.0))
    }

    pub fn pass_times(&self) -> &[PassTime] {
        self.renderer.pass_times().unwrap_or_default()
    }

    /// Depth (camera-space z, world units) of the nearest surfel at a pixel of what was drawn last.
    pub fn depth_at(&self, x_px: u32, y_px: u32) -> Option<f64> {
        self.shown.as_ref()?;
        self.renderer.depth_at(x_px, y_px)
    }

    /// Depths of what was drawn last: see [`RasterRenderer::median_depths`].
    pub fn depths(&self) -> Option<Vec<f32>> {
        self.shown.as_ref()?;
        self.renderer.median_depths()
    }

    /// The view of `camera`, as bytes. Waits for the GPU.
    pub fn picture(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Rgb8Image, RenderError> {
        // the renderer remembers one frame, and this becomes it
        self.shown = None;
        self.renderer.picture(camera, options)
    }

    /// A texture of `size`, known to egui by `id` if it has one already.
    fn make_target(&self, size: wgpu::Extent3d, id: Option<TextureId>) -> Target {
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING;
        let view = texture(&self.state.device, size, FORMAT, usage);
        let mut egui = self.state.renderer.write();
        let (device, filter) = (&self.state.device, wgpu::FilterMode::Linear);
        let id = match id {
            Some(id) => {
                egui.update_egui_texture_from_wgpu_texture(device, &view, filter, id);
                id
            }
            None => egui.register_native_texture(device, &view, filter),
        };
        Target { view, id }
    }
}

impl Drop for Canvas {
    fn drop(&mut self) {
        if let Some(target) = &self.target {
            self.state.renderer.write().free_texture(&target.id);
        }
    }
}

//! The picture of the scene as a texture that egui shows, and as bytes.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use eframe::egui_wgpu::RenderState;
use egui::TextureId;

use crate::readback::texels;
use crate::stream::{Levels, Loader, StreamError, StreamStatus};
use crate::{PassTime, RenderError, RenderOptions, Renderer, Rgb8Image};

/// A format that egui shows without conversion; colours are display-referred.
const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Draws a scene on the device of egui.
pub struct Canvas {
    state: RenderState,
    renderer: Renderer,
    /// The cells that come and go, where the scene has levels of detail.
    loader: Option<Loader>,
    target: Option<Target>,
    /// The content of the target; `None` if it has to be drawn again.
    shown: Option<(Camera, RenderOptions)>,
}

struct Target {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    id: TextureId,
}

impl Canvas {
    /// # Errors
    /// The errors of [`Renderer::new`].
    pub fn new(state: &RenderState) -> Result<Self, RenderError> {
        let (precision, depths) = (Renderer::best_precision(&state.device), Renderer::best_depths(&state.device));
        let renderer = Renderer::new(&state.device, &state.queue, FORMAT, precision, depths)?;
        Ok(Self { state: state.clone(), renderer, loader: None, target: None, shown: None })
    }

    /// # Errors
    /// The errors of [`Renderer::upload`].
    pub fn upload(&mut self, scene: &SceneData) -> Result<(), RenderError> {
        self.shown = None;
        self.renderer.upload(scene)?;
        self.loader = None;
        Ok(())
    }

    /// Shows a scene in levels of detail. Calls `wake` whenever a part of it has come.
    ///
    /// # Errors
    /// The errors of [`Loader::new`].
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
    ///
    /// # Errors
    /// The errors of [`Renderer::render`].
    pub fn draw(&mut self, camera: &Camera, options: &RenderOptions) -> Result<bool, RenderError> {
        let wanted = (*camera, *options);
        if self.shown.as_ref() == Some(&wanted) {
            return Ok(false);
        }
        self.shown = None;
        let size = [camera.width, camera.height];
        let target = match self.target.take() {
            Some(target) if size_of(&target.texture) == size => target,
            other => self.make_target(size, other.map(|target| target.id)),
        };
        let result = submit(&self.state, &mut self.renderer, &target.view, camera, options);
        self.target = Some(target);
        result?;
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

    /// The view of `camera`, as bytes. Waits for the GPU.
    ///
    /// # Errors
    /// The errors of [`Renderer::render`], and [`RenderError::Device`].
    pub fn picture(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Rgb8Image, RenderError> {
        // the renderer remembers one frame, and this becomes it
        self.shown = None;
        let texture = self.make_texture([camera.width, camera.height]);
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        submit(&self.state, &mut self.renderer, &view, camera, options)?;
        let (origin, size) = (wgpu::Origin3d::ZERO, [texture.width(), texture.height()]);
        let rgba = texels(&self.state.device, &self.state.queue, &texture, origin, size)
            .ok_or_else(|| RenderError::Device("the picture could not be read back".to_owned()))?;
        let pixels = rgba.chunks_exact(4).map(|pixel| [pixel[0], pixel[1], pixel[2]]);
        Ok(Rgb8Image::from_pixels(camera.width, camera.height, pixels))
    }

    fn make_texture(&self, [width, height]: [usize; 2]) -> wgpu::Texture {
        self.state.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                | wgpu::TextureUsages::TEXTURE_BINDING
                | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        })
    }

    /// A texture of `size`, known to egui by `id` if it has one already.
    fn make_target(&self, size: [usize; 2], id: Option<TextureId>) -> Target {
        let texture = self.make_texture(size);
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut egui = self.state.renderer.write();
        let (device, filter) = (&self.state.device, wgpu::FilterMode::Linear);
        let id = match id {
            Some(id) => {
                egui.update_egui_texture_from_wgpu_texture(device, &view, filter, id);
                id
            }
            None => egui.register_native_texture(device, &view, filter),
        };
        Target { texture, view, id }
    }
}

impl Drop for Canvas {
    fn drop(&mut self) {
        if let Some(target) = &self.target {
            self.state.renderer.write().free_texture(&target.id);
        }
    }
}

fn size_of(texture: &wgpu::Texture) -> [usize; 2] {
    [texture.width() as usize, texture.height() as usize]
}

fn submit(
    state: &RenderState,
    renderer: &mut Renderer,
    target: &wgpu::TextureView,
    camera: &Camera,
    options: &RenderOptions,
) -> Result<(), RenderError> {
    let mut encoder = state.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("scene") });
    renderer.render(&mut encoder, target, camera, options)?;
    state.queue.submit([encoder.finish()]);
    renderer.finish_frame();
    Ok(())
}

//! The state of the page: a canvas, the renderer, and the scene it shows.

mod levels;
mod tour;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::navigation::Tour;
use dpges_render::path::cameras_from_json;
use dpges_render::{Precision, RasterRenderer, RenderOptions};
use js_sys::{Promise, Uint8ClampedArray};
use serde::Serialize;
use wasm_bindgen::prelude::*;
use wasm_bindgen_futures::future_to_promise;
use web_sys::HtmlCanvasElement;
use wgpu::{CurrentSurfaceTexture, SurfaceConfiguration, TextureFormat, TextureUsages, TextureView};

use crate::device::Gpu;
use crate::page::{self, PageOptions};
use crate::pixels::Copy;
use levels::Levels;

#[wasm_bindgen]
pub struct Viewer {
    gpu: Gpu,
    surface: SurfaceConfiguration,
    precision: Precision,
    renderer: RasterRenderer,
    levels: Levels,
    /// Through the scene that is shown.
    tour: Option<Tour>,
    view: Option<View>,
}

struct View {
    camera: Camera,
    options: RenderOptions,
}

#[wasm_bindgen]
impl Viewer {
    /// Draws on `canvas` through `backend`: "auto" (WebGPU if there is one, or else WebGL2), "webgpu" or "webgl".
    pub async fn create(canvas: HtmlCanvasElement, backend: String) -> Result<Viewer, JsError> {
        console_error_panic_hook::set_once();
        let gpu = Gpu::open(&canvas, &backend).await.map_err(|cause| JsError::new(&cause))?;
        let format = eight_bits(&gpu)?;
        let (width, height) = (canvas.width().max(1), canvas.height().max(1));
        let surface = gpu.surface.get_default_config(&gpu.adapter, width, height);
        let surface = surface.ok_or_else(|| JsError::new("the graphics device cannot draw on this canvas"))?;
        let surface = SurfaceConfiguration { format, ..surface };
        let (precision, depths) =
            (RasterRenderer::best_precision(&gpu.device), RasterRenderer::best_depths(&gpu.device));
        let renderer = RasterRenderer::new(&gpu.device, &gpu.queue, format, precision, depths)?;
        gpu.surface.configure(&gpu.device, &surface);
        Ok(Self { gpu, surface, precision, renderer, levels: Levels::default(), tour: None, view: None })
    }

    /// The device that draws, as JSON.
    pub fn device(&self) -> Result<String, JsError> {
        let info = self.gpu.adapter.get_info();
        json(&page::Device {
            backend: if info.backend == wgpu::Backend::BrowserWebGpu { "WebGPU" } else { "WebGL2" },
            adapter: if info.name.is_empty() { info.driver } else { info.name },
            precision_bits: if matches!(self.precision, Precision::Float) { 32 } else { 16 },
            largest_px: self.gpu.device.limits().max_texture_dimension_2d,
        })
    }

    /// Takes the bytes of a scene file; messages call it `name`. Returns what the scene is, as JSON.
    ///
    /// # Errors
    /// A message about the file, or the reason why the scene cannot be drawn. The scene before it stays.
    pub fn load(&mut self, bytes: &[u8], name: &str) -> Result<String, JsError> {
        let scene = SceneData::from_bytes(bytes, name)?;
        self.renderer.upload(&scene)?;
        self.levels = Levels::default();
        self.summary(&scene, [scene.surfels.len(), scene.gaussians.len()])
    }

    /// Says what the next frame shows by itself: a camera of a `cameras.json`, and options as JSON.
    pub fn set_view(&mut self, camera: &str, options: &str) -> Result<(), JsError> {
        let info = self.renderer.scene_info().ok_or_else(|| JsError::new("no scene is loaded"))?;
        let cameras = cameras_from_json(&format!("[{camera}]"), info).map_err(|cause| JsError::new(&cause))?;
        self.look(cameras[0].1, options)
    }

    /// Draws a frame on the canvas, which takes the camera's size. `false`: the browser had no room for a frame now.
    pub fn draw(&mut self) -> Result<bool, JsError> {
        let Some(view) = &self.view else { return Ok(false) };
        let (width, height) = (view.camera.width as u32, view.camera.height as u32);
        if (self.surface.width, self.surface.height) != (width, height) {
            self.surface = SurfaceConfiguration { width, height, ..self.surface.clone() };
            self.gpu.surface.configure(&self.gpu.device, &self.surface);
        }
        let frame = match self.gpu.surface.get_current_texture() {
            CurrentSurfaceTexture::Success(frame) | CurrentSurfaceTexture::Suboptimal(frame) => frame,
            CurrentSurfaceTexture::Outdated | CurrentSurfaceTexture::Lost => {
                self.gpu.surface.configure(&self.gpu.device, &self.surface);
                return Ok(false);
            }
            CurrentSurfaceTexture::Timeout | CurrentSurfaceTexture::Occluded | CurrentSurfaceTexture::Validation => {
                return Ok(false);
            }
        };
        let target = frame.texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.submit(&target, |_, _| ())?;
        self.gpu.queue.present(frame);
        Ok(true)
    }

    /// Draws a frame into a texture and resolves to its pixels [height, width, 4], as `ImageData` takes them.
    ///
    /// # Errors
    /// Why it could not be drawn. The promise is rejected if the device is lost meanwhile.
    pub fn read_pixels(&mut self) -> Result<Promise, JsError> {
        let view = self.view.as_ref().ok_or_else(|| JsError::new("there is no view to read"))?;
        let (width, height) = (view.camera.width as u32, view.camera.height as u32);
        let texture = self.gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture to read"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: self.surface.format,
            usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let target = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let device = self.gpu.device.clone();
        let copy = self.submit(&target, |device, encoder| Copy::record(device, encoder, &texture))?;
        Ok(future_to_promise(async move {
            let pixels = copy.pixels(device).await.map_err(|cause| JsError::new(&cause))?;
            Ok(Uint8ClampedArray::from(&pixels[..]).into())
        }))
    }

    /// Milliseconds that the passes of a recent frame took, as a JSON object; `undefined` where the device has no
    /// clock.
    pub fn pass_times(&self) -> Result<Option<String>, JsError> {
        let times = self.renderer.pass_times();
        times
            .map(|times| json(&times.iter().map(|time| (time.name, time.milliseconds)).collect::<Vec<_>>()))
            .transpose()
    }

    /// The first error of the device since it was opened, if any.
    pub fn fault(&self) -> Option<String> {
        self.gpu.fault.lock().expect("no thread panics while it holds the lock").clone()
    }
}

impl Viewer {
    /// Describes `scene`, or the scene of `counts` primitives whose coarsest level it is, which is shown from now on.
    fn summary(&mut self, scene: &SceneData, [surfels, gaussians]: [usize; 2]) -> Result<String, JsError> {
        self.tour = Some(Tour::new(scene));
        self.view = None;
        json(&page::Summary { surfels, gaussians, info: &scene.info })
    }

    /// The next frame shows what `camera` sees, with options as JSON.
    fn look(&mut self, camera: Camera, options: &str) -> Result<(), JsError> {
        let info = self.renderer.scene_info().ok_or_else(|| JsError::new("no scene is loaded"))?;
        let options: PageOptions = serde_json::from_str(options).map_err(|error| wrong("options", &error))?;
        self.view = Some(View { camera, options: options.options(info) });
        Ok(())
    }

    /// Renders the view into `target`, then what `record` adds, and hands both to the device.
    fn submit<T>(
        &mut self,
        target: &TextureView,
        record: impl FnOnce(&wgpu::Device, &mut wgpu::CommandEncoder) -> T,
    ) -> Result<T, JsError> {
        let View { camera, options } = self.view.as_ref().ok_or_else(|| JsError::new("there is no view to draw"))?;
        self.levels.advance(&mut self.renderer, camera);
        let mut encoder = self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.renderer.render(&mut encoder, target, camera, options)?;
        let recorded = record(&self.gpu.device, &mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        self.renderer.finish_frame();
        self.gpu.device.poll(wgpu::PollType::Poll)?;
        Ok(recorded)
    }
}

/// The canvas's format with eight bits that are stored as they are computed: pictures are display-referred already.
fn eight_bits(gpu: &Gpu) -> Result<TextureFormat, JsError> {
    let formats = gpu.surface.get_capabilities(&gpu.adapter).formats;
    let wanted = [TextureFormat::Bgra8Unorm, TextureFormat::Rgba8Unorm];
    let found = formats.iter().find(|format| wanted.contains(format));
    found.copied().ok_or_else(|| JsError::new("the canvas has no format with 8 bits per channel"))
}

fn json(value: &impl Serialize) -> Result<String, JsError> {
    Ok(serde_json::to_string(value)?)
}

fn wrong(what: &str, error: &serde_json::Error) -> JsError {
    JsError::new(&format!("{what}: {error}"))
}

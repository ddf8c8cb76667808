//! A device without a window, for files and tests.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use half::f16;

use crate::error::{RenderError, Result};
use crate::image::Rgb8Image;
use crate::options::{DepthSource, Precision, RenderOptions};
use crate::renderer::RasterRenderer;

/// An adapter and its device.
#[derive(Clone, Debug)]
pub struct Headless {
    adapter: wgpu::AdapterInfo,
    /// Format of pictures that are not rounded to bytes.
    floats: wgpu::TextureFormat,
    device: wgpu::Device,
    queue: wgpu::Queue,
}

impl Headless {
    /// The adapter that wgpu prefers (`WGPU_BACKEND` and `WGPU_ADAPTER_NAME` choose another), with what helps the
    /// renderer and the adapter has.
    ///
    /// # Errors
    /// [`RenderError::NoAdapter`], [`RenderError::Adapter`].
    pub fn new() -> Result<Self> {
        let descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
        let instance = wgpu::Instance::new(descriptor);
        let wanted = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..wgpu::RequestAdapterOptions::default()
        };
        let adapter = match pollster::block_on(wgpu::util::initialize_adapter_from_env(&instance, None)) {
            Ok(adapter) => adapter,
            Err(_) => pollster::block_on(instance.request_adapter(&wanted))
                .map_err(|error| RenderError::NoAdapter(error.to_string()))?,
        };
        Self::on(&adapter)
    }

    /// Another device of `adapter`.
    ///
    /// # Errors
    /// [`RenderError::Adapter`].
    pub fn on(adapter: &wgpu::Adapter) -> Result<Self> {
        RasterRenderer::check_adapter(adapter)?;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("dpges"),
            required_features: RasterRenderer::required_features(adapter),
            required_limits: adapter.limits(),
            ..wgpu::DeviceDescriptor::default()
        };
        let refused = |error: wgpu::RequestDeviceError| RenderError::Adapter {
            adapter: adapter.get_info().name,
            reason: error.to_string(),
        };
        let usages = adapter.get_texture_format_features(wgpu::TextureFormat::Rgba32Float).allowed_usages;
        let draws_floats = usages.contains(wgpu::TextureUsages::RENDER_ATTACHMENT);
        let floats = if draws_floats { wgpu::TextureFormat::Rgba32Float } else { wgpu::TextureFormat::Rgba16Float };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor)).map_err(refused)?;
        Ok(Self { adapter: adapter.get_info(), floats, device, queue })
    }

    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Name and interface of the adapter.
    pub fn adapter_name(&self) -> String {
        format!("{} ({})", self.adapter.name, self.adapter.backend)
    }

    /// Whether the adapter is a driver that emulates a GPU on the CPU.
    pub fn is_software(&self) -> bool {
        self.adapter.device_type == wgpu::DeviceType::Cpu
    }

    pub fn backend(&self) -> wgpu::Backend {
        self.adapter.backend
    }

    /// Bytes of everything that is allocated on the device; `None` where its interface does not tell.
    pub fn allocated_bytes(&self) -> Option<u64> {
        self.device.generate_allocator_report().map(|report| report.total_allocated_bytes)
    }

    /// A renderer for [`picture`](Self::picture) with the best precision of the device.
    ///
    /// # Errors
    /// The errors of [`RasterRenderer::new`].
    pub fn renderer(&self) -> Result<RasterRenderer> {
        self.renderer_with(None)
    }

    /// [`renderer`](Self::renderer) with `precision`, if that is given.
    ///
    /// # Errors
    /// The errors of [`RasterRenderer::new`].
    pub fn renderer_with(&self, precision: Option<Precision>) -> Result<RasterRenderer> {
        let precision = precision.unwrap_or_else(|| RasterRenderer::best_precision(&self.device));
        let depths = RasterRenderer::best_depths(&self.device);
        RasterRenderer::new(&self.device, &self.queue, PICTURE_FORMAT, precision, depths)
    }

    /// The picture of the scene that `renderer` holds, which must render into [`PICTURE_FORMAT`].
    ///
    /// # Errors
    /// The errors of [`RasterRenderer::render`]; [`RenderError::Device`] if it cannot be read back.
    pub fn draw(&self, renderer: &mut RasterRenderer, camera: &Camera, options: &RenderOptions) -> Result<Rgb8Image> {
        renderer.picture(camera, options)
    }

    /// The picture of `scene` from `camera`.
    ///
    /// # Errors
    /// The errors of [`RasterRenderer::upload`] and [`draw`](Self::draw).
    pub fn picture(&self, scene: &SceneData, camera: &Camera, options: &RenderOptions) -> Result<Rgb8Image> {
        let mut renderer = self.renderer()?;
        renderer.upload(scene)?;
        self.draw(&mut renderer, camera, options)
    }

    /// A renderer for [`planes`](Self::planes), with sums of `precision` and depths from `depths`.
    ///
    /// # Errors
    /// The errors of [`RasterRenderer::new`].
    pub fn float_renderer(&self, precision: Precision, depths: DepthSource) -> Result<RasterRenderer> {
        RasterRenderer::new(&self.device, &self.queue, self.floats, precision, depths)
    }

    /// The planes [3, H, W] of a picture of the scene that `renderer` holds, not clamped and not rounded to bytes. It must be a
    /// [`float_renderer`](Self::float_renderer). Where the device cannot draw into 32-bit floats, numbers are rounded to 16 bits.
    ///
    /// # Errors
    /// The errors of [`draw`](Self::draw).
    pub fn planes(&self, renderer: &mut RasterRenderer, camera: &Camera, options: &RenderOptions) -> Result<Vec<f32>> {
        let bytes = renderer.texels(camera, options)?;
        let numbers: Vec<f32> = if self.floats == wgpu::TextureFormat::Rgba32Float {
            bytemuck::pod_collect_to_vec(&bytes)
        } else {
            bytes.as_chunks::<2>().0.iter().map(|&half| f16::from_le_bytes(half).to_f32()).collect()
        };
        let (pixels, _) = numbers.as_chunks::<4>();
        Ok((0..3).flat_map(|channel| pixels.iter().map(move |pixel| pixel[channel])).collect())
    }
}

/// Format of the target of [`Headless::draw`].
pub const PICTURE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

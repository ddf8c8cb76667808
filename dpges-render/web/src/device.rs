//! A device for a canvas: WebGPU, or WebGL2 where the browser has no WebGPU.

use std::sync::{Arc, Mutex};

use dpges_render::RasterRenderer;
use web_sys::HtmlCanvasElement;
use wgpu::{Adapter, Backends, Device, Instance, Queue, Surface, SurfaceTarget};

/// The first error of the device since it was opened.
pub type Fault = Arc<Mutex<Option<String>>>;

pub struct Gpu {
    pub adapter: Adapter,
    pub device: Device,
    pub queue: Queue,
    pub surface: Surface<'static>,
    pub fault: Fault,
}

impl Gpu {
    /// Opens the `backend` "auto", "webgpu" or "webgl" for `canvas`.
    pub async fn open(canvas: &HtmlCanvasElement, backend: &str) -> Result<Self, String> {
        match backend {
            "webgpu" => Self::webgpu(canvas).await,
            "webgl" => Self::webgl(canvas).await,
            "auto" => match Self::webgpu(canvas).await {
                Ok(gpu) => Ok(gpu),
                Err(webgpu) => Self::webgl(canvas).await.map_err(|webgl| format!("{webgpu} {webgl}")),
            },
            other => Err(format!("`backend` is {other}, expected auto, webgpu or webgl.")),
        }
    }

    /// The canvas is asked last: one that has given a context for WebGPU has none for WebGL2.
    async fn webgpu(canvas: &HtmlCanvasElement) -> Result<Self, String> {
        if !wgpu::util::is_browser_webgpu_supported().await {
            return Err("This browser offers no WebGPU.".to_owned());
        }
        let instance = instance(Backends::BROWSER_WEBGPU);
        let failed = |cause: String| format!("WebGPU failed: {cause}.");
        let adapter = adapter(&instance, None).await.map_err(failed)?;
        let (device, queue) = device(&adapter).await.map_err(failed)?;
        let surface = surface(&instance, canvas).map_err(failed)?;
        Ok(Self::new(adapter, device, queue, surface))
    }

    async fn webgl(canvas: &HtmlCanvasElement) -> Result<Self, String> {
        let instance = instance(Backends::GL);
        let failed = |cause: String| format!("WebGL2 failed: {cause}.");
        let surface = surface(&instance, canvas).map_err(failed)?;
        let adapter = adapter(&instance, Some(&surface)).await.map_err(failed)?;
        let (device, queue) = device(&adapter).await.map_err(failed)?;
        Ok(Self::new(adapter, device, queue, surface))
    }

    fn new(adapter: Adapter, device: Device, queue: Queue, surface: Surface<'static>) -> Self {
        let fault = Fault::default();
        let lost = fault.clone();
        device.set_device_lost_callback(move |_, message| {
            note(&lost, format!("the graphics device was lost: {message}"))
        });
        let wrong = fault.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&wrong, error.to_string())));
        Self { adapter, device, queue, surface, fault }
    }
}

fn note(fault: &Fault, cause: String) {
    fault.lock().expect("no thread panics while it holds the lock").get_or_insert(cause);
}

fn instance(backends: Backends) -> Instance {
    Instance::new(wgpu::InstanceDescriptor { backends, ..wgpu::InstanceDescriptor::new_without_display_handle() })
}

fn surface(instance: &Instance, canvas: &HtmlCanvasElement) -> Result<Surface<'static>, String> {
    instance.create_surface(SurfaceTarget::Canvas(canvas.clone())).map_err(|error| error.to_string())
}

async fn adapter(instance: &Instance, surface: Option<&Surface<'static>>) -> Result<Adapter, String> {
    let options = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        compatible_surface: surface,
        ..Default::default()
    };
    instance.request_adapter(&options).await.map_err(|error| error.to_string())
}

async fn device(adapter: &Adapter) -> Result<(Device, Queue), String> {
    RasterRenderer::check_adapter(adapter).map_err(|error| error.to_string())?;
    let descriptor = wgpu::DeviceDescriptor {
        label: Some("dpges"),
        required_features: RasterRenderer::required_features(adapter),
        required_limits: adapter.limits(),
        ..Default::default()
    };
    adapter.request_device(&descriptor).await.map_err(|error| error.to_string())
}

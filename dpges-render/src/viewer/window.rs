//! The window itself: its device, and how it ends.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

use eframe::egui_wgpu::{WgpuConfiguration, WgpuSetup, WgpuSetupCreateNew};

use super::app::Viewer;
use super::error::ViewerError;
use super::loading::{Opener, open_scene};
use super::start::{DeviceFailure, Start};
use super::state::waker;
use crate::RasterRenderer;

/// Name under which the desktop knows the window, and of the folder of its settings.
const APPLICATION: &str = "dpges";

/// A device of the application that the window draws on.
pub use eframe::egui_wgpu::WgpuSetupExisting as Gpu;

pub struct ViewerOptions {
    pub title: String,
    pub start: Start,
    pub opener: Opener,
    /// `None`: a device of its own.
    pub gpu: Option<Gpu>,
}

impl Default for ViewerOptions {
    /// The start page; scene files without views can be opened.
    fn default() -> Self {
        Self { title: APPLICATION.to_owned(), start: Start::Page, opener: Arc::new(open_scene), gpu: None }
    }
}

/// Opens a window and returns when it is closed. Call it on the main thread.
///
/// # Errors
/// [`ViewerError`] without a display, without a graphics adapter, or when the device failed.
pub fn run(options: ViewerOptions) -> Result<(), ViewerError> {
    let failure = DeviceFailure::default();
    let ViewerOptions { title, start, opener, gpu } = options;
    let watches = gpu.is_none();
    let native = eframe::NativeOptions {
        viewport: egui::ViewportBuilder::default()
            .with_title(title)
            .with_app_id(APPLICATION)
            .with_inner_size([1280.0, 800.0])
            .with_min_inner_size([320.0, 240.0])
            .with_drag_and_drop(true),
        renderer: eframe::Renderer::Wgpu,
        wgpu_options: WgpuConfiguration { wgpu_setup: setup(gpu), ..WgpuConfiguration::default() },
        ..eframe::NativeOptions::default()
    };
    let of_window = failure.clone();
    let create = move |context: &eframe::CreationContext<'_>| -> Result<Box<dyn eframe::App>, _> {
        if let (true, Some(state)) = (watches, &context.wgpu_render_state) {
            of_window.watch(state, waker(&context.egui_ctx));
        }
        let gpu = context.wgpu_render_state.as_ref();
        let viewer = Viewer::new(&context.egui_ctx, gpu, context.storage, start, opener, of_window)?;
        Ok(Box::new(viewer))
    };
    // egui panics where its device is gone
    let end = catch_unwind(AssertUnwindSafe(|| eframe::run_native(APPLICATION, native, Box::new(create))));
    match (failure.reason(), end) {
        (Some(reason), _) => Err(ViewerError::Device { reason }),
        (None, Ok(end)) => Ok(end?),
        (None, Err(panic)) => resume_unwind(panic),
    }
}

fn setup(gpu: Option<Gpu>) -> WgpuSetup {
    if let Some(gpu) = gpu {
        return gpu.into();
    }
    let device = |adapter: &wgpu::Adapter| wgpu::DeviceDescriptor {
        label: Some("viewer"),
        required_features: RasterRenderer::required_features(adapter),
        required_limits: adapter.limits(),
        ..wgpu::DeviceDescriptor::default()
    };
    WgpuSetupCreateNew { device_descriptor: Arc::new(device), ..WgpuSetupCreateNew::without_display_handle() }.into()
}

//! Measures of a finished cell beyond its evaluation.

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::frame_times::Rounds;
use dpges_render::path::Size;
use dpges_render::{Headless, check_drawn_as_trained};
use dpges_train::dataset::Dataset;
use dpges_train::device::DeviceName;
use dpges_train::eval::frame_ms::frame_times_as_trained;
use dpges_train::eval::rendered::TrainingRenderer;
use dpges_train::eval::{Measures, evaluate_each};
use dpges_train::metrics::lpips::choice::load;
use dpges_train::metrics::lpips::{Lpips, Network};
use dpges_train::run::folder::write_json;
use dpges_train::run::scene::every_nth;

use super::super::cell::Cell;
use super::super::evaluated::{self, Further};
use super::super::{Result, StudyError};
use super::{Benchmark, Planned, ROW};

/// Key of LPIPS with pictures from 0 to 1.
pub const LPIPS: &str = "lpips_vgg_unscaled";
/// Size of the frames whose time is measured, px.
const FRAME: Size = Size { width: 1920, height: 1080 };
/// At most so many held-out views are timed.
const TIMED_VIEWS: usize = 16;
const ROUNDS: Rounds = Rounds { warm_up: 2, counted: 10 };

impl Benchmark {
    /// Measures what the paper's tables have of a finished `cell`, and leaves its row in its folder. `name` is the device that
    /// it was trained on.
    ///
    /// # Errors
    /// If the scene or the evaluation cannot be read, a view cannot be rendered, or the row not be written.
    pub fn measure(
        &self,
        planned: &Planned,
        cell: &Cell,
        dataset: &Dataset,
        name: DeviceName,
        device: &Device,
    ) -> Result<()> {
        Further { dataset, device, networks: &[], popping: true }.measure(cell)?;
        let mut row = evaluated::row(cell)?;
        row.scene = Some(format!("{}/{}", planned.scene.dataset.name, planned.scene.name));
        row.device = name.describe().ok();
        let scene = SceneData::load(&cell.folder.scene())?;
        let renderer = TrainingRenderer::new(&scene, device);
        let networks: Vec<Lpips> = load(&self.request.lpips, device)?
            .into_iter()
            .filter(|lpips| lpips.network == Network::Vgg)
            .map(Lpips::unscaled)
            .collect();
        if !networks.is_empty() {
            let views = &dataset.test;
            tracing::info!("{}: measuring LPIPS of {} views", cell.name, views.len());
            let measures = Measures::lpips(&networks);
            let found = evaluate_each(&renderer, &scene, views, measures, |_, _| Ok::<_, StudyError>(()))?;
            row.set(LPIPS, found.perceptual.lpips_vgg);
        }
        let longest = dataset.test.iter().map(|view| view.camera.width.max(view.camera.height)).max();
        row.set("longest_px", longest.map(|px| px as f64));
        match adapter(name) {
            Ok(headless) if headless.is_software() => {
                tracing::info!("{}: no frame times, since {} is no GPU", cell.name, headless.adapter_name());
            }
            Ok(_) if name.is_cpu() && check_drawn_as_trained(&scene.info).is_err() => {
                tracing::info!("{}: no frame times, since it is drawn as it was trained on a CPU alone", cell.name);
            }
            Ok(headless) => {
                let views = every_nth(&dataset.test, TIMED_VIEWS);
                let cameras: Vec<Camera> = views.map(|view| FRAME.apply(&view.camera)).collect();
                let (times, _) = frame_times_as_trained(&scene, &cameras, ROUNDS, || Ok(headless), &renderer)?;
                row.set("frames_per_second", Some(times.frames_per_second));
                row.set("frame_ms", Some(times.p50_ms));
                row.set("frame_p99_ms", Some(times.p99_ms));
                row.set("frames", Some(times.frames as f64));
            }
            Err(error) => tracing::info!("{}: no frame times: {error}", cell.name),
        }
        Ok(write_json(&cell.folder.path().join(ROW), &row)?)
    }
}

/// The adapter that a scene was trained on, since others may be at work on another cell; the best one if that was a CPU.
#[cfg(feature = "gpu")]
fn adapter(device: DeviceName) -> dpges_render::Result<Headless> {
    device.wgpu_setup().map_or_else(Headless::new, |setup| Headless::on(&setup.adapter))
}

#[cfg(not(feature = "gpu"))]
fn adapter(_device: DeviceName) -> dpges_render::Result<Headless> {
    Headless::new()
}

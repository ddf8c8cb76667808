//! `dpges train --view`: the run on a thread of its own, its scene in a window.

use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread;

use dpges_core::scene::SceneData;
use dpges_render::viewer::{self, DatasetViews, LiveProgress, LiveScene, Start, ViewerOptions};
use dpges_train::dataset::Dataset;
use dpges_train::eval::{Evaluation, pictures};
use dpges_train::run::{Observer, StepReport, interrupts};

use super::super::Result;
use super::session::Session;

/// Share of a training view in the mean PSNR that the window shows.
const FRESH: f64 = 0.05;

/// The parts of a run that the window needs.
type Begun = (DatasetViews, Option<viewer::Gpu>);

/// Trains what `begin` returns, beside a window on this thread, the main one. Returns what came out, as a table for
/// people. A window that cannot be opened does not end the run.
pub fn train_in_window(begin: impl FnOnce() -> Result<Session> + Send + 'static) -> Result<String> {
    let live = LiveScene::new();
    let (sender, begun) = channel();
    let trainer = {
        let live = live.clone();
        thread::spawn(move || {
            let result = begin().and_then(|session| train(session, &live, &sender));
            live.finish(match &result {
                Ok(_) => Ok("the training is over".to_owned()),
                Err(failure) => Err(failure.text()),
            });
            result
        })
    };
    // without a run there is no window
    if let Ok((views, gpu)) = begun.recv() {
        let start = Start::Live(live.clone(), Some(views));
        let options = ViewerOptions { title: "dpges: training".to_owned(), start, gpu, ..ViewerOptions::default() };
        if let Err(error) = viewer::run(options) {
            tracing::warn!("the run goes on without a window: {error}");
            live.leave();
        }
    }
    trainer.join().unwrap_or_else(|panic| resume_unwind(panic))
}

fn train(session: Session, live: &LiveScene, begun: &Sender<Begun>) -> Result<String> {
    let interrupted = interrupts::watch()?;
    let trainer = session.run.trainer();
    // nobody listens if the main thread has panicked
    let _ = begun.send((views(trainer.dataset()), gpu(&session)));
    let steps = trainer.config().total_steps();
    let mut publisher = Publisher { live: live.clone(), interrupted: Arc::clone(&interrupted), steps, psnr: None };
    let result = session.train(&interrupted, &mut publisher);
    if interrupted.load(Ordering::SeqCst) {
        live.close_window();
    }
    result
}

/// The views that the run is trained on, as pinhole cameras take them: the window draws nothing else.
fn views(dataset: &Arc<Dataset>) -> DatasetViews {
    let cameras = dataset
        .train
        .iter()
        .map(|view| {
            let camera = view.undistorted_camera().unwrap_or_else(|| view.camera.without_lens());
            (view.name.clone(), camera)
        })
        .collect();
    let dataset = Arc::clone(dataset);
    let photograph = move |index: usize| {
        let picture = dataset.train.get(index)?.undistorted().transpose()?.and_then(|view| view.picture());
        picture.inspect_err(|error| tracing::warn!("{error}")).ok().map(|picture| pictures::photograph(&picture))
    };
    DatasetViews { cameras, photograph: Box::new(photograph) }
}

/// The device that the run uses, if a window can draw on it.
#[cfg(feature = "gpu")]
fn gpu(session: &Session) -> Option<viewer::Gpu> {
    let setup = session.device.wgpu_setup()?.clone();
    Some(viewer::Gpu { instance: setup.instance, adapter: setup.adapter, device: setup.device, queue: setup.queue })
}

#[cfg(not(feature = "gpu"))]
fn gpu(_session: &Session) -> Option<viewer::Gpu> {
    None
}

/// Tells the window of the run, and lets the window pause and stop it.
struct Publisher {
    live: LiveScene,
    interrupted: Arc<AtomicBool>,
    steps: usize,
    /// Mean over the last training views, dB.
    psnr: Option<f64>,
}

impl Observer for Publisher {
    fn step(&mut self, report: &StepReport, _seconds: f64) {
        let before = self.psnr.unwrap_or(report.psnr);
        self.psnr = Some(before + FRESH * (report.psnr - before));
        let counts = format!("{}: {} surfels, {} Gaussians", report.stage, report.surfels, report.gaussians);
        let text = report.events.last().cloned().unwrap_or(counts);
        self.live.report(LiveProgress { step: report.step, steps: self.steps, psnr: self.psnr, text });
    }

    fn evaluated(&mut self, step: usize, evaluation: &Evaluation) {
        let text = format!("held-out views: {:.2} dB", evaluation.psnr);
        self.live.report(LiveProgress { step, steps: self.steps, psnr: self.psnr, text });
    }

    fn wants_scene(&mut self) -> bool {
        self.live.wants_scene()
    }

    fn scene(&mut self, _step: usize, scene: SceneData) {
        self.live.publish(scene);
    }

    fn should_stop(&mut self) -> bool {
        self.live.wait_while_paused(|| self.interrupted.load(Ordering::SeqCst));
        self.live.should_stop()
    }
}

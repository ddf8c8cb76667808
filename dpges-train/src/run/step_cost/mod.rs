//! The time of a training step, and its requests to its device.
//!
//! [`Steps`] takes the steps of a run, and never refines; [`measure`] counts and times them.
//!
//! ```no_run
//! use dpges_core::scene::SceneData;
//! use dpges_core::testing::scenes::realistic;
//! use dpges_train::run::step_cost::{Rounds, StepStage, Steps, measure};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let device: burn::tensor::Device = "cpu".parse::<dpges_train::device::DeviceName>()?.open()?;
//! let (scene, camera) = realistic(10_000, 100_000, 400, 400, 1).into_scene();
//! let mut steps = Steps::new(&scene, &[camera], StepStage::Joint, &device)?;
//! let cost = measure(&mut steps, Rounds { warm_up: 3, counted: 10 })?;
//! println!("{:.1} ms", cost.median_ms);
//! # Ok(())
//! # }
//! ```

mod steps;
#[cfg(test)]
mod tests;

use std::cmp::Reverse;
use std::time::Instant;

use dpges_core::counters::GpuWork;
#[cfg(feature = "gpu")]
use dpges_core::counters::kernels::observe;
use dpges_core::counters::transfers::{Transfers, transfers};
use dpges_render::percentile::percentiles;
use serde::Serialize;

use crate::device::memory::PeakMemory;
use crate::run::TrainError;
pub use crate::run::own_pictures::StepStage;
pub use steps::Steps;

/// How many steps are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rounds {
    /// Before those: kernels are compiled, and buffers find their sizes.
    pub warm_up: usize,
    /// Steps whose times count; at least 1.
    pub counted: usize,
}

/// The measurements of a step.
#[derive(Clone, Debug, Serialize)]
pub struct StepCost {
    /// `joint`, `mcmc` or `2dgs`.
    pub stage: String,
    pub surfels: usize,
    pub gaussians: usize,
    /// Views that the steps take turns with, and their size, px.
    pub views: usize,
    pub width: usize,
    pub height: usize,
    pub steps: usize,
    /// Median of steps one after another, as in a run: the host prepares a step while a GPU works on the one before.
    pub median_ms: f64,
    /// 95 % of the steps took no longer.
    pub p95_ms: f64,
    /// The most memory that this process has had in use during these steps, bytes; `None` where that is not known.
    pub process_peak_bytes: Option<u64>,
    /// Between host and device, in a step.
    pub transfers: Transfers,
    /// `None` on a CPU.
    pub gpu: Option<GpuWork>,
}

/// Takes steps and measures them: first the times, then everything else, in a step that is waited for.
pub fn measure(steps: &mut Steps, rounds: Rounds) -> Result<StepCost, TrainError> {
    (0..rounds.warm_up).try_for_each(|_| steps.step())?;
    let (peak, count) = (PeakMemory::start(), rounds.counted.max(1));
    let times = times(steps, count)?;
    let process_peak_bytes = peak.bytes();
    let [median_ms, p95_ms] = percentiles(times, [0.5, 0.95]).expect("a step is counted");
    let before = transfers();
    steps.step_and_settle()?;
    let (transfers, gpu) = (transfers().since(before), gpu_work(steps)?);
    let (surfels, gaussians) = steps.primitives();
    let [width, height] = steps.size();
    let (stage, views, steps) = (steps.kind().to_string(), steps.views(), count);
    Ok(StepCost {
        stage,
        surfels,
        gaussians,
        views,
        width,
        height,
        steps,
        median_ms,
        p95_ms,
        process_peak_bytes,
        transfers,
        gpu,
    })
}

/// The time of each step, ms.
fn times(steps: &mut Steps, count: usize) -> Result<Vec<f64>, TrainError> {
    // a GPU works on this one when the clock starts
    steps.step()?;
    let mut last = Instant::now();
    let mut times = Vec::with_capacity(count);
    for _ in 0..count {
        steps.step()?;
        let now = Instant::now();
        times.push(1e3 * now.duration_since(last).as_secs_f64());
        last = now;
    }
    steps.settle()?;
    Ok(times)
}

#[cfg(feature = "gpu")]
fn gpu_work(steps: &mut Steps) -> Result<Option<GpuWork>, TrainError> {
    let device = steps.device().clone();
    let (taken, work) = observe(&device, || steps.step_and_settle());
    taken.map(|()| work)
}

#[cfg(not(feature = "gpu"))]
fn gpu_work(_: &mut Steps) -> Result<Option<GpuWork>, TrainError> {
    Ok(None)
}

impl StepCost {
    /// Names and values as text.
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let megabytes = |bytes: u64| format!("{:.2} MB", bytes as f64 / 1e6);
        let Self { stage, surfels, gaussians, views, width, height, steps, median_ms, p95_ms, .. } = self;
        let Transfers { uploads, uploaded_bytes, downloads, downloaded_bytes, waits } = self.transfers;
        let mut rows = vec![
            ("step", format!("{stage}, {surfels} surfels, {gaussians} Gaussians, {views} x {width}x{height} px")),
            ("time", format!("median {median_ms:.2} ms, p95 {p95_ms:.2} ms, of {steps}")),
            (
                "transfers",
                format!("up {uploads}: {uploaded_bytes} B, down {downloads}: {downloaded_bytes} B, {waits} waited for"),
            ),
        ];
        rows.extend(self.process_peak_bytes.map(|bytes| ("process", format!("peak {}", megabytes(bytes)))));
        let Some(GpuWork { kernels, memory }) = &self.gpu else { return rows };
        let [alive, peak, reserved] = [memory.alive_bytes, memory.peak_bytes, memory.reserved_bytes].map(megabytes);
        rows.push(("memory", format!("between steps {alive}, peak {peak}, reserved {reserved}")));
        let launches = kernels.values().map(|kernel| kernel.launches).sum::<usize>();
        rows.push(("launches", format!("{launches} of {} kernels", kernels.len())));
        let mut kernels: Vec<_> = kernels.iter().collect();
        kernels
            .sort_by_key(|(_, kernel)| Reverse(((1e6 * kernel.milliseconds.unwrap_or(0.0)) as u64, kernel.launches)));
        rows.extend(kernels.into_iter().map(|(name, kernel)| {
            let time = kernel.milliseconds.map_or(String::new(), |time| format!("{time:9.3} ms  "));
            ("", format!("{time}{:4} x {name}", kernel.launches))
        }));
        rows
    }
}

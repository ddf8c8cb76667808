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
//! println!("{:.1} ms", cost.time.median_ms);
//! # Ok(())
//! # }
//! ```

mod lists;
pub mod report;
mod steps;
#[cfg(test)]
mod tests;

use std::time::Instant;

use dpges_core::backend::device::is_gpu;
use dpges_core::counters::transfers::Transfers;
use dpges_core::counters::{DeviceMemory, KernelTime, Launches};
use serde::Serialize;

use crate::device::memory::PeakMemory;
use crate::run::TrainError;
pub use crate::run::own_pictures::StepStage;
pub use lists::{List, Lists};
pub use steps::Steps;

/// How many steps are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rounds {
    /// Before those: kernels are compiled, and buffers find their sizes.
    pub warm_up: usize,
    /// Steps whose times count; at least 1.
    pub counted: usize,
}

/// Times of steps one after another, as in a run: the host prepares a step while a GPU works on the one before.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StepTimes {
    pub steps: usize,
    pub median_ms: f64,
    /// 95 % of the steps took no longer.
    pub p95_ms: f64,
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
    pub time: StepTimes,
    /// The most memory that this process has had in use during these steps, bytes; `None` where that is not known.
    pub process_peak_bytes: Option<u64>,
    /// Tile lists of the first view.
    pub lists: Lists,
    /// `None` on a CPU.
    pub gpu: Option<GpuCost>,
}

/// The requests of a step to a GPU.
#[derive(Clone, Debug, Serialize)]
pub struct GpuCost {
    /// Launches of all kernels, dpges' own and Burn's.
    pub launches: usize,
    pub launches_by_kernel: Launches,
    pub transfers: Transfers,
    pub memory: DeviceMemory,
    /// By the clock of the device, the longest first; `None` where the adapter has no timestamps.
    pub kernel_times: Option<Vec<KernelTime>>,
}

/// Takes steps and measures them: first the times, then, of steps that are waited for, all else.
pub fn measure(steps: &mut Steps, rounds: Rounds) -> Result<StepCost, TrainError> {
    (0..rounds.warm_up).try_for_each(|_| steps.step())?;
    let peak = PeakMemory::start();
    let time = times(steps, rounds.counted.max(1))?;
    let process_peak_bytes = peak.bytes();
    let gpu = if is_gpu(steps.device()) { gpu_cost(steps)? } else { None };
    let (surfels, gaussians) = steps.primitives();
    let [width, height] = steps.size();
    let (stage, views, lists) = (steps.kind().to_string(), steps.views(), steps.lists()?);
    Ok(StepCost { stage, surfels, gaussians, views, width, height, time, process_peak_bytes, lists, gpu })
}

fn times(steps: &mut Steps, count: usize) -> Result<StepTimes, TrainError> {
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
    times.sort_unstable_by(f64::total_cmp);
    let [median_ms, p95_ms] = [0.5, 0.95].map(|share| times[(share * (count - 1) as f64).round() as usize]);
    Ok(StepTimes { steps: count, median_ms, p95_ms })
}

#[cfg(feature = "gpu")]
fn gpu_cost(steps: &mut Steps) -> Result<Option<GpuCost>, TrainError> {
    use dpges_core::counters::kernels::{count_launches, time_kernels, watch_memory};
    use dpges_core::counters::transfers::transfers;

    let before = transfers();
    let (taken, launches_by_kernel) = count_launches(|| steps.step_and_settle());
    taken?;
    let transfers = transfers().since(before);
    let device = steps.device().clone();
    let (taken, memory) = watch_memory(&device, || steps.step_and_settle());
    taken?;
    let (taken, kernel_times) = time_kernels(|| steps.step_and_settle());
    taken?;
    let launches = launches_by_kernel.values().sum();
    Ok(memory.map(|memory| GpuCost { launches, launches_by_kernel, transfers, memory, kernel_times }))
}

#[cfg(not(feature = "gpu"))]
fn gpu_cost(_: &mut Steps) -> Result<Option<GpuCost>, TrainError> {
    Ok(None)
}

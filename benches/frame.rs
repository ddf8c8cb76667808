//! `cargo bench -p dpges-benches --bench frame -- [DEVICE …]`: a large view, as users train them, on
//! each of the named devices (`ndarray`, `flex`, `wgpu`; all that there are by default). `dpges bench step` says more
//! of the step.

use std::time::Instant;

use burn::tensor::{DType, Device};
use clap::Parser;
use dpges_benches::{devices, machine};
use dpges_core::render::{RenderOptions, Values, render_probed};
use dpges_core::testing::scenes::{TestScene, realistic};
use dpges_train::run::step_cost::{Rounds, StepStage, Steps, measure as measure_step};

#[derive(Parser)]
struct Arguments {
    /// `ndarray`, `flex`, `wgpu`; all that there are without
    devices: Vec<String>,
    #[arg(long, default_value_t = 150_000)]
    surfels: usize,
    #[arg(long, default_value_t = 1_500_000)]
    gaussians: usize,
    #[arg(long, default_value_t = 1920)]
    width: usize,
    #[arg(long, default_value_t = 1080)]
    height: usize,
    #[arg(long, default_value_t = 10)]
    repeats: usize,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// Median of some runs in ms, after two that warm up.
fn median_ms(repeats: usize, mut run: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..repeats + 2)
        .map(|_| {
            let start = Instant::now();
            run();
            1e3 * start.elapsed().as_secs_f64()
        })
        .skip(2)
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn measure(name: &str, device: &Device, scene: &TestScene, repeats: usize) {
    let (surfels, gaussians) = scene.tensors(device, DType::F32);
    let options = RenderOptions::default();
    let forward = median_ms(repeats, || {
        _ = render_probed(&surfels, &gaussians, &scene.camera, None, &options, Values::KnownFinite).expect("valid");
        device.sync().expect("the device runs");
    });
    let (scene, camera) = scene.clone().into_scene();
    let mut steps = Steps::new(&scene, &[camera], StepStage::Joint, device).expect("valid");
    let cost = measure_step(&mut steps, Rounds { warm_up: 2, counted: repeats }).expect("valid");
    let launches = cost.gpu.map_or(String::new(), |gpu| format!(", {} launches", gpu.launches));
    println!("{name} ({device:?}): forward {forward:.2} ms, training step {:.2} ms{launches}", cost.time.median_ms);
}

fn main() {
    let Arguments { devices: names, surfels, gaussians, width, height, repeats, .. } = Arguments::parse();
    println!("{}; {surfels} surfels, {gaussians} Gaussians, {width} × {height} px, medians of {repeats}", machine());
    let scene = realistic(surfels, gaussians, width, height, 1);
    for (name, device) in devices() {
        if names.is_empty() || names.iter().any(|wanted| wanted == name) {
            measure(name, &device, &scene, repeats);
        }
    }
}

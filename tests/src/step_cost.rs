//! The requests of a training step to a GPU.

use burn::tensor::Device;
use dpges_core::counters::GpuWork;
use dpges_core::counters::transfers::Transfers;
use dpges_core::testing::scenes::realistic;
use dpges_train::run::step_cost::{Rounds, StepCost, StepStage, Steps, measure};

/// The cost of a small scene, measured again.
fn cost(stage: StepStage, device: &Device) -> StepCost {
    let (scene, camera) = realistic(200, 1000, 64, 48, 1).into_scene();
    let mut steps = Steps::new(&scene, &[camera], stage, device).unwrap();
    let cost = measure(&mut steps, Rounds { warm_up: 2, counted: 3 }).unwrap();
    println!("{} step: median {:.1} ms", cost.stage, cost.median_ms);
    cost
}

/// Launches by kernel.
fn launches(cost: &StepCost) -> Vec<(&str, usize)> {
    let kernels = &cost.gpu.as_ref().expect("the device is a GPU").kernels;
    kernels.iter().map(|(name, kernel)| (&name[..], kernel.launches)).collect()
}

/// Holds for any step.
fn check(cost: &StepCost) {
    let StepCost { transfers, gpu: Some(GpuWork { kernels, memory }), .. } = cost else { panic!("no GPU: {cost:?}") };
    let own = |(name, _): &(&str, usize)| name.starts_with("dpges_core::");
    let (own, others): (Vec<_>, Vec<_>) = launches(cost).into_iter().partition(own);
    assert!(!own.is_empty() && !others.is_empty(), "of dpges {own:?}, of Burn {others:?}");
    // it is on the device since the first step
    let photograph = 3 * 64 * 48;
    assert!(transfers.uploaded_bytes < photograph, "{transfers:?}");
    assert!(transfers.downloads > 0 && transfers.downloaded_bytes < photograph, "{transfers:?}");
    // for the losses, and not for the lengths of lists
    assert!(transfers.waits <= 1, "{transfers:?}");
    assert!(memory.alive_bytes > 0 && memory.peak_bytes > memory.alive_bytes, "{memory:?}");
    assert!(memory.reserved_bytes >= memory.alive_bytes, "{memory:?}");
    let times: Vec<f64> = kernels.values().filter_map(|kernel| kernel.milliseconds).collect();
    if times.is_empty() {
        return println!("the adapter has no timestamps");
    }
    assert!(times.iter().sum::<f64>() > 0.0 && kernels.values().all(|kernel| kernel.launches > 0), "{kernels:?}");
}

/// Whether a kernel of the module is among the launches.
fn is_launched(cost: &StepCost, module: &str) -> bool {
    launches(cost).iter().any(|(kernel, _)| kernel.starts_with(module))
}

pub fn a_step_is_counted_alike_every_time(device: &Device) {
    let (first, second) = (cost(StepStage::Joint, device), cost(StepStage::Joint, device));
    check(&first);
    for operation in ["dpges_core::splat::", "dpges_core::peel::"] {
        assert!(is_launched(&first, operation), "nothing of {operation} among {:?}", launches(&first));
    }
    // the losses, and the lengths of two lists
    assert_eq!(first.transfers.downloads, 3, "{:?}", first.transfers);
    assert_eq!(launches(&first), launches(&second));
    // whether the losses are there when they are asked for is a matter of time
    let without_waits = |cost: &StepCost| Transfers { waits: 0, ..cost.transfers };
    assert_eq!(without_waits(&first), without_waits(&second));
}

pub fn a_blended_step_is_counted(device: &Device) {
    let found = cost(StepStage::Blended, device);
    check(&found);
    assert!(is_launched(&found, "dpges_core::blend::"), "{:?}", launches(&found));
    assert!(!is_launched(&found, "dpges_core::peel::"), "{:?}", launches(&found));
}

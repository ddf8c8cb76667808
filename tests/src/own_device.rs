//! Devices that are made for one test: one with the limits that WebGPU guarantees, and one that is lost.

use burn::tensor::Device;
use burn_wgpu::{RuntimeOptions, WgpuSetup, init_device, wgpu};
use dpges_train::device::adapter::adapters;
use dpges_train::device::failure::{DeviceFailure, Watch};
use dpges_train::device::selftest::CASES;
use dpges_train::run::folder::{Origin, RunFolder};
use dpges_train::run::{Observer, Run, SavedRun, StepReport};

use crate::devices::ndarray;
use crate::{parity, training};

/// A device of its own on the adapter that the other tests use.
fn own(limits: impl FnOnce(&wgpu::Adapter) -> wgpu::Limits) -> (Device, wgpu::Device) {
    let shared = adapters().iter().filter_map(|adapter| adapter.setup()).next().expect("the tests have opened one");
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: shared.backend.into(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let name = shared.adapter.get_info().name;
    let found = burn::tensor::read_sync(instance.enumerate_adapters(shared.backend.into()));
    let adapter = found.into_iter().find(|adapter| adapter.get_info().name == name).expect("it was there before");
    let descriptor = wgpu::DeviceDescriptor {
        required_features: adapter.features().difference(wgpu::Features::MAPPABLE_PRIMARY_BUFFERS),
        required_limits: limits(&adapter),
        // SAFETY: the features of the adapter are used as on the device that Burn makes
        experimental_features: unsafe { wgpu::ExperimentalFeatures::enabled() },
        ..wgpu::DeviceDescriptor::default()
    };
    let (device, queue) = burn::tensor::read_sync(adapter.request_device(&descriptor)).expect("the driver gives one");
    let setup = WgpuSetup { instance, adapter, device: device.clone(), queue, backend: shared.backend };
    (Device::new(init_device(setup, RuntimeOptions::default())), device)
}

/// wgpu refuses what exceeds them: eight buffers of a kernel, 128 MiB of one, 16 KiB of workgroup memory, 256 invocations.
pub fn every_operation_keeps_to_the_limits_of_webgpu(_: &Device) {
    let (device, limited) = own(|_| wgpu::Limits::default());
    let most = limited.limits();
    assert_eq!((most.max_storage_buffers_per_shader_stage, most.max_storage_buffer_binding_size), (8, 128 << 20));
    assert_eq!((most.max_compute_workgroup_storage_size, most.max_compute_invocations_per_workgroup), (16 << 10, 256));
    let wrong: Vec<_> = CASES.iter().flat_map(|case| case.check(&device)).filter(|finding| !finding.passed).collect();
    assert!(wrong.is_empty(), "{wrong:?}");
    parity::weighted_sums_agree_on_random_scenes(&device);
    for method in ["dpges", "3dgs", "sss", "2dgs", "sortfree", "htgs", "stopthepop"] {
        let config = training::config(6, &[&format!("train.method={method}"), "train.exposure=on", "train.poses=on"]);
        training::trained(&training::dataset(), config, &device);
    }
}

/// Takes its device away after a step.
struct Taken<'a> {
    device: &'a wgpu::Device,
    after: usize,
    saved: Vec<usize>,
    watch: Watch,
}

impl Observer for Taken<'_> {
    fn step(&mut self, report: &StepReport, _seconds: f64) {
        if report.step == self.after {
            self.device.destroy();
        }
    }

    fn saved(&mut self, step: usize) {
        self.saved.push(step);
    }

    fn device_failure(&mut self) -> Option<String> {
        self.watch.failure().map(|failure| failure.to_string())
    }
}

/// As one that is reset or unplugged, or one of a laptop that sleeps.
pub fn a_device_that_is_lost_leaves_a_run_that_goes_on_elsewhere(_: &Device) {
    let at = tempfile::tempdir().unwrap();
    let (device, taken) = own(wgpu::Adapter::limits);
    let config = || training::config(30, &["train.checkpoint_every=10"]);
    let run = Run::new(config(), training::dataset(), device).unwrap();
    let mut run = run.write_to(RunFolder::new(at.path().join("run")), Origin::new("builtin", "wgpu")).unwrap();
    let watch = Watch::start();
    let mut observer = Taken { device: &taken, after: 15, saved: Vec::new(), watch: watch.clone() };
    let message = match watch.catch(|| run.train(&mut observer)) {
        Ok(Ok(_)) => panic!("the run ended as if nothing had happened"),
        Ok(Err(error)) => error.to_string(),
        Err(failure) => failure.to_string(),
    };
    // as when its program ends, for another run gets the folder then
    let _ = watch.catch(|| drop(run));
    drop(watch);
    assert_eq!(observer.saved, [10], "{message}");
    assert!(DeviceFailure::new(&message).advice().contains("--device cpu"), "{message}");
    println!("lost: {message}");
    let saved = SavedRun::open(RunFolder::new(at.path().join("run"))).unwrap();
    let mut resumed = Run::resume(saved, training::dataset(), ndarray()).unwrap();
    assert_eq!(resumed.trainer().completed_steps(), 10);
    let outcome = resumed.train(&mut ()).unwrap();
    assert!(resumed.trainer().is_finished() && outcome.evaluation.is_some_and(|of| of.psnr > 10.0));
}

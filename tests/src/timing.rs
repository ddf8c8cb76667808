//! Timing, not kept.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::ops::blend::{BlendOptions, Form, blend};
use dpges_core::ops::composite::{CompositeOptions, composite};
use dpges_core::ops::peel::{PeelOptions, peel};
use dpges_core::ops::splat::{SplatOptions, contributions, splat};
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::Gaussians;
use dpges_core::scene::schema::Columns;
use dpges_core::testing::scenes::{TestScene, realistic};

fn leaf<const D: usize>(tensor: &Tensor<D>) -> Tensor<D> {
    tensor.clone().autodiff().require_grad()
}

/// CPU seconds of all threads so far.
fn busy() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap();
    let of = |task: std::fs::DirEntry| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).unwrap_or_default();
        text.split(' ').next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0)
    };
    tasks.map(|task| of(task.unwrap())).sum::<f64>() * 1e-9
}

fn best(repeats: usize, mut run: impl FnMut() -> f64) -> (f64, f64) {
    run();
    let mut times: Vec<f64> = (0..repeats).map(|_| run()).collect();
    times.sort_by(f64::total_cmp);
    (times[0], times[times.len() / 2])
}

fn measure(name: &str, scene: &TestScene, device: &Device) {
    let repeats: usize = std::env::var("DPGES_REPEATS").ok().and_then(|v| v.parse().ok()).unwrap_or(5);
    let only = std::env::var("DPGES_ONLY").unwrap_or_default();
    let (surfels, gaussians) = scene.tensors(device, DType::F32);
    let view = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap();
    let camera = &scene.camera;
    let wanted = |what: &str| only.is_empty() || what.contains(&only);
    let report = |what: &str, (least, median): (f64, f64)| {
        println!("{name} | {what} | best {:.1} ms, median {:.1} ms", 1e3 * least, 1e3 * median)
    };
    let timed = |run: &mut dyn FnMut()| {
        device.sync().unwrap();
        let start = busy();
        run();
        device.sync().unwrap();
        busy() - start
    };
    if wanted("peel") {
        report(
            "peel",
            best(repeats, || {
                timed(&mut || {
                    _ = peel(
                        &surfels.positions,
                        &surfels.quaternions,
                        &surfels.log_scales,
                        camera,
                        &PeelOptions::default(),
                    );
                })
            }),
        );
    }
    for deterministic in [false, true] {
        let options = SplatOptions { deterministic };
        let what = if deterministic { "splat deterministic" } else { "splat" };
        if wanted(what) {
            report(
                what,
                best(repeats, || {
                    timed(&mut || {
                        _ = splat(&gaussians, &view.gaussian_colours, &view.limits, camera, &options).unwrap();
                    })
                }),
            );
        }
    }
    let leaves = |g: &Gaussians| g.map_ref(|_, tensor| leaf(tensor));
    if wanted("splat backward") {
        report(
            "splat backward",
            best(repeats, || {
                let limits = view.limits.clone().autodiff();
                let colours = leaf(&view.gaussian_colours);
                let sums = splat(&leaves(&gaussians), &colours, &limits, camera, &SplatOptions::default()).unwrap();
                let loss = sums.sum();
                timed(&mut || _ = loss.backward())
            }),
        );
    }
    if wanted("contributions") {
        report(
            "contributions",
            best(repeats, || {
                timed(&mut || {
                    _ = contributions(&gaussians, &view.gaussian_colours, &view.limits, &view.limits, camera).unwrap();
                })
            }),
        );
    }
    if wanted("composite backward") {
        let sums = splat(&gaussians, &view.gaussian_colours, &view.limits, camera, &SplatOptions::default()).unwrap();
        report(
            "composite backward",
            best(repeats, || {
                let mut layers = view.layers.clone();
                layers.alpha = leaf(&layers.alpha);
                layers.depth = layers.depth.autodiff();
                layers.ids = layers.ids.autodiff();
                let options = CompositeOptions { background: [0.0; 3], detach_transmittance: false };
                let out = composite(&layers, &leaf(&view.surfel_colours), &leaf(&sums), &options).unwrap();
                let loss = out.image.sum() + out.surfel_image.sum() + out.transmittance.sum();
                timed(&mut || _ = loss.backward())
            }),
        );
    }
    for (what, form, maps) in [
        ("blend ellipsoids", Form::Ellipsoids, false),
        ("blend ellipsoids maps", Form::Ellipsoids, true),
        ("blend discs", Form::Discs, false),
    ] {
        let options = BlendOptions { form, maps, ..BlendOptions::default() };
        if wanted(what) {
            report(
                what,
                best(repeats, || {
                    timed(&mut || {
                        _ = blend(&gaussians, &view.gaussian_colours, None, camera, &options).unwrap();
                    })
                }),
            );
        }
        let what = format!("{what} backward");
        if wanted(&what) {
            report(
                &what,
                best(repeats, || {
                    let out =
                        blend(&leaves(&gaussians), &leaf(&view.gaussian_colours), None, camera, &options).unwrap();
                    let mut loss = out.colour.sum() + out.alpha.sum();
                    if let Some(maps) = out.maps {
                        loss = loss + maps.depth.sum() + maps.normal.sum() + maps.distortion.sum();
                    }
                    timed(&mut || _ = loss.backward())
                }),
            );
        }
    }
}

pub fn everything(device: Device) {
    if std::env::var("DPGES_TIMING").is_err() {
        return;
    }
    let scene = realistic(10_000, 100_000, 400, 400, 1);
    measure("realistic", &scene, &device);
    let mut large = scene.clone();
    let g = &mut large.gaussians;
    // the first Gaussians fill the screen, in front of everything
    let count: usize = std::env::var("DPGES_LARGE").ok().and_then(|v| v.parse().ok()).unwrap_or(1);
    let pose = &large.camera.camera_from_world;
    for i in 0..count {
        let centre = pose.rotation.transpose() * (glam::DVec3::new(0.0, 0.0, 1.0) - pose.translation);
        g.positions[3 * i..3 * i + 3].copy_from_slice(&centre.to_array().map(|v| v as f32));
        g.log_scales[3 * i..3 * i + 3].copy_from_slice(&[1.0, 1.1, 0.9]);
        g.opacities[i] = 0.3;
    }
    measure("one fills the screen", &large, &device);
}

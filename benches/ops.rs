//! `cargo bench -p dpges-benches --bench ops`: each operation, and a whole training step.

use std::hint::black_box;
use std::time::Duration;

use burn::tensor::{DType, Device, Tensor};
use criterion::{BatchSize, Criterion, SamplingMode, criterion_group, criterion_main};
use dpges_benches::training::{Parameter, Training, Variant, adam_settings};
use dpges_benches::{devices, machine, plain};
use dpges_core::ops::blend::{Blend, BlendOptions, Form, blend};
use dpges_core::ops::composite::{Composite, CompositeOptions, composite};
use dpges_core::ops::interval_limits::interval_limits;
use dpges_core::ops::peel::{Layers, PeelOptions, peel};
use dpges_core::ops::photometric::ssim;
use dpges_core::ops::splat::splat;
use dpges_core::render::{Render, RenderOptions, render};
use dpges_core::scene::schema::Columns;
use dpges_core::scene::{Gaussians, MarginLookup, Surfels};
use dpges_core::testing::scenes::{TestScene, realistic};

const SURFELS: usize = 10_000;
const GAUSSIANS: usize = 100_000;
const SIZE: usize = 400;
const BLENDING: CompositeOptions = CompositeOptions { background: [0.0; 3], detach_transmittance: false };

fn scene() -> TestScene {
    realistic(SURFELS, GAUSSIANS, SIZE, SIZE, 1)
}

/// A rendered view whose tensors are leaves of a tape, or off it.
struct Fixture {
    scene: TestScene,
    device: Device,
    surfels: Surfels,
    gaussians: Gaussians,
    render: Render,
}

impl Fixture {
    fn new(device: &Device) -> Self {
        let scene = scene();
        let (surfels, gaussians) = scene.tensors(device, DType::F32);
        let render = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap();
        Self { scene, device: device.clone(), surfels, gaussians, render }
    }

    fn peel(&self) -> Layers {
        self.peel_leaves(|t| t)
    }

    fn peel_leaves(&self, of: impl Fn(Tensor<2>) -> Tensor<2>) -> Layers {
        let s = &self.surfels;
        let [p, q, l] = [&s.positions, &s.quaternions, &s.log_scales].map(|tensor| of(tensor.clone()));
        peel(&p, &q, &l, &self.scene.camera, &PeelOptions::default()).unwrap()
    }

    fn splat(&self) -> Tensor<4> {
        let (colours, limits) = (&self.render.gaussian_colours, &self.render.limits);
        splat(&self.gaussians, colours, limits, &self.scene.camera).unwrap()
    }

    fn gaussian_leaves(&self) -> Gaussians {
        self.gaussians.map_ref(|_, tensor| leaf(tensor))
    }

    fn splat_leaves(&self) -> Tensor<4> {
        let limits = self.render.limits.clone().autodiff();
        let colours = leaf(&self.render.gaussian_colours);
        splat(&self.gaussian_leaves(), &colours, &limits, &self.scene.camera).unwrap()
    }

    fn blend(&self, options: &BlendOptions) -> Blend {
        blend(&self.gaussians, &self.render.gaussian_colours, None, &self.scene.camera, options).unwrap()
    }

    /// All outputs that carry gradients.
    fn blend_loss(&self, options: &BlendOptions, with_probe: bool) -> Tensor<1> {
        let colours = &self.render.gaussian_colours;
        let zeros = || Tensor::<2>::zeros([self.gaussians.len(), 4], (&colours.device(), colours.dtype()));
        let probe = with_probe.then(|| leaf(&zeros()));
        let out = blend(&self.gaussian_leaves(), &leaf(colours), probe.as_ref(), &self.scene.camera, options).unwrap();
        let loss = out.colour.sum() + out.alpha.sum();
        match out.maps {
            Some(maps) => loss + maps.depth.sum() + maps.normal.sum() + maps.distortion.sum(),
            None => loss,
        }
    }

    /// Image, surfel image and transmittance, which the losses use, weighted so that all have gradients.
    fn composite(&self, sums: &Tensor<4>, own: bool) -> Composite {
        self.composite_of(self.render.layers.clone(), self.render.surfel_colours.clone(), sums.clone(), own)
    }

    fn composite_of(&self, layers: Layers, colours: Tensor<2>, sums: Tensor<4>, own: bool) -> Composite {
        if own {
            composite(&layers, &colours, &sums, &BLENDING).unwrap()
        } else {
            plain::composite(&layers, colours, sums, &BLENDING)
        }
    }

    fn composite_loss(&self, sums: &Tensor<4>, own: bool) -> Tensor<1> {
        let mut layers = self.render.layers.clone();
        layers.alpha = leaf(&layers.alpha);
        layers.depth = layers.depth.autodiff();
        layers.ids = layers.ids.autodiff();
        let out = self.composite_of(layers, leaf(&self.render.surfel_colours), leaf(sums), own);
        out.image.sum() + out.surfel_image.sum() + out.transmittance.sum()
    }

    fn sync(&self) {
        self.device.sync().unwrap();
    }
}

fn leaf<const D: usize>(tensor: &Tensor<D>) -> Tensor<D> {
    tensor.clone().autodiff().require_grad()
}

fn blends() -> [(&'static str, BlendOptions); 4] {
    let of = |form, maps| BlendOptions { form, maps, ..BlendOptions::default() };
    [
        ("blend ellipsoids", of(Form::Ellipsoids, false)),
        ("blend ellipsoids with maps", of(Form::Ellipsoids, true)),
        ("blend discs", of(Form::Discs, false)),
        ("blend discs with maps", of(Form::Discs, true)),
    ]
}

/// Adam's parameters of a step: positions, rotations, scales and colours of all Gaussians.
fn parameters(view: &Fixture) -> Vec<(Parameter, Tensor<2>)> {
    let g = &view.gaussians;
    [&g.positions, &g.quaternions, &g.log_scales, &g.colour.base, &g.colour.detail]
        .map(|tensor| (Parameter::new(tensor), tensor.clone() * 1e-3))
        .into()
}

fn operations(c: &mut Criterion) {
    println!("{}", machine());
    for (name, device) in devices() {
        let view = Fixture::new(&device);
        let sums = view.splat();
        let mut group = c.benchmark_group(name);
        group.sampling_mode(SamplingMode::Flat);
        let mut forward = |operation: &str, run: &dyn Fn()| {
            group.bench_function(operation, |b| {
                b.iter(|| {
                    run();
                    view.sync();
                });
            });
        };
        forward("peel", &|| _ = black_box(view.peel()));
        forward("limits", &|| {
            let margins = &view.surfels.margins;
            _ = black_box(interval_limits(&view.render.layers, margins, MarginLookup::Shifted).unwrap());
        });
        forward("splat", &|| _ = black_box(view.splat()));
        forward("composite", &|| _ = black_box(view.composite(&sums, true)));
        forward("composite, plain", &|| _ = black_box(view.composite(&sums, false)));
        let (image, target) = (&view.render.composite.image, &view.render.composite.surfel_image);
        forward("ssim", &|| _ = black_box(ssim(image, target).unwrap()));
        forward("render", &|| {
            _ = black_box(
                render(&view.surfels, &view.gaussians, &view.scene.camera, &RenderOptions::default()).unwrap(),
            );
        });
        for (operation, options) in blends() {
            forward(operation, &|| _ = black_box(view.blend(&options)));
            // no output depends on the probe, so it costs nothing forward
            let probes: &[(&str, bool)] =
                if options.form == Form::Discs { &[("", false), (", probe", true)] } else { &[("", false)] };
            for &(suffix, with_probe) in probes {
                forward(&format!("{operation}{suffix}, forward and backward"), &|| {
                    _ = black_box(view.blend_loss(&options, with_probe).backward());
                });
            }
        }
        let mut backward = |operation: &str, make: &dyn Fn() -> Tensor<1>| {
            group.bench_function(format!("{operation} backward"), |b| {
                let run = |loss: Tensor<1>| {
                    let gradients = black_box(loss.backward());
                    view.sync();
                    gradients
                };
                b.iter_batched(make, run, BatchSize::PerIteration);
            });
        };
        backward("peel", &|| view.peel_leaves(|t| leaf(&t)).alpha.sum());
        backward("splat", &|| view.splat_leaves().sum());
        backward("composite", &|| view.composite_loss(&sums, true));
        backward("composite, plain", &|| view.composite_loss(&sums, false));
        backward("ssim", &|| ssim(&leaf(image), &target.clone().autodiff()).unwrap());
        for (operation, own) in [("Adam", true), ("Adam, plain", false)] {
            let (mut parameters, mut time) = (parameters(&view), 0);
            group.bench_function(operation, |b| {
                b.iter(|| {
                    time += 1;
                    parameters.iter_mut().for_each(|(p, grad)| p.step(grad.clone(), adam_settings(time), own));
                    view.sync();
                });
            });
        }
    }
}

fn steps(c: &mut Criterion) {
    for (name, device) in devices() {
        let mut group = c.benchmark_group(format!("step on {name}"));
        group.sampling_mode(SamplingMode::Flat);
        for variant in [Variant::OWN, Variant::PLAIN_COMPOSITE, Variant::PLAIN_ADAM, Variant::PLAIN] {
            let mut training = Training::new(&scene(), &device);
            group.bench_function(variant.name(), |b| b.iter(|| black_box(training.step(variant))));
        }
    }
}

fn short() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_millis(1500))
}

criterion_group! { name = all; config = short(); targets = operations, steps }
criterion_main!(all);

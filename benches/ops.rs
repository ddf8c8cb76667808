//! `cargo bench -p dpges-benches --bench ops -- [NAME …]`: the time of each operation, forward and backward, on every device.
//! `dpges bench step` measures a whole step.

use std::hint::black_box;
use std::time::Instant;

use burn::tensor::{DType, Device, Tensor};
use clap::Parser;
use dpges_benches::{devices, machine};
use dpges_core::ops::adam::{AdamStep, adam_step};
use dpges_core::ops::blend::{Blend, BlendOptions, Form, blend};
use dpges_core::ops::composite::{Composite, CompositeOptions, composite};
use dpges_core::ops::peel::{Layers, PeelOptions, peel};
use dpges_core::ops::photometric::ssim;
use dpges_core::ops::splat::splat;
use dpges_core::ops::visibility::{Visibility, visibility};
use dpges_core::render::{Render, RenderOptions, render};
use dpges_core::scene::schema::Columns;
use dpges_core::scene::{Gaussians, Peeling, Surfels};
use dpges_core::testing::scenes::{TestScene, realistic};

const BLENDING: CompositeOptions = CompositeOptions { background: [0.0; 3], detach_transmittance: false };
/// Runs before those whose median counts.
const WARM_UP: usize = 2;

#[derive(Parser)]
struct Arguments {
    /// Parts of names, such as `wgpu` or `blend`; everything without
    names: Vec<String>,
    #[arg(long, default_value_t = 10_000)]
    surfels: usize,
    #[arg(long, default_value_t = 100_000)]
    gaussians: usize,
    #[arg(long, default_value_t = 400)]
    width: usize,
    #[arg(long, default_value_t = 400)]
    height: usize,
    #[arg(long, default_value_t = 10)]
    repeats: usize,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// A rendered view whose tensors are leaves of a tape, or off it.
struct Fixture<'a> {
    arguments: &'a Arguments,
    scene: &'a TestScene,
    name: &'static str,
    device: Device,
    surfels: Surfels,
    gaussians: Gaussians,
    render: Render,
}

impl<'a> Fixture<'a> {
    fn new(arguments: &'a Arguments, scene: &'a TestScene, (name, device): (&'static str, Device)) -> Self {
        let (surfels, gaussians) = scene.tensors(&device, DType::F32);
        let render = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap();
        Self { arguments, scene, name, device, surfels, gaussians, render }
    }

    /// Prints the median time of `run` on what `make` has made, if its name is wanted.
    fn time<I, O>(&self, operation: &str, make: impl Fn() -> I, run: impl Fn(I) -> O) {
        let name = format!("{} {operation}", self.name);
        if !self.arguments.names.is_empty() && !self.arguments.names.iter().any(|wanted| name.contains(wanted)) {
            return;
        }
        let once = |_| {
            let input = make();
            self.sync();
            let start = Instant::now();
            let output = black_box(run(input));
            self.sync();
            let elapsed = start.elapsed();
            drop(output);
            1e3 * elapsed.as_secs_f64()
        };
        let mut times: Vec<f64> = (0..WARM_UP + self.arguments.repeats).map(once).skip(WARM_UP).collect();
        times.sort_by(f64::total_cmp);
        println!("{:9.3} ms  {name}", times[times.len() / 2]);
    }

    fn forward<O>(&self, operation: &str, run: impl Fn() -> O) {
        self.time(operation, || (), |()| run());
    }

    fn backward(&self, operation: &str, make: impl Fn() -> Tensor<1>) {
        self.time(&format!("{operation} backward"), make, |loss| loss.backward());
    }

    fn sync(&self) {
        self.device.sync().unwrap();
    }

    fn peel(&self, of: impl Fn(&Tensor<2>) -> Tensor<2>) -> Layers {
        peel(&self.surfels.map_ref(|_, tensor| of(tensor)), &self.scene.camera, &PeelOptions::default()).unwrap()
    }

    fn splat(&self) -> Tensor<4> {
        let (colours, limits) = (&self.render.gaussian_colours, &self.render.seen.limits);
        splat(&self.gaussians, colours, limits, &self.scene.camera).unwrap()
    }

    fn gaussian_leaves(&self) -> Gaussians {
        self.gaussians.map_ref(|_, tensor| leaf(tensor))
    }

    fn splat_leaves(&self) -> Tensor<4> {
        let limits = self.render.seen.limits.clone().autodiff();
        let colours = leaf(&self.render.gaussian_colours);
        splat(&self.gaussian_leaves(), &colours, &limits, &self.scene.camera).unwrap()
    }

    fn blend(&self, options: &BlendOptions) -> Blend {
        blend(&self.gaussians, &self.render.gaussian_colours, None, &self.scene.camera, options).unwrap()
    }

    /// All outputs that carry gradients.
    fn blend_loss(&self, options: &BlendOptions) -> Tensor<1> {
        let colours = leaf(&self.render.gaussian_colours);
        let out = blend(&self.gaussian_leaves(), &colours, None, &self.scene.camera, options).unwrap();
        let loss = out.colour.sum() + out.alpha.sum();
        match out.maps {
            Some(maps) => loss + maps.depth.sum() + maps.normal.sum() + maps.distortion.sum(),
            None => loss,
        }
    }

    fn composite(&self, sums: &Tensor<4>) -> Composite {
        let Render { layers, seen, surfel_colours, .. } = &self.render;
        composite(layers, seen, surfel_colours, sums, &BLENDING).unwrap()
    }

    fn layer_leaves(&self) -> Layers {
        let Layers { ids, alpha, depth } = &self.render.layers;
        Layers { ids: ids.clone().autodiff(), alpha: leaf(alpha), depth: leaf(depth) }
    }

    /// Both outputs that carry gradients.
    fn visibility_loss(&self) -> Tensor<1> {
        let margins = self.surfels.margins.clone().autodiff();
        let seen = visibility(&self.layer_leaves(), &margins, Peeling::Continuous).unwrap();
        seen.weights.sum() + seen.transmittance.sum()
    }

    /// Image and surfel image, which the losses use.
    fn composite_loss(&self, sums: &Tensor<4>) -> Tensor<1> {
        let Visibility { weights, transmittance, limits } = &self.render.seen;
        let (weights, transmittance, limits) = (leaf(weights), leaf(transmittance), limits.clone().autodiff());
        let seen = Visibility { weights, transmittance, limits };
        let colours = leaf(&self.render.surfel_colours);
        let out = composite(&self.layer_leaves(), &seen, &colours, &leaf(sums), &BLENDING).unwrap();
        out.image.sum() + out.surfel_image.sum()
    }

    /// Adam for positions, rotations, scales and colours of all Gaussians.
    fn adam(&self) {
        let g = &self.gaussians;
        let values = [&g.positions, &g.quaternions, &g.log_scales, &g.colour.base, &g.colour.detail];
        let gate = Tensor::ones([1], (&self.device, DType::F32));
        let settings = AdamStep { learning_rate: 1e-6, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 1 };
        // of its own, since a shared tensor could not be stepped in place
        let own = |value: &Tensor<2>| value.clone() + 0.0;
        let state = || values.map(|value| (own(value), [(); 2].map(|()| own(&value.zeros_like())), own(value)));
        self.time("Adam", state, |state| {
            state.map(|(value, moments, grad)| adam_step(value, moments, &grad, &gate, &settings).unwrap())
        });
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

fn main() {
    let arguments = Arguments::parse();
    let Arguments { surfels, gaussians, width, height, repeats, .. } = arguments;
    println!("{}; {surfels} surfels, {gaussians} Gaussians, {width} × {height} px, medians of {repeats}", machine());
    let scene = realistic(surfels, gaussians, width, height, 1);
    for device in devices() {
        let view = Fixture::new(&arguments, &scene, device);
        let sums = view.splat();
        let (image, target) = (&view.render.composite.image, &view.render.composite.surfel_image);
        let margins = &view.surfels.margins;
        view.forward("peel", || view.peel(Tensor::clone));
        view.forward("visibility", || visibility(&view.render.layers, margins, Peeling::Continuous).unwrap());
        view.forward("splat", || view.splat());
        view.forward("composite", || view.composite(&sums));
        view.forward("ssim", || ssim(image, target).unwrap());
        let options = RenderOptions::default();
        view.forward("render", || render(&view.surfels, &view.gaussians, &scene.camera, &options).unwrap());
        view.backward("peel", || view.peel(leaf).alpha.sum());
        view.backward("visibility", || view.visibility_loss());
        view.backward("splat", || view.splat_leaves().sum());
        view.backward("composite", || view.composite_loss(&sums));
        view.backward("ssim", || ssim(&leaf(image), &target.clone().autodiff()).unwrap());
        for (operation, options) in blends() {
            view.forward(operation, || view.blend(&options));
            view.backward(operation, || view.blend_loss(&options));
        }
        view.adam();
    }
}

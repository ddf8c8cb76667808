//! Every operation on its own, forward and backward, so that two devices can be compared.
//!
//! An operation whose input is another one's output gets that output from the reference device on
//! both sides: what differs is then its own doing.
//!
//! Whether a fragment exists and whether it is opaque are decided by comparison with a threshold, and
//! now and then two devices that round differently decide differently. Such pixels are counted, and
//! left out of all that follows.

use burn::tensor::{DType, Device, Gradients, Int, Tensor, TensorData};

use super::compare::relative_l2;
use super::golden::{gradient, values};
use super::random::Random;
use super::scenes::TestScene;
use crate::backend::readback::begin_readback;
use crate::counters::transfers::uploaded;
use crate::ops::adam::{AdamStep, adam_step};
use crate::ops::blend::{BlendOptions, Form, blend};
use crate::ops::colour::colour;
use crate::ops::composite::{CompositeOptions, composite};
use crate::ops::coverage::coverage;
use crate::ops::environment::environment;
use crate::ops::finite::FiniteChecks;
use crate::ops::harmonics::harmonics;
use crate::ops::jitter::{JitterOptions, NoiseGate, jitter};
use crate::ops::peel::{Layers, PeelOptions, peel};
use crate::ops::photometric::{PhotometricWeights, photometric, ssim};
use crate::ops::scale_loss::scale_loss;
use crate::ops::splat::{contributions, splat};
use crate::ops::surfel_loss::{SurfelLossWeights, surfel_loss};
use crate::ops::visibility::{Visibility, visibility};
use crate::render::ViewRequest;
use crate::render::summed::{SummedOptions, WeightedSumTensors, render_summed};
use crate::scene::schema::Columns;
use crate::scene::{DepthWeight, Gaussians, Peeling, Surfels};

/// A tensor by name, as `peel.alpha` or `splat.grad.positions`.
pub type Named = (String, Vec<f64>);

#[derive(Clone, Debug)]
pub struct Reference {
    ids: Vec<i64>,
    alpha: Vec<f64>,
    depth: Vec<f64>,
    weights: Vec<f64>,
    transmittance: Vec<f64>,
    limits: Vec<f64>,
    sums: Vec<f64>,
    surfel_colours: Vec<f64>,
    gaussian_colours: Vec<f64>,
    /// [K, H, W] 1 where both devices have the same layers in the pixel, else 0.
    agreed: Vec<f64>,
}

impl Reference {
    /// Leaves out the pixels in which another device has other layers: `ids` [K, H, W].
    #[must_use]
    pub fn only_where(mut self, ids: &[i64], layer_count: usize) -> Self {
        let pixels = ids.len() / layer_count;
        for pixel in 0..pixels {
            let layers = (0..layer_count).map(|k| k * pixels + pixel);
            if layers.clone().any(|at| ids[at] != self.ids[at]) {
                layers.for_each(|at| self.agreed[at] = 0.0);
            }
        }
        self
    }

    /// Share of the pixels that are left out.
    pub fn disagreement(&self) -> f64 {
        1.0 - self.agreed.iter().sum::<f64>() / self.agreed.len().max(1) as f64
    }
}

pub struct Bench<'a> {
    scene: &'a TestScene,
    options: PeelOptions,
    device: Device,
    surfels: Surfels,
    gaussians: Gaussians,
    found: Vec<Named>,
}

impl<'a> Bench<'a> {
    /// `device` without a tape.
    pub fn new(scene: &'a TestScene, options: PeelOptions, device: &Device) -> Self {
        let device = device.clone().autodiff();
        let (surfels, gaussians) = scene.leaves(&device, DType::F32);
        Self { scene, options, device, surfels, gaussians, found: Vec::new() }
    }

    fn tensor<const D: usize>(&self, values: &[f64], shape: [usize; D]) -> Tensor<D> {
        uploaded(values.to_vec(), shape, &self.device, DType::F32)
    }

    /// The gradient that makes a sum out of `output`: random, the same on every device.
    fn upstream<const D: usize>(&self, output: &Tensor<D>, seed: u64) -> Tensor<D> {
        let count = output.dims().iter().product();
        self.tensor(&Random::new(seed).numbers(count, -1.0, 1.0), output.dims())
    }

    fn note<const D: usize>(&mut self, name: &str, tensor: &Tensor<D>) {
        self.found.push((name.to_owned(), values(tensor)));
    }

    fn gradient<const D: usize>(&mut self, name: &str, leaf: &Tensor<D>, gradients: &Gradients) {
        self.found.push((name.to_owned(), gradient(leaf, gradients)));
    }

    fn gradients(&mut self, of: &str, leaves: &[(&str, &Tensor<2>)], gradients: &Gradients) {
        for (name, leaf) in leaves {
            self.gradient(&format!("{of}.grad.{name}"), leaf, gradients);
        }
    }

    fn shape(&self) -> [usize; 3] {
        [self.options.layer_count, self.scene.camera.height, self.scene.camera.width]
    }

    fn layers(&self, reference: &Reference) -> Layers {
        let ids = TensorData::new(reference.ids.clone(), self.shape());
        Layers {
            ids: Tensor::<3, Int>::from_data(ids, (&self.device, DType::I32)),
            alpha: self.tensor(&reference.alpha, self.shape()),
            depth: self.tensor(&reference.depth, self.shape()),
        }
    }

    fn peeled(&self) -> Layers {
        peel(&self.surfels, &self.scene.camera, &self.options).expect("valid input")
    }

    /// [K, H, W] surfels of the layers, −1 where there is none.
    pub fn ids(&self) -> Vec<i64> {
        self.peeled().ids.into_data().iter::<i64>().collect()
    }

    /// Goes back from each output by itself, and from both together.
    fn peel(&mut self, reference: &Reference) {
        let agreed = self.tensor(&reference.agreed, self.shape());
        let Surfels { positions, quaternions, log_scales, .. } = &self.surfels.clone();
        let leaves = [("positions", positions), ("quaternions", quaternions), ("log_scales", log_scales)];
        for output in ["alpha", "depth", "both"] {
            let layers = self.peeled();
            // a missing layer is at infinity
            let left_out = layers.ids.clone().lower_elem(0).float() + (agreed.clone() * -1.0 + 1.0);
            let alpha = layers.alpha * agreed.clone();
            let depth = layers.depth.mask_fill(left_out.greater_elem(0.5), 0.0);
            let upstream = self.upstream(&alpha, 1);
            let loss = match output {
                "alpha" => {
                    self.note("peel.alpha", &alpha);
                    (alpha * upstream).sum()
                }
                "depth" => {
                    self.note("peel.depth", &depth);
                    (depth * upstream).sum()
                }
                _ => (alpha * upstream.clone()).sum() + (depth * upstream).sum(),
            };
            self.gradients(&format!("peel.{output}"), &leaves, &loss.backward());
        }
    }

    fn colours(&mut self) -> [Tensor<2>; 2] {
        let centre = self.scene.camera.centre().to_array();
        let pairs = [
            ("surfels", self.surfels.colour.clone(), self.surfels.positions.clone()),
            ("gaussians", self.gaussians.colour.clone(), self.gaussians.positions.clone()),
        ];
        pairs.map(|(of, model, positions)| {
            let out = colour(&model, &positions, centre).expect("valid input");
            self.note(&format!("colour.{of}"), &out);
            let gradients = (out.clone() * self.upstream(&out, 2)).sum().backward();
            let leaves = [("base", &model.base), ("detail", &model.detail)];
            self.gradients(&format!("colour.{of}"), &leaves, &gradients);
            out
        })
    }

    fn splat(&mut self, limits: Tensor<3>, colours: Tensor<2>) -> Tensor<4> {
        let (gaussians, camera) = (self.gaussians.clone(), &self.scene.camera);
        let colours = colours.require_grad();
        let sums = splat(&gaussians, &colours, &limits, camera).expect("valid input");
        self.note("splat.sums", &sums);
        let gradients = (sums.clone() * self.upstream(&sums, 3)).sum().backward();
        self.gradients("splat", &leaves(&gaussians), &gradients);
        self.gradient("splat.grad.colours", &colours, &gradients);
        let [bounds, height, width] = limits.dims();
        let gates = self.upstream(&limits.clone().slice([0..bounds - 1, 0..height, 0..width]), 4).abs();
        let largest = contributions(&gaussians, &colours, &limits, &gates, camera).expect("valid input");
        self.note("splat.contributions", &largest);
        sums
    }

    /// With every peeling; goes back from weights and transmittances.
    fn visibility(&mut self, layers: &Layers) {
        for (name, peeling) in
            [("continuous", Peeling::Continuous), ("nearest", Peeling::Nearest), ("literal", Peeling::Literal)]
        {
            let of = format!("visibility.{name}");
            for output in ["weights", "transmittance"] {
                let (alpha, depth) = (layers.alpha.clone().require_grad(), layers.depth.clone().require_grad());
                let layers = Layers { alpha: alpha.clone(), depth: depth.clone(), ids: layers.ids.clone() };
                let seen = visibility(&layers, &self.surfels.margins, peeling).expect("one shape");
                let tensor = if output == "weights" {
                    self.note(&format!("{of}.limits"), &seen.limits);
                    seen.weights
                } else {
                    seen.transmittance
                };
                self.note(&format!("{of}.{output}"), &tensor);
                let gradients = (tensor.clone() * self.upstream(&tensor, 17)).sum().backward();
                self.gradient(&format!("{of}.{output}.grad.alpha"), &alpha, &gradients);
                self.gradient(&format!("{of}.{output}.grad.depth"), &depth, &gradients);
            }
        }
    }

    /// Goes back from each output by itself, and from all of them together.
    fn composite(&mut self, layers: &Layers, seen: &Visibility, colours: &Tensor<2>, sums: &Tensor<4>) {
        const NAMES: [&str; 4] = ["image", "surfel_image", "gaussian_colour", "gaussian_weight"];
        for detach_transmittance in [false, true] {
            let options = CompositeOptions { background: [0.3, 0.6, 0.1], detach_transmittance };
            let every: Vec<usize> = (0..NAMES.len()).collect();
            for chosen in every.chunks(1).chain([every.as_slice()]) {
                let weights = seen.weights.clone().require_grad();
                let transmittance = seen.transmittance.clone().require_grad();
                let (colours, sums) = (colours.clone().require_grad(), sums.clone().require_grad());
                let limits = seen.limits.clone();
                let seen = Visibility { weights: weights.clone(), transmittance: transmittance.clone(), limits };
                let out = composite(layers, &seen, &colours, &sums, &options).expect("valid input");
                let outputs = [out.image, out.surfel_image, out.gaussian_colour, out.gaussian_weight];
                let name = if let [one] = chosen { NAMES[*one] } else { "all" };
                let of = format!("composite{}.{name}", if detach_transmittance { ".detached" } else { "" });
                if let [one] = chosen {
                    self.note(&of, &outputs[*one]);
                }
                let losses = chosen.iter().map(|&output| {
                    let output = &outputs[output];
                    (output.clone() * self.upstream(output, 5)).sum()
                });
                let gradients = losses.reduce(|sum, loss| sum + loss).expect("an output").backward();
                self.gradient(&format!("{of}.grad.weights"), &weights, &gradients);
                self.gradient(&format!("{of}.grad.transmittance"), &transmittance, &gradients);
                self.gradient(&format!("{of}.grad.colours"), &colours, &gradients);
                self.gradient(&format!("{of}.grad.sums"), &sums, &gradients);
            }
        }
    }

    /// Without a mask, and with one that leaves out every seventh pixel.
    fn losses(&mut self, layers: &Layers) {
        let [layer_count, height, width] = self.shape();
        let area = height * width;
        let random = |planes: usize, seed| Random::new(seed).numbers(planes * area, 0.0, 1.0);
        let target = self.tensor(&random(3, 21), [3, height, width]);
        // one pixel alone counts
        let ignored: Vec<f64> = (0..area).map(|pixel| f64::from(u8::from(pixel % 7 == 3 && area > 1))).collect();
        let pixels_per_counted = area as f64 / (area as f64 - ignored.iter().sum::<f64>());
        let ignored = self.tensor(&ignored, [1, height, width]);
        for (name, mask, pixels_per_counted) in [("", None, 1.0), (".masked", Some(&ignored), pixels_per_counted)] {
            let bright = self.tensor(&Random::new(22).numbers(3 * area, -0.2, 1.2), [3, height, width]);
            let image = bright.clone().require_grad();
            let weights = PhotometricWeights { pixels_per_counted, ..PhotometricWeights::l1_and_dssim(0.2) };
            let found = photometric(&image, &target, mask, &weights).expect("one shape");
            self.note(&format!("photometric{name}"), &found.value);
            self.note(&format!("photometric{name}.squared_error"), &found.squared_error);
            let gradients = (found.value * 0.7).backward();
            self.gradient(&format!("photometric{name}.grad"), &image, &gradients);

            let transmittance = self.tensor(&random(layer_count + 1, 23), [layer_count + 1, height, width]);
            let transmittance = transmittance.require_grad();
            let image = bright.require_grad();
            let weights = SurfelLossWeights { image: 0.3, transmittance: 0.8, pixels_per_counted };
            let found = surfel_loss(&image, &transmittance, &layers.ids, &target, mask, &weights).expect("one shape");
            self.note(&format!("surfel_loss{name}"), &found.weighted);
            self.note(&format!("surfel_loss{name}.image"), &found.image);
            self.note(&format!("surfel_loss{name}.transmittance"), &found.transmittance);
            let gradients = (found.weighted * 0.7).backward();
            self.gradient(&format!("surfel_loss{name}.grad.image"), &image, &gradients);
            self.gradient(&format!("surfel_loss{name}.grad.transmittance"), &transmittance, &gradients);
        }

        let log_scales = self.surfels.log_scales.clone();
        let found = scale_loss(&log_scales, 0.3);
        self.note("scale_loss", &found.weighted);
        self.note("scale_loss.value", &found.value);
        if !self.surfels.is_empty() {
            let gradients = (found.weighted * 0.7).backward();
            self.gradient("scale_loss.grad", &log_scales, &gradients);
        }
    }

    /// Tensors that are read together, and that are checked: their numbers depend on nothing but their places.
    fn batches(&mut self) {
        let numbers = |at: usize| Random::new(30).numbers(1 + at % 3, 0.0, 1.0);
        let tensor = |bench: &Self, numbers: &[f64]| bench.tensor(numbers, [numbers.len()]).inner();
        let parts: Vec<Tensor<1>> = (0..14).map(|at| tensor(self, &numbers(at))).collect();
        let read = begin_readback(parts.clone()).arrived().expect("the device runs");
        self.found.push(("readback".into(), read.iter::<f64>().collect()));
        for bad in [None, Some(0), Some(9)] {
            let mut checks = FiniteChecks::default();
            for at in 0..parts.len() {
                let mut numbers = numbers(at);
                if bad == Some(at) {
                    *numbers.last_mut().expect("a number") = f64::INFINITY;
                }
                checks.add("part", &tensor(self, &numbers));
            }
            let found = checks.launch();
            let positions = found.positions().into_data().iter::<f64>().collect();
            self.found.push((format!("finite.{bad:?}"), positions));
            let gate = found.gate();
            self.note(&format!("finite.{bad:?}.open"), &gate.open);
            self.note(&format!("finite.{bad:?}.bad"), &gate.bad);
        }
    }

    fn image_operations(&mut self) {
        let [_, height, width] = self.shape();
        let count = 3 * height * width;
        let random = |seed| Random::new(seed).numbers(count, 0.0, 1.0);
        let image = self.tensor(&random(6), [3, height, width]).require_grad();
        let target = self.tensor(&random(7), [3, height, width]);
        let value = ssim(&image, &target).expect("one shape");
        self.note("ssim", &value);
        let gradients = (value * 0.7).sum().backward();
        self.gradient("ssim.grad", &image, &gradients);

        for count in [1, 4, 9, 16] {
            let coefficients = self.tensor(&Random::new(15).numbers(3 * count, -1.0, 1.0), [count, 3]).require_grad();
            let image = environment(&coefficients, &self.scene.camera).expect("coefficients of a degree");
            self.note(&format!("environment.{count}"), &image);
            let gradients = (image.clone() * self.upstream(&image, 16)).sum().backward();
            self.gradient(&format!("environment.{count}.grad"), &coefficients, &gradients);
        }

        let step = AdamStep { learning_rate: 0.01, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 3 };
        let inner = |seed| self.tensor(&random(seed), [3, height, width]).inner();
        let (parameter, moments, gradient) = (inner(8), [inner(9), inner(10)], inner(11));
        for (name, gate) in [("open", 1.0), ("closed", 0.0)] {
            let gate = self.tensor(&[gate], [1]).inner();
            let stepped = adam_step(parameter.clone(), moments.clone(), &gradient, &gate, &step);
            let (parameter, [moment_1, moment_2]) = stepped.expect("one shape");
            self.note(&format!("adam.{name}.parameter"), &parameter);
            self.note(&format!("adam.{name}.moment_1"), &moment_1);
            self.note(&format!("adam.{name}.moment_2"), &moment_2);
        }
    }

    fn jitter(&mut self) {
        let gaussians = self.gaussians.map_ref(|_, tensor| tensor.clone().inner());
        for (name, gate) in [("mcmc", NoiseGate::Mcmc), ("beta", NoiseGate::Beta)] {
            let opacities = gaussians.opacities.clone() * 0.01;
            let faint = Gaussians { opacities, ..gaussians.clone() };
            let moved = jitter(&faint, &JitterOptions { gate, amount: 5.0, seed: 14 }).expect("valid input");
            self.note(&format!("jitter.{name}"), &(moved - gaussians.positions.clone()));
        }
    }

    /// Runs sorted blending of the Gaussians in random colours, and goes back from each of its outputs.
    pub fn blended(self, options: BlendOptions) -> Vec<Named> {
        let [_, height, width] = self.shape();
        self.blended_where(options, &vec![1.0; height * width])
    }

    /// [3, H, W] colour of sorted blending of the Gaussians in random colours.
    pub fn blended_colour(&self, options: BlendOptions) -> Vec<f64> {
        let count = self.gaussians.len();
        let colours = self.tensor(&Random::new(12).numbers(3 * count, 0.0, 1.0), [count, 3]);
        values(&blend(&self.gaussians, &colours, None, &self.scene.camera, &options).expect("valid input").colour)
    }

    /// [`blended`](Self::blended) where `agreed` [H, W] is 1; the rest of each output is 0.
    pub fn blended_where(mut self, options: BlendOptions, agreed: &[f64]) -> Vec<Named> {
        let (mut gaussians, count) = (self.gaussians.clone(), self.gaussians.len());
        if options.form == Form::Students {
            let powers = Random::new(15).numbers(count, 0.0, 3.5);
            let degrees: Vec<f64> = powers.into_iter().map(|power| 10f64.powf(power)).collect();
            // behind many below 0 T is so large that one fragment at the cutoff, where devices may differ, shows
            let opacities = Random::new(16).numbers(count, -0.3, 0.98);
            gaussians.degrees_of_freedom = Some(self.tensor(&degrees, [count, 1]).require_grad());
            gaussians.opacities = self.tensor(&opacities, [count, 1]).require_grad();
        }
        let [_, height, width] = self.shape();
        let agreed = self.tensor(agreed, [1, height, width]);
        let outputs: &[&str] =
            if options.maps { &["colour", "alpha", "depth", "normal", "distortion"] } else { &["colour", "alpha"] };
        for &name in outputs {
            let colours = self.tensor(&Random::new(12).numbers(3 * count, 0.0, 1.0), [count, 3]).require_grad();
            let probe = self.tensor(&vec![0.0; 4 * count], [count, 4]).require_grad();
            let out = blend(&gaussians, &colours, Some(&probe), &self.scene.camera, &options);
            let out = out.expect("valid input");
            let output = match (name, out.maps) {
                ("colour", _) => out.colour,
                ("depth", Some(maps)) => {
                    self.note("blend.median_depth", &(maps.median_depth * agreed.clone()));
                    maps.depth
                }
                ("normal", Some(maps)) => maps.normal,
                ("distortion", Some(maps)) => maps.distortion,
                _ => out.alpha,
            };
            let output = output * agreed.clone();
            self.note(&format!("blend.{name}"), &output);
            let gradients = (output.clone() * self.upstream(&output, 13)).sum().backward();
            let of = format!("blend.{name}");
            self.gradients(&of, &leaves(&gaussians), &gradients);
            if let Some(degrees) = &gaussians.degrees_of_freedom {
                self.gradients(&of, &[("degrees_of_freedom", degrees)], &gradients);
            }
            self.gradients(&of, &[("colours", &colours), ("probe", &probe)], &gradients);
        }
        self.found
    }

    /// Renders the Gaussians as a weighted sum, with probes, and goes back from each of its outputs. Their opacities depend on
    /// the direction.
    pub fn summed(mut self, weight: DepthWeight) -> Vec<Named> {
        let gaussians = self.gaussians.clone();
        let centre = self.scene.camera.centre().to_array();
        let of = &gaussians;
        let factors = harmonics(&of.opacity_base, &of.opacity_detail, &of.positions, centre).expect("valid input");
        self.note("harmonics", &factors);
        let gradients = (factors.clone() * self.upstream(&factors, 15)).sum().backward();
        let leaves = [("base", &gaussians.opacity_base), ("detail", &gaussians.opacity_detail)];
        self.gradients("harmonics", &leaves, &gradients);

        let options = SummedOptions { weight, background: [0.3, 0.6, 0.1], depth: true };
        for name in ["image", "alpha", "depth"] {
            // some lie behind σ, or weigh clearly less than others
            let sigma = if weight == DepthWeight::Exponential { 0.2 } else { 3.5 };
            let number = |value: f64| self.tensor(&[value], [1, 1]).require_grad();
            let common = WeightedSumTensors { sigma: number(sigma), beta: number(1.3), background: number(0.05) };
            let probe = self.tensor(&vec![0.0; 2 * gaussians.len()], [gaussians.len(), 2]).require_grad();
            let view = ViewRequest { probe: Some(&probe), ..(&self.scene.camera).into() };
            let view = render_summed(&gaussians, &common, view, &options);
            let view = view.expect("valid input");
            let output = match name {
                "image" => view.image,
                "alpha" => view.alpha,
                _ => view.depth.expect("asked for"),
            };
            self.note(&format!("summed.{name}"), &output);
            let gradients = (output.clone() * self.upstream(&output, 16)).sum().backward();
            let WeightedSumTensors { sigma, beta, background } = &common;
            let shared = [("sigma", sigma), ("beta", beta), ("background", background), ("probe", &probe)];
            let own = gaussians.iter().map(|(attribute, leaf)| (attribute.name, leaf));
            self.gradients(&format!("summed.{name}"), &own.chain(shared).collect::<Vec<_>>(), &gradients);
        }
        self.found
    }

    /// Runs everything forward, each operation on its own results.
    pub fn reference(mut self) -> Reference {
        let layers = self.peeled();
        let Visibility { weights, transmittance, limits } =
            visibility(&layers, &self.surfels.margins, self.options.peeling).expect("one shape");
        let [surfel_colours, gaussian_colours] = self.colours();
        let camera = &self.scene.camera;
        let sums = splat(&self.gaussians, &gaussian_colours, &limits, camera).expect("valid input");
        Reference {
            agreed: vec![1.0; self.shape().iter().product()],
            ids: layers.ids.clone().into_data().iter::<i64>().collect(),
            alpha: values(&layers.alpha),
            depth: values(&layers.depth),
            weights: values(&weights),
            transmittance: values(&transmittance),
            limits: values(&limits),
            sums: values(&sums),
            surfel_colours: values(&surfel_colours),
            gaussian_colours: values(&gaussian_colours),
        }
    }

    /// Runs everything, with what the reference found between the operations.
    pub fn against(mut self, reference: &Reference) -> Vec<Named> {
        let (surfels, gaussians) = (self.surfels.len(), self.gaussians.len());
        let [layer_count, height, width] = self.shape();
        self.peel(reference);
        self.colours();
        let layers = self.layers(reference);
        let covered = coverage(&layers, surfels).into_data().iter::<f64>().collect();
        self.found.push(("coverage".into(), covered));
        self.visibility(&layers);
        let planes = |values: &[f64], count: usize| self.tensor(values, [count, height, width]);
        let limits = planes(&reference.limits, layer_count + 1);
        let seen = Visibility {
            weights: planes(&reference.weights, layer_count),
            transmittance: planes(&reference.transmittance, layer_count + 1),
            limits: limits.clone(),
        };
        self.splat(limits, self.tensor(&reference.gaussian_colours, [gaussians, 3]));
        let colours = self.tensor(&reference.surfel_colours, [surfels, 3]);
        let sums = self.tensor(&reference.sums, [layer_count, 4, height, width]);
        self.composite(&layers, &seen, &colours, &sums);
        self.image_operations();
        self.losses(&layers);
        self.batches();
        self.jitter();
        self.found
    }
}

/// Parameters that have gradients however Gaussians are drawn.
fn leaves(gaussians: &Gaussians) -> [(&'static str, &Tensor<2>); 4] {
    let Gaussians { positions, quaternions, log_scales, opacities, .. } = gaussians;
    [("positions", positions), ("quaternions", quaternions), ("log_scales", log_scales), ("opacities", opacities)]
}

/// How far two devices are apart: relative L2 of every tensor.
pub fn distances(found: &[Named], expected: &[Named]) -> Vec<(String, f64)> {
    assert_eq!(found.len(), expected.len(), "the same operations");
    let distance = |((name, found), (expected_name, expected)): (&Named, &Named)| {
        assert_eq!(name, expected_name);
        (name.clone(), relative_l2(found, expected))
    };
    found.iter().zip(expected).map(distance).collect()
}

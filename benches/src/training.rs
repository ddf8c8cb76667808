//! A training step: render, losses, backward, Adam for every parameter.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::losses::{LossWeights, losses};
use dpges_core::ops::adam::{AdamStep, adam_step};
use dpges_core::ops::colour::colour;
use dpges_core::ops::composite::CompositeOptions;
use dpges_core::ops::limits::interval_limits;
use dpges_core::ops::peel::peel;
use dpges_core::ops::splat::splat;
use dpges_core::render::{Render, RenderOptions, Values, render_values, validate};
use dpges_core::scene::{Colour, ColourModel, Gaussians, Surfels};
use dpges_core::testing::scenes::TestScene;

use crate::plain;

/// Which parts are operations of dpges, and which plain tensor operations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    pub own_composite: bool,
    pub own_adam: bool,
}

impl Variant {
    pub const OWN: Self = Self { own_composite: true, own_adam: true };
    pub const PLAIN_COMPOSITE: Self = Self { own_composite: false, own_adam: true };
    pub const PLAIN_ADAM: Self = Self { own_composite: true, own_adam: false };
    pub const PLAIN: Self = Self { own_composite: false, own_adam: false };

    pub fn name(self) -> &'static str {
        match (self.own_composite, self.own_adam) {
            (true, true) => "own operations",
            (false, true) => "plain composite",
            (true, false) => "plain Adam",
            (false, false) => "plain composite and Adam",
        }
    }
}

/// A parameter and its moments, off the tape.
#[derive(Clone, Debug)]
pub struct Parameter<const D: usize> {
    /// Value, first and second moment; `None` only while they are stepped.
    state: Option<(Tensor<D>, [Tensor<D>; 2])>,
}

impl<const D: usize> Parameter<D> {
    pub fn new(value: &Tensor<D>) -> Self {
        let zero = value.zeros_like();
        Self { state: Some((value.clone(), [zero.clone() + 0.0, zero + 0.0])) }
    }

    fn leaf(&self) -> Tensor<D> {
        self.state.as_ref().expect("nothing is being stepped").0.clone().autodiff().require_grad()
    }

    pub fn step(&mut self, grad: Tensor<D>, step: AdamStep, own: bool) {
        let (value, moments) = self.state.take().expect("nothing is being stepped");
        self.state = Some(if own {
            let gate = Tensor::ones([1], (&grad.device(), grad.dtype()));
            adam_step(value, moments, &grad, &gate, &step).expect("a gradient has the shape of its parameter")
        } else {
            plain::adam_step(value, moments, grad, &step)
        });
    }
}

/// One step's settings; small enough that a benchmark does not change the scene much.
pub fn adam_settings(time: u64) -> AdamStep {
    AdamStep { learning_rate: 1e-6, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time }
}

/// A scene in training against one target view.
#[derive(Clone, Debug)]
pub struct Training {
    scene: TestScene,
    rows: Vec<Parameter<2>>,
    opacities: Parameter<1>,
    margins: Tensor<1>,
    target: Tensor<3>,
    device: Device,
    time: u64,
}

impl Training {
    /// Trains `scene` towards a darker picture of itself.
    pub fn new(scene: &TestScene, device: &Device) -> Self {
        let (s, g) = scene.tensors(device, DType::F32);
        let options = RenderOptions::default();
        let view = render_values(&s, &g, &scene.camera, &options, Values::Unknown).expect("benchmark scenes are valid");
        let target = view.composite.image.clamp(0.0, 1.0) * 0.9;
        let rows = [
            &s.positions,
            &s.quaternions,
            &s.log_scales,
            &s.colour.base,
            &s.colour.detail,
            &g.positions,
            &g.quaternions,
            &g.log_scales,
            &g.colour.base,
            &g.colour.detail,
        ];
        Self {
            rows: rows.map(Parameter::new).into(),
            opacities: Parameter::new(&g.opacities),
            margins: s.margins,
            target,
            device: device.clone(),
            scene: scene.clone(),
            time: 0,
        }
    }

    /// The same scene seen by its camera at another size.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let scene = TestScene { camera: self.scene.camera.resized(width, height), ..self.scene.clone() };
        Self::new(&scene, &self.device)
    }

    fn leaves(&self) -> (Surfels, Gaussians) {
        let leaf = |i: usize| self.rows[i].leaf();
        let model: ColourModel = self.scene.model;
        let colour = |base: usize| Colour { model, base: leaf(base), detail: leaf(base + 1) };
        (
            Surfels {
                positions: leaf(0),
                quaternions: leaf(1),
                log_scales: leaf(2),
                colour: colour(3),
                margins: self.margins.clone().autodiff(),
            },
            Gaussians {
                positions: leaf(5),
                quaternions: leaf(6),
                log_scales: leaf(7),
                opacities: self.opacities.leaf(),
                colour: colour(8),
            },
        )
    }

    /// The loss of a view, on the tape.
    pub fn loss(&self, variant: Variant) -> Tensor<1> {
        self.loss_of(&self.leaves(), variant)
    }

    fn loss_of(&self, (surfels, gaussians): &(Surfels, Gaussians), variant: Variant) -> Tensor<1> {
        let view = if variant.own_composite {
            let options = RenderOptions::default();
            render_values(surfels, gaussians, &self.scene.camera, &options, Values::KnownFinite).expect("valid")
        } else {
            self.render_plainly(surfels, gaussians)
        };
        let target = self.target.clone().autodiff();
        losses(&view, surfels.log_scales.clone(), target, &LossWeights::default()).expect("valid").total
    }

    /// `dpges_core::render::render` with [`plain::composite`].
    fn render_plainly(&self, surfels: &Surfels, gaussians: &Gaussians) -> Render {
        let (camera, options) = (&self.scene.camera, RenderOptions::default());
        validate(surfels, gaussians, Values::KnownFinite).expect("valid");
        let centre = camera.centre().to_array();
        let surfel_colours = colour(&surfels.colour, &surfels.positions, centre).expect("valid");
        let gaussian_colours = colour(&gaussians.colour, &gaussians.positions, centre).expect("valid");
        let (positions, quaternions) = (&surfels.positions, &surfels.quaternions);
        let layers = peel(positions, quaternions, &surfels.log_scales, camera, &options.peel).expect("valid");
        let limits = interval_limits(&layers, &surfels.margins, options.margin_lookup).expect("valid");
        let sums = splat(gaussians, &gaussian_colours, &limits, camera, &options.splat).expect("valid");
        let blending = CompositeOptions { background: options.background, detach_transmittance: false };
        let composite = plain::composite(&layers, surfel_colours.clone(), sums, &blending);
        Render { composite, layers, limits, surfel_colours, gaussian_colours }
    }

    /// One step; returns the loss before it.
    pub fn step(&mut self, variant: Variant) -> f64 {
        let leaves = self.leaves();
        let loss = self.loss_of(&leaves, variant);
        let mut gradients = loss.backward();
        let value = loss.into_data().iter::<f64>().next().unwrap_or(f64::NAN);
        let (s, g) = &leaves;
        let rows = [
            &s.positions,
            &s.quaternions,
            &s.log_scales,
            &s.colour.base,
            &s.colour.detail,
            &g.positions,
            &g.quaternions,
            &g.log_scales,
            &g.colour.base,
            &g.colour.detail,
        ];
        let grads = rows.map(|tensor| tensor.grad_remove(&mut gradients).expect("every parameter is reached"));
        let opacities = g.opacities.grad_remove(&mut gradients).expect("every parameter is reached");
        // nothing may share the parameters when they are stepped in place
        drop((leaves, gradients));
        self.time += 1;
        let step = adam_settings(self.time);
        self.rows.iter_mut().zip(grads).for_each(|(row, grad)| row.step(grad, step, variant.own_adam));
        self.opacities.step(opacities, step, variant.own_adam);
        self.device.sync().expect("the device runs");
        value
    }
}

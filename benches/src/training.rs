//! A training step: render, losses, backward, Adam for every parameter.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::losses::{LossWeights, losses};
use dpges_core::ops::adam::{AdamStep, adam_step};
use dpges_core::ops::colour::colour;
use dpges_core::ops::composite::CompositeOptions;
use dpges_core::ops::interval_limits::interval_limits;
use dpges_core::ops::peel::peel;
use dpges_core::ops::splat::splat;
use dpges_core::render::{Render, RenderOptions, Values, render, render_probed, validate};
use dpges_core::scene::schema::{Columns, GaussianColumns, SurfelColumns};
use dpges_core::scene::{Gaussians, Surfels};
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
pub struct Parameter {
    /// [rows, width] value, first and second moment; `None` only while they are stepped.
    state: Option<(Tensor<2>, [Tensor<2>; 2])>,
}

impl Parameter {
    pub fn new(value: &Tensor<2>) -> Self {
        let zero = value.zeros_like();
        Self { state: Some((value.clone(), [zero.clone() + 0.0, zero + 0.0])) }
    }

    fn leaf(&self) -> Tensor<2> {
        self.state.as_ref().expect("nothing is being stepped").0.clone().autodiff().require_grad()
    }

    pub fn step(&mut self, grad: Tensor<2>, step: AdamStep, own: bool) {
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
    surfels: SurfelColumns<Parameter>,
    gaussians: GaussianColumns<Parameter>,
    target: Tensor<3>,
    device: Device,
    time: u64,
}

impl Training {
    /// Trains `scene` towards a darker picture of itself.
    pub fn new(scene: &TestScene, device: &Device) -> Self {
        let (s, g) = scene.tensors(device, DType::F32);
        let options = RenderOptions::default();
        let view = render(&s, &g, &scene.camera, &options).expect("benchmark scenes are valid");
        let target = view.composite.image.clamp(0.0, 1.0) * 0.9;
        Self {
            surfels: s.map_ref(|_, tensor| Parameter::new(tensor)),
            gaussians: g.map_ref(|_, tensor| Parameter::new(tensor)),
            target,
            device: device.clone(),
            scene: scene.clone(),
            time: 0,
        }
    }

    fn leaves(&self) -> (Surfels, Gaussians) {
        (self.surfels.map_ref(|_, parameter| parameter.leaf()), self.gaussians.map_ref(|_, parameter| parameter.leaf()))
    }

    /// The loss of a view, on the tape.
    fn loss(&self, (surfels, gaussians): &(Surfels, Gaussians), variant: Variant) -> Tensor<1> {
        let view = if variant.own_composite {
            let options = RenderOptions::default();
            render_probed(surfels, gaussians, &self.scene.camera, None, &options, Values::KnownFinite).expect("valid")
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
        let sums = splat(gaussians, &gaussian_colours, &limits, camera).expect("valid");
        let blending = CompositeOptions { background: options.background, detach_transmittance: false };
        let composite = plain::composite(&layers, surfel_colours.clone(), sums, &blending);
        Render { composite, layers, limits, surfel_colours, gaussian_colours }
    }

    /// One step; returns the loss before it.
    pub fn step(&mut self, variant: Variant) -> f64 {
        let leaves = self.leaves();
        let loss = self.loss(&leaves, variant);
        let mut gradients = loss.backward();
        let value = loss.into_data().iter::<f64>().next().unwrap_or(f64::NAN);
        let leaf_values = leaves.0.iter().chain(leaves.1.iter()).filter(|(attribute, _)| attribute.learns());
        let reached =
            |(_, leaf): (_, &Tensor<2>)| leaf.grad_remove(&mut gradients).expect("every parameter is reached");
        let grads: Vec<Tensor<2>> = leaf_values.map(reached).collect();
        // Nothing may share the parameters when they are stepped in place.
        drop((leaves, gradients));
        self.time += 1;
        let step = adam_settings(self.time);
        let attributes = SurfelColumns::<()>::ATTRIBUTES.iter().chain(GaussianColumns::<()>::ATTRIBUTES);
        let parameters = attributes.zip(self.surfels.list_mut().into_iter().chain(self.gaussians.list_mut()));
        let learning = parameters.filter(|(attribute, _)| attribute.learns());
        learning.zip(grads).for_each(|((_, parameter), grad)| parameter.step(grad, step, variant.own_adam));
        self.device.sync().expect("the device runs");
        value
    }
}

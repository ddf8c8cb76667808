//! Training of blended Gaussians: discs (2DGS), or ellipsoids that are relocated (3DGS-MCMC, DBS).

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::camera::Camera;
use dpges_core::losses;
use dpges_core::losses::geometry::{expected_depth, normal_consistency, normals_from_depth};
use dpges_core::ops::blend::Maps;
use dpges_core::render::Values;
use dpges_core::render::blended::{BlendedOptions, BlendedRender, render_blended};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Gaussians, Rendering, SceneData, SceneInfo, SurfelData};

use super::context::Context;
use super::pending::{Gate, PendingStep};
use super::{StepReport, TrainError};
use crate::config::stages::SHORTEST_RESET;
use crate::config::{Config, Opacity, Relocation, StageKind, StagePlan};
use crate::optimizer::AttributeRows;
use crate::refine::densify::{DensifyRule, GradientSums, densify, reset_opacities};
use crate::refine::noise::{Noise, jitter};
use crate::refine::relocate::{grown, relocate_and_add};
use crate::scene_state::{GaussianState, Rates};

/// Steps between relocations at least: fewer would say nothing new about who is dead, and cost more than the steps.
const SHORTEST_RELOCATION: usize = 5;
/// Jitter of DBS over that of 3DGS-MCMC, where both relocate.
const BETA_NOISE: f64 = 0.1;

/// A stage of blended Gaussians. Their opacities are trained as logits.
pub struct BlendedStage {
    pub plan: StagePlan,
    pub info: SceneInfo,
    pub gaussians: GaussianState,
    pub sums: ScreenGradients,
    schedule: BlendedSchedule,
}

/// Completed steps of a stage at which something changes, ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct BlendedSchedule {
    densify: Vec<usize>,
    reset: Vec<usize>,
    relocate: Vec<usize>,
}

impl BlendedSchedule {
    /// Of a stage over `views` training views. As with pruning, densification waits until all were seen.
    fn new(config: &Config, plan: StagePlan, views: usize) -> Self {
        let scaled = |steps: Vec<usize>| -> Vec<usize> {
            let mut steps: Vec<usize> = steps.into_iter().map(|step| plan.scaled(step)).collect();
            steps.retain(|&step| step > 0 && step < plan.steps);
            steps.dedup();
            steps
        };
        let every = |every: usize, from: usize, until: usize| (from..until).step_by(every.max(1)).collect::<Vec<_>>();
        match plan.kind {
            StageKind::Discs => {
                let discs = &config.discs;
                let views = views.max(1);
                let until = plan.scaled(discs.densify_until).min(plan.steps);
                let steps = every(discs.densify_every, discs.densify_from + discs.densify_every, discs.densify_until);
                let mut densify: Vec<usize> =
                    scaled(steps).into_iter().map(|step| step.div_ceil(views) * views).collect();
                densify.retain(|&step| step < until);
                densify.dedup();
                let resets = plan.scaled(discs.reset_every) >= SHORTEST_RESET;
                let reset = if resets {
                    scaled(every(discs.reset_every, discs.reset_every, discs.densify_until))
                } else {
                    Vec::new()
                };
                Self { densify, reset, relocate: Vec::new() }
            }
            StageKind::Gaussians(_) => {
                let relocation = &config.relocation;
                let steps = every(relocation.every, relocation.from + relocation.every, relocation.until);
                let mut relocate = scaled(steps);
                let mut last = 0;
                relocate.retain(|&step| {
                    let stays = step - last >= SHORTEST_RELOCATION;
                    last = if stays { step } else { last };
                    stays
                });
                Self { relocate, ..Self::default() }
            }
            StageKind::Joint => Self::default(),
        }
    }
}

/// How much the pictures wanted each Gaussian to move on the screen, summed over views; kept on the device. NDC units.
pub struct ScreenGradients {
    /// [M] norms
    signed: Tensor<1>,
    /// [M] norms of the sums of absolute values over pixels
    absolute: Tensor<1>,
    /// [M] views in which the Gaussian took part
    views: Tensor<1>,
}

impl ScreenGradients {
    /// Names of its columns in a checkpoint.
    pub const NAMES: [&'static str; 3] =
        ["screen_gradients.signed", "screen_gradients.absolute", "screen_gradients.views"];

    pub fn new(count: usize, device: &Device) -> Self {
        Self::from_columns([&vec![0.0; count], &vec![0.0; count], &vec![0.0; count]], device)
    }

    /// In the order of [`NAMES`](Self::NAMES).
    pub fn from_columns(columns: [&Vec<f32>; 3], device: &Device) -> Self {
        let [signed, absolute, views] = columns
            .map(|column| Tensor::from_data(TensorData::new(column.clone(), [column.len()]), (device, DType::F32)));
        Self { signed, absolute, views }
    }

    pub fn columns(&self) -> [Vec<f32>; 3] {
        [&self.signed, &self.absolute, &self.views].map(tensor_to_rows)
    }

    /// Adds the gradient [M, 4] of the probe of one view.
    fn add(&mut self, probe: Tensor<2>) {
        let [count, _] = probe.dims();
        let squares = probe.clone() * probe.clone();
        let norm = |from: usize| squares.clone().slice([0..count, from..from + 2]).sum_dim(1).sqrt().reshape([count]);
        let (signed, absolute) = (norm(0), norm(2));
        self.views = self.views.clone() + absolute.clone().greater_elem(0.0).float();
        self.signed = self.signed.clone() + signed;
        self.absolute = self.absolute.clone() + absolute;
    }

    fn sums(&self) -> GradientSums {
        let [signed, absolute, views] = self.columns();
        GradientSums { signed, absolute, views: views.into_iter().map(|views| views as u32).collect() }
    }
}

impl BlendedStage {
    /// A stage that begins with `gaussians`.
    pub fn new(context: &Context, plan: StagePlan, gaussians: &GaussianData) -> Self {
        let device = &context.device;
        let state = GaussianState::new(gaussians, context.config.model.colour, Opacity::Sigmoid, device);
        Self::resume(context, plan, state, ScreenGradients::new(gaussians.len(), device))
    }

    /// A stage that goes on.
    pub fn resume(context: &Context, plan: StagePlan, gaussians: GaussianState, sums: ScreenGradients) -> Self {
        let rendering = if plan.kind == StageKind::Discs { Rendering::Discs } else { Rendering::Ellipsoids };
        Self {
            plan,
            info: context.scene_info(rendering),
            schedule: BlendedSchedule::new(&context.config, plan, context.dataset.train.len()),
            gaussians,
            sums,
        }
    }

    /// Rows of a checkpoint as the state of such a stage.
    pub fn state(context: &Context, rows: [AttributeRows; 6]) -> GaussianState {
        GaussianState::from_rows(rows, context.config.model.colour, Opacity::Sigmoid, &context.device)
    }

    pub fn gaussians(&self) -> GaussianData {
        self.gaussians.to_data()
    }

    pub fn scene(&self) -> SceneData {
        SceneData { info: self.info.clone(), surfels: SurfelData::default(), gaussians: self.gaussians() }
    }

    /// Whether anything changes after `completed` steps of this stage.
    pub fn is_due(&self, completed: usize) -> bool {
        let BlendedSchedule { densify, reset, relocate } = &self.schedule;
        [densify, reset, relocate].into_iter().any(|steps| steps.binary_search(&completed).is_ok())
    }

    /// Does what is due after the completed steps; says what it did.
    pub fn refine(&mut self, context: &mut Context) -> Vec<String> {
        let completed = context.completed_steps - self.plan.begin;
        let due = |steps: &[usize]| steps.binary_search(&completed).is_ok();
        let (is_densify, is_reset, is_relocate) =
            (due(&self.schedule.densify), due(&self.schedule.reset), due(&self.schedule.relocate));
        let mut events = Vec::new();
        if is_densify {
            events.push(self.densify(context, completed));
        }
        if is_reset {
            let discs = &context.config.discs;
            let opacities = reset_opacities(&self.gaussians.to_data().opacities, discs.reset_opacity as f32);
            self.gaussians.reset_opacities(&opacities);
            events.push(format!("opacities reset to at most {}", discs.reset_opacity));
        }
        if let (true, StageKind::Gaussians(kind)) = (is_relocate, self.plan.kind) {
            self.relocate(context, kind);
            if kind == Relocation::Beta {
                self.jitter(context, Noise::Beta, completed);
            }
        }
        events
    }

    fn densify(&mut self, context: &mut Context, completed: usize) -> String {
        let discs = &context.config.discs;
        let rule = DensifyRule {
            gradient_threshold: discs.gradient_threshold,
            by_quantile: discs.by_quantile,
            dense_fraction: discs.dense_fraction,
            min_opacity: discs.min_opacity,
            max_scale_fraction: (completed >= self.plan.scaled(discs.max_scale_from)).then_some(discs.max_scale),
            flat: true,
        };
        let before = self.gaussians.len();
        let room = context.most_primitives(self.plan.budget_share).saturating_sub(before);
        let edit = densify(
            &self.gaussians.to_data(),
            self.info.colour_model,
            &self.sums.sums(),
            self.info.extent,
            &rule,
            room,
            &mut context.rng,
        );
        self.gaussians.edit(&edit);
        self.sums = ScreenGradients::new(self.gaussians.len(), &context.device);
        let (removed, added) = (edit.rows.removed_from(before), edit.added.len());
        format!("{added} of {before} discs added by densification, {removed} removed")
    }

    /// It happens every few steps: nothing is said of it but to those who ask for details.
    fn relocate(&mut self, context: &mut Context, kind: Relocation) {
        let relocation = &context.config.relocation;
        let cap = context.most_primitives(self.plan.budget_share);
        let gaussians = self.gaussians.to_data();
        let target = grown(gaussians.len(), relocation.growth, cap);
        let min_opacity = relocation.min_opacity;
        let Some(relocated) = relocate_and_add(&gaussians, target, min_opacity, kind, &mut context.rng) else { return };
        self.gaussians.relocate(&relocated);
        self.sums = ScreenGradients::new(self.gaussians.len(), &context.device);
        tracing::debug!("{} Gaussians relocated, {} added", relocated.relocated, relocated.added);
    }

    /// Moves Gaussians at random, faint ones most.
    fn jitter(&mut self, context: &mut Context, kind: Noise, completed: usize) {
        let relocation = &context.config.relocation;
        let factor = if kind == Noise::Beta { BETA_NOISE } else { 1.0 };
        let amount = relocation.noise * factor * self.position_rate(&context.config, completed);
        if amount > 0.0 {
            let positions = jitter(&self.gaussians.to_data(), kind, amount, &mut context.rng);
            self.gaussians.set_positions(&positions);
        }
    }

    /// Hands everything of one step to the device.
    pub fn begin_step(&mut self, context: &mut Context, mut report: StepReport) -> Result<PendingStep, TrainError> {
        let completed = context.completed_steps - self.plan.begin;
        report.gaussians = self.gaussians.len();
        let dataset = context.dataset.clone();
        let view = &dataset.train[report.view];
        let at = |source| TrainError::Step { step: report.step, view: view.name.clone(), source };
        let tape = context.device.clone().autodiff();

        let (gaussians, opacities) = self.gaussians.leaves();
        let probe = self.probe(completed, &tape);
        let target = view.target(&tape);
        let known = if completed == 0 { Values::Unknown } else { Values::KnownFinite };
        let weights = self.weights(&context.config, completed);
        let mut options = BlendedOptions::new(&self.info)?;
        options.blend.maps = weights.normal > 0.0 || weights.distortion > 0.0;
        let rendered = render_blended(&gaussians, probe.clone(), &view.camera, &options, known).map_err(at)?;
        let rgb = losses::rgb(rendered.image.clone(), target.clone(), context.config.train.lambda_dssim).map_err(at)?;
        let total = weights.add(rgb.clone(), &gaussians, &rendered, &view.camera);

        let mut gradients = total.backward();
        let found = self.gaussians.gradients((&gaussians, &opacities), &mut gradients);
        if let Some(moved) = probe.and_then(|probe| probe.grad_remove(&mut gradients)) {
            self.sums.add(moved);
        }
        let gate = Gate::new(&total, GaussianState::NAMES.into_iter().zip(&found));
        let none = Tensor::zeros([1], (&tape, DType::F32));
        let numbers = [total, rgb, none.clone(), none.clone(), none];
        let pending = PendingStep::new(report, view.name.clone(), numbers, rendered.image.clone(), target, &gate);
        // the tape shares the parameters: without it the optimiser can work in place
        drop((gaussians, opacities, rendered));

        let rates = self.rates(&context.config, completed);
        self.gaussians.step(found, &gate.open, &rates, context.config.optimizer.adam(completed))?;
        if self.plan.kind == StageKind::Gaussians(Relocation::Mcmc) {
            self.jitter(context, Noise::Mcmc, completed);
        }
        Ok(pending)
    }

    /// [M, 4] leaf whose gradient densification wants, if there is one to come.
    fn probe(&self, completed: usize, tape: &Device) -> Option<Tensor<2>> {
        let wanted = self.schedule.densify.last().is_some_and(|&last| completed < last);
        wanted.then(|| Tensor::zeros([self.gaussians.len(), 4], (tape, DType::F32)).require_grad())
    }

    fn weights(&self, config: &Config, completed: usize) -> Weights {
        let (discs, relocation) = (&config.discs, &config.relocation);
        let from = |step: usize, weight: f64| if completed >= self.plan.scaled(step) { weight } else { 0.0 };
        match self.plan.kind {
            StageKind::Discs => Weights {
                normal: from(discs.normal_from, discs.lambda_normal),
                distortion: from(discs.distortion_from, discs.lambda_distortion),
                ..Weights::default()
            },
            StageKind::Gaussians(kind) => {
                // DBS: as long as Gaussians are relocated
                let on = kind == Relocation::Mcmc
                    || (self.plan.scaled(relocation.from)..self.plan.scaled(relocation.until)).contains(&completed);
                let weight = |weight: f64| if on { weight } else { 0.0 };
                let (opacity, scale) = (weight(relocation.lambda_opacity), weight(relocation.lambda_scale));
                Weights { opacity, scale, ..Weights::default() }
            }
            StageKind::Joint => Weights::default(),
        }
    }

    /// World units.
    fn position_rate(&self, config: &Config, completed: usize) -> f64 {
        let progress = completed as f64 / self.plan.steps as f64;
        let alone = config.plan().len() == 1;
        let progress = if alone { progress } else { config.stages.position_share * progress };
        config.optimizer.position_rate(progress, self.info.extent)
    }

    fn rates(&self, config: &Config, completed: usize) -> Rates {
        let (optimizer, positions) = (&config.optimizer, self.position_rate(config, completed));
        Rates {
            surfel_positions: positions,
            gaussian_positions: positions,
            quaternions: optimizer.quaternions,
            log_scales: optimizer.log_scales,
            opacities: config.stages.opacities,
            base: optimizer.base,
            detail: optimizer.detail,
        }
    }
}

/// Weights of what is added to L_rgb.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Weights {
    opacity: f64,
    scale: f64,
    normal: f64,
    distortion: f64,
}

impl Weights {
    fn add(&self, rgb: Tensor<1>, gaussians: &Gaussians, rendered: &BlendedRender, camera: &Camera) -> Tensor<1> {
        let mut total = rgb;
        if self.opacity > 0.0 {
            total = total + gaussians.opacities.clone().mean() * self.opacity;
        }
        if self.scale > 0.0 {
            total = total + gaussians.log_scales.clone().exp().mean() * self.scale;
        }
        let Some(Maps { depth, normal, distortion, .. }) = rendered.blend.maps.clone() else { return total };
        if self.normal > 0.0 {
            let alpha = rendered.blend.alpha.clone();
            let depth_normal = normals_from_depth(expected_depth(depth, alpha.clone()), camera);
            total = total + normal_consistency(normal, depth_normal, alpha) * self.normal;
        }
        if self.distortion > 0.0 {
            total = total + distortion.mean() * self.distortion;
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Method;

    fn schedule(method: Method, steps: usize, views: usize) -> BlendedSchedule {
        let mut config = Config::default();
        (config.train.method, config.train.steps) = (method, steps);
        BlendedSchedule::new(&config, config.plan()[0], views)
    }

    #[test]
    fn methods_of_their_own_length_have_the_schedules_of_their_papers() {
        let discs = schedule(Method::Discs, 30_000, 100);
        assert_eq!((discs.densify[0], discs.densify.last(), discs.densify.len()), (600, Some(&14_900), 144));
        assert_eq!(discs.reset, [3000, 6000, 9000, 12_000]);
        let dbs = schedule(Method::Dbs, 30_000, 100);
        assert_eq!((dbs.relocate[0], dbs.relocate.last(), dbs.relocate.len()), (600, Some(&24_900), 244));
        assert!(dbs.densify.is_empty() && discs.relocate.is_empty());
    }

    #[test]
    fn short_runs_wait_for_every_view_and_reset_nothing() {
        let discs = schedule(Method::Discs, 3000, 40);
        assert!(discs.densify.iter().all(|step| step % 40 == 0) && discs.densify.len() > 20);
        assert!(discs.reset.is_empty());
        let mcmc = schedule(Method::Mcmc, 300, 40);
        assert!(mcmc.relocate.windows(2).all(|pair| pair[0] + 5 <= pair[1]) && mcmc.relocate.len() > 40);
        assert!(mcmc.relocate.iter().all(|&step| step < 250));
    }

    #[test]
    fn screen_gradients_are_summed_by_norm_and_counted_where_there_are_any() {
        let device = Device::flex();
        let mut sums = ScreenGradients::new(2, &device);
        let probe = |rows: [f32; 8]| Tensor::from_data(TensorData::new(rows.to_vec(), [2, 4]), (&device, DType::F32));
        sums.add(probe([3.0, -4.0, 6.0, 8.0, 0.0, 0.0, 0.0, 0.0]));
        sums.add(probe([0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 1.0, 0.0]));
        let GradientSums { signed, absolute, views } = sums.sums();
        assert_eq!((signed, absolute, views), (vec![6.0, 0.0], vec![12.0, 1.0], vec![2, 1]));
    }
}

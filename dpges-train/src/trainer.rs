//! A training run: the stages of its plan one after another, one view per step.

mod blended;
mod context;
mod joint;
mod pending;
mod refinement;
mod requirement;
mod resume;
mod start;
mod statistics;
mod supervision;
mod validation;

use std::path::PathBuf;
use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::device::is_gpu;
use dpges_core::scene::{GaussianData, SceneData};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::config::{Config, StageKind, StagePlan};
use crate::dataset::Dataset;
use crate::init::InitError;
use blended::BlendedStage;
use context::Context;
use joint::JointStage;
use pending::PendingStep;
pub use validation::{Validation, Verdict};

#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error("initialisation: {0}")]
    Init(#[from] InitError),
    #[error("`{key}`: {path} does not serve: {reason}")]
    Given { key: &'static str, path: PathBuf, reason: String },
    #[error("{0}")]
    Plan(String),
    #[error("step {step}, view `{view}`: {source}; the step was not taken")]
    Step { step: usize, view: String, source: dpges_core::Error },
    #[error("step {step}, view `{view}`: the loss is {loss}; the step was not taken")]
    Loss { step: usize, view: String, loss: f64 },
    #[error("step {step}: the device failed: {reason}")]
    Device { step: usize, reason: String },
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
    #[error("the checkpoint does not fit: {reason}")]
    Resume { reason: String },
}

/// What one step did.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Completed steps of the run, this one included.
    pub step: usize,
    pub stage: StageKind,
    /// Index of the training view.
    pub view: usize,
    /// Weighted sum of the terms.
    pub loss: f64,
    pub rgb: f64,
    /// L_s; 0 in stages without surfels, as the next two.
    pub surfel: f64,
    pub scale: f64,
    pub transmittance: f64,
    /// dB of the training view before the step, clamped and not quantised.
    pub psnr: f64,
    pub surfels: usize,
    pub gaussians: usize,
    /// What refinement did before the step.
    pub events: Vec<String>,
}

impl StepReport {
    /// Before the numbers are known.
    fn begin(step: usize, stage: StageKind, view: usize, events: Vec<String>) -> Self {
        let unknown = f64::NAN;
        Self {
            step,
            stage,
            view,
            loss: unknown,
            rgb: unknown,
            surfel: unknown,
            scale: unknown,
            transmittance: unknown,
            psnr: unknown,
            surfels: 0,
            gaussians: 0,
            events,
        }
    }
}

/// What is trained now.
enum Stage {
    Blended(Box<BlendedStage>),
    Joint(Box<JointStage>),
}

/// A run: a dataset, a scene that learns it, and where in its plan it stands.
pub struct Trainer {
    context: Context,
    plan: Vec<StagePlan>,
    /// Index in the plan.
    at: usize,
    stage: Stage,
    /// The trained discs, from their stage until nothing needs them any more.
    discs: Option<GaussianData>,
    validation: Validation,
    /// A GPU works on this step while the host prepares the next.
    pending: Option<PendingStep>,
}

impl Trainer {
    /// A run before its first step.
    ///
    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to start from, [`TrainError::Given`] if a file that the
    /// configuration names cannot take the place of a stage.
    pub fn new(dataset: Arc<Dataset>, config: Config, device: Device) -> Result<Self, TrainError> {
        let plan = config.plan();
        let rng = ChaCha8Rng::seed_from_u64(config.train.seed);
        let mut context = Context { dataset, config, device, rng, remaining_views: Vec::new(), completed_steps: 0 };
        context.check_given(&plan)?;
        let stage = context.begin_stage(plan[0], None, None)?;
        let validation = Validation::default();
        Ok(Self { context, plan, at: 0, stage, discs: None, validation, pending: None })
    }

    pub fn config(&self) -> &Config {
        &self.context.config
    }

    pub fn completed_steps(&self) -> usize {
        self.context.completed_steps
    }

    /// The stage of the next step, or of the last.
    pub fn stage(&self) -> StagePlan {
        self.plan[self.at]
    }

    /// Whether all steps of all stages are done, or the validation views said that it is enough.
    pub fn is_finished(&self) -> bool {
        self.validation.stopped() || (self.at + 1 == self.plan.len() && self.stage_is_over())
    }

    /// Whether all steps of this stage are done.
    pub fn stage_is_over(&self) -> bool {
        self.context.completed_steps >= self.stage().end()
    }

    /// The scene as it stands.
    pub fn scene(&self) -> SceneData {
        match &self.stage {
            Stage::Blended(stage) => stage.scene(),
            Stage::Joint(stage) => stage.scene(),
        }
    }

    /// How validation views have fared, to be told of every evaluation of theirs.
    pub fn validation_mut(&mut self) -> &mut Validation {
        &mut self.validation
    }

    /// Begins the stage after one that is over and settled.
    ///
    /// # Errors
    /// Those of [`new`](Self::new); [`TrainError::Plan`] if nothing came out of the stage that the next can use.
    pub fn next_stage(&mut self) -> Result<(), TrainError> {
        let trained = match &self.stage {
            Stage::Blended(stage) => stage.gaussians(),
            Stage::Joint(_) => unreachable!("the joint stage is the last"),
        };
        let mut gaussians = None;
        match self.stage().kind {
            StageKind::Discs => self.discs = Some(trained),
            StageKind::Gaussians(_) | StageKind::Joint => gaussians = Some(trained),
        }
        self.at += 1;
        self.stage = self.context.begin_stage(self.stage(), self.discs.as_ref(), gaussians)?;
        if self.stage().kind == StageKind::Joint {
            self.discs = None;
        }
        Ok(())
    }

    /// Whatever refinement is due, then one optimisation step on the next view; first of all the next stage, if this
    /// one is over.
    ///
    /// In this order, since a scene is at its worst right after Gaussians were added: between two steps,
    /// when it is evaluated and saved, it has been optimised since.
    ///
    /// Returns the report of this step on a CPU. A GPU is still working on this step: there it is the
    /// report of the step before, if [`settle`](Self::settle) has not given it away.
    ///
    /// # Errors
    /// [`TrainError::Step`] or [`TrainError::Loss`] if the loss or a gradient was not finite; that step
    /// then changed nothing. Those of [`next_stage`](Self::next_stage).
    pub fn step(&mut self) -> Result<Option<StepReport>, TrainError> {
        let mut known = None;
        if self.stage_is_over() {
            known = self.settle()?;
            self.next_stage()?;
        }
        let completed = self.context.completed_steps - self.stage().begin;
        let due = match &self.stage {
            Stage::Blended(stage) => stage.is_due(completed),
            Stage::Joint(stage) => stage.due(completed) != Default::default(),
        };
        let mut events = Vec::new();
        if due {
            known = self.settle()?.or(known);
            events = match &mut self.stage {
                Stage::Blended(stage) => stage.refine(&mut self.context)?,
                Stage::Joint(stage) => stage.refine(&mut self.context)?,
            };
        }
        let before = self.pending.take();
        let view = self.context.next_view();
        let report = StepReport::begin(self.context.completed_steps + 1, self.stage().kind, view, events);
        self.pending = Some(match &mut self.stage {
            Stage::Blended(stage) => stage.begin_step(&mut self.context, report)?,
            Stage::Joint(stage) => stage.begin_step(&mut self.context, report)?,
        });
        self.context.completed_steps += 1;
        if !is_gpu(&self.context.device) {
            return self.settle();
        }
        if let Some(before) = before {
            known = Some(before.settle()?);
        }
        Ok(known)
    }

    /// Waits for the step that the device is working on and returns its report, if there is one.
    ///
    /// # Errors
    /// Those of [`step`](Self::step).
    pub fn settle(&mut self) -> Result<Option<StepReport>, TrainError> {
        self.pending.take().map(PendingStep::settle).transpose()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use dpges_core::scene::Rendering;

    use super::*;
    use crate::checkpoint::Checkpoint;
    use crate::dataset::{BuiltinOptions, builtin};
    use crate::device::DeviceName;

    fn dataset() -> Arc<Dataset> {
        let options =
            BuiltinOptions { width: 24, height: 24, train_views: 3, test_views: 1, points: 200, ..Default::default() };
        Arc::new(builtin(&options))
    }

    fn config(set: &[&str]) -> Config {
        let set: Vec<String> = set.iter().map(|&text| text.to_owned()).collect();
        Config::resolve(None, None, &set).unwrap()
    }

    fn device() -> Device {
        "cpu".parse::<DeviceName>().unwrap().open().unwrap()
    }

    fn trainer(set: &[&str]) -> Trainer {
        Trainer::new(dataset(), config(set), device()).unwrap()
    }

    /// All stages and everything that changes something in them.
    const STAGES: [&str; 12] = [
        "train.steps=60",
        "refine.budget=700",
        "stages.surfels=0.3",
        "stages.gaussians=0.3",
        "stages.surfel_opacity=0.12",
        "train.lambda_depth=0.1",
        "train.lambda_normal=0.05",
        "train.lambda_depth_normal=0.05",
        "relocation.every=1000",
        "discs.densify_every=1000",
        "discs.gradient_threshold=1e-7",
        "relocation.min_opacity=0.3",
    ];

    fn finished(mut trainer: Trainer) -> Checkpoint {
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        trainer.checkpoint()
    }

    fn saved_and_loaded(checkpoint: &Checkpoint, folder: &Path) -> Checkpoint {
        let path = folder.join("checkpoint.safetensors");
        checkpoint.save(&path).unwrap();
        Checkpoint::load(&path).unwrap()
    }

    #[test]
    fn frozen_surfels_learn_nothing_but_colours() {
        let mut trainer = trainer(&["train.steps=9", "train.freeze_surfels=true"]);
        let before = trainer.scene();
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        let after = trainer.scene();
        assert!(!before.surfels.is_empty());
        assert_eq!(after.surfels.positions, before.surfels.positions);
        assert_eq!(after.surfels.quaternions, before.surfels.quaternions);
        assert_eq!(after.surfels.log_scales, before.surfels.log_scales);
        assert_ne!(after.surfels.colour, before.surfels.colour);
        assert_ne!(after.gaussians.positions, before.gaussians.positions);
    }

    fn joint(trainer: &mut Trainer) -> &mut JointStage {
        match &mut trainer.stage {
            Stage::Joint(stage) => stage,
            Stage::Blended(_) => panic!("not the joint stage"),
        }
    }

    #[test]
    fn gaussians_that_draw_nothing_are_in_no_scene_and_make_room_for_others() {
        for (set, replaced) in [("refine.replace_until=20000", true), ("refine.replace_until=0", false)] {
            // batches after 12, 16, …, 48 steps, replacements after 52, …, 76
            let mut trainer = trainer(&["train.steps=100", "refine.budget=300", "refine.split=false", set]);
            while trainer.completed_steps() < 52 {
                trainer.step().unwrap();
            }
            let mut opacities = joint(&mut trainer).gaussians.to_data().opacities;
            let (count, left) = (opacities.len(), opacities.iter().filter(|&&o| o > 0.1).count());
            assert!(left > 20 && left < count, "{left} of {count}");
            opacities.iter_mut().filter(|o| **o <= 0.1).for_each(|o| *o = -1.0);
            joint(&mut trainer).gaussians.reset_opacities(&opacities);
            assert_eq!(trainer.scene().gaussians.len(), left);

            let report = trainer.step().unwrap().unwrap();
            let said = format!("{} Gaussians that draw nothing removed", count - left);
            assert_eq!(report.events.iter().any(|event| event.contains(&said)), replaced, "{:?}", report.events);
            let alive = joint(&mut trainer).gaussians.to_data().opacities.iter().filter(|&&o| o > 0.0).count();
            assert_eq!(alive > left, replaced, "{alive}, {left} before");
        }
    }

    #[test]
    fn gaussians_are_added_where_no_surfel_is_if_that_is_wanted() {
        for (set, grows) in [("refine.add_everywhere=true", true), ("refine.add_everywhere=false", false)] {
            let few = ["train.steps=40", "init.method=random", "init.random_gaussians=100", "refine.budget=300"];
            let mut trainer = trainer(&[&few[..], &["refine.split=false", set]].concat());
            assert!(trainer.scene().surfels.is_empty());
            while !trainer.is_finished() {
                trainer.step().unwrap();
            }
            assert_eq!(joint(&mut trainer).gaussians.len() > 100, grows, "{set}");
        }
    }

    #[test]
    fn stages_hand_on_what_they_trained() {
        let mut trainer = trainer(&STAGES);
        let mut seen = Vec::new();
        let mut events = Vec::new();
        while !trainer.is_finished() {
            let report = trainer.step().unwrap().unwrap();
            assert!(report.loss.is_finite() && report.psnr > 0.0, "{report:?}");
            events.extend(report.events);
            if trainer.stage_is_over() {
                seen.push((report.stage, trainer.completed_steps(), trainer.scene()));
            }
        }
        let order: Vec<(String, usize)> = seen.iter().map(|(stage, step, _)| (stage.to_string(), *step)).collect();
        assert_eq!(order, [("2dgs".to_owned(), 18), ("dbs".to_owned(), 36), ("joint".to_owned(), 60)]);
        let [(_, _, discs), (_, _, gaussians), (_, _, joint)] = &seen[..] else { unreachable!() };
        assert_eq!((discs.info.rendering, gaussians.info.rendering), (Rendering::Discs, Rendering::Ellipsoids));
        assert_eq!(joint.info.rendering, Rendering::Peeled);
        let opaque = discs.gaussians.opacities.iter().filter(|&&opacity| opacity > 0.12).count();
        assert!(opaque > 10 && joint.surfels.len() <= opaque, "{opaque}, {}", joint.surfels.len());
        assert!(discs.gaussians.len() <= 210 && gaussians.gaussians.len() <= 420);
        assert!(events.iter().any(|event| event.contains("discs added by densification")), "{events:?}");
    }

    #[test]
    fn a_run_goes_on_from_any_step_of_any_stage_to_the_same_end() {
        let folder = tempfile::tempdir().unwrap();
        let runs: [(&[&str], &[usize]); 4] = [
            (&STAGES, &[7, 18, 19, 30, 36, 50]),
            (&["train.steps=40", "train.method=mcmc", "refine.budget=300"], &[1, 25]),
            (&["train.steps=40", "train.method=dbs", "refine.budget=300"], &[25]),
            (&["train.steps=40", "train.method=2dgs", "refine.budget=300", "model.colour=sh1"], &[25]),
        ];
        for (set, stops) in runs {
            let whole = finished(trainer(set));
            for &stop in stops {
                let mut first = trainer(set);
                while first.completed_steps() < stop {
                    first.step().unwrap();
                }
                let checkpoint = saved_and_loaded(&first.checkpoint(), folder.path());
                let second = Trainer::resume(dataset(), checkpoint, device()).unwrap();
                assert!(finished(second) == whole, "{set:?} stopped after {stop}");
            }
        }
    }

    #[test]
    fn methods_alone_learn() {
        for method in ["2dgs", "mcmc", "dbs"] {
            let method = format!("train.method={method}");
            let mut trainer = trainer(&["train.steps=60", &method, "refine.budget=500"]);
            let mut loss = Vec::new();
            while !trainer.is_finished() {
                loss.push(trainer.step().unwrap().unwrap().rgb);
            }
            let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
            let (early, late) = (mean(&loss[..6]), mean(&loss[54..]));
            assert!(late < 0.8 * early, "{method}: {early} at first, {late} at last");
        }
    }

    #[test]
    fn plans_that_lack_something_are_refused_before_the_first_step() {
        let error = |set: &[&str]| match Trainer::new(dataset(), config(set), device()) {
            Err(error) => error.to_string(),
            Ok(_) => panic!("not refused"),
        };
        assert!(error(&["train.lambda_normal=0.05"]).contains("stages.surfels above 0"));
        assert!(error(&["stages.gaussians_by=rest"]).contains("needs discs"));
        assert!(error(&["refine.budget=auto"]).contains("validation views"));
        let absent = error(&["stages.surfels_from=absent.safetensors"]);
        assert!(absent.contains("stages.surfels_from") && absent.contains("absent.safetensors"), "{absent}");
    }
}

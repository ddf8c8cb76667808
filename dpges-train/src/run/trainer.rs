//! The steps of a run, without evaluations and files: the stages of its plan one after another, one view per step.

#[cfg(test)]
mod tests;

use std::borrow::Cow;
use std::iter::zip;
use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::backend::device::is_gpu;
use dpges_core::ranks::Ranks;
use dpges_core::scene::SceneData;

use super::checkpoint::{Checkpoint, RunState};
use super::hash::Hash;
use super::validation::Validation;
use crate::config::{Config, StagePlan};
use crate::dataset::{Dataset, View};
use crate::device::place::Place;
use crate::init::chance::without_random_points;
use crate::optimizer::Parameter;
use crate::stage::{
    self, Context, Parameters, PendingStep, Settled, Stage, StageCheckpoint, StepReport, Surroundings, TrainError,
    Trained, begin_step,
};
use crate::views::corrections::ViewCorrections;
use crate::views::exposure::state as exposures;
use crate::views::pose::{PoseChanges, PoseState};

/// A scene that learns a dataset, and where in the plan of its stages it stands.
pub struct Trainer {
    context: Context,
    plan: Vec<StagePlan>,
    /// Index in the plan.
    at: usize,
    stage: Box<dyn Stage>,
    trained: Trained,
    /// Wants to be told of every evaluation of the validation views, and then ends the run with `train.stop = "validation"`.
    pub(super) validation: Validation,
    /// A GPU works on this step while the host prepares the next.
    pending: Option<PendingStep>,
}

impl Trainer {
    /// A run before its first step, on a device alone or on one of several ranks.
    ///
    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to begin with, [`TrainError::Pretrained`] if a file that the
    /// configuration names cannot take the place of a stage, [`TrainError::Plan`] if the plan lacks something else.
    pub fn new(config: Config, dataset: Arc<Dataset>, place: impl Into<Place>) -> Result<Self, TrainError> {
        let plan = config.plan(dataset.longest_side());
        let place = place.into();
        let dataset = without_random_points(dataset, &config)?;
        let surroundings = Surroundings::read(&config, &dataset, &place)?;
        let mut context = Context { surroundings, ..Context::new(config, dataset, place) };
        context.check_plan(&plan)?;
        context.metres_per_unit = context.given_scale()?;
        context.resize(&plan[0])?;
        context.exposure = context.start_of_exposure()?;
        context.poses = context.start_of_poses();
        context.depth = context.start_of_depth();
        let mut trained = Trained { environment: context.start_of_environment()?, ..Trained::default() };
        let stage = stage::begin(plan[0], &mut trained, &mut context)?;
        let validation = Validation::default();
        Ok(Self { context, plan, at: 0, stage, trained, validation, pending: None })
    }

    /// Whether there is all that the plan of a run needs, which [`new`](Self::new) asks first. It takes no time: a series of runs
    /// asks before it begins with any.
    pub fn check(config: &Config, dataset: &Arc<Dataset>, device: &Device) -> Result<(), TrainError> {
        Context::new(config.clone(), Arc::clone(dataset), device.clone().into())
            .check_plan(&config.plan(dataset.longest_side()))
    }

    /// Goes on where `checkpoint`, with the Gaussians of all ranks, was made, by any number of ranks.
    ///
    /// # Errors
    /// [`TrainError::Resume`] if the dataset is another one or the checkpoint contradicts itself.
    pub fn resume(checkpoint: Checkpoint, dataset: Arc<Dataset>, place: impl Into<Place>) -> Result<Self, TrainError> {
        let place = place.into();
        let Checkpoint { state, mut attributes, mut columns, max_pixels } = checkpoint;
        let plan = state.plan();
        let RunState { config, info, completed_steps, stage: at, validation, growth, .. } = state;
        let RunState { rng, remaining_views, view_names, cameras, .. } = state;
        if view_names != names_of_views(&dataset) {
            let (before, now) = (view_names.len(), dataset.train.len());
            let reason = format!("it was made with {before} training views, and these {now} are not the same ones");
            return Err(TrainError::resume(reason));
        }
        let of_other_cameras = zip(&dataset.train, &cameras).filter(|(view, camera)| camera_hash(view) != **camera);
        let mut changed = of_other_cameras.map(|(view, _)| &*view.name);
        if let Some(first) = changed.next() {
            let count = 1 + changed.count();
            let reason = format!(
                "the cameras of {count} of its training views, `{first}` first, are not those that the run began with: bring \
                 them back, or begin anew with --overwrite"
            );
            return Err(TrainError::resume(reason));
        }
        let Some(&current) = plan.get(at) else {
            return Err(TrainError::resume(format!("stage {at} of {} does not exist", plan.len())));
        };
        let exposure = exposures::from_rows(&mut attributes, dataset.train.len(), &place.device);
        let exposure = exposure.map_err(TrainError::resume)?;
        let poses = PoseState::from_rows(&mut attributes, &mut columns, &dataset).map_err(TrainError::resume)?;
        let dataset = without_random_points(dataset, &config)?;
        let surroundings = Surroundings::read(&config, &dataset, &place)?;
        let context = Context { metres_per_unit: info.metres_per_unit, ..Context::new(config, dataset, place) };
        let mut context = Context { rng, remaining_views, completed_steps, exposure, poses, surroundings, ..context };
        context.resize(&current)?;
        context.depth = context.start_of_depth();
        context.place_cameras();
        let of_stage = StageCheckpoint { info, growth, attributes, columns, max_pixels };
        let (stage, trained) = stage::resume(current, of_stage, &context)?;
        Ok(Self { context, plan, at, stage, trained, validation, pending: None })
    }

    /// All that [`resume`](Self::resume) needs to go on to the same result; of several ranks the part of this one, see
    /// [`Checkpoint::join`]. Settle before.
    pub fn checkpoint(&self) -> Checkpoint {
        let context = &self.context;
        let mut stage = self.stage.checkpoint();
        if let Some(discs) = &self.trained.discs {
            stage.add_discs(discs);
        }
        let StageCheckpoint { info, growth, mut attributes, mut columns, max_pixels } = stage;
        let of_views = context.exposure.as_ref().map(Parameter::named_rows).into_iter().chain(context.poses.rows());
        attributes.extend(of_views.map(|(name, rows)| (name.to_owned(), rows)));
        columns.extend(context.poses.columns().into_iter().map(|(name, values)| (name.to_owned(), values)));
        let state = RunState {
            config: context.config.clone(),
            info,
            completed_steps: context.completed_steps,
            stage: self.at,
            longest_side: self.context.longest_side(),
            validation: self.validation,
            growth,
            rng: context.rng.clone(),
            remaining_views: context.remaining_views.clone(),
            view_names: names_of_views(&context.dataset),
            cameras: context.whole.train.iter().map(camera_hash).collect(),
        };
        Checkpoint { state, attributes, columns, max_pixels }
    }

    pub fn config(&self) -> &Config {
        &self.context.config
    }

    /// With the cameras of the training views where they are by now, if their poses are refined.
    pub fn dataset(&self) -> &Arc<Dataset> {
        &self.context.dataset
    }

    pub fn device(&self) -> &Device {
        &self.context.device
    }

    pub fn ranks(&self) -> &Arc<dyn Ranks> {
        &self.context.ranks
    }

    /// Compares what all ranks have alike.
    ///
    /// # Errors
    /// [`TrainError::Diverged`] names the first rank that has something else.
    pub fn check_ranks(&mut self) -> Result<(), TrainError> {
        let ranks = &self.context.ranks;
        if ranks.is_alone() {
            return Ok(());
        }
        let is_sharded = !self.stage.ranks().is_alone();
        let Parameters { surfels, gaussians, environment, .. } = self.stage.parameters();
        let mut hash = Hash::default();
        surfels.rows().into_values().for_each(|rows| hash.add_numbers(&rows.raw));
        let of_all = [&*environment, &self.context.exposure].into_iter().flatten();
        of_all.for_each(|parameter| hash.add_numbers(&parameter.raw_rows()));
        if !is_sharded {
            gaussians.rows().into_values().for_each(|rows| hash.add_numbers(&rows.raw));
        }
        let hashes = ranks.gather_numbers(&[hash.value()]).concat();
        let alike = |of: u64| hashes.iter().filter(|&&other| other == of).count();
        // the first of equally many
        let most = hashes.iter().rev().copied().max_by_key(|&of| alike(of)).expect("there are ranks");
        match hashes.iter().position(|&of| of != most) {
            Some(rank) => Err(TrainError::Diverged { step: self.context.completed_steps, rank }),
            None => Ok(()),
        }
    }

    /// Steps of the whole run that are done, or that a GPU is still working on.
    pub fn completed_steps(&self) -> usize {
        self.context.completed_steps
    }

    /// The stage of the last step, or of the next one before the first.
    pub fn stage(&self) -> StagePlan {
        self.plan[self.at]
    }

    /// The stages of the run in their order.
    pub fn plan(&self) -> &[StagePlan] {
        &self.plan
    }

    /// Whether all steps of all stages are done, or the validation views have stopped to improve.
    pub fn is_finished(&self) -> bool {
        self.validation.stopped() || (self.is_in_last_stage() && self.stage_is_over())
    }

    /// Whether all steps of the current stage are done.
    pub fn stage_is_over(&self) -> bool {
        self.context.completed_steps >= self.stage().end()
    }

    pub fn is_in_last_stage(&self) -> bool {
        self.at + 1 == self.plan.len()
    }

    /// The stage before the last; `None` if there is only one.
    pub fn last_but_one(&self) -> Option<StagePlan> {
        Some(self.plan[self.plan.len().checked_sub(2)?])
    }

    /// Whether the run corrects the exposures of its training views.
    pub fn corrects_exposure(&self) -> bool {
        self.context.exposure.is_some()
    }

    /// The corrections of the training views so far.
    pub fn view_corrections(&self) -> ViewCorrections {
        let exposure = self.corrects_exposure().then(|| {
            let corrections = exposures::corrections(&self.context.exposure);
            names_of_views(&self.context.dataset).into_iter().zip(corrections).collect()
        });
        ViewCorrections { exposure, poses: self.context.refined_poses() }
    }

    /// How far the cameras of the training views have been moved; `None` if they are where they were recorded.
    pub fn pose_changes(&self) -> Option<PoseChanges> {
        self.context.pose_changes()
    }

    /// The scene as it stands. All ranks ask for it together.
    pub fn scene(&self) -> SceneData {
        self.stage.scene()
    }

    /// `scene`, of this run, as it is to be looked at: a block with what is around it.
    pub fn complete<'a>(&self, scene: &'a SceneData) -> Cow<'a, SceneData> {
        match &self.context.surroundings {
            Some(around) => Cow::Owned(around.complete(scene)),
            None => Cow::Borrowed(scene),
        }
    }

    /// Begins the stage after one that is over, settled and not the last.
    pub(super) fn next_stage(&mut self) -> Result<(), TrainError> {
        self.stage.finish(&mut self.trained);
        // the schedule of a stage counts passes from its start
        self.context.remaining_views.clear();
        let next = self.plan[self.at + 1];
        self.context.resize(&next)?;
        self.stage = stage::begin(next, &mut self.trained, &mut self.context)?;
        self.at += 1;
        Ok(())
    }

    /// Begins the next stage if this one is over, refines if that is due, then takes one optimisation step on the next
    /// view.
    ///
    /// Refinement comes first because a scene is at its worst right after Gaussians were added. Between two steps, when
    /// it is evaluated and saved, it has been optimised since.
    ///
    /// Returns the report of this step on a CPU. A GPU is still working on this step: there it is the report of the
    /// step before, unless [`settle`](Self::settle) has returned it already.
    ///
    /// # Errors
    /// [`TrainError::Step`] or [`TrainError::Loss`] if the loss or a gradient was not finite, [`TrainError::Device`] if the device
    /// failed; then only an earlier checkpoint can go on. Those of [`new`](Self::new) where a stage begins.
    pub fn step(&mut self) -> Result<Option<StepReport>, TrainError> {
        let mut known = None;
        self.context.refine_poses();
        if self.stage_is_over() {
            known = self.settle()?;
            self.next_stage()?;
        }
        let completed = self.context.completed_in(self.stage());
        let mut events = Vec::new();
        if self.stage.is_due(completed) {
            known = self.settle()?.or(known);
            events = self.stage.refine(completed, &mut self.context)?;
        }
        let views = self.context.next_views(&*self.stage);
        let after = (self.context.completed_steps + views.of_ranks.len()).min(self.stage().end());
        let report = StepReport::begin(after, self.stage(), views.own, events);
        let begun = begin_step(&mut *self.stage, &mut self.context, report, views);
        known = self.settle()?.or(known);
        let ranks = &self.context.ranks;
        let of_rank = |error| TrainError::OnRank { rank: ranks.rank(), source: Box::new(error) };
        let begun = begun.map_err(|error| if ranks.is_alone() { error } else { of_rank(error) })?;
        self.pending = Some(begun.learn(&mut *self.stage, &mut self.context)?);
        self.context.completed_steps = after;
        if is_gpu(&self.context.device) { Ok(known) } else { self.settle() }
    }

    /// Waits for the step that the device is working on. Returns its report, if there is one.
    ///
    /// # Errors
    /// [`TrainError::Step`] or [`TrainError::Loss`] if its loss or a gradient was not finite, [`TrainError::Device`] if the
    /// device failed.
    pub fn settle(&mut self) -> Result<Option<StepReport>, TrainError> {
        let Some(pending) = self.pending.take() else { return Ok(None) };
        let Settled { report, pose_gradients } = pending.settle()?;
        for (view, gradient) in pose_gradients {
            self.context.poses.keep(report.step, view, gradient);
        }
        Ok(Some(report))
    }
}

/// The hash of the camera that took a view, down to the last bit: text of numbers has all of them.
fn camera_hash(view: &View) -> u64 {
    Hash::of(format!("{:?}", view.camera).as_bytes())
}

fn names_of_views(dataset: &Dataset) -> Vec<String> {
    dataset.train.iter().map(|view| view.name.clone()).collect()
}

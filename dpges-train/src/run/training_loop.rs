//! Training to the end: steps, and between them evaluations, checkpoints and the ends of stages.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use dpges_core::scene::SceneData;

use super::shards;
use super::{Observer, Outcome, Run, RunError, StepReport, TrainError, Trainer, Verdict};
use crate::config::Stop;
use crate::device::place::Place;
use crate::eval::floaters::Floaters;
use crate::eval::pictures::{comparison, file_stems, save_png};
use crate::eval::rendered::TrainingRenderer;
use crate::eval::{Evaluation, Measures, evaluate_each};

/// A request to the trainer; it returns the report of the step whose numbers are then known.
type Work = fn(&mut Trainer) -> Result<Option<StepReport>, TrainError>;

/// Number of held-out views written as pictures at each evaluation.
const PICTURE_VIEWS: usize = 3;
/// Steps after which ranks compare what they have alike.
const COMPARE_EVERY: usize = 200;

impl Run {
    /// Trains to the end. Evaluates and saves on the way, as the configuration says.
    ///
    /// # Errors
    /// [`RunError::Stopped`] if the observer has asked for it, [`RunError::Train`] if a step or the beginning of a stage
    /// failed, others if a file cannot be written or a view cannot be rendered. A folder then has the last checkpoint.
    pub fn train(&mut self, observer: &mut dyn Observer) -> Result<Outcome, RunError> {
        self.started = Instant::now();
        let result =
            self.train_to_the_end(observer).map_err(|error| if error.is_full() { self.rescue(error) } else { error });
        self.seconds_before = self.seconds();
        let (scene, evaluation) = result?;
        Ok(Outcome { scene, evaluation, seconds: self.seconds_before })
    }

    /// Keeps the state in the folder for temporary files if the disk of the run is full.
    fn rescue(&mut self, error: RunError) -> RunError {
        let settled = self.trainer.settle();
        let step = self.trainer.completed_steps();
        let rescued = (settled.is_ok() && self.saved != Some(step) && self.trainer.ranks().is_alone()).then(|| {
            let name = self.folder.as_ref().and_then(|folder| folder.path().file_name()).unwrap_or_default();
            // folders elsewhere may have the same name, and be as full
            let (name, process) = (name.to_string_lossy(), std::process::id());
            let path = std::env::temp_dir().join(format!("dpges-{name}-{process}-step-{step}.safetensors"));
            self.trainer.checkpoint().save(&path).ok().map(|()| path)
        });
        RunError::DiskFull { source: Box::new(error), step, rescued: rescued.flatten() }
    }

    fn train_to_the_end(&mut self, observer: &mut dyn Observer) -> Result<(SceneData, Option<Evaluation>), RunError> {
        let train = self.trainer.config().train.clone();
        let ranks = Arc::clone(self.trainer.ranks());
        while !self.trainer.is_finished() {
            if self.trainer.stage_is_over() {
                self.end_stage(observer)?;
            }
            let before = self.trainer.completed_steps();
            self.work(Trainer::step, observer)?;
            let step = self.trainer.completed_steps();
            let is_due = |every: usize| is_due(before..step, every);
            let (evaluates, stage_is_over) = (is_due(train.evaluate_every), self.trainer.stage_is_over());
            if evaluates && !stage_is_over {
                self.work(Trainer::settle, observer)?;
                self.evaluate(&self.trainer.scene(), Measures::BASIC, observer)?;
            }
            if train.stop == Stop::Validation && (evaluates || stage_is_over) && self.trainer.is_in_last_stage() {
                self.work(Trainer::settle, observer)?;
                self.validate(train.patience, observer)?;
            }
            if ranks.any(observer.wants_scene()) {
                self.work(Trainer::settle, observer)?;
                observer.scene(step, self.trainer.scene());
            }
            let finished = self.trainer.is_finished();
            let stop = !finished && ranks.any(observer.should_stop());
            if is_due(COMPARE_EVERY) {
                self.trainer.check_ranks()?;
            }
            if is_due(train.checkpoint_every) || finished || stop {
                self.work(Trainer::settle, observer)?;
                self.save(observer)?;
            }
            if stop {
                return Err(RunError::Stopped { step, steps: self.trainer.config().total_steps() });
            }
        }
        let scene = if train.stop == Stop::Validation { self.best_scene()? } else { self.trainer.scene() };
        let scene = self.unless_it_was_better_before(scene)?;
        self.report_validation(&scene, observer)?;
        let evaluation = self.evaluate(&scene, Measures::perceptual(&[]), observer)?;
        let floaters = self.floaters(&scene)?;
        if let (Some(evaluation), Some(record)) = (&evaluation, &self.record) {
            let folder = &record.folder;
            record.report("test", &folder.scene(), evaluation, floaters, &folder.evaluation())?;
        }
        Ok((scene, evaluation))
    }

    /// Lets the trainer work, then reports the step whose numbers are known by that: on a GPU not the one it has just
    /// begun.
    fn work(&mut self, work: Work, observer: &mut dyn Observer) -> Result<(), RunError> {
        let start = Instant::now();
        let known = work(&mut self.trainer)?;
        self.check_device(observer)?;
        let Some(report) = known else { return Ok(()) };
        observer.step(&report, start.elapsed().as_secs_f64());
        let last = report.step == self.trainer.config().total_steps();
        let seconds = self.seconds();
        if let Some(record) = &mut self.record {
            record.step(&report, last, seconds)?;
        }
        Ok(())
    }

    /// Evaluates and saves what a stage has made, and begins the next.
    fn end_stage(&mut self, observer: &mut dyn Observer) -> Result<(), RunError> {
        self.work(Trainer::settle, observer)?;
        let (stage, scene) = (self.trainer.stage(), self.trainer.scene());
        self.check_device(observer)?;
        if let Some(record) = &self.record {
            record.save_scene(&scene, &self.trainer.view_corrections(), &record.folder.stage_scene(&stage))?;
        }
        observer.stage_ended(stage, &scene);
        let (evaluation, floaters) = (self.evaluate(&scene, Measures::BASIC, observer)?, self.floaters(&scene)?);
        if let (Some(evaluation), Some(record)) = (evaluation, &self.record) {
            let (file, report) = (record.folder.stage_scene(&stage), record.folder.stage_evaluation(&stage));
            record.report("test", &file, &evaluation, floaters, &report)?;
        }
        if self.trainer.last_but_one() == Some(stage) {
            if !self.trainer.dataset().validation.is_empty() {
                let psnr = self.deciding_psnr(&self.evaluate_validation(&scene)?);
                self.trainer.validation.before_last_stage = Some(psnr);
            }
            self.before_last_stage = self.folder.is_none().then_some(scene);
        }
        self.trainer.next_stage()?;
        self.save(observer)
    }

    /// `scene`, the result of the last stage, or the scene that this stage began with if the validation views are better
    /// with that; then it becomes the scene of the run.
    fn unless_it_was_better_before(&mut self, scene: SceneData) -> Result<SceneData, RunError> {
        let (Some(before), Some(stage)) = (self.trainer.validation.before_last_stage, self.trainer.last_but_one())
        else {
            return Ok(scene);
        };
        let psnr = self.deciding_psnr(&self.evaluate_validation(&scene)?);
        if psnr >= before {
            return Ok(scene);
        }
        tracing::warn!(
            "the last stage has made validation views worse, from {before:.2} to {psnr:.2} dB: the result is the scene of \
             stage {stage} (a longer run may be better: --steps)"
        );
        let Some(folder) = &self.folder else {
            return Ok(self.before_last_stage.take().expect("kept when the stage ended"));
        };
        self.take(&folder.stage_scene(&stage))
    }

    /// The scene in the file `earlier` of the folder, which becomes that of the run.
    fn take(&self, earlier: &Path) -> Result<SceneData, RunError> {
        Ok(match &self.record {
            Some(record) => record.take(earlier)?,
            None => SceneData::load(earlier)?,
        })
    }

    /// Lets the validation views judge the scene as it stands.
    fn validate(&mut self, patience: usize, observer: &mut dyn Observer) -> Result<(), RunError> {
        let (step, scene) = (self.trainer.completed_steps(), self.trainer.scene());
        self.check_device(observer)?;
        let evaluation = self.evaluate_validation(&scene)?;
        let psnr = self.deciding_psnr(&evaluation);
        let verdict = self.trainer.validation.observe(step, psnr, patience);
        let is_best = verdict == Verdict::Best;
        let seconds = self.seconds();
        if let Some(record) = &mut self.record {
            record.metrics.validation(step, &evaluation, seconds)?;
            if is_best {
                record.save_scene(&scene, &self.trainer.view_corrections(), &record.folder.best())?;
            }
        } else if is_best && self.folder.is_none() {
            self.best = Some(scene);
        }
        observer.validated(step, psnr, verdict);
        Ok(())
    }

    /// Writes down how well `scene`, the result, shows the validation views, if there are any and there is a folder.
    fn report_validation(&self, scene: &SceneData, observer: &mut dyn Observer) -> Result<(), RunError> {
        if self.folder.is_none() || self.trainer.dataset().validation.is_empty() {
            return Ok(());
        }
        let evaluation = self.evaluate_validation(scene)?;
        self.check_device(observer)?;
        let Some(record) = &self.record else { return Ok(()) };
        let folder = &record.folder;
        Ok(record.report("validation", &folder.scene(), &evaluation, None, &folder.validation())?)
    }

    fn evaluate_validation(&self, scene: &SceneData) -> Result<Evaluation, RunError> {
        let views = &self.trainer.dataset().validation;
        let measures = Measures { fitted: self.trainer.corrects_exposure(), ..Measures::BASIC };
        evaluate_each(&self.renderer(scene), scene, views, measures, |_, _| Ok(()))
    }

    /// The PSNR of validation views that all ranks decide by, dB.
    fn deciding_psnr(&self, evaluation: &Evaluation) -> f64 {
        self.trainer.ranks().of_first(vec![evaluation.deciding_psnr()])[0]
    }

    /// The best scene by the validation views; in a folder it becomes the scene of the run.
    fn best_scene(&self) -> Result<SceneData, RunError> {
        match &self.folder {
            Some(folder) => self.take(&folder.best()),
            None => Ok(self.best.clone().unwrap_or_else(|| self.trainer.scene())),
        }
    }

    /// `None` if they are written nowhere, or not known.
    fn floaters(&self, scene: &SceneData) -> Result<Option<Floaters>, RunError> {
        if self.folder.is_none() || self.trainer.dataset().test.is_empty() {
            return Ok(None);
        }
        Ok(self.renderer(scene).floaters(self.trainer.dataset())?)
    }

    fn renderer(&self, scene: &SceneData) -> TrainingRenderer {
        let place = Place { device: self.trainer.device().clone(), ranks: Arc::clone(self.trainer.ranks()) };
        TrainingRenderer::on_ranks(&self.trainer.complete(scene), &place)
    }

    /// Evaluates the held-out views and writes pictures of a few; `None` if there are none.
    fn evaluate(
        &mut self,
        scene: &SceneData,
        measures: Measures<'_>,
        observer: &mut dyn Observer,
    ) -> Result<Option<Evaluation>, RunError> {
        let dataset = Arc::clone(self.trainer.dataset());
        if dataset.test.is_empty() {
            return Ok(None);
        }
        let (views, step) = (&dataset.test, self.trainer.completed_steps());
        let stems = file_stems(views.iter().map(|view| &*view.name));
        let measures = Measures { fitted: self.trainer.corrects_exposure(), ..measures };
        let shown = evenly_spaced(PICTURE_VIEWS, views.len());
        let evaluation = evaluate_each(&self.renderer(scene), scene, views, measures, |index, render| {
            let Some(folder) = self.folder.as_ref().filter(|_| shown.contains(&index)) else { return Ok(()) };
            save_png(&comparison(&views[index], render)?, &folder.picture(step, &stems[index]))
        })?;
        observer.evaluated(step, &evaluation);
        let seconds = self.seconds();
        if let Some(record) = &mut self.record {
            record.metrics.evaluation(step, &evaluation, seconds)?;
        }
        Ok(Some(evaluation))
    }

    /// Saves scene and checkpoint, if there is a folder.
    fn save(&mut self, observer: &mut dyn Observer) -> Result<(), RunError> {
        let Some(folder) = &self.folder else { return Ok(()) };
        self.trainer.check_ranks()?;
        let (scene, checkpoint) = (self.trainer.scene(), self.trainer.checkpoint());
        // what was read from a device that has failed must not replace the files of an earlier step
        self.check_device(observer)?;
        if let Some(record) = &self.record {
            record.save_scene(&scene, &self.trainer.view_corrections(), &folder.scene())?;
        }
        let completed = checkpoint.completed_steps();
        shards::save(checkpoint, folder, &**self.trainer.ranks())?;
        self.saved = Some(completed);
        if let Some(changes) = self.trainer.pose_changes() {
            tracing::info!("after {completed} steps training cameras are {changes}");
        }
        observer.saved(completed);
        Ok(())
    }

    fn seconds(&self) -> f64 {
        self.seconds_before + self.started.elapsed().as_secs_f64()
    }

    fn check_device(&self, observer: &mut dyn Observer) -> Result<(), RunError> {
        match observer.device_failure() {
            Some(reason) => Err(TrainError::Device { step: self.trainer.completed_steps().max(1), reason }.into()),
            None => Ok(()),
        }
    }
}

/// Whether something is due after one of the `steps`, numbered from 0, that were taken at once.
fn is_due(steps: Range<usize>, every: usize) -> bool {
    every > 0 && steps.start / every < steps.end / every
}

/// `count` of `0..len`, or all of them.
fn evenly_spaced(count: usize, len: usize) -> Vec<usize> {
    let count = count.min(len);
    (0..count).map(|index| index * len / count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shown_views_are_spread_over_all() {
        assert_eq!(evenly_spaced(3, 7), [0, 2, 4]);
        assert_eq!(evenly_spaced(3, 2), [0, 1]);
        assert_eq!(evenly_spaced(0, 2), [0usize; 0]);
    }

    #[test]
    fn steps_taken_at_once_pass_no_number_by_and_nothing_is_due_every_zero_steps() {
        assert!([19..20, 18..21, 17..20].into_iter().all(|steps| is_due(steps, 10)));
        assert!(!is_due(14..15, 10) && !is_due(20..23, 10) && !is_due(9..10, 0));
    }
}

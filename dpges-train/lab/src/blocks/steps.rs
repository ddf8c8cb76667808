//! The steps of a plan as runs: their folders, their configurations, what they begin with, what is left of them.

use std::fmt;
use std::fs::File;
use std::path::{Path, PathBuf};

use dpges_core::Error;
use dpges_core::scene::SceneData;
use dpges_core::scene::atomic::make_folder;
use dpges_train::config::{Budget, Config, Stop};
use dpges_train::dataset::Dataset;
use dpges_train::dataset::block::{Block, Bounds};
use dpges_train::device::DeviceRequest;
use dpges_train::device::place::Place;
use dpges_train::run::folder::{RunFolder, write_json};
use dpges_train::run::jobs::{Job, OtherRun, State, lock, needs_gpu, write_slurm};
use dpges_train::run::shell::quoted;
use serde::{Deserialize, Serialize};

use super::plan::{Plan, PlannedBlock};
use super::scenes::{cut, join};
use super::{BlocksError, Result};

/// Length of the joint run relative to a run.
pub const JOINT_SHARE: f64 = 0.1;

/// Names of files beside those of runs.
const BLOCK: &str = "block.json";
const SURROUNDINGS: &str = "surroundings.safetensors";
const INSIDE: &str = "inside.safetensors";
const JOINED: &str = "joined.safetensors";
const DONE: &str = "done.json";

/// A step of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The whole capture, coarsely.
    Coarse,
    /// One block.
    Block(usize),
    /// All blocks together.
    Merge,
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Coarse => f.write_str("the coarse scene"),
            Self::Block(block) => write!(f, "block {block}"),
            Self::Merge => f.write_str("the merge"),
        }
    }
}

/// The content of `done.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Done {
    pub surfels: usize,
    pub gaussians: usize,
}

/// A plan in its folder.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Absolute.
    folder: PathBuf,
    pub plan: Plan,
}

impl Capture {
    /// The plan in `folder`.
    ///
    /// # Errors
    /// Those of [`Plan::load`].
    pub fn open(folder: &Path) -> Result<Self> {
        let plan = Plan::load(folder)?;
        let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        Ok(Self { folder, plan })
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// All blocks.
    pub fn blocks(&self) -> impl Iterator<Item = Step> + use<> {
        (0..self.plan.blocks.len()).map(Step::Block)
    }

    /// Where the run of a step is.
    pub fn run_folder(&self, step: Step) -> RunFolder {
        RunFolder::new(self.folder.join(match step {
            Step::Coarse => "coarse".to_owned(),
            Step::Block(block) => format!("block-{block}"),
            Step::Merge => "merged".to_owned(),
        }))
    }

    fn file(&self, step: Step, name: &str) -> PathBuf {
        self.run_folder(step).path().join(name)
    }

    fn block(&self, block: usize) -> Result<&PlannedBlock> {
        let count = self.plan.blocks.len();
        self.plan.blocks.get(block).ok_or(BlocksError::NoBlock { block, count })
    }

    /// The command that does a step.
    pub fn command(&self, step: Step) -> String {
        let folder = quoted(&self.folder.to_string_lossy());
        match step {
            Step::Coarse => format!("dpges blocks coarse {folder}"),
            Step::Block(block) => format!("dpges blocks train {folder} --block {block}"),
            Step::Merge => format!("dpges blocks merge {folder}"),
        }
    }

    /// Whether a step is done.
    pub fn is_done(&self, step: Step) -> bool {
        self.file(step, DONE).is_file()
    }

    /// Waits until no other process works on a step, and keeps others from it until the result is dropped.
    ///
    /// # Errors
    /// If the folder of the step cannot be written.
    pub fn lock(&self, step: Step) -> Result<File> {
        Ok(lock(self.run_folder(step).path(), &step.to_string())?)
    }

    /// How far a step has come whose predecessors are done.
    ///
    /// # Errors
    /// [`BlocksError::NoBlock`]; [`BlocksError::Missing`] names a step that comes before; [`BlocksError::OtherRun`] if its folder
    /// holds another run.
    pub fn state(&self, step: Step) -> Result<State> {
        if let Step::Block(block) = step {
            self.block(block)?;
        }
        let before: Vec<Step> = match step {
            Step::Coarse => Vec::new(),
            Step::Block(_) => vec![Step::Coarse],
            Step::Merge => std::iter::once(Step::Coarse).chain(self.blocks()).collect(),
        };
        if let Some(missing) = before.into_iter().find(|&before| !self.is_done(before)) {
            return Err(BlocksError::Missing { missing: missing.to_string(), command: self.command(missing) });
        }
        if self.is_done(step) {
            return Ok(State::Finished);
        }
        let folder = self.run_folder(step);
        if !folder.has_checkpoint() {
            return Ok(State::New);
        }
        OtherRun::check(&folder, &self.config(step)?)?;
        Ok(State::Begun)
    }

    /// The remaining work, a line for each step.
    pub fn progress(&self) -> String {
        let all = std::iter::once(Step::Coarse).chain(self.blocks()).chain([Step::Merge]);
        let line = |step: Step| {
            let state = if self.is_done(step) { "done".to_owned() } else { format!("`{}`", self.command(step)) };
            format!("{step}: {state}\n")
        };
        all.map(line).collect()
    }

    /// Writes [jobs of Slurm](write_slurm) into the folder of the plan: the coarse scene, an array of the blocks, the merge. A job
    /// asks for a GPU unless `device` is a CPU, and goes on where it was if it is requeued. Returns the paths, one a line.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write_slurm(&self, device: DeviceRequest) -> Result<String> {
        let program = std::env::current_exe();
        let program = program.map_err(|source| Error::Io { action: "cannot find", path: "dpges".into(), source })?;
        let [program, folder] = [&program, &self.folder].map(|path| quoted(&path.to_string_lossy()));
        let job = |name, count, step: &str| {
            let script = format!("exec {program} blocks {step} --device={device}\n");
            Job { name, count, needs_gpu: needs_gpu(device), after: "afterok", script }
        };
        let block = format!("train {folder} --block=\"$SLURM_ARRAY_TASK_ID\"");
        let jobs = [
            job("coarse", None, &format!("coarse {folder}")),
            job("blocks", Some(self.plan.blocks.len()), &block),
            job("merge", None, &format!("merge {folder}")),
        ];
        Ok(write_slurm(&self.folder, &jobs)?)
    }

    /// The configuration of the run of a step. That of the merge wants to know what it [begins with](Self::prepare).
    ///
    /// # Errors
    /// [`BlocksError::NoBlock`], [`BlocksError::Core`] if the joined scene cannot be read.
    pub fn config(&self, step: Step) -> Result<Config> {
        let mut config = self.plan.config.clone();
        let mut begin_with = |path: PathBuf| {
            let path = path.display().to_string();
            (config.stages.surfels_from, config.stages.gaussians_from) = (path.clone(), path);
        };
        match step {
            Step::Coarse => config.refine.budget = self.plan.coarse_budget.unwrap_or(config.refine.budget),
            Step::Block(_) => {
                begin_with(self.file(step, INSIDE));
                config.train.block = self.file(step, BLOCK).display().to_string();
            }
            Step::Merge => {
                let joined = self.file(step, JOINED);
                let SceneData { surfels, gaussians, info, .. } = SceneData::load(&joined)?;
                begin_with(joined);
                let steps = (config.train.steps as f64 * JOINT_SHARE).ceil() as usize;
                (config.train.steps, config.train.stop) = (steps.max(1), Stop::Steps);
                (config.stages.surfels, config.stages.gaussians) = (0.0, 0.0);
                config.model.layers = info.layer_count;
                // as the last steps of a run: nothing comes or goes
                let (refine, optimizer) = (&mut config.refine, &mut config.optimizer);
                refine.budget = Budget::Primitives(surfels.len() + gaussians.len());
                for until in [
                    &mut refine.surfel_prune_until,
                    &mut refine.gaussian_prune_until,
                    &mut refine.add_until,
                    &mut refine.replace_until,
                    &mut refine.split_until,
                ] {
                    *until = 0;
                }
                optimizer.position_start = optimizer.position_end;
                for rate in [
                    &mut optimizer.quaternions,
                    &mut optimizer.log_scales,
                    &mut optimizer.opacities,
                    &mut optimizer.base,
                    &mut optimizer.detail,
                    &mut optimizer.environment,
                ] {
                    *rate *= optimizer.decay;
                }
                optimizer.decay = 1.0;
            }
        }
        Ok(config)
    }

    /// Writes the files that the run of a step begins with.
    ///
    /// # Errors
    /// If a scene cannot be read, or a file not be written.
    pub fn prepare(&self, step: Step) -> Result<()> {
        make_folder(self.run_folder(step).path())?;
        let coarse = || SceneData::load(&self.run_folder(Step::Coarse).scene());
        match step {
            Step::Coarse => {}
            Step::Block(block) => {
                let PlannedBlock { grown, cameras, .. } = self.block(block)?;
                let [inside, around] = cut(&coarse()?, grown);
                inside.save(&self.file(step, INSIDE))?;
                around.save(&self.file(step, SURROUNDINGS))?;
                let block = Block { bounds: *grown, views: cameras.clone(), surroundings: SURROUNDINGS.into() };
                write_json(&self.file(step, BLOCK), &block)?;
            }
            Step::Merge => {
                // what is behind everything is that of the coarse scene
                let [mut all, _] = cut(&coarse()?, &Bounds { max: [Some(f32::NEG_INFINITY); 3], ..Bounds::ALL });
                for (block, PlannedBlock { core, .. }) in self.blocks().zip(&self.plan.blocks) {
                    join(&mut all, &SceneData::load(&self.run_folder(block).scene())?, core);
                }
                all.save(&self.file(step, JOINED))?;
            }
        }
        Ok(())
    }

    /// Ends a step whose run is at its end. After the coarse scene, cameras are found by that, on `dataset`, all views of the
    /// capture.
    ///
    /// # Errors
    /// If a view cannot be rendered, or a file not be read or written.
    pub fn finish(&mut self, step: Step, dataset: &Dataset, place: &Place) -> Result<()> {
        let scene = SceneData::load(&self.run_folder(step).scene())?;
        if step == Step::Coarse {
            self.plan.assign_by_scene(dataset, &scene, place)?;
        }
        if !place.ranks.is_first() {
            return Ok(());
        }
        if step == Step::Coarse {
            self.plan.save(&self.folder, dataset)?;
        }
        let done = Done { surfels: scene.surfels.len(), gaussians: scene.gaussians.len() };
        Ok(write_json(&self.file(step, DONE), &done)?)
    }
}

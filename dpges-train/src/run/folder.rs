//! The folder a training run writes to:
//!
//! ```text
//! config.toml               every key of the configuration as used
//! run.json                  the dataset, the device, the version of the program
//! metrics.jsonl             losses, PSNR and counts along the run, see `run::metrics_log`
//! scene.safetensors         the scene at the last checkpoint, then the result
//! checkpoint.safetensors    what `--resume` continues from
//! checkpoint.json           in its place for a run on several ranks: the newest two generations, see `run::shards`
//! checkpoint_N_R_of_RANKS.safetensors  the part of rank R in generation N
//! stage_NAME.safetensors    the scene at the end of a stage before the last (`2dgs`, `dbs`, `mcmc`, `coarse`)
//! stage_NAME.json           its evaluation, like eval.json
//! exposure.json             gain and offset of every training view in that scene, if exposures are corrected
//! poses.json                where every training camera is in that scene, if their poses are refined
//! best.safetensors          the best scene so far by the validation views, if they end the run
//! SCENE_exposure.json       the same for the scene in file SCENE.safetensors, `best` or of a stage
//! SCENE_poses.json          poses.json for that scene
//! eval.json                 the evaluation of the finished run, see `eval::EvalReport`
//! target.json               what the run is to reach, and what is expected of it, if there is a target
//! validation.json           the evaluation of the views that were kept for decisions, if there are any
//! pictures/step_N_VIEW.png  photograph · render · surfels only · error
//! ```

use std::fmt;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use dpges_core::Error;
use dpges_core::scene::atomic::{make_folder, write_atomically};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::hold::{Hold, HoldError, check_file};
use crate::config::{Config, StagePlan};
use crate::views::pose::RefinedPoses;

/// Files of every run.
const FILES: [&str; 14] = [
    "config.toml",
    "run.json",
    "metrics.jsonl",
    "scene.safetensors",
    "checkpoint.safetensors",
    "checkpoint.json",
    "eval.json",
    "validation.json",
    "target.json",
    "exposure.json",
    "poses.json",
    "best.safetensors",
    "best_exposure.json",
    "best_poses.json",
];
/// Stages before the last, and the ends of the names of their files.
const STAGES: [&str; 4] = ["2dgs", "dbs", "mcmc", "coarse"];
const OF_STAGE: [&str; 4] = [".safetensors", ".json", "_exposure.json", "_poses.json"];

/// Why a folder cannot be used for a run.
#[derive(Debug, thiserror::Error)]
pub enum RunFolderError {
    #[error(
        "{path} holds another run ({found}): go on with it (--resume), replace it (--overwrite), or name another --out"
    )]
    Used { path: PathBuf, found: String },
    #[error("{path} holds no run to resume: {missing} is missing")]
    NoCheckpoint { path: PathBuf, missing: PathBuf },
    #[error("the run in {path} ended before its first checkpoint: replace it (--overwrite), or name another --out")]
    Begun { path: PathBuf },
    #[error("{path} does not say what it was trained on: {reason}")]
    Origin { path: PathBuf, reason: String },
    #[error(
        "{path} does not say where the training cameras are: {reason}; without it they are where the dataset has them"
    )]
    Poses { path: PathBuf, reason: String },
    #[error(transparent)]
    Held(#[from] HoldError),
    #[error(transparent)]
    File(#[from] Error),
}

/// The origin of a run besides its configuration: the content of `run.json`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origin {
    /// Absolute path of the dataset's folder, or `builtin`.
    pub dataset: String,
    /// The name that `--device` takes.
    pub device: String,
    pub version: String,
}

impl Origin {
    /// The origin of a run that starts now with this version of the program.
    pub fn new(dataset: impl fmt::Display, device: impl fmt::Display) -> Self {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        Self { dataset: dataset.to_string(), device: device.to_string(), version }
    }
}

/// Paths of a run's files.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
    /// `None` unless this program is writing to it.
    hold: Option<Hold>,
}

impl RunFolder {
    /// The folder at `path`, which need not exist.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into(), hold: None }
    }

    /// The folder, which is made and into which no other program writes until this and all copies of it are dropped.
    ///
    /// # Errors
    /// [`RunFolderError::Held`].
    pub fn held(self) -> Result<Self, RunFolderError> {
        let hold = match self.hold {
            Some(hold) => hold,
            None => Hold::of_folder(&self.path)?,
        };
        Ok(Self { hold: Some(hold), ..self })
    }

    /// Whether `file` is one of those of the run that is in this folder.
    fn has_file(&self, file: &Path) -> bool {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        self.config().is_file() && self.origin().is_file() && files().any(|known| known == name)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn config(&self) -> PathBuf {
        self.path.join("config.toml")
    }

    pub fn origin(&self) -> PathBuf {
        self.path.join("run.json")
    }

    pub fn metrics(&self) -> PathBuf {
        self.path.join("metrics.jsonl")
    }

    pub fn scene(&self) -> PathBuf {
        self.path.join("scene.safetensors")
    }

    pub fn checkpoint(&self) -> PathBuf {
        self.path.join("checkpoint.safetensors")
    }

    /// The file that names the parts of a checkpoint of several ranks.
    pub fn manifest(&self) -> PathBuf {
        self.path.join("checkpoint.json")
    }

    /// The parts of checkpoints of several ranks that are there.
    pub fn shards(&self) -> Vec<PathBuf> {
        files_in(&self.path, |name| {
            name.starts_with("checkpoint_") && name.contains("_of_") && name.ends_with(".safetensors")
        })
    }

    pub fn evaluation(&self) -> PathBuf {
        self.path.join("eval.json")
    }

    pub fn validation(&self) -> PathBuf {
        self.path.join("validation.json")
    }

    pub fn target(&self) -> PathBuf {
        self.path.join("target.json")
    }

    pub fn exposure(&self) -> PathBuf {
        self.path.join("exposure.json")
    }

    pub fn poses(&self) -> PathBuf {
        self.path.join("poses.json")
    }

    /// `exposure.json` and `poses.json` of the scene in the file `scene` of this folder: `best_exposure.json` and
    /// `best_poses.json` of `best.safetensors`.
    pub fn corrections_of(&self, scene: &Path) -> [PathBuf; 2] {
        if scene == self.scene() {
            return [self.exposure(), self.poses()];
        }
        let stem = scene.file_stem().unwrap_or_default().to_string_lossy();
        ["exposure", "poses"].map(|of| self.path.join(format!("{stem}_{of}.json")))
    }

    pub fn best(&self) -> PathBuf {
        self.path.join("best.safetensors")
    }

    pub fn stage_scene(&self, stage: &StagePlan) -> PathBuf {
        self.path.join(format!("stage_{stage}.safetensors"))
    }

    pub fn stage_evaluation(&self, stage: &StagePlan) -> PathBuf {
        self.path.join(format!("stage_{stage}.json"))
    }

    /// Folder of the comparison pictures.
    pub fn pictures(&self) -> PathBuf {
        self.path.join("pictures")
    }

    /// Comparison picture of the view with file stem `view` after `step` steps.
    pub fn picture(&self, step: usize, view: &str) -> PathBuf {
        self.pictures().join(format!("step_{step:06}_{view}.png"))
    }

    /// Checks that the folder holds no file of a run.
    ///
    /// # Errors
    /// [`RunFolderError::Used`] names the first one found, [`RunFolderError::Begun`] says that they are of no use.
    pub fn check_unused(&self) -> Result<(), RunFolderError> {
        if let Err(begun @ RunFolderError::Begun { .. }) = self.check_resumable() {
            return Err(begun);
        }
        match files().find(|file| self.path.join(file).exists()) {
            Some(found) => Err(RunFolderError::Used { path: self.path.clone(), found }),
            None => Ok(()),
        }
    }

    /// Checks that there is a checkpoint.
    ///
    /// # Errors
    /// [`RunFolderError::Begun`] if a run has not got that far, [`RunFolderError::NoCheckpoint`] if there is none.
    pub fn check_resumable(&self) -> Result<(), RunFolderError> {
        if self.has_checkpoint() {
            return Ok(());
        }
        let path = self.path.clone();
        Err(if self.origin().is_file() && !self.scene().is_file() {
            RunFolderError::Begun { path }
        } else {
            RunFolderError::NoCheckpoint { path, missing: self.checkpoint() }
        })
    }

    /// Whether there is a checkpoint.
    pub fn has_checkpoint(&self) -> bool {
        self.checkpoint().is_file() || self.manifest().is_file()
    }

    /// Makes the folder, removes the files of an earlier run and nothing else, and writes `run.json` and `config.toml`.
    ///
    /// # Errors
    /// [`RunFolderError::File`] if a file cannot be removed or written.
    pub fn start(&self, origin: &Origin, config: &Config) -> Result<(), RunFolderError> {
        let pictures = self.pictures();
        let shown = files_in(&pictures, |name| name.starts_with("step_") && name.ends_with(".png"));
        let mut found = files().map(|file| self.path.join(file)).chain(self.shards()).chain(shown);
        found.try_for_each(|file| remove(&file))?;
        make_folder(&pictures)?;
        write_json(&self.origin(), origin)?;
        Ok(self.write_config(config)?)
    }

    /// # Errors
    /// [`Error::Io`].
    pub fn write_config(&self, config: &Config) -> Result<(), Error> {
        write_atomically(&self.config(), |file| file.write_all(config.to_toml().as_bytes()))
    }

    /// Reads `run.json`.
    ///
    /// # Errors
    /// [`RunFolderError::Origin`] if it is missing or not what was written.
    pub fn read_origin(&self) -> Result<Origin, RunFolderError> {
        let path = self.origin();
        let wrong = |reason: String| RunFolderError::Origin { path: path.clone(), reason };
        let text = std::fs::read_to_string(&path).map_err(|error| wrong(error.to_string()))?;
        serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))
    }

    /// Reads `poses.json`; `None` if there is none.
    ///
    /// # Errors
    /// [`RunFolderError::Poses`] if it is not what was written, or moves a camera without bounds.
    pub fn read_poses(&self) -> Result<Option<RefinedPoses>, RunFolderError> {
        let path = self.poses();
        let wrong = |reason: String| RunFolderError::Poses { path: path.clone(), reason };
        let text = match std::fs::read_to_string(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            text => text.map_err(|error| wrong(error.to_string()))?,
        };
        let poses: RefinedPoses = serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        match poses.iter().find(|(_, pose)| !pose.correction.is_sound()) {
            Some((view, pose)) => Err(wrong(format!("the correction of view `{view}` is {:?}", pose.correction))),
            None => Ok(Some(poses)),
        }
    }
}

/// Checks before the work that the file at `path` can be written after it. If it is one of a run, no other program writes to its
/// folder until the result is dropped.
///
/// # Errors
/// [`HoldError::Held`] if another one does, [`HoldError::File`] if it cannot be written.
pub fn hold_file(path: &Path) -> Result<Option<Hold>, HoldError> {
    check_file(path)?;
    let folder = path.parent().unwrap_or(path);
    if RunFolder::new(folder).has_file(path) { Hold::of_folder(folder).map(Some) } else { Ok(None) }
}

/// # Errors
/// [`Error::Io`] naming `path`.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, Error> {
    let read = || -> std::io::Result<T> { Ok(serde_json::from_slice(&std::fs::read(path)?)?) };
    read().map_err(failed("cannot read", path))
}

/// Writes `value` as indented JSON, the whole file or nothing.
///
/// # Errors
/// [`Error::Io`].
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), Error> {
    write_atomically(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        file.write_all(b"\n")
    })
}

/// Names of the files that a run may have in its folder.
fn files() -> impl Iterator<Item = String> {
    let of_stages = STAGES.iter().flat_map(|stage| OF_STAGE.map(|end| format!("stage_{stage}{end}")));
    FILES.into_iter().map(str::to_owned).chain(of_stages)
}

fn files_in(folder: &Path, is_wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let wanted = entries.filter(|entry| is_wanted(&entry.file_name().to_string_lossy()));
    wanted.map(|entry| entry.path()).collect()
}

/// The error of an `action` on the file at `path`.
pub fn failed<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(std::io::Error) -> Error + 'a {
    move |source| Error::Io { action, path: path.to_owned(), source }
}

/// Removes a file, if it is there.
///
/// # Errors
/// [`Error::Io`].
pub fn remove(path: &Path) -> Result<(), Error> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed.map_err(failed("cannot remove", path)),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_scene_has_corrections_of_its_own_that_a_new_run_removes() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::new(folder.path());
        assert_eq!(run.corrections_of(&run.scene()), [run.exposure(), run.poses()]);
        // every stage before the last that a run may have
        let plans = [&["stages.surfels=0.2"][..], &["stages.gaussians_by=dbs"], &["stages.coarse=0.7"]];
        let plans = plans.map(|set| Config::with(set).unwrap().plan(usize::MAX));
        let before_last = |plan: &Vec<StagePlan>| {
            plan[..plan.len() - 1].iter().map(|stage| run.stage_scene(stage)).collect::<Vec<_>>()
        };
        let stages: BTreeSet<PathBuf> = plans.iter().flat_map(before_last).collect();
        assert_eq!(stages.len(), STAGES.len());
        for scene in stages.into_iter().chain([run.best()]) {
            for file in run.corrections_of(&scene) {
                std::fs::write(&file, "old").unwrap();
                assert!(run.check_unused().is_err(), "{}", file.display());
                run.start(&Origin::new("builtin", "cpu"), &Config::default()).unwrap();
                assert!(!file.exists(), "{}", file.display());
                remove(&run.config()).unwrap();
                remove(&run.origin()).unwrap();
            }
        }
    }

    #[test]
    fn starting_removes_an_earlier_run_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::new(folder.path().join("new/run"));
        let origin = Origin::new("builtin", "cpu");
        run.check_unused().unwrap();
        assert!(run.check_resumable().unwrap_err().to_string().contains("checkpoint.safetensors"));
        run.start(&origin, &Config::default()).unwrap();
        assert_eq!(run.read_origin().unwrap(), origin);
        assert_eq!(Config::resolve(None, Some(&run.config()), &[]).unwrap(), Config::default());
        for error in [run.check_unused(), run.check_resumable()] {
            assert!(matches!(error, Err(RunFolderError::Begun { .. })), "{error:?}");
        }
        std::fs::write(run.checkpoint(), "old").unwrap();
        assert!(run.check_unused().unwrap_err().to_string().contains("config.toml"));
        let notes = run.path().join("notes.md");
        for path in [run.checkpoint(), run.picture(5, "a"), notes.clone()] {
            std::fs::write(path, "old").unwrap();
        }
        run.check_resumable().unwrap();
        run.start(&origin, &Config::default()).unwrap();
        assert!(!run.checkpoint().exists() && !run.picture(5, "a").exists() && notes.exists());
        std::fs::write(run.origin(), "{}").unwrap();
        assert!(run.read_origin().unwrap_err().to_string().contains("dataset"));
    }
}

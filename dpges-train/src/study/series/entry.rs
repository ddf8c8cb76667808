//! One run of a series.

use std::path::Path;
use std::sync::Arc;

use dpges_core::scene::SceneData;
use dpges_train::config::Config;
use dpges_train::run::folder::{Origin, RunFolder};
use dpges_train::run::{Observer, Run, SavedRun, Trainer};

use super::Common;
use super::row::Measured;
use crate::cli::data::Source;
use crate::cli::train::session::Session;
use crate::cli::train::{differences, say_resumed};
use crate::cli::{Failure, Result};

/// How far a run has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    New,
    Begun,
    Finished,
}

/// The run of a member with one seed.
pub struct Entry {
    pub label: &'static str,
    pub config: Config,
    folder: RunFolder,
    state: State,
    /// As messages call it.
    name: String,
}

impl Entry {
    /// The run with `config` in the folder `out` of a series; `says_seed` says whether messages name its seed.
    ///
    /// # Errors
    /// If its folder holds another run.
    pub fn new(label: &'static str, config: Config, out: &Path, source: &Source, says_seed: bool) -> Result<Self> {
        let seed = config.train.seed;
        let folder = RunFolder::new(out.join(relative(label, seed)));
        let state = state(&folder, &config, source)?;
        let name = if says_seed { format!("{label}, seed {seed}") } else { label.to_owned() };
        Ok(Self { label, config, folder, state, name })
    }

    /// Its folder, relative to that of the series.
    pub fn relative(&self) -> String {
        relative(self.label, self.config.train.seed)
    }

    /// Whether it was finished before the series was begun.
    pub fn is_finished(&self) -> bool {
        self.state == State::Finished
    }

    /// Whether it could begin.
    ///
    /// # Errors
    /// If the dataset or a file has not what its stages need.
    pub fn check(&self, common: &Common) -> Result<()> {
        if self.state != State::New {
            return Ok(());
        }
        Trainer::check(&self.config, &common.dataset, &common.device).map_err(|error| {
            let help = "leave it out, or change the options that all have in common";
            Failure::with_help(format!("{}: {error}", self.name), help)
        })
    }

    /// Trains the steps that are left.
    pub fn train(&self, common: &Common) -> Result<()> {
        self.train_watched(common, &mut ())
    }

    /// [`train`](Self::train) with an observer, which hears of everything and can stop the run.
    pub fn train_watched(&self, common: &Common, observer: &mut dyn Observer) -> Result<()> {
        let Self { config, folder, state, name, .. } = self;
        let (data, opened) = (Arc::clone(&common.dataset), common.device.clone());
        let run = match state {
            State::Finished => {
                tracing::info!("{name}: already finished");
                return Ok(());
            }
            State::Begun => {
                tracing::info!("{name}: resumed");
                let saved = SavedRun::open(folder.clone())?;
                say_resumed(&saved, common.name);
                Run::resume(saved, data, opened)?
            }
            State::New => {
                tracing::info!("{name}: {} steps", config.train.steps);
                let origin = Origin::new(&common.source, common.name);
                Run::new(config.clone(), data, opened)?.overwrite(folder.clone(), origin)?
            }
        };
        let session = Session { run, folder: folder.clone(), device: common.name, style: common.style };
        session.train_watched(&common.interrupted, observer)?;
        Ok(())
    }

    /// The scene of the finished run.
    pub fn scene(&self) -> Result<SceneData> {
        Ok(SceneData::load(&self.folder.scene())?)
    }

    /// What came out of it.
    pub fn measured(&self) -> Result<Measured> {
        Measured::read(&self.folder, self.relative(), self.config.train.seed)
    }
}

fn relative(label: &str, seed: u64) -> String {
    format!("{label}/seed_{seed}")
}

/// How far the run of `config` in `folder` has come.
///
/// # Errors
/// If the folder holds another run.
fn state(folder: &RunFolder, config: &Config, source: &Source) -> Result<State> {
    if folder.check_unused().is_ok() {
        return Ok(State::New);
    }
    let other = |reason: String| {
        let message = format!("{} holds another run: {reason}", folder.path().display());
        Failure::with_help(message, "choose another --out, or remove that folder")
    };
    let trained_on = folder.read_origin().map_err(|error| other(error.to_string()))?.dataset;
    if trained_on != source.to_string() {
        return Err(other(format!("it was trained on {trained_on}, not on {source}")));
    }
    let found = Config::resolve(None, Some(&folder.config()), &[]).map_err(|error| other(error.to_string()))?;
    let differences = differences(&found, config);
    if !differences.is_empty() {
        return Err(other(differences.join(", ")));
    }
    Ok(match (folder.evaluation().is_file(), folder.checkpoint().is_file()) {
        (true, _) => State::Finished,
        (false, true) => State::Begun,
        (false, false) => State::New,
    })
}

#[cfg(test)]
mod tests {
    use dpges_train::run::folder::write_json;

    use super::*;

    #[test]
    fn a_folder_is_new_begun_finished_or_refused() {
        let at = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(at.path().join("full"));
        let config = Config::default();
        let state = |config: &Config| state(&folder, config, &Source::Builtin);
        let refused = |config: &Config| match state(config) {
            Err(Failure::Failed(report)) => report.to_string(),
            _ => panic!("not refused"),
        };
        assert_eq!(state(&config).unwrap(), State::New);
        folder.start(&Origin::new(&Source::Builtin, "cpu"), &config).unwrap();
        assert_eq!(state(&config).unwrap(), State::New, "stopped before its first checkpoint");
        std::fs::write(folder.checkpoint(), "of a step").unwrap();
        assert_eq!(state(&config).unwrap(), State::Begun);
        std::fs::write(folder.evaluation(), "{}").unwrap();
        assert_eq!(state(&config).unwrap(), State::Finished);
        let mut longer = config.clone();
        longer.train.steps = 7;
        assert!(refused(&longer).contains("`train.steps` is 5000, not 7"));
        let elsewhere = Origin::new("/data/garden", "cpu");
        write_json(&folder.origin(), &elsewhere).unwrap();
        assert!(refused(&config).contains("/data/garden"));
    }
}

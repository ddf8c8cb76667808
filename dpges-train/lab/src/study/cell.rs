//! One run of a study: a variant with a seed, in `LABEL/seed_SEED`.

use std::path::Path;
use std::sync::Arc;

use burn::tensor::Device;
use dpges_train::config::Config;
use dpges_train::dataset::Dataset;
use dpges_train::run::Trainer;
use dpges_train::run::folder::RunFolder;
use dpges_train::run::jobs::{OtherRun, State};

use super::variant::Variant;
use super::{Result, StudyError};

/// The run of a variant with one seed.
#[derive(Clone, Debug)]
pub struct Cell {
    pub variant: Variant,
    pub config: Config,
    pub folder: RunFolder,
    /// The folder, relative to that of all cells.
    pub relative: String,
    pub state: State,
    /// As messages call it.
    pub name: String,
}

/// Which cells there are.
#[derive(Debug)]
pub struct Plan<'a> {
    pub variants: &'a [Variant],
    /// Number of seeds: that of the configuration, and those that follow it.
    pub seeds: u64,
    /// Folder of all cells.
    pub folder: &'a Path,
    /// As runs name it.
    pub dataset: &'a str,
}

impl Plan<'_> {
    /// All variants with the first seed, then with the second, and so on. `resolve` makes a configuration of `key=value`.
    ///
    /// # Errors
    /// [`StudyError::OtherRun`] if a folder holds anything else; those of `resolve`.
    pub fn cells<E: From<StudyError>>(&self, resolve: impl Fn(&[String]) -> Result<Config, E>) -> Result<Vec<Cell>, E> {
        let first = resolve(&[])?.train.seed;
        let mut cells = Vec::new();
        for seed in (first..).take(self.seeds as usize) {
            let seeded = format!("train.seed={seed}");
            for variant in self.variants {
                let config = resolve(&[&variant.settings[..], std::slice::from_ref(&seeded)].concat())?;
                cells.push(self.cell(variant, config)?);
            }
        }
        Ok(cells)
    }

    /// That of `variant` with a configuration, as far as it has come.
    ///
    /// # Errors
    /// [`StudyError::OtherRun`] if its folder holds anything else.
    pub fn cell(&self, variant: &Variant, config: Config) -> Result<Cell> {
        let (label, seed) = (variant.label, config.train.seed);
        let relative = format!("{label}/seed_{seed}");
        let folder = RunFolder::new(self.folder.join(&relative));
        let state = state(&folder, &config, self.dataset)?;
        let name = if self.seeds > 1 { format!("{label}, seed {seed}") } else { label.to_owned() };
        Ok(Cell { variant: variant.clone(), config, folder, relative, state, name })
    }
}

impl Cell {
    pub fn seed(&self) -> u64 {
        self.config.train.seed
    }

    /// Whether it could begin, if it has not.
    ///
    /// # Errors
    /// [`StudyError::Untrainable`] if the dataset or a file has not what its stages need.
    pub fn check(&self, dataset: &Arc<Dataset>, device: &Device) -> Result<()> {
        if self.state != State::New {
            return Ok(());
        }
        let variant = self.name.clone();
        Trainer::check(&self.config, dataset, device)
            .map_err(|source| StudyError::Untrainable { variant, source: Box::new(source) })
    }
}

/// How far the run of `config` in `folder` has come.
fn state(folder: &RunFolder, config: &Config, dataset: &str) -> Result<State> {
    if folder.check_unused().is_ok() {
        return Ok(State::New);
    }
    let other = |reason: String| OtherRun { path: folder.path().to_owned(), reason };
    let trained_on = folder.read_origin().map_err(|error| other(error.to_string()))?.dataset;
    if trained_on != dataset {
        return Err(other(format!("it was trained on {trained_on}, not on {dataset}")).into());
    }
    OtherRun::check(folder, config)?;
    Ok(match (folder.evaluation().is_file(), folder.has_checkpoint()) {
        (true, _) => State::Finished,
        (false, true) => State::Begun,
        (false, false) => State::New,
    })
}

#[cfg(test)]
mod tests {
    use dpges_train::run::folder::{Origin, write_json};

    use super::*;

    #[test]
    fn a_folder_is_new_begun_finished_or_refused() {
        let at = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(at.path().join("full"));
        let config = Config::default();
        let state = |config: &Config| state(&folder, config, "builtin");
        let refused = |config: &Config| state(config).unwrap_err().to_string();
        assert_eq!(state(&config).unwrap(), State::New);
        folder.start(&Origin::new("builtin", "cpu"), &config).unwrap();
        assert_eq!(state(&config).unwrap(), State::New, "stopped before its first checkpoint");
        std::fs::write(folder.checkpoint(), "of a step").unwrap();
        assert_eq!(state(&config).unwrap(), State::Begun);
        std::fs::write(folder.evaluation(), "{}").unwrap();
        assert_eq!(state(&config).unwrap(), State::Finished);
        let mut longer = config.clone();
        longer.train.steps = 7;
        assert!(refused(&longer).contains("`train.steps` is 5000, not 7"));
        write_json(&folder.origin(), &Origin::new("/data/garden", "cpu")).unwrap();
        assert!(refused(&config).contains("/data/garden"));
    }

    fn cells(seeds: u64, set: &[&str]) -> Result<Vec<Cell>> {
        let out = tempfile::tempdir().unwrap();
        let variants =
            [("a", 1), ("b", 2)].map(|(label, layers)| Variant::new(label, "", vec![format!("model.layers={layers}")]));
        let plan = Plan { variants: &variants, seeds, folder: out.path(), dataset: "builtin" };
        let set: Vec<String> = set.iter().map(|&set| set.to_owned()).collect();
        plan.cells(|more| Ok(Config::resolve(None, None, &[&set[..], more].concat())?))
    }

    #[test]
    fn seeds_follow_that_of_the_configuration_and_change_nothing_else() {
        let cells = cells(2, &["train.seed=7", "train.steps=9"]).unwrap();
        let found: Vec<(&str, u64, usize)> =
            cells.iter().map(|cell| (&cell.relative[..], cell.seed(), cell.config.model.layers)).collect();
        assert_eq!(found, [("a/seed_7", 7, 1), ("b/seed_7", 7, 2), ("a/seed_8", 8, 1), ("b/seed_8", 8, 2)]);
        let mut second = cells[2].config.clone();
        second.train.seed = 7;
        assert_eq!(second, cells[0].config);
    }

    #[test]
    fn there_are_no_seeds_beyond_the_largest() {
        let largest = format!("train.seed={}", i64::MAX);
        assert_eq!(cells(1, &[&largest]).unwrap().len(), 2);
        let message = cells(2, &[&largest]).unwrap_err().to_string();
        assert!(message.contains("`train.seed`"), "{message}");
    }
}

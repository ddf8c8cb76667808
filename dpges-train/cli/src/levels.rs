//! Scenes in levels of detail on the command line.

use std::path::Path;

use clap::Args;
use dpges_render::stream::{DEFAULT_BUDGET, Levels, is_lod, parse_budget};
use dpges_train::eval::rendering_preset::RenderingPreset;

use super::data::Scene;
use super::{Failure, Result};

#[derive(Debug, Args)]
pub struct LevelsArgs {
    /// Largest number of primitives in memory of a scene in levels of detail [default: 2M]
    #[arg(long, value_name = "N", value_parser = parse_budget)]
    budget: Option<usize>,
}

impl LevelsArgs {
    /// Whether `path` is a scene in levels of detail.
    ///
    /// # Errors
    /// [`Failure::Usage`] if it is, and an option makes no sense for it, or if it is not, and there is a budget.
    pub fn are_at(&self, path: &Path, preset: Option<RenderingPreset>) -> Result<bool> {
        let text = match (is_lod(path), self.budget, preset) {
            (true, _, Some(_)) => {
                "--preset: a scene in levels of detail is drawn as it was exported: use --budget".to_owned()
            }
            (false, Some(_), _) => format!(
                "--budget: {} is no scene in levels of detail (`dpges export --format lod` makes one)",
                path.display()
            ),
            (found, ..) => return Ok(found),
        };
        Err(Failure::Usage(text))
    }

    /// The scene in levels of detail at `path`, if it is one.
    pub fn open(&self, path: &Path) -> Result<Option<Levels>> {
        let open = || Levels::open(path, self.budget.unwrap_or(DEFAULT_BUDGET));
        Ok(is_lod(path).then(open).transpose()?)
    }
}

/// The scene at `path`: the coarsest of its `levels`, if it has any.
pub fn load(path: &Path, levels: Option<&Levels>) -> Result<Scene> {
    match levels {
        Some(levels) => Ok(Scene::of_levels(path, levels.scene().coarse().clone())),
        None => Ok(Scene::load(path)?),
    }
}

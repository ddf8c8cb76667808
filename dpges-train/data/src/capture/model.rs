//! The models that came out: the largest is taken, and what it lacks is said.

use std::path::{Path, PathBuf};

use dpges_core::scene::atomic::make_folder;

use super::FEWEST;
use super::error::SfmError;
use super::step::Step;
use super::workspace::{Workspace, copy, file_names, replace};
use crate::names::list;
use crate::{ModelContent, model_content};

/// Share of the photographs that must have found a place, or there is a warning.
const ENOUGH: f64 = 0.5;

/// A dataset that is finished.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    pub dataset: PathBuf,
    pub photographs: usize,
    /// Photographs with a mask.
    pub masked: usize,
    /// Names of photographs without a camera, sorted.
    pub unplaced: Vec<String>,
    pub points: usize,
    /// Numbers of photographs of the models that came out, from most to least. The first is in use. Empty if they have been
    /// removed since.
    pub models: Vec<usize>,
    /// How long each step took; empty if the dataset was there already.
    pub seconds: Vec<(Step, f64)>,
}

impl Outcome {
    /// How many photographs have a camera.
    pub fn placed(&self) -> usize {
        self.photographs - self.unplaced.len()
    }

    /// Problems of the model, with advice.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let (placed, all) = (self.placed(), self.photographs);
        if (placed as f64) < ENOUGH * all as f64 {
            warnings.push(format!(
                "only {placed} of {all} photographs have found a place, the scene will lack the rest: take more with more in \
                 common from one to the next, or compare all pairs (--sfm-matching exhaustive)"
            ));
        }
        if self.models.len() > 1 {
            let sizes: Vec<String> = self.models.iter().map(usize::to_string).collect();
            warnings.push(format!(
                "the photographs are {} groups that nothing connects, of {}: the largest is used; photographs from between \
                 them would join them",
                sizes.len(),
                sizes.join(", ")
            ));
        }
        if !self.unplaced.is_empty() {
            warnings.push(format!("without a place, and so not used: {}", list(&self.unplaced)));
        }
        warnings
    }
}

/// Models in `folder`, from that with the most photographs to that with the least.
fn models(folder: &Path) -> Result<Vec<(PathBuf, ModelContent)>, SfmError> {
    let paths = file_names(folder)?.into_iter().map(|name| folder.join(name));
    let models = paths.filter(|path| ["images.bin", "images.txt"].iter().any(|name| path.join(name).is_file()));
    let mut models: Vec<_> =
        models.map(|path| Ok((path.clone(), model_content(&path)?))).collect::<Result<_, SfmError>>()?;
    models.sort_by_key(|(_, content)| std::cmp::Reverse((content.images.len(), content.points)));
    Ok(models)
}

/// Makes `sparse/0` of the largest model.
///
/// # Errors
/// [`SfmError::NoModel`], [`SfmError::TooFewRegistered`].
pub(super) fn take_largest(workspace: &Workspace) -> Result<(), SfmError> {
    let photographs = workspace.picture_names()?.len();
    let models = models(&workspace.models)?;
    let Some((path, content)) = models.first() else {
        return Err(SfmError::NoModel { photographs, log: workspace.log(Step::Mapping) });
    };
    let registered = content.images.len();
    if registered < FEWEST {
        return Err(SfmError::TooFewRegistered { registered, photographs });
    }
    let part = workspace.empty_folder("sparse.part")?;
    let place = part.join("0");
    make_folder(&place)?;
    for name in file_names(path)? {
        copy(&path.join(&name), &place.join(&name))?;
    }
    replace(&part, &workspace.sparse)
}

pub(super) fn outcome(workspace: &Workspace, seconds: Vec<(Step, f64)>) -> Result<Outcome, SfmError> {
    let content = model_content(&workspace.sparse.join("0"))?;
    let names = workspace.picture_names()?;
    let is_placed = |name: &String| content.images.binary_search(name).is_ok();
    Ok(Outcome {
        dataset: workspace.root.clone(),
        photographs: names.len(),
        masked: names.iter().filter(|name| workspace.mask_of(name).is_some()).count(),
        unplaced: names.into_iter().filter(|name| !is_placed(name)).collect(),
        points: content.points,
        models: models(&workspace.models)?.iter().map(|(_, content)| content.images.len()).collect(),
        seconds,
    })
}

/// Whether the last program that wrote to `log` says that no pair of photographs fits.
pub(super) fn says_nothing_fits(log: &Path) -> bool {
    let text = std::fs::read(log).map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default();
    let last = text.rsplit_once("\n$ ").map_or(text.as_str(), |(_, last)| last);
    ["failed to create sparse model", "No good initial image pair", "No images with matches"]
        .iter()
        .any(|phrase| last.contains(phrase))
}

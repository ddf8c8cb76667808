//! The plan of a capture in blocks: what is trained, and where blocks lie.

use std::path::{Path, PathBuf};

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_train::config::{Budget, Config, Method, differences};
use dpges_train::dataset::block::Bounds;
use dpges_train::dataset::{Dataset, View};
use dpges_train::device::place::Place;
use dpges_train::run::folder::read_json;
use dpges_train::views::pose::are_learnt;
use serde::{Deserialize, Serialize};

use super::cameras::{MeasuredBy, assign, shares_of_points, shares_of_scene};
use super::split::{Limit, Part, split};
use super::{BlocksError, Result};

/// A block as planned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlannedBlock {
    /// Points of the dataset in the core.
    pub points: usize,
    /// Primitives in it are kept at the merge.
    pub core: Bounds,
    /// The block is trained in it.
    pub grown: Bounds,
    /// Names of the views that belong to the block, held-out ones too.
    pub cameras: Vec<String>,
}

/// The content of `plan.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Absolute path of the dataset's folder, or `builtin`.
    pub dataset: String,
    /// Measure by which the cameras of blocks were found.
    pub cameras_by: MeasuredBy,
    pub blocks: Vec<PlannedBlock>,
    /// Of the runs of blocks; those of the coarse run and of the merge follow from it.
    pub config: Config,
    /// Of the coarse run, if it is not that of a block.
    pub coarse_budget: Option<Budget>,
}

/// All views of `dataset`, those to train on first, and the number of these.
fn views(dataset: &Dataset) -> (Vec<&View>, usize) {
    let train: Vec<&View> = dataset.train.iter().chain(&dataset.validation).collect();
    let count = train.len();
    (train.into_iter().chain(&dataset.test).collect(), count)
}

impl Plan {
    /// Plans runs of `config` on the blocks of `dataset`, which commands call `name`. Cameras are found by points.
    ///
    /// # Errors
    /// [`BlocksError`] says what does not fit.
    pub fn new(name: String, dataset: &Dataset, config: Config, limit: Limit) -> Result<Self> {
        if config.train.method != Method::Dpges {
            return Err(BlocksError::Method);
        }
        if are_learnt(config.train.poses, dataset) {
            return Err(BlocksError::Poses);
        }
        let points = &dataset.points.positions;
        if points.is_empty() {
            return Err(BlocksError::NoPoints { dataset: name });
        }
        let parts = split(points, limit);
        if let Limit::Blocks(count) = limit
            && parts.len() < count
        {
            return Err(BlocksError::FewPlaces { dataset: name, found: parts.len() });
        }
        let (views, train) = views(dataset);
        let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
        let of_parts = assign(&views, train, &parts, &shares_of_points(&cameras, points, &parts));
        let names = |indices: Vec<usize>| indices.into_iter().map(|index| views[index].name.clone()).collect();
        let planned = |(part, indices): (Part, Vec<usize>)| {
            let Part { core, grown, points } = part;
            PlannedBlock { points, core, grown, cameras: names(indices) }
        };
        let blocks = parts.into_iter().zip(of_parts).map(planned).collect();
        Ok(Self { dataset: name, cameras_by: MeasuredBy::Points, blocks, config, coarse_budget: None })
    }

    /// Finds the cameras of all blocks anew, by what they see of the coarse `scene` of `dataset`.
    ///
    /// # Errors
    /// [`BlocksError::Core`] if a view cannot be rendered.
    pub fn assign_by_scene(&mut self, dataset: &Dataset, scene: &SceneData, place: &Place) -> Result<()> {
        let (views, train) = views(dataset);
        let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
        let part = |&PlannedBlock { points, core, grown, .. }: &PlannedBlock| Part { core, grown, points };
        let parts: Vec<Part> = self.blocks.iter().map(part).collect();
        let shares = shares_of_scene(&cameras, scene, &parts, place)?;
        for (block, indices) in self.blocks.iter_mut().zip(assign(&views, train, &parts, &shares)) {
            block.cameras = indices.into_iter().map(|index| views[index].name.clone()).collect();
        }
        self.cameras_by = MeasuredBy::CoarseScene;
        Ok(())
    }

    /// Reads that in `folder`.
    ///
    /// # Errors
    /// [`BlocksError::NoPlan`], and [`BlocksError::Core`] if it cannot be read.
    pub fn load(folder: &Path) -> Result<Self> {
        let path = Self::path(folder);
        if !path.is_file() {
            return Err(BlocksError::NoPlan { path: folder.to_owned() });
        }
        Ok(read_json(&path)?)
    }

    /// Whether `folder` holds this plan, whatever its cameras were found by.
    ///
    /// # Errors
    /// [`BlocksError::OtherPlan`] if it holds another one.
    pub fn is_in(&self, folder: &Path) -> Result<bool> {
        if !Self::path(folder).is_file() {
            return Ok(false);
        }
        let found = Self::load(folder)?;
        let other = |reason: String| BlocksError::OtherPlan { path: folder.to_owned(), reason };
        if found.dataset != self.dataset {
            return Err(other(format!("it is of {}, not of {}", found.dataset, self.dataset)));
        }
        let differences = differences(&found.config, &self.config);
        if !differences.is_empty() {
            return Err(other(differences.join(", ")));
        }
        if found.coarse_budget != self.coarse_budget {
            let told =
                |budget: Option<Budget>| budget.map_or("that of a block".to_owned(), |budget| budget.to_string());
            let [there, here] = [found.coarse_budget, self.coarse_budget].map(told);
            return Err(other(format!("the budget of its coarse scene is {there}, not {here}")));
        }
        let bounds = |plan: &Self| plan.blocks.iter().map(|block| (block.core, block.grown)).collect::<Vec<_>>();
        if bounds(&found) != bounds(self) {
            return Err(other(format!(
                "it has {} blocks at other places, not {}",
                found.blocks.len(),
                self.blocks.len()
            )));
        }
        Ok(true)
    }

    /// Where the plan in `folder` is.
    pub(super) fn path(folder: &Path) -> PathBuf {
        folder.join("plan.json")
    }
}

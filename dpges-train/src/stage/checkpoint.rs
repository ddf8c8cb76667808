//! A stage to and from its part of a checkpoint.

use std::collections::{BTreeMap, HashMap};

use dpges_core::scene::{ColourData, ColourModel, GaussianData, SceneInfo};

use super::blended::{BlendedStage, ScreenGradients};
use super::joint::{JointStage, Statistics, Supervisions};
use super::{Context, TrainError};
use crate::config::{Opacity, StagePlan};
use crate::optimizer::AttributeRows;
use crate::refine::growth::Growth;
use crate::refine::relocate::Relocation;
use crate::scene_state::{GaussianState, NamedRows, SurfelState};

const MARGINS: &str = "margins";
const MAX_CONTRIBUTIONS: &str = "max_contributions";
/// Rows of the trained discs.
const DISCS: [&str; 6] =
    ["discs.positions", "discs.quaternions", "discs.log_scales", "discs.opacities", "discs.base", "discs.detail"];

/// What a stage adds to the checkpoint of its run.
pub struct StageCheckpoint {
    pub info: SceneInfo,
    /// Growth decisions of an automatic budget; `None` before the first, and with a fixed budget.
    pub growth: Option<Growth>,
    /// Attributes by name, with their moments.
    pub attributes: HashMap<String, AttributeRows>,
    /// Further numbers by name.
    pub columns: BTreeMap<String, Vec<f32>>,
    /// [N] see [`Statistics`]; empty in stages without surfels.
    pub max_pixels: Vec<u32>,
}

impl StageCheckpoint {
    pub fn of_blended(stage: &BlendedStage) -> Self {
        let columns = ScreenGradients::NAMES.into_iter().zip(stage.screen_gradients.columns());
        Self {
            info: stage.info.clone(),
            growth: None,
            attributes: named([stage.gaussians.rows()]),
            columns: columns.map(|(name, values)| (name.to_owned(), values)).collect(),
            max_pixels: Vec::new(),
        }
    }

    pub fn of_joint(stage: &JointStage) -> Self {
        let columns = [
            (MARGINS.to_owned(), stage.surfels.to_data().margins),
            (MAX_CONTRIBUTIONS.to_owned(), stage.statistics.max_contributions()),
        ];
        let mut checkpoint = Self {
            info: stage.info.clone(),
            growth: stage.growth.clone(),
            attributes: named([stage.surfels.rows(), stage.gaussians.rows()]),
            columns: columns.into(),
            max_pixels: stage.statistics.max_pixels(),
        };
        if let Some(supervisions) = &stage.supervisions {
            checkpoint.add_discs(supervisions.discs());
        }
        checkpoint
    }

    /// Adds trained discs that a stage still needs.
    pub fn add_discs(&mut self, discs: &GaussianData) {
        let GaussianData { positions, quaternions, log_scales, opacities, colour } = discs.clone();
        let parts = [positions, quaternions, log_scales, opacities, colour.base, colour.detail];
        self.columns.extend(DISCS.into_iter().map(str::to_owned).zip(parts));
    }

    /// Takes out the trained discs, if there are any.
    ///
    /// # Errors
    /// [`TrainError::Resume`] if their columns do not fit together.
    pub fn take_discs(&mut self) -> Result<Option<GaussianData>, TrainError> {
        take_discs(&mut self.columns, self.info.colour_model)
    }
}

impl BlendedStage {
    /// The stage of `plan` where `checkpoint` was made.
    ///
    /// # Errors
    /// [`TrainError::Resume`] if the checkpoint contradicts itself.
    pub fn resume(
        plan: StagePlan,
        relocation: Option<Relocation>,
        checkpoint: StageCheckpoint,
        context: &Context,
    ) -> Result<Self, TrainError> {
        let StageCheckpoint { info, mut attributes, mut columns, .. } = checkpoint;
        let model = info.colour_model;
        let mut found = Vec::with_capacity(3);
        for name in ScreenGradients::NAMES {
            found.push(column(&mut columns, name)?);
        }
        let count = found[0].len();
        let rows = take(&mut attributes, GaussianState::NAMES, gaussian_widths(model), count)?;
        if found.iter().any(|column| column.len() != count) {
            return Err(TrainError::Resume { reason: "columns `screen_gradients` differ in length".into() });
        }
        let gaussians = GaussianState::from_rows(rows, model, Opacity::Sigmoid, &context.device);
        let gradients = ScreenGradients::from_columns([&found[0], &found[1], &found[2]], &context.device);
        Ok(Self::new(plan, relocation, gaussians, gradients, context))
    }
}

impl JointStage {
    /// The stage of `plan` where `checkpoint` was made, with the `discs` of its losses.
    ///
    /// # Errors
    /// [`TrainError::Resume`] if the checkpoint contradicts itself, [`TrainError::Core`] if the discs cannot be rendered.
    pub fn resume(
        plan: StagePlan,
        checkpoint: StageCheckpoint,
        discs: Option<GaussianData>,
        context: &Context,
    ) -> Result<Self, TrainError> {
        let StageCheckpoint { info, growth, mut attributes, mut columns, max_pixels } = checkpoint;
        let (model, device) = (info.colour_model, &context.device);
        let (margins, contributions) = (column(&mut columns, MARGINS)?, column(&mut columns, MAX_CONTRIBUTIONS)?);
        let surfel_widths = [3, 4, 2, 3, model.detail_len()];
        let surfel_rows = take(&mut attributes, SurfelState::NAMES, surfel_widths, margins.len())?;
        let gaussian_rows = take(&mut attributes, GaussianState::NAMES, gaussian_widths(model), contributions.len())?;
        if max_pixels.len() != margins.len() {
            return Err(TrainError::Resume { reason: "`max_pixels` and `margins` differ in length".into() });
        }
        Ok(Self {
            plan,
            schedule: context.config.schedule(context.dataset.train.len()),
            surfels: SurfelState::from_rows(surfel_rows, &margins, model, device),
            gaussians: GaussianState::from_rows(gaussian_rows, model, context.config.model.opacity, device),
            statistics: Statistics::from_rows(&max_pixels, &contributions, device),
            supervisions: discs.map(|discs| Supervisions::new(&discs, context)).transpose()?,
            growth,
            info,
        })
    }
}

fn gaussian_widths(model: ColourModel) -> [usize; 6] {
    [3, 4, 3, 1, 3, model.detail_len()]
}

fn named<const N: usize>(rows: [NamedRows; N]) -> HashMap<String, AttributeRows> {
    rows.into_iter().flatten().map(|(name, rows)| (name.to_owned(), rows)).collect()
}

fn column(columns: &mut BTreeMap<String, Vec<f32>>, name: &str) -> Result<Vec<f32>, TrainError> {
    columns.remove(name).ok_or_else(|| TrainError::Resume { reason: format!("column `{name}` is missing") })
}

/// The trained discs, if the checkpoint has them.
fn take_discs(
    columns: &mut BTreeMap<String, Vec<f32>>,
    model: ColourModel,
) -> Result<Option<GaussianData>, TrainError> {
    if !columns.contains_key(DISCS[0]) {
        return Ok(None);
    }
    let mut parts = Vec::with_capacity(DISCS.len());
    for name in DISCS {
        parts.push(column(columns, name)?);
    }
    let count = parts[3].len();
    for ((name, part), width) in DISCS.into_iter().zip(&parts).zip(gaussian_widths(model)) {
        if part.len() != count * width {
            let reason = format!("column `{name}` has {} numbers, expected {count} × {width}", part.len());
            return Err(TrainError::Resume { reason });
        }
    }
    let [positions, quaternions, log_scales, opacities, base, detail]: [Vec<f32>; 6] =
        parts.try_into().expect("one per name");
    let colour = ColourData { base, detail };
    Ok(Some(GaussianData { positions, quaternions, log_scales, opacities, colour }))
}

/// The rows of the named attributes, each `count` × its width.
fn take<const N: usize>(
    attributes: &mut HashMap<String, AttributeRows>,
    names: [&str; N],
    widths: [usize; N],
    count: usize,
) -> Result<[AttributeRows; N], TrainError> {
    let mut rows = Vec::with_capacity(N);
    for (name, width) in names.into_iter().zip(widths) {
        let Some(found) = attributes.remove(name) else {
            return Err(TrainError::Resume { reason: format!("attribute `{name}` is missing") });
        };
        if (found.count, found.width) != (count, width) {
            let reason = format!("`{name}` is {} × {}, expected {count} × {width}", found.count, found.width);
            return Err(TrainError::Resume { reason });
        }
        rows.push(found);
    }
    Ok(rows.try_into().expect("one per name"))
}

//! A run to and from a [`Checkpoint`].

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::scene::{ColourData, ColourModel, GaussianData, Rendering};

use super::blended::{BlendedStage, ScreenGradients};
use super::context::Context;
use super::joint::JointStage;
use super::statistics::Statistics;
use super::supervision::Supervisions;
use super::{Stage, TrainError, Trainer};
use crate::checkpoint::{Checkpoint, Progress};
use crate::config::StageKind;
use crate::dataset::Dataset;
use crate::optimizer::AttributeRows;
use crate::scene_state::{GaussianState, SurfelState};

const MARGINS: &str = "margins";
const MAX_CONTRIBUTIONS: &str = "max_contributions";
/// Rows of the trained discs.
const DISCS: [&str; 6] =
    ["discs.positions", "discs.quaternions", "discs.log_scales", "discs.opacities", "discs.base", "discs.detail"];

impl Trainer {
    /// All that [`resume`](Self::resume) needs to go on to the same result.
    pub fn checkpoint(&self) -> Checkpoint {
        let context = &self.context;
        let mut columns = BTreeMap::new();
        let mut add = |name: &str, values: Vec<f32>| columns.insert(name.to_owned(), values);
        if let Some(discs) = self.discs.as_ref().or(self.discs_of_losses()) {
            let GaussianData { positions, quaternions, log_scales, opacities, colour } = discs.clone();
            let parts = [positions, quaternions, log_scales, opacities, colour.base, colour.detail];
            for (name, values) in DISCS.into_iter().zip(parts) {
                add(name, values);
            }
        }
        let mut attributes = HashMap::new();
        let mut name = |rows: BTreeMap<&'static str, AttributeRows>| {
            attributes.extend(rows.into_iter().map(|(name, rows)| (name.to_owned(), rows)));
        };
        let (info, max_pixels, growth) = match &self.stage {
            Stage::Blended(stage) => {
                name(stage.gaussians.rows());
                for (name, values) in ScreenGradients::NAMES.into_iter().zip(stage.sums.columns()) {
                    add(name, values);
                }
                (stage.info.clone(), Vec::new(), None)
            }
            Stage::Joint(stage) => {
                name(stage.surfels.rows());
                name(stage.gaussians.rows());
                add(MARGINS, stage.surfels.to_data().margins);
                add(MAX_CONTRIBUTIONS, stage.statistics.max_contributions());
                (stage.info.clone(), stage.statistics.max_pixels(), stage.growth.clone())
            }
        };
        Checkpoint {
            progress: Progress {
                config: context.config.clone(),
                info,
                completed_steps: context.completed_steps,
                stage: self.at,
                validation: self.validation,
                growth,
                rng: context.rng.clone(),
                remaining_views: context.remaining_views.clone(),
                view_names: view_names(&context.dataset),
            },
            attributes,
            columns,
            max_pixels,
        }
    }

    /// Discs that the losses of the joint stage are made of.
    fn discs_of_losses(&self) -> Option<&GaussianData> {
        match &self.stage {
            Stage::Joint(stage) => stage.supervisions.as_ref().map(Supervisions::discs),
            Stage::Blended(_) => None,
        }
    }

    /// Goes on where `checkpoint` was made.
    ///
    /// # Errors
    /// [`TrainError::Resume`] if the dataset is another one or the checkpoint contradicts itself.
    pub fn resume(dataset: Arc<Dataset>, checkpoint: Checkpoint, device: Device) -> Result<Self, TrainError> {
        let Checkpoint { progress, mut attributes, mut columns, max_pixels } = checkpoint;
        if progress.view_names != view_names(&dataset) {
            let (before, now) = (progress.view_names.len(), dataset.train.len());
            let reason = format!("it was made with {before} training views, and these {now} are not the same ones");
            return Err(TrainError::Resume { reason });
        }
        let plan = progress.config.plan();
        let Some(&current) = plan.get(progress.stage) else {
            let (stage, stages) = (progress.stage, plan.len());
            return Err(TrainError::Resume { reason: format!("stage {stage} of {stages} is none") });
        };
        let context = Context {
            dataset,
            config: progress.config,
            device,
            rng: progress.rng,
            remaining_views: progress.remaining_views,
            completed_steps: progress.completed_steps,
        };
        let model = progress.info.colour_model;
        let discs = take_discs(&mut columns, model)?;
        let gaussian_widths = [3, 4, 3, 1, 3, model.detail_len()];
        let mut discs_of_run = None;
        let stage = if current.kind == StageKind::Joint {
            let (margins, contributions) = (column(&mut columns, MARGINS)?, column(&mut columns, MAX_CONTRIBUTIONS)?);
            let surfel_widths = [3, 4, 2, 3, model.detail_len()];
            let surfel_rows = take(&mut attributes, SurfelState::NAMES, surfel_widths, margins.len())?;
            let gaussian_rows = take(&mut attributes, GaussianState::NAMES, gaussian_widths, contributions.len())?;
            if max_pixels.len() != margins.len() {
                return Err(TrainError::Resume { reason: "`max_pixels` and `margins` differ in length".into() });
            }
            let supervisions = match discs {
                Some(discs) => {
                    let info = context.scene_info(Rendering::Discs);
                    Some(Supervisions::new(&discs, &info, &context.dataset, &context.device)?)
                }
                None => None,
            };
            let device = &context.device;
            Stage::Joint(Box::new(JointStage {
                plan: current,
                schedule: context.config.schedule(context.dataset.train.len()),
                surfels: SurfelState::from_rows(surfel_rows, &margins, model, device),
                gaussians: GaussianState::from_rows(gaussian_rows, model, context.config.model.opacity, device),
                statistics: Statistics::from_rows(&max_pixels, &contributions, device),
                supervisions,
                growth: progress.growth,
                info: progress.info,
            }))
        } else {
            discs_of_run = discs;
            let mut found = Vec::with_capacity(3);
            for name in ScreenGradients::NAMES {
                found.push(column(&mut columns, name)?);
            }
            let count = found[0].len();
            let rows = take(&mut attributes, GaussianState::NAMES, gaussian_widths, count)?;
            if found.iter().any(|column| column.len() != count) {
                return Err(TrainError::Resume { reason: "columns `screen_gradients` differ in length".into() });
            }
            let state = BlendedStage::state(&context, rows);
            let sums = ScreenGradients::from_columns([&found[0], &found[1], &found[2]], &context.device);
            Stage::Blended(Box::new(BlendedStage::resume(&context, current, state, sums)))
        };
        Ok(Self {
            context,
            plan,
            at: progress.stage,
            stage,
            discs: discs_of_run,
            validation: progress.validation,
            pending: None,
        })
    }
}

fn view_names(dataset: &Dataset) -> Vec<String> {
    dataset.train.iter().map(|view| view.name.clone()).collect()
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
    for ((name, part), width) in DISCS.into_iter().zip(&parts).zip([3, 4, 3, 1, 3, model.detail_len()]) {
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

//! A run to and from a [`Checkpoint`].

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::scene::schema::{Attribute, Columns};
use dpges_core::scene::{ColourModel, GaussianData, Rendering};

use super::blended::{BlendedStage, ScreenGradients};
use super::context::Context;
use super::joint::JointStage;
use super::statistics::Statistics;
use super::supervision::Supervisions;
use super::{Stage, TrainError, Trainer};
use crate::checkpoint::{Checkpoint, Progress};
use crate::config::{OpacityActivation, StageKind};
use crate::dataset::Dataset;
use crate::scene_state::{GaussianState, NamedRows, SurfelState};

const MAX_CONTRIBUTIONS: &str = "max_contributions";

impl Trainer {
    /// All that [`resume`](Self::resume) needs to go on to the same result.
    pub fn checkpoint(&self) -> Checkpoint {
        let context = &self.context;
        let mut columns = BTreeMap::new();
        let mut add = |name: &str, values: Vec<f32>| columns.insert(name.to_owned(), values);
        if let Some(discs) = self.discs.as_ref().or(self.discs_of_losses()) {
            for (attribute, values) in discs.iter() {
                add(&disc_column(attribute), values.clone());
            }
        }
        let mut attributes = HashMap::new();
        let mut name = |rows: NamedRows| {
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
        let mut discs_of_run = None;
        let stage = if current.kind == StageKind::Joint {
            let contributions = column(&mut columns, MAX_CONTRIBUTIONS)?;
            let device = &context.device;
            let surfels = SurfelState::from_rows(&mut attributes, model, OpacityActivation::Linear, device)
                .map_err(|reason| TrainError::Resume { reason })?;
            let gaussians = GaussianState::from_rows(&mut attributes, model, context.config.model.opacity, device)
                .map_err(|reason| TrainError::Resume { reason })?;
            if (max_pixels.len(), contributions.len()) != (surfels.len(), gaussians.len()) {
                let reason = "`max_pixels` or `max_contributions` does not fit the primitives".into();
                return Err(TrainError::Resume { reason });
            }
            let supervisions = match discs {
                Some(discs) => {
                    let info = context.scene_info(Rendering::Discs);
                    Some(Supervisions::new(&discs, &info, &context.dataset, &context.device)?)
                }
                None => None,
            };
            Stage::Joint(Box::new(JointStage {
                plan: current,
                schedule: context.config.schedule(context.dataset.train.len()),
                surfels,
                gaussians,
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
            let state = GaussianState::from_rows(&mut attributes, model, OpacityActivation::Sigmoid, &context.device)
                .map_err(|reason| TrainError::Resume { reason })?;
            if found.iter().any(|column| column.len() != state.len()) {
                let reason = "columns `screen_gradients` do not fit the Gaussians".into();
                return Err(TrainError::Resume { reason });
            }
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

/// Name of the column of the trained discs that holds an attribute.
fn disc_column(attribute: &Attribute) -> String {
    attribute.name.replace("gaussians.", "discs.")
}

/// The trained discs, if the checkpoint has them.
fn take_discs(
    columns: &mut BTreeMap<String, Vec<f32>>,
    model: ColourModel,
) -> Result<Option<GaussianData>, TrainError> {
    let first = &GaussianData::ATTRIBUTES[0];
    let Some(positions) = columns.get(&disc_column(first)) else { return Ok(None) };
    let count = positions.len() / first.width.under(model);
    let discs = GaussianData::try_generate(model, |attribute| {
        let name = disc_column(attribute);
        let values = column(columns, &name)?;
        let [count, width] = attribute.shape(count, model);
        if values.len() != count * width {
            let reason = format!("column `{name}` has {} numbers, expected {count} × {width}", values.len());
            return Err(TrainError::Resume { reason });
        }
        Ok(values)
    })?;
    Ok(Some(discs))
}

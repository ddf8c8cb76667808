//! A stage to and from its part of a checkpoint.

use std::collections::{BTreeMap, HashMap};

use dpges_core::scene::schema::{Attribute, Columns};
use dpges_core::scene::{GaussianData, SceneInfo};

use super::blended::{BlendedStage, Momenta, ScreenGradients};
use super::joint::{JointStage, OWNERS, SamplingLimits, Sharding, Statistics, Supervisions};
use super::sampling_limit::SamplingLimit;
use super::{Context, EnvironmentState, TrainError, WeightedSumState, environment};
use crate::config::{Blended, OpacityActivation, StagePlan};
use crate::optimizer::scene_state::{GaussianState, NamedRows, SurfelState};
use crate::optimizer::{Parameter, ParameterRows};
use crate::refine::growth::Growth;

const MAX_CONTRIBUTIONS: &str = "max_contributions";
const ERRORS: &str = "errors";
/// Column of the momenta of positions, [M × 3].
const MOMENTA: &str = "momenta";
/// Columns of the filters of surfels and of Gaussians.
const SURFEL_LIMIT: &str = "surfel_sampling_limit";
const GAUSSIAN_LIMIT: &str = "sampling_limit";

/// Column of the points that surfels are held to, [N × 4].
const SURFEL_POINTS: &str = "surfel_points";

/// Whether an attribute or a column has a row for each Gaussian of the joint stage.
pub fn is_sharded(name: &str) -> bool {
    name.starts_with("gaussians.") || [MAX_CONTRIBUTIONS, ERRORS, GAUSSIAN_LIMIT].contains(&name)
}

/// The part of a stage in the checkpoint of its run.
pub struct StageCheckpoint {
    pub info: SceneInfo,
    /// Growth decisions of an automatic budget; `None` before the first, and with a fixed budget.
    pub growth: Option<Growth>,
    /// Parameters by their raw names, with their moments.
    pub attributes: HashMap<String, ParameterRows>,
    /// Further numbers by name.
    pub columns: BTreeMap<String, Vec<f32>>,
    /// [N] as in [`Statistics`]; empty in stages without surfels.
    pub max_pixels: Vec<u32>,
}

impl StageCheckpoint {
    pub fn of_blended(stage: &BlendedStage) -> Self {
        let gradients = ScreenGradients::NAMES.into_iter().zip(stage.screen_gradients.columns());
        let limit = stage.sampling_limit.iter().map(|limit| (GAUSSIAN_LIMIT, limit.column()));
        let momenta = stage.momenta.iter().map(|momenta| (MOMENTA, momenta.column()));
        let columns = gradients.chain(limit).chain(momenta);
        let mut attributes = named([stage.gaussians.rows()], &stage.environment);
        let common = stage.weighted_sum.iter().flat_map(WeightedSumState::rows);
        attributes.extend(common.map(|(name, rows)| (name.to_owned(), rows)));
        Self {
            info: stage.scene_info(),
            growth: None,
            attributes,
            columns: columns.map(|(name, values)| (name.to_owned(), values)).collect(),
            max_pixels: Vec::new(),
        }
    }

    pub fn of_joint(stage: &JointStage) -> Self {
        let limits = stage
            .limits
            .iter()
            .flat_map(|limits| [(SURFEL_LIMIT, limits.surfels.column()), (GAUSSIAN_LIMIT, limits.gaussians.column())]);
        let statistics =
            [(MAX_CONTRIBUTIONS, stage.statistics.max_contributions()), (ERRORS, stage.statistics.errors())];
        let measured = stage.measured.iter().map(|measured| (SURFEL_POINTS, measured.column()));
        let columns = statistics.into_iter().chain(limits).chain(measured).chain(stage.sharding.column());
        let mut checkpoint = Self {
            info: stage.info.clone(),
            growth: stage.growth,
            attributes: named([stage.surfels.rows(), stage.gaussians.rows()], &stage.environment),
            columns: columns.map(|(name, values)| (name.to_owned(), values)).collect(),
            max_pixels: stage.statistics.max_pixels(),
        };
        if let Some(supervisions) = &stage.supervisions {
            checkpoint.add_discs(&supervisions.data);
        }
        checkpoint
    }

    pub fn add_discs(&mut self, discs: &GaussianData) {
        self.columns.extend(discs.iter().map(|(attribute, values)| (disc_column(attribute), values.clone())));
    }

    /// Takes out the trained discs, if there are any.
    pub fn take_discs(&mut self) -> Result<Option<GaussianData>, TrainError> {
        let (model, first) = (self.info.colour_model, &GaussianData::ATTRIBUTES[0]);
        let Some(positions) = self.columns.get(&disc_column(first)) else { return Ok(None) };
        let count = positions.len() / first.width.under(model);
        let discs = GaussianData::try_generate(model, |attribute| {
            column(&mut self.columns, &disc_column(attribute), attribute.shape(count, model).iter().product())
        });
        discs.map(Some)
    }
}

impl BlendedStage {
    /// The stage of `plan` where `checkpoint` was made.
    pub fn resume(
        plan: StagePlan,
        blended: Blended,
        checkpoint: StageCheckpoint,
        context: &Context,
    ) -> Result<Self, TrainError> {
        let StageCheckpoint { info, mut attributes, mut columns, .. } = checkpoint;
        let model = info.colour_model;
        let device = &context.device;
        let gaussians =
            GaussianState::from_rows(&mut attributes, model, blended.opacity(), device).map_err(TrainError::resume)?;
        let environment = environment::from_rows(&mut attributes, device).map_err(TrainError::resume)?;
        let sum = info.weighted_sum.as_ref();
        let weighted_sum = sum.map(|sum| WeightedSumState::from_rows(&mut attributes, sum.weight, device)).transpose();
        let count = gaussians.len();
        let [signed, absolute, views] = ScreenGradients::NAMES.map(|name| column(&mut columns, name, count));
        let gradients = ScreenGradients::from_columns([&signed?, &absolute?, &views?], device);
        let smoothing_px = context.config.mip_splatting_px();
        let sampling_limit = limit(&mut columns, GAUSSIAN_LIMIT, count, smoothing_px, context)?;
        let mut stage = Self::new(plan, blended, gaussians, environment, gradients, context);
        stage.sampling_limit = sampling_limit;
        if let Some(momenta) = &mut stage.momenta {
            *momenta = Momenta::from_column(&column(&mut columns, MOMENTA, 3 * count)?, device);
        }
        stage.weighted_sum = weighted_sum.map_err(TrainError::resume)?;
        stage.info = info;
        Ok(stage)
    }
}

impl JointStage {
    /// The stage of `plan` where `checkpoint`, with the Gaussians of all ranks, was made, with the `discs` of its losses.
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
        let wrong = TrainError::resume;
        let count = attributes.get(GaussianData::ATTRIBUTES[0].raw_name).map_or(0, |rows| rows.count);
        let [contributions, errors] = [MAX_CONTRIBUTIONS, ERRORS].map(|name| column(&mut columns, name, count));
        let sharding = Sharding::from_column(columns.remove(OWNERS), count, context.ranks.clone()).map_err(wrong)?;
        if !context.ranks.is_alone() {
            for (_, rows) in attributes.iter_mut().filter(|(name, _)| is_sharded(name)) {
                *rows = sharding.own_rows(rows).map_err(wrong)?;
            }
        }
        let surfels =
            SurfelState::from_rows(&mut attributes, model, OpacityActivation::Linear, device).map_err(wrong)?;
        let gaussians =
            GaussianState::from_rows(&mut attributes, model, context.config.model.opacity, device).map_err(wrong)?;
        let environment = environment::from_rows(&mut attributes, device).map_err(wrong)?;
        if max_pixels.len() != surfels.len() {
            return Err(wrong("`max_pixels` does not fit the surfels".into()));
        }
        let [contributions, errors] = [contributions?, errors?].map(|all| sharding.own_of(&all, 1));
        let smoothing_px = context.config.model.sampling_limit;
        let surfel_limit = limit(&mut columns, SURFEL_LIMIT, surfels.len(), smoothing_px, context)?;
        if let Some(column) = columns.get_mut(GAUSSIAN_LIMIT).filter(|column| column.len() == count) {
            *column = sharding.own_of(column, 1);
        }
        let gaussian_limit = limit(&mut columns, GAUSSIAN_LIMIT, gaussians.len(), smoothing_px, context)?;
        let (count, held_to_points) = (surfels.len(), context.config.train.lambda_points > 0.0);
        let targets = held_to_points.then(|| column(&mut columns, SURFEL_POINTS, 4 * count)).transpose()?;
        let mut stage = Self {
            info,
            limits: surfel_limit.zip(gaussian_limit).map(|(surfels, gaussians)| SamplingLimits { surfels, gaussians }),
            statistics: Statistics::from_rows(&max_pixels, [&contributions, &errors], device),
            supervisions: discs.map(|discs| Supervisions::new(&discs, context)).transpose()?,
            growth,
            ..Self::of_states(plan, surfels, gaussians, sharding, environment, context)?
        };
        if let (Some(measured), Some(targets)) = (&mut stage.measured, targets) {
            measured.restore(&targets, device);
        }
        Ok(stage)
    }
}

fn named<const N: usize>(rows: [NamedRows; N], environment: &EnvironmentState) -> HashMap<String, ParameterRows> {
    rows.into_iter()
        .flatten()
        .chain(environment.as_ref().map(Parameter::named_rows))
        .map(|(name, rows)| (name.to_owned(), rows))
        .collect()
}

/// Takes out the column `name`, which should have so many numbers.
fn column(columns: &mut BTreeMap<String, Vec<f32>>, name: &str, numbers: usize) -> Result<Vec<f32>, TrainError> {
    let column = columns.remove(name).ok_or_else(|| TrainError::resume(format!("column `{name}` is missing")))?;
    if column.len() == numbers {
        return Ok(column);
    }
    Err(TrainError::resume(format!("column `{name}` has {} numbers, expected {numbers}", column.len())))
}

/// The filter in column `name`, if there is one.
fn limit(
    columns: &mut BTreeMap<String, Vec<f32>>,
    name: &str,
    primitives: usize,
    smoothing_px: f64,
    context: &Context,
) -> Result<Option<SamplingLimit>, TrainError> {
    let found = columns.contains_key(name).then(|| column(columns, name, primitives)).transpose()?;
    Ok(found.map(|column| SamplingLimit::from_column(&column, smoothing_px, &context.device)))
}

/// Name of the column of the trained discs that holds an attribute.
fn disc_column(attribute: &Attribute) -> String {
    attribute.name.replace("gaussians.", "discs.")
}

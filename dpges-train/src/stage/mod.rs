//! The stages of a run: discs, Gaussians, then surfels and Gaussians together.
//!
//! Every kind implements [`Stage`]. The skeleton of a step, [`begin_step`], is the same for all of them: a stage only
//! says how a view is rendered and compared, at which rates it learns, and what refinement is due.

mod blended;
mod checkpoint;
mod context;
mod environment;
mod error;
mod joint;
mod parameters;
mod pending;
mod photographs;
mod pretrained;
mod report;
mod sampling_limit;
mod step;
mod surroundings;
mod view_states;
mod weighted_sum;

use std::sync::Arc;

use burn::tensor::Tensor;
use dpges_core::camera::Camera;
use dpges_core::losses::Losses;
use dpges_core::ranks::{Alone, Ranks};
use dpges_core::scene::{EnvironmentData, GaussianData, SceneData};

use crate::config::{Config, StageKind, StagePlan};
use crate::init::InitialScene;
use blended::BlendedStage;
#[cfg(test)]
pub use blended::ScreenGradients;
pub use checkpoint::{StageCheckpoint, is_sharded};
pub use context::{Context, budget, mean_pixels};
pub use environment::EnvironmentState;
pub use error::TrainError;
use joint::{JointStage, Statistics};
pub use joint::{OWNERS, in_order};
pub use parameters::{Leaves, Parameters, StepRates};
pub use pending::{PendingStep, Settled};
pub use photographs::DevicePhotographs;
pub use report::StepReport;
pub use step::{StepInput, StepViews, begin_step};
pub use surroundings::Surroundings;
pub use weighted_sum::WeightedSumState;

/// The training of one kind of scene. `completed` is the number of steps of this stage that are done.
pub trait Stage: Send {
    fn plan(&self) -> StagePlan;

    fn parameters(&mut self) -> Parameters<'_>;

    /// The scene as it stands. All ranks ask for it together.
    fn scene(&self) -> SceneData;

    /// The ranks over which its Gaussians are sharded; one alone where every rank has all of them.
    fn ranks(&self) -> Arc<dyn Ranks> {
        Arc::new(Alone)
    }

    /// Number of views of a step, each on a rank of its own; 1 where all ranks have the same view.
    fn views_per_step(&self) -> usize {
        1
    }

    /// Number of Gaussians of all ranks.
    fn gaussian_count(&mut self) -> usize {
        self.parameters().gaussians.len()
    }

    /// Whether [`refine`](Self::refine) has something to do after `completed` steps.
    fn is_due(&self, completed: usize) -> bool;

    /// Refines the scene as is due after `completed` steps. Returns a sentence for each thing it did.
    fn refine(&mut self, completed: usize, context: &mut Context) -> Result<Vec<String>, TrainError>;

    /// Renders a view from `leaves` and compares it with its photograph.
    fn forward(&self, leaves: &Leaves, input: &StepInput<'_>, context: &Context) -> dpges_core::Result<ForwardPass>;

    /// Whether [`forward`](Self::forward) looks at the pictures of its views in host memory.
    fn looks_at_pictures(&self) -> bool {
        false
    }

    /// Records what refinement needs of the views of a step: `observed` from that of this rank, and their `cameras`.
    fn observe(&mut self, _observed: Observed, _cameras: &[Camera]) {}

    /// Learning rates of the step after `completed` ones.
    fn rates(&self, completed: usize, config: &Config) -> StepRates;

    /// Changes parameters beyond what the optimiser does in the step after `completed` ones.
    fn after_step(&mut self, _completed: usize, _context: &mut Context) -> Result<(), TrainError> {
        Ok(())
    }

    /// All that [`resume`] needs to go on with this stage, on the host, with the own ones of sharded Gaussians.
    fn checkpoint(&self) -> StageCheckpoint;

    /// Leaves what it has trained to the stages after it. The last stage leaves nothing.
    fn finish(&self, _trained: &mut Trained) {}
}

/// A view as a stage renders it, on the tape of one step.
pub struct ForwardPass {
    pub losses: Losses,
    /// Leaf beside the parameters whose gradient the stage needs.
    pub probe: Option<Tensor<2>>,
    /// Statistics of the stage with this view; `None` if it has none.
    pub statistics: Option<Statistics>,
}

/// Observations of a view beside the gradients of the parameters.
pub struct Observed {
    /// Statistics of the [forward pass](ForwardPass::statistics).
    pub statistics: Option<Statistics>,
    /// The gradient of its [probe](ForwardPass::probe).
    pub of_probe: Option<Tensor<2>>,
}

/// Results of the stages so far for those to come.
#[derive(Default)]
pub struct Trained {
    pub discs: Option<GaussianData>,
    pub gaussians: Option<GaussianData>,
    /// Surfels and Gaussians of a joint stage, which the next one goes on with.
    pub joined: Option<InitialScene>,
    /// The environment that the next stage starts with; `None` in runs without one.
    pub environment: Option<EnvironmentData>,
}

/// Begins the stage of `plan` with what is `trained`, with the files that the configuration names, or with the points of
/// the dataset. The joint stage takes `trained` with it.
///
/// # Errors
/// [`TrainError::Init`] if the dataset has nothing to begin with, [`TrainError::Pretrained`] if a file is of no use,
/// [`TrainError::Plan`] if there is nothing to train.
pub fn begin(plan: StagePlan, trained: &mut Trained, context: &mut Context) -> Result<Box<dyn Stage>, TrainError> {
    Ok(match plan.kind {
        StageKind::Blended(blended) => Box::new(BlendedStage::begin(plan, blended, trained, context)?),
        StageKind::Joint => Box::new(JointStage::begin(plan, std::mem::take(trained), context)?),
    })
}

/// A stage of `plan` that begins with `scene` as it is; one of blended Gaussians leaves its surfels out.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn of_scene(plan: StagePlan, scene: &SceneData, context: &Context) -> dpges_core::Result<Box<dyn Stage>> {
    Ok(match plan.kind {
        StageKind::Blended(blended) => Box::new(BlendedStage::of_scene(plan, blended, scene, context)),
        StageKind::Joint => Box::new(JointStage::of_scene(plan, scene, context)?),
    })
}

/// Goes on with the stage of `plan` where `checkpoint` was made. Returns it, and what the stages before it have left to
/// those after it.
///
/// # Errors
/// [`TrainError::Resume`] if the checkpoint contradicts itself, [`TrainError::Core`] if its discs cannot be rendered.
pub fn resume(
    plan: StagePlan,
    mut checkpoint: StageCheckpoint,
    context: &Context,
) -> Result<(Box<dyn Stage>, Trained), TrainError> {
    let discs = checkpoint.take_discs()?;
    let blended = match plan.kind {
        StageKind::Joint => {
            let stage = JointStage::resume(plan, checkpoint, discs, context)?;
            return Ok((Box::new(stage), Trained::default()));
        }
        StageKind::Blended(blended) => blended,
    };
    let stage = BlendedStage::resume(plan, blended, checkpoint, context)?;
    Ok((Box::new(stage), Trained { discs, ..Trained::default() }))
}

//! Who watches a run.

use dpges_core::scene::SceneData;

use super::{StepReport, Verdict};
use crate::config::StagePlan;
use crate::eval::Evaluation;

/// Receives events of a run and answers its questions. Every method does nothing, or answers no, unless it is
/// implemented.
///
/// `()` ignores everything; a closure `FnMut(&StepReport)` is told of steps only. `step` counts the completed steps of
/// the run.
pub trait Observer {
    /// A step is done, which took `seconds` of wall clock. A GPU is a step ahead of what is known of it.
    fn step(&mut self, _report: &StepReport, _seconds: f64) {}

    /// The held-out views were evaluated.
    fn evaluated(&mut self, _step: usize, _evaluation: &Evaluation) {}

    /// The validation views were evaluated, with a mean PSNR of `psnr` dB.
    fn validated(&mut self, _step: usize, _psnr: f64, _verdict: Verdict) {}

    /// A stage that is not the last is over, and has made `scene`.
    fn stage_ended(&mut self, _stage: StagePlan, _scene: &SceneData) {}

    /// Scene and checkpoint are in the folder of the run.
    fn saved(&mut self, _step: usize) {}

    /// Asked after every step: whether [`scene`](Self::scene) is to be told of the scene as it stands. On a GPU that
    /// waits for the step.
    fn wants_scene(&mut self) -> bool {
        false
    }

    fn scene(&mut self, _step: usize, _scene: SceneData) {}

    /// Asked after every step: whether the run is to save its state and end with
    /// [`RunError::Stopped`](super::RunError::Stopped).
    fn should_stop(&mut self) -> bool {
        false
    }

    /// Asked before what the device holds is used: why the device failed, if the observer knows that it has. The run
    /// then ends with [`TrainError::Device`](super::TrainError::Device) and leaves the files of earlier steps alone.
    ///
    /// Burn tells of a failed device by a panic on a thread of its own, which only a panic hook can see.
    fn device_failure(&mut self) -> Option<String> {
        None
    }
}

impl Observer for () {}

impl<F: FnMut(&StepReport)> Observer for F {
    fn step(&mut self, report: &StepReport, _seconds: f64) {
        self(report);
    }
}

use crate::config::StagePlan;

/// The report of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Completed steps of the run, this one included.
    pub step: usize,
    pub stage: StagePlan,
    pub view: usize,
    /// Weighted sum of all terms.
    pub loss: f64,
    /// Name and value of each term that the stage has for the view, without its weight, as in [`Losses`](dpges_core::losses::Losses).
    pub terms: Vec<(&'static str, f64)>,
    /// dB, of the training view before the step, clamped to 0..1 and not quantised.
    pub psnr: f64,
    pub surfels: usize,
    pub gaussians: usize,
    /// Refinements before the step, a sentence each.
    pub events: Vec<String>,
}

impl StepReport {
    /// The report of a step whose numbers are not known yet: they are NaN, and the counts 0. There are no terms.
    pub fn begin(step: usize, stage: StagePlan, view: usize, events: Vec<String>) -> Self {
        let unknown = f64::NAN;
        Self { step, stage, view, loss: unknown, terms: Vec::new(), psnr: unknown, surfels: 0, gaussians: 0, events }
    }
}

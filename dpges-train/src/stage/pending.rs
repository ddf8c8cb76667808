//! A step that has been handed to the device and whose numbers are not known yet.

use burn::tensor::{Tensor, TensorData};
use dpges_core::Error;
use dpges_core::backend::readback::{Readback, begin_readback};
use dpges_core::counters::transfers::{download, wait};
use dpges_core::losses::Losses;
use dpges_core::ops::finite::{FiniteChecks, FiniteResults, Gate};
use dpges_core::ranks::Ranks;

use super::{StepReport, StepViews, TrainError};

pub struct PendingStep {
    /// Complete but for the numbers.
    report: StepReport,
    view_name: String,
    views: StepViews,
    checks: FiniteResults,
    numbers: Readback<Result<TensorData, String>>,
}

/// The results of a step that the device has done.
pub struct Settled {
    pub report: StepReport,
    /// Views of the step with the gradient of their poses; empty if these are not refined.
    pub pose_gradients: Vec<(usize, [f32; 6])>,
}

/// Whether a step may be taken: whether its loss and all its gradients are finite.
pub struct StepGate {
    checks: FiniteResults,
    gate: Gate,
}

impl StepGate {
    /// The gate of a step with this `loss` and these named `gradients`. It is open if it is so on all `ranks`.
    pub fn new<'a>(
        loss: &Tensor<1>,
        gradients: impl Iterator<Item = (&'a str, &'a Tensor<2>)>,
        ranks: &dyn Ranks,
    ) -> Self {
        let mut checks = FiniteChecks::default();
        checks.add("loss", &loss.clone().inner());
        for (name, gradient) in gradients {
            checks.add(format!("gradient of {name}"), gradient);
        }
        let checks = checks.launch();
        let mut gate = checks.gate();
        if !ranks.is_alone() {
            let bad = ranks.joined(gate.bad);
            gate = Gate { open: (bad.clone() * -1.0 + 1.0).clamp_min(0.0), bad };
        }
        Self { checks, gate }
    }

    /// [1] 1 if all are finite, else 0.
    pub fn open(&self) -> &Tensor<1> {
        &self.gate.open
    }
}

impl PendingStep {
    /// Begins to read the numbers without waiting for them: the `losses`, and the gradient [V, 6] of the poses of the
    /// `views`, if there is one.
    pub fn new(
        mut report: StepReport,
        view_name: String,
        views: StepViews,
        losses: Losses,
        of_poses: Option<Tensor<2>>,
        gate: &StepGate,
    ) -> Self {
        let Losses { total, terms, squared_error } = losses;
        let mut numbers = vec![total.inner(), squared_error.inner(), gate.gate.bad.clone()];
        report.terms = terms.iter().map(|&(name, _)| (name, f64::NAN)).collect();
        numbers.extend(terms.into_iter().map(|(_, value)| value.inner()));
        numbers.extend(of_poses.map(|gradient| gradient.reshape([-1])));
        Self { report, view_name, views, checks: gate.checks.clone(), numbers: begin_readback(numbers) }
    }

    /// Waits for the numbers.
    ///
    /// # Errors
    /// [`TrainError::Loss`] or [`TrainError::Step`] if the loss or a gradient was not finite: its gate has held the parameters
    /// back. [`TrainError::Device`] if the device failed.
    pub fn settle(self) -> Result<Settled, TrainError> {
        let has_arrived = self.numbers.has_arrived();
        let numbers = if has_arrived { self.numbers.arrived() } else { wait(|| self.numbers.arrived()) };
        let (step, view, views) = (self.report.step, self.view_name, self.views.of_ranks);
        let numbers = numbers.map_err(|reason| TrainError::Device { step, reason })?;
        let numbers: Vec<f64> = download(numbers).iter::<f64>().collect();
        let &[loss, squared_error, bad, ref rest @ ..] = numbers.as_slice() else {
            unreachable!("at least three numbers were asked for");
        };
        if !loss.is_finite() {
            return Err(TrainError::Loss { step, view, loss });
        }
        if bad != 0.0 {
            let own = self.checks.check();
            let source = own.err().unwrap_or(Error::NonFinite { tensor: "a gradient of another rank".into(), row: 0 });
            return Err(TrainError::Step { step, view, source });
        }
        let psnr = -10.0 * squared_error.log10();
        let mut report = StepReport { loss, psnr, ..self.report };
        let (terms, poses) = rest.split_at(report.terms.len());
        report.terms.iter_mut().zip(terms).for_each(|((_, value), &found)| *value = found);
        let rows = poses.as_chunks().0.iter().map(|row: &[f64; 6]| row.map(|value| value as f32));
        Ok(Settled { report, pose_gradients: views.into_iter().zip(rows).collect() })
    }
}

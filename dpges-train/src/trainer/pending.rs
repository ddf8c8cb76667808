//! A step that has been handed to the device and whose numbers are not known yet.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};

use burn::tensor::{ExecutionError, Tensor, TensorData, read_sync};
use dpges_core::losses::Losses;
use dpges_core::ops::finite::{FiniteChecks, check_finite};
use dpges_core::render::Render;

use super::{StepReport, TrainError};

type Numbers = Result<TensorData, ExecutionError>;

pub struct PendingStep {
    /// All but the numbers.
    report: StepReport,
    view_name: String,
    checks: FiniteChecks,
    numbers: Waiting,
}

enum Waiting {
    For(Pin<Box<dyn Future<Output = Numbers> + Send>>),
    No(Numbers),
}

impl PendingStep {
    /// Asks for the numbers without waiting for them. `bad` [1] counts the tensors of `checks` that
    /// are not finite.
    pub fn new(
        report: StepReport,
        view_name: String,
        terms: &Losses,
        rendered: &Render,
        target: Tensor<3>,
        checks: FiniteChecks,
        bad: Tensor<1>,
    ) -> Self {
        let difference = rendered.composite.image.clone().inner().clamp(0.0, 1.0) - target.inner();
        let squared_error = difference.clone().mul(difference).mean();
        let terms = [&terms.total, &terms.rgb, &terms.surfel, &terms.scale, &terms.transmittance];
        let mut numbers: Vec<Tensor<1>> = terms.map(|term| term.clone().inner()).into();
        numbers.extend([squared_error, bad]);
        let mut future: Pin<Box<dyn Future<Output = Numbers> + Send>> =
            Box::pin(Tensor::cat(numbers, 0).into_data_async());
        // a future begins when it is first polled: this one is to begin now
        let numbers = match future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(numbers) => Waiting::No(numbers),
            Poll::Pending => Waiting::For(future),
        };
        Self { report, view_name, checks, numbers }
    }

    /// Waits for the numbers.
    ///
    /// # Errors
    /// [`TrainError`] if one of them, or a gradient, was not finite, or the device failed.
    pub fn settle(self) -> Result<StepReport, TrainError> {
        let numbers = match self.numbers {
            Waiting::For(future) => read_sync(future),
            Waiting::No(numbers) => numbers,
        };
        let (step, view) = (self.report.step, self.view_name);
        let numbers = numbers.map_err(|error| TrainError::Device { step, reason: error.to_string() })?;
        let numbers: Vec<f64> = numbers.iter::<f64>().collect();
        let &[loss, rgb, surfel, scale, transmittance, squared_error, bad] = numbers.as_slice() else {
            unreachable!("seven numbers were asked for");
        };
        if !loss.is_finite() {
            return Err(TrainError::Loss { step, view, loss });
        }
        if bad != 0.0 {
            check_finite(&self.checks).map_err(|source| TrainError::Step { step, view, source })?;
        }
        let psnr = -10.0 * squared_error.log10();
        Ok(StepReport { loss, rgb, surfel, scale, transmittance, psnr, ..self.report })
    }
}

//! `scale_loss` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{ScaleLossOps, ScaleLossOutput};
use crate::backend::tape::{BackwardState, on_tape};

#[derive(Clone, Debug)]
pub struct ScaleLossState<B: Backend> {
    pub log_scales: FloatTensor<B>,
    pub log_mean: FloatTensor<B>,
    pub weight: f64,
}

impl<B: ScaleLossOps, S: CheckpointStrategy> ScaleLossOps for Autodiff<B, S>
where
    ScaleLossState<B>: BackwardState<B, 1>,
{
    fn scale_loss(log_scales: FloatTensor<Self>, weight: f64) -> ScaleLossOutput<Self> {
        let (log_scales, node) = log_scales.into_parts();
        let ScaleLossOutput { weighted, value, log_mean } = B::scale_loss(log_scales.clone(), weight);
        let state = ScaleLossState { log_scales, log_mean: log_mean.clone(), weight };
        ScaleLossOutput {
            weighted: on_tape::<B, S, _, _>([node], |_| (weighted, state)),
            value: <Self as AutodiffBackend>::from_inner(value),
            log_mean: <Self as AutodiffBackend>::from_inner(log_mean),
        }
    }
}

//! `photometric` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{PhotometricInput, PhotometricOps, PhotometricOutput, PhotometricWeights};
use crate::backend::tape::{BackwardState, on_tape};

#[derive(Clone, Debug)]
pub struct PhotometricState<B: Backend> {
    pub input: PhotometricInput<B>,
    pub partials: FloatTensor<B>,
    pub weights: PhotometricWeights,
    pub masked: bool,
}

impl<B: PhotometricOps, S: CheckpointStrategy> PhotometricOps for Autodiff<B, S>
where
    PhotometricState<B>: BackwardState<B, 1>,
{
    fn photometric(
        input: PhotometricInput<Self>,
        weights: PhotometricWeights,
        masked: bool,
    ) -> PhotometricOutput<Self> {
        let (image, node) = input.image.into_parts();
        let (target, ignored) = (input.target.into_parts().0, input.ignored.into_parts().0);
        let input = PhotometricInput { image, target, ignored };
        let PhotometricOutput { value, squared_error, partials } = B::photometric(input.clone(), weights, masked);
        let state = PhotometricState { input, partials: partials.clone(), weights, masked };
        PhotometricOutput {
            value: on_tape::<B, S, _, _>([node], |_| (value, state)),
            squared_error: <Self as AutodiffBackend>::from_inner(squared_error),
            partials: <Self as AutodiffBackend>::from_inner(partials),
        }
    }
}

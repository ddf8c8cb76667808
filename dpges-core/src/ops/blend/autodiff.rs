//! `blend` on the tape: all planes share one node, so that a loss on several planes passes through the primitives
//! once.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{BlendInput, BlendLists, BlendOps, BlendOptions, BlendOutput};
use crate::backend::kept::Kept;
use crate::backend::tape::{BackwardState, on_tape};
use crate::camera::Camera;

#[derive(Clone, Debug)]
pub struct BlendState<B: Backend> {
    pub input: BlendInput<B>,
    pub lists: BlendLists<B>,
    pub camera: Camera,
    pub options: BlendOptions,
    pub kept: Kept,
}

impl<B: BlendOps, S: CheckpointStrategy> BlendOps for Autodiff<B, S>
where
    BlendState<B>: BackwardState<B, 7>,
{
    fn blend(input: BlendInput<Self>, camera: Camera, options: BlendOptions, _: Kept) -> BlendOutput<Self> {
        let tensors = input.into_array();
        let values = BlendInput::from_array(tensors.clone().map(|tensor| tensor.into_parts().0));
        let mut others = None;
        let planes = on_tape::<B, S, _, _>(tensors.map(|tensor| tensor.into_parts().1), |kept| {
            let BlendOutput { planes, median_depth, lists } = B::blend(values.clone(), camera, options, kept.clone());
            others = Some((median_depth, lists.clone()));
            (planes, BlendState { input: values, lists, camera, options, kept })
        });
        let (median_depth, lists) = others.expect("blended above");
        let BlendLists { order, starts, pairs, primitives, offsets } = lists;
        let lists = BlendLists { order, starts, pairs, primitives, offsets };
        BlendOutput { planes, median_depth: <Self as AutodiffBackend>::from_inner(median_depth), lists }
    }
}

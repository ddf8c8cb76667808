//! `coverage`: the number of pixels at which each surfel is the nearest layer.
//!
//! ids [K, H, W] → `[N]` integers, counted in plane 0. No gradient.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::IntTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::{Int, Tensor};

use super::peel::Layers;

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait CoverageOps: Backend {
    fn coverage(ids: IntTensor<Self>, count: usize) -> IntTensor<Self>;
}

/// `[count]` number of pixels at which each of `count` surfels is the nearest of `layers`.
pub fn coverage(layers: &Layers, count: usize) -> Tensor<1, Int> {
    Tensor::from_dispatch(Dispatch::coverage(layers.ids.clone().inner().into_dispatch(), count))
}

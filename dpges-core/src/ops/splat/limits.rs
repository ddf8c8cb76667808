//! Where the depth intervals of a pixel end: peeled depths, shifted by the surfels' margins or bare.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, AutodiffBackend, Backend, Dispatch, TensorMetadata, backend_extension};
use burn::tensor::Tensor;
use rayon::prelude::*;

use crate::error::Result;
use crate::host::{self, Host, for_each_cpu_backend, with_real};
use crate::ops::peel::Layers;
use crate::real::Real;
use crate::scene::MarginLookup;
use crate::scene::tensors::check_shape;

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait LimitOps: Backend {
    fn interval_limits(
        ids: IntTensor<Self>,
        alpha: FloatTensor<Self>,
        depth: FloatTensor<Self>,
        margins: FloatTensor<Self>,
        lookup: MarginLookup,
    ) -> FloatTensor<Self>;
}

/// Upper limits [K, H, W] of the depth intervals of every pixel, ascending, for `margins` `[N]` of the
/// surfels (DP-GES, transmittance lookup). No gradient.
///
/// A Gaussian at depth d belongs to the first layer with `d < D + ε`, or with `d < D` where `lookup`
/// is [`MarginLookup::Literal`], or else to the K-th; a missing layer lies at infinity. A pixel is
/// closed when its last layer is opaque or is the K-th: then nothing at or behind `D + ε` of the last
/// layer is visible, whatever the lookup. With a running maximum and that cap the intervals are
/// `limit(k−1) ≤ d < limit(k)`.
///
/// # Errors
/// [`crate::Error::Shape`] if the layers' tensors do not agree.
pub fn interval_limits(layers: &Layers, margins: Tensor<1>, lookup: MarginLookup) -> Result<Tensor<3>> {
    let shape = layers.depth.dims();
    check_shape("layers.alpha", &layers.alpha, shape)?;
    Ok(Tensor::from_dispatch(Dispatch::interval_limits(
        layers.ids.clone().into_dispatch(),
        layers.alpha.clone().into_dispatch(),
        layers.depth.clone().into_dispatch(),
        margins.into_dispatch(),
        lookup,
    )))
}

fn limits<T: Real>(
    ids: &[i32],
    alpha: &[T],
    depth: &[T],
    margins: &[T],
    layers: usize,
    lookup: MarginLookup,
) -> Vec<T> {
    let pixels = depth.len() / layers;
    let per_pixel = |pixel: usize| {
        let (mut closed, mut last, mut present) = (false, T::INFINITY, 0);
        for at in (0..layers).map(|k| k * pixels + pixel).take_while(|&at| ids[at] >= 0) {
            last = depth[at] + margins[ids[at] as usize];
            closed |= alpha[at] >= T::one();
            present += 1;
        }
        if closed || present == layers { last } else { T::INFINITY }
    };
    let caps: Vec<T> = (0..pixels).into_par_iter().with_min_len(4096).map(per_pixel).collect();
    let mut out = vec![T::INFINITY; depth.len()];
    let mut reached = vec![-T::INFINITY; pixels];
    for (k, out) in out.chunks_mut(pixels.max(1)).enumerate() {
        out.par_iter_mut().zip(&mut reached).zip(&caps).with_min_len(4096).enumerate().for_each(
            |(pixel, ((out, reached), &cap))| {
                let at = k * pixels + pixel;
                let end = match lookup {
                    _ if ids[at] < 0 => T::INFINITY,
                    MarginLookup::Shifted => depth[at] + margins[ids[at] as usize],
                    // of the last interval only the cap is the end
                    MarginLookup::Literal if k + 1 == layers => T::INFINITY,
                    MarginLookup::Literal => depth[at],
                };
                *reached = reached.max(end);
                *out = reached.min(cap);
            },
        );
    }
    out
}

fn limits_on<B: Host>(
    ids: &IntTensor<B>,
    alpha: &FloatTensor<B>,
    depth: &FloatTensor<B>,
    margins: &FloatTensor<B>,
    lookup: MarginLookup,
) -> FloatTensor<B> {
    let shape: [usize; 3] = depth.shape().dims();
    with_real!(depth.dtype(), T => {
        let (alpha, values, margins) = (host::floats::<B, T>(alpha), host::floats::<B, T>(depth), host::floats::<B, T>(margins));
        let limits = limits(&host::ints::<B>(ids), &alpha, &values, &margins, shape[0], lookup);
        host::float_tensor::<B, T, 3>(limits, shape, &depth.device())
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl LimitOps for $backend {
            fn interval_limits(
                ids: IntTensor<Self>,
                alpha: FloatTensor<Self>,
                depth: FloatTensor<Self>,
                margins: FloatTensor<Self>,
                lookup: MarginLookup,
            ) -> FloatTensor<Self> {
                limits_on::<Self>(&ids, &alpha, &depth, &margins, lookup)
            }
        }
    };
}
for_each_cpu_backend!(implement);

impl<B: LimitOps, S: CheckpointStrategy> LimitOps for Autodiff<B, S> {
    fn interval_limits(
        ids: IntTensor<Self>,
        alpha: FloatTensor<Self>,
        depth: FloatTensor<Self>,
        margins: FloatTensor<Self>,
        lookup: MarginLookup,
    ) -> FloatTensor<Self> {
        let [alpha, depth, margins] = [alpha, depth, margins].map(|tensor| tensor.into_parts().0);
        <Self as AutodiffBackend>::from_inner(B::interval_limits(ids, alpha, depth, margins, lookup))
    }
}

#[cfg(test)]
mod tests {
    use super::limits;
    use crate::scene::MarginLookup;

    #[test]
    fn limits_ascend_and_close_behind_the_last_layer() {
        // two layers; pixels: rim then opaque | margin of the first reaches past the second | nothing | one rim
        let ids = [0, 1, -1, 2, 1, 0, -1, -1];
        let alpha = [0.5, 0.5, 0.0, 0.5, 1.0, 0.5, 0.0, 0.0];
        let inf = f64::INFINITY;
        let depth = [1.0, 1.0, inf, 1.0, 2.0, 2.0, inf, inf];
        let margins = [0.1, 5.0, 0.3];
        let shifted = limits::<f64>(&ids, &alpha, &depth, &margins, 2, MarginLookup::Shifted);
        assert_eq!(shifted, [1.1, 2.1, inf, 1.3, 7.0, 2.1, inf, inf]);
        let literal = limits::<f64>(&ids, &alpha, &depth, &margins, 2, MarginLookup::Literal);
        assert_eq!(literal, [1.0, 1.0, inf, 1.0, 7.0, 2.1, inf, inf]);
    }
}

//! `surfel_loss`: what surfels lack, rendered alone.
//!
//! L_s, the mean absolute difference of the surfels' image [3, H, W] and the photograph over pixels and channels; and
//! L_t = `(1 − T_K)²` averaged over all pixels, with the transmittance T [K + 1, H, W] behind the last layer, where a pixel has
//! at least two layers: ids [K, H, W] of its second one is not −1 (DP-GES). Means are those over the pixels that count.
//!
//! Gradients: from the weighted sum of the two to the surfels' image and to the transmittance. Both have none where
//! pixels do not count, and a term of weight 0 has none at all.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{Int, Tensor};

use crate::error::Result;
use crate::scene::tensors::check_shape;

/// Fewest layers of a pixel that L_t asks to let nothing through.
const FEWEST_LAYERS: usize = 2;

/// Without gradients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfelLossWeights {
    /// Weight of L_s.
    pub image: f64,
    /// Weight of L_t.
    pub transmittance: f64,
    /// Number of all pixels over the number of those that count.
    pub pixels_per_counted: f64,
}

#[derive(ExtensionType, Debug, Clone)]
pub struct SurfelLossInput<B: Backend> {
    /// [3, H, W]
    pub image: FloatTensor<B>,
    /// [K + 1, H, W]
    pub transmittance: FloatTensor<B>,
    /// [K, H, W]
    pub ids: IntTensor<B>,
    /// [3, H, W]
    pub target: FloatTensor<B>,
    /// [1, H, W] above 0.5 where pixels do not count; not looked at unless the call says that there is a mask.
    pub ignored: FloatTensor<B>,
}

/// `[1]` each
#[derive(ExtensionType, Debug, Clone)]
pub struct SurfelLossOutput<B: Backend> {
    pub weighted: FloatTensor<B>,
    pub image: FloatTensor<B>,
    pub transmittance: FloatTensor<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait SurfelLossOps: Backend {
    fn surfel_loss(
        #[extension_type] input: SurfelLossInput<Self>,
        weights: SurfelLossWeights,
        masked: bool,
    ) -> SurfelLossOutput<Self>;
}

/// The results of [`surfel_loss`], `[1]` each.
#[derive(Clone, Debug)]
pub struct SurfelLoss {
    /// The weighted sum; a term of weight 0 is not part of it.
    pub weighted: Tensor<1>,
    /// L_s, without gradient.
    pub image: Tensor<1>,
    /// L_t, without gradient.
    pub transmittance: Tensor<1>,
}

/// Compares the surfels' `image` [3, H, W] with `target` [3, H, W]; `transmittance` [K + 1, H, W] and `ids` [K, H, W] are those
/// of its layers, and `ignored` [1, H, W] is 1 where pixels do not count, else 0.
///
/// # Errors
/// [`crate::Error::Shape`] if the tensors do not fit each other.
pub fn surfel_loss(
    image: &Tensor<3>,
    transmittance: &Tensor<3>,
    ids: &Tensor<3, Int>,
    target: &Tensor<3>,
    ignored: Option<&Tensor<3>>,
    weights: &SurfelLossWeights,
) -> Result<SurfelLoss> {
    let [layers, height, width] = ids.dims();
    check_shape("surfel image", image, [3, height, width])?;
    check_shape("transmittance", transmittance, [layers + 1, height, width])?;
    check_shape("target", target, [3, height, width])?;
    if let Some(ignored) = ignored {
        check_shape("mask", ignored, [1, height, width])?;
    }
    // the tape expects a gradient for what is on it
    let reached =
        |tensor: &Tensor<3>, weight: f64| if weight == 0.0 { tensor.clone().detach() } else { tensor.clone() };
    let input = SurfelLossInput {
        image: reached(image, weights.image).into_dispatch(),
        transmittance: reached(transmittance, weights.transmittance).into_dispatch(),
        ids: ids.clone().into_dispatch(),
        target: target.clone().into_dispatch(),
        ignored: ignored.unwrap_or(target).clone().into_dispatch(),
    };
    let out = Dispatch::surfel_loss(input, *weights, ignored.is_some());
    Ok(SurfelLoss {
        weighted: Tensor::from_dispatch(out.weighted),
        image: Tensor::from_dispatch(out.image),
        transmittance: Tensor::from_dispatch(out.transmittance),
    })
}

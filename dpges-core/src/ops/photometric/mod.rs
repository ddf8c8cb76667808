//! `photometric`: how far an image is from a photograph, by absolute differences and by structural similarity.
//!
//! Two images [C, H, W] in [0, 1] → `[1]`: a weighted sum of the mean absolute difference (L1) and the mean structural
//! similarity (SSIM) over pixels and channels. SSIM has an 11 × 11 Gaussian window with σ = 1.5 px, zero padding,
//! C1 = 0.01², C2 = 0.03² (3DGS). Beside it the mean squared error `[1]` of the image clamped to [0, 1].
//!
//! Where pixels do not count, the photograph shows what the image does: they are equal there, no window across the border of
//! a mask sees an edge that only one of them has, and what the photograph shows there is of no effect.
//!
//! Gradient: from the weighted sum to the image, 0 where pixels do not count; the photograph has none.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use crate::backend::real::Real;
use crate::error::Result;
use crate::scene::tensors::check_shape;

/// Width of the Gaussian window of SSIM and its standard deviation, px (3DGS).
const WINDOW: usize = 11;
const RADIUS: usize = WINDOW / 2;
const SIGMA_PX: f64 = 1.5;
/// Constants that keep the quotients of SSIM finite, for values from 0 to 1 (3DGS).
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Normalised weights of the window.
fn taps<T: Real>() -> [T; WINDOW] {
    let raw: [f64; WINDOW] =
        std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / (2.0 * SIGMA_PX * SIGMA_PX)).exp());
    let sum: f64 = raw.iter().sum();
    // normalised in f64, so that f32 and f64 have one window
    raw.map(|tap| T::of(tap / sum))
}

/// Without gradients. The value is `offset + l1 · L1 + ssim · SSIM`, times `pixels_per_counted`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhotometricWeights {
    pub offset: f64,
    pub l1: f64,
    pub ssim: f64,
    /// Number of all pixels over the number of those that count: turns a mean over all pixels of what is 0 where they do
    /// not into the mean over those that do.
    pub pixels_per_counted: f64,
}

impl PhotometricWeights {
    /// Mean SSIM alone.
    const SSIM: Self = Self { offset: 0.0, l1: 0.0, ssim: 1.0, pixels_per_counted: 1.0 };

    /// `(1 − share) · L1 + share · (1 − SSIM)` (3DGS).
    pub fn l1_and_dssim(share: f64) -> Self {
        Self { offset: share, l1: 1.0 - share, ssim: -share, pixels_per_counted: 1.0 }
    }
}

#[derive(ExtensionType, Debug, Clone)]
pub struct PhotometricInput<B: Backend> {
    /// [C, H, W]
    pub image: FloatTensor<B>,
    /// [C, H, W]
    pub target: FloatTensor<B>,
    /// [1, H, W] above 0.5 where pixels do not count; not looked at unless the call says that there is a mask.
    pub ignored: FloatTensor<B>,
}

#[derive(ExtensionType, Debug, Clone)]
pub struct PhotometricOutput<B: Backend> {
    /// `[1]`
    pub value: FloatTensor<B>,
    /// `[1]`
    pub squared_error: FloatTensor<B>,
    /// [3, C, H, W] derivatives of the mean SSIM with respect to the windowed means of a, a² and a·b
    pub partials: FloatTensor<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait PhotometricOps: Backend {
    fn photometric(
        #[extension_type] input: PhotometricInput<Self>,
        weights: PhotometricWeights,
        masked: bool,
    ) -> PhotometricOutput<Self>;
}

/// The results of [`photometric`], `[1]` each.
#[derive(Clone, Debug)]
pub struct Photometric {
    /// The weighted sum.
    pub value: Tensor<1>,
    /// Mean squared error of the image clamped to [0, 1], without gradient.
    pub squared_error: Tensor<1>,
}

/// Compares `image` with `target`, both [C, H, W]; `ignored` [1, H, W] is 1 where pixels do not count, else 0.
///
/// # Errors
/// [`crate::Error::Shape`] if they differ in shape, or the mask in size.
pub fn photometric(
    image: &Tensor<3>,
    target: &Tensor<3>,
    ignored: Option<&Tensor<3>>,
    weights: &PhotometricWeights,
) -> Result<Photometric> {
    let [_, height, width] = image.dims();
    check_shape("target", target, image.dims())?;
    if let Some(ignored) = ignored {
        check_shape("mask", ignored, [1, height, width])?;
    }
    let input = PhotometricInput {
        image: image.clone().into_dispatch(),
        target: target.clone().into_dispatch(),
        ignored: ignored.unwrap_or(target).clone().into_dispatch(),
    };
    let out = Dispatch::photometric(input, *weights, ignored.is_some());
    Ok(Photometric { value: Tensor::from_dispatch(out.value), squared_error: Tensor::from_dispatch(out.squared_error) })
}

/// Mean SSIM `[1]` of `image` against `target`, both [C, H, W].
///
/// # Errors
/// [`crate::Error::Shape`] if the two differ in shape.
pub fn ssim(image: &Tensor<3>, target: &Tensor<3>) -> Result<Tensor<1>> {
    Ok(photometric(image, target, None, &PhotometricWeights::SSIM)?.value)
}

//! The losses of DP-GES. Each is a function of tensors that returns a tensor `[1]`.

pub mod depth;
pub mod geometry;
pub mod points;
mod target;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

use crate::error::Result;
use crate::ops::photometric::{self, Photometric, PhotometricWeights};
use crate::ops::scale_loss::scale_loss;
use crate::ops::surfel_loss::{SurfelLoss, SurfelLossWeights, surfel_loss};
use crate::render::Render;
pub use target::{Mask, PackedMask, Target, mean_of_counted};

/// Weights of the terms of the total loss.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossWeights {
    /// Share of 1 − SSIM in the photometric loss; the rest is L1.
    pub dssim: f64,
    /// λ1 of L_s.
    pub surfel: f64,
    /// λ2 of L_scale: 5e-5 for unbounded scenes, 1e-5 for bounded ones.
    pub scale: f64,
    /// λ3 of L_t.
    pub transmittance: f64,
}

impl Default for LossWeights {
    /// The weights of the paper for a bounded scene.
    fn default() -> Self {
        Self { dssim: 0.2, surfel: 0.01, scale: 1e-5, transmittance: 0.08 }
    }
}

/// L_rgb: `(1 − share) · L1 + share · (1 − SSIM)`, on the unclamped image. Where pixels do not count, image and target
/// are taken to be equal, and both means are those over the pixels that count.
///
/// # Errors
/// [`crate::Error::Shape`] if the images differ in shape.
pub fn rgb(image: Tensor<3>, target: impl Into<Target>, dssim_share: f64) -> Result<Tensor<1>> {
    Ok(rgb_and_error(&image, &target.into(), dssim_share)?.value)
}

/// [`rgb`], and the mean squared error of the clamped image over the pixels that count.
///
/// # Errors
/// The errors of [`rgb`].
pub fn rgb_and_error(image: &Tensor<3>, target: &Target, dssim_share: f64) -> Result<Photometric> {
    let weights = PhotometricWeights::l1_and_dssim(dssim_share);
    let weights = PhotometricWeights { pixels_per_counted: target.pixels_per_counted(), ..weights };
    photometric::photometric(image, &target.image, target.ignored(), &weights)
}

/// L_scale: the mean of exp(x), where x is the mean of a surfel's two scales divided by the mean scale of all surfels,
/// which carries no gradient; see [`scale_loss`](mod@crate::ops::scale_loss). 0 without surfels. `log_scales` [N, 2].
pub fn scale(log_scales: Tensor<2>) -> Tensor<1> {
    scale_loss(&log_scales, 1.0).weighted
}

/// L_t: (1 − T_K)² averaged over all pixels. Pixels covered by fewer than two layers contribute neither value nor
/// gradient.
pub fn transmittance(render: &Render) -> Tensor<1> {
    let image = render.composite.surfel_image.clone();
    let weights = LossWeights { surfel: 0.0, transmittance: 1.0, ..LossWeights::default() };
    of_surfels(render, &image.into(), &weights).expect("an image is as large as itself").weighted
}

/// L_s and L_t.
fn of_surfels(render: &Render, target: &Target, weights: &LossWeights) -> Result<SurfelLoss> {
    let weights = SurfelLossWeights {
        image: weights.surfel,
        transmittance: weights.transmittance,
        pixels_per_counted: target.pixels_per_counted(),
    };
    let (composite, seen, ids) = (&render.composite, &render.seen, &render.layers.ids);
    surfel_loss(&composite.surfel_image, &seen.transmittance, ids, &target.image, target.ignored(), &weights)
}

/// Mean over all pixels of the share of what is behind everything, background or environment, that surfels and Gaussians
/// hide, where `mask` [1, H, W] is 1; elsewhere it is 0.
pub fn hidden(render: &Render, mask: Tensor<3>) -> Tensor<1> {
    let shown = render.seen.behind_all() / (render.composite.gaussian_weight.clone() + 1.0);
    ((shown * -1.0 + 1.0) * mask).mean()
}

/// The unweighted terms of the loss of one view, `[1]` each, and their weighted sum. Gradients come from `rgb` and `total`.
#[derive(Clone, Debug)]
pub struct Losses {
    pub rgb: Tensor<1>,
    pub surfel: Tensor<1>,
    pub scale: Tensor<1>,
    pub transmittance: Tensor<1>,
    /// Weighted sum.
    pub total: Tensor<1>,
    /// Mean squared error of the clamped image over the pixels that count; no term.
    pub squared_error: Tensor<1>,
}

/// All terms for one rendered view. Terms of weight 0 are not part of the total, so no gradient flows through them.
/// `log_scales` [N, 2] of the surfels, `target` [3, H, W]. Means over pixels are those over the pixels that count.
///
/// # Errors
/// [`crate::Error::Shape`] if the target does not fit the image.
pub fn losses(
    render: &Render,
    log_scales: Tensor<2>,
    target: impl Into<Target>,
    weights: &LossWeights,
) -> Result<Losses> {
    let target = target.into();
    let Photometric { value: rgb, squared_error } = rgb_and_error(&render.composite.image, &target, weights.dssim)?;
    let surfels = of_surfels(render, &target, weights)?;
    let scale = scale_loss(&log_scales, weights.scale);
    let mut total = rgb.clone();
    if weights.surfel != 0.0 || weights.transmittance != 0.0 {
        total = total + surfels.weighted;
    }
    if weights.scale != 0.0 {
        total = total + scale.weighted;
    }
    let SurfelLoss { image: surfel, transmittance, .. } = surfels;
    Ok(Losses { rgb, surfel, scale: scale.value, transmittance, total, squared_error })
}

//! The losses of DP-GES. Each is a function of tensors that returns a tensor `[1]`.

pub mod depth;
pub mod geometry;
mod target;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

use crate::error::Result;
use crate::ops::ssim::ssim;
use crate::render::Render;
pub use target::{Mask, Target, mean_of_counted};

/// Beyond this x, the tangent continues the exp(x) of the scale loss, so that one huge surfel neither overflows nor
/// loses its gradient.
pub const SCALE_LOSS_LINEAR_FROM: f64 = 20.0;

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

/// Mean absolute difference of two images of the same shape.
pub fn l1(image: Tensor<3>, target: Tensor<3>) -> Tensor<1> {
    (image - target).abs().mean()
}

/// L_rgb: `(1 − share) · L1 + share · (1 − SSIM)`, on the unclamped image. Where pixels do not count, image and target
/// are taken to be equal, and both means are those over the pixels that count.
///
/// # Errors
/// [`crate::Error::Shape`] if the images differ in shape.
pub fn rgb(image: Tensor<3>, target: impl Into<Target>, dssim_share: f64) -> Result<Tensor<1>> {
    target.into().compared(image, |image, target| {
        let similarity = ssim(&image, &target)?;
        Ok(l1(image, target) * (1.0 - dssim_share) + (similarity * -1.0 + 1.0) * dssim_share)
    })
}

/// L_scale: the mean of exp(x), where x is the mean of a surfel's two scales divided by the mean scale of all surfels,
/// which carries no gradient. 0 without surfels. `log_scales` [N, 2].
pub fn scale(log_scales: Tensor<2>) -> Tensor<1> {
    let device = log_scales.device();
    if log_scales.dims()[0] == 0 {
        return Tensor::zeros([1], (&device, log_scales.dtype()));
    }
    // relative to the largest: scales of surfels that no view sees shrink until their exponentials, and the mean, are 0
    let fixed = log_scales.clone().detach();
    let largest = fixed.clone().max();
    let log_mean = (fixed - largest.clone().unsqueeze::<2>()).exp().mean().log() + largest;
    let x = (log_scales - log_mean.unsqueeze::<2>()).exp().mean_dim(1);
    let clamped = x.clone().clamp_max(SCALE_LOSS_LINEAR_FROM);
    (clamped.clone().exp() * (x - clamped + 1.0)).mean()
}

/// L_t: (1 − T_K)² averaged over all pixels. Pixels covered by fewer than two layers contribute neither value nor
/// gradient.
pub fn transmittance(render: &Render) -> Tensor<1> {
    transmittance_within(render, None)
}

fn transmittance_within(render: &Render, mask: Option<&Mask>) -> Tensor<1> {
    let [count, height, width] = render.layers.alpha.dims();
    if count < 2 {
        return Tensor::zeros([1], (&render.layers.alpha.device(), render.layers.alpha.dtype()));
    }
    let last = render.composite.transmittance.clone().slice([count..count + 1, 0..height, 0..width]);
    let uncovered = render.layers.ids.clone().slice([1..2, 0..height, 0..width]).lower_elem(0);
    mean_of_counted((last * -1.0 + 1.0).powi_scalar(2).mask_fill(uncovered, 0.0), mask)
}

/// Mean over all pixels of the share of what is behind everything, background or environment, that surfels and Gaussians
/// hide, where `mask` [1, H, W] is 1; elsewhere it is 0.
pub fn hidden(render: &Render, mask: Tensor<3>) -> Tensor<1> {
    let [planes, height, width] = render.composite.transmittance.dims();
    let last = render.composite.transmittance.clone().slice([planes - 1..planes, 0..height, 0..width]);
    let shown = last / (render.composite.gaussian_weight.clone() + 1.0);
    ((shown * -1.0 + 1.0) * mask).mean()
}

/// The unweighted terms of the loss of one view, `[1]` each, and their weighted sum.
#[derive(Clone, Debug)]
pub struct Losses {
    pub rgb: Tensor<1>,
    pub surfel: Tensor<1>,
    pub scale: Tensor<1>,
    pub transmittance: Tensor<1>,
    /// Weighted sum.
    pub total: Tensor<1>,
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
    let rgb = rgb(render.composite.image.clone(), target.clone(), weights.dssim)?;
    let surfel = target.compared(render.composite.surfel_image.clone(), |image, target| Ok(l1(image, target)))?;
    let scale = scale(log_scales);
    let transmittance = transmittance_within(render, target.mask.as_ref());
    let mut total = rgb.clone();
    for (term, weight) in [(&surfel, weights.surfel), (&scale, weights.scale), (&transmittance, weights.transmittance)]
    {
        if weight != 0.0 {
            total = total + term.clone() * weight;
        }
    }
    Ok(Losses { rgb, surfel, scale, transmittance, total })
}

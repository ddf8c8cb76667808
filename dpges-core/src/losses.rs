//! The losses of DP-GES: functions of tensors that return a tensor `[1]`, or [`Losses`].

pub mod depth;
pub mod geometry;
pub mod points;
mod target;
#[cfg(test)]
mod tests;

use burn::tensor::Tensor;

use crate::error::Result;
use crate::ops::photometric::{PhotometricWeights, photometric};
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
pub fn rgb(image: &Tensor<3>, target: impl Into<Target>, dssim_share: f64) -> Result<Losses> {
    let target = target.into();
    let weights = PhotometricWeights::l1_and_dssim(dssim_share);
    let weights = PhotometricWeights { pixels_per_counted: target.pixels_per_counted(), ..weights };
    let rgb = photometric(image, &target.image, target.ignored(), &weights)?;
    Ok(Losses { total: rgb.value.clone(), terms: vec![("rgb", rgb.value)], squared_error: rgb.squared_error })
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

/// The loss of one view, `[1]` each. Gradients come from `total`.
#[derive(Clone, Debug)]
pub struct Losses {
    /// Weighted sum of the terms.
    pub total: Tensor<1>,
    /// Name and value of each term, without its weight.
    pub terms: Vec<(&'static str, Tensor<1>)>,
    /// Mean squared error of the clamped image over the pixels that count; no term.
    pub squared_error: Tensor<1>,
}

impl Losses {
    /// Adds a term of this `value` `[1]` to the total, `weight` times.
    pub fn add(&mut self, name: &'static str, value: Tensor<1>, weight: f64) {
        self.total = self.total.clone() + value.clone() * weight;
        self.terms.push((name, value));
    }
}

/// The terms `rgb`, `surfel`, `scale` and `transmittance` of one rendered view. Terms of weight 0 are not part of the total, so
/// no gradient flows through them.
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
    let mut losses = rgb(&render.composite.image, target.clone(), weights.dssim)?;
    let surfels = of_surfels(render, &target, weights)?;
    let scale = scale_loss(&log_scales, weights.scale);
    if weights.surfel != 0.0 || weights.transmittance != 0.0 {
        losses.total = losses.total + surfels.weighted;
    }
    if weights.scale != 0.0 {
        losses.total = losses.total + scale.weighted;
    }
    losses.terms.extend([("surfel", surfels.image), ("scale", scale.value), ("transmittance", surfels.transmittance)]);
    Ok(losses)
}

//! Image quality of 8-bit pictures: the values that a PNG stores are measured.

use burn::tensor::Tensor;

use crate::error::Result;
use crate::ops::ssim::ssim;

/// Clamps to [0, 1] and rounds to 8-bit steps, like saving a PNG and reading it back.
pub fn quantised(image: Tensor<3>) -> Tensor<3> {
    ((image.clamp(0.0, 1.0) * 255.0).round()) / 255.0
}

/// Peak signal-to-noise ratio in dB of two images of the same shape with values in [0, 1], over all pixels and
/// channels.
pub fn psnr(image: Tensor<3>, target: Tensor<3>) -> f64 {
    let difference = image - target;
    let mse = difference.clone().mul(difference).mean().into_data().iter::<f64>().next().unwrap_or(f64::NAN);
    -10.0 * mse.log10()
}

/// Mean structural similarity (SSIM) of two images [C, H, W] with values in [0, 1].
///
/// # Errors
/// [`crate::Error::Shape`] if they differ in shape.
pub fn mean_ssim(image: Tensor<3>, target: Tensor<3>) -> Result<f64> {
    Ok(ssim(&image, &target)?.into_data().iter::<f64>().next().unwrap_or(f64::NAN))
}

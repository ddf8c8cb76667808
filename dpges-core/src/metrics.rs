//! Image quality of 8-bit pictures: the values that a PNG stores are measured.

use burn::tensor::Tensor;

use crate::error::Result;
use crate::losses::{Target, mean_of_counted};
use crate::ops::photometric::ssim;

/// Value of pixels that do not count, in both pictures: the middle one of 8 bits. It is the same for every render, so
/// that scores of several renders stay comparable.
pub const OF_IGNORED_PIXELS: f64 = 128.0 / 255.0;

/// Clamps to [0, 1] and rounds to 8-bit steps, like saving a PNG and reading it back.
pub fn quantised(image: Tensor<3>) -> Tensor<3> {
    ((image.clamp(0.0, 1.0) * 255.0).round()) / 255.0
}

/// Peak signal-to-noise ratio in dB of two images of the same shape with values in [0, 1], over all channels of the
/// pixels that count.
pub fn psnr(image: Tensor<3>, target: impl Into<Target>) -> f64 {
    let Target { image: target, mask } = target.into();
    let difference = image - target;
    let mse = mean_of_counted(difference.clone().mul(difference), mask.as_ref());
    -10.0 * mse.into_data().iter::<f64>().next().unwrap_or(f64::NAN).log10()
}

/// Mean structural similarity (SSIM) of two images [C, H, W] with values in [0, 1]. Pixels that do not count have the
/// same value in both, and 1 − SSIM is divided by the number of pixels that count.
///
/// # Errors
/// [`crate::Error::Shape`] if they differ in shape.
pub fn mean_ssim(image: Tensor<3>, target: impl Into<Target>) -> Result<f64> {
    let Target { image: target, mask } = target.into();
    let value = |image: &Tensor<3>, target: &Tensor<3>| -> Result<f64> {
        Ok(ssim(image, target)?.into_data().iter::<f64>().next().unwrap_or(f64::NAN))
    };
    let Some(mask) = mask else { return value(&image, &target) };
    let [image, target] = [image, target].map(|image| mask.filled(image, OF_IGNORED_PIXELS));
    Ok(1.0 - (1.0 - value(&image, &target)?) * mask.pixels_per_counted())
}

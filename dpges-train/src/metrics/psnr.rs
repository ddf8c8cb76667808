//! PSNR of 8-bit pictures: the values that a PNG stores are measured.

use burn::tensor::Tensor;
use dpges_core::losses::{Target, mean_of_counted};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::masked::{AREA, counted, image, overpainted, target};

    #[test]
    fn it_is_over_the_pixels_that_count() {
        let shown = overpainted(&[0.5; 3 * AREA], &[0.9; 3 * AREA]);
        let decibels = psnr(image(&shown), target(&[0.25; 3 * AREA], &counted()));
        let expected = -20.0 * 0.25f64.log10();
        assert!((decibels - expected).abs() < 1e-11, "{decibels} dB, not {expected} dB");
    }

    #[test]
    fn eight_bits_are_those_of_a_png() {
        let found =
            quantised(image(&[[-0.1, 0.4999 / 255.0, 0.5001 / 255.0, 1.2].as_slice(), &[0.0; 3 * AREA - 4]].concat()));
        let found: Vec<f64> = found.into_data().iter().take(4).collect();
        assert_eq!(found, [0.0, 0.0, 1.0 / 255.0, 1.0]);
    }
}

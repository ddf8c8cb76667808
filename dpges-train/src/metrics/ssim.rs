//! SSIM of 8-bit pictures, which are extended by zeros at their borders, as 3DGS does.

use burn::tensor::Tensor;
use dpges_core::Result;
use dpges_core::losses::Target;
use dpges_core::ops::photometric::ssim;

/// Value of pixels that do not count, in both pictures: the middle one of 8 bits. It is the same for every render, so
/// that scores of several renders stay comparable.
pub const OF_IGNORED_PIXELS: f64 = 128.0 / 255.0;

/// Mean structural similarity (SSIM) of two images [C, H, W] with values in [0, 1]. Pixels that do not count have the
/// same value in both, and 1 − SSIM is divided by the number of pixels that count.
///
/// # Errors
/// [`dpges_core::Error::Shape`] if they differ in shape.
pub fn mean_ssim(image: Tensor<3>, target: impl Into<Target>) -> Result<f64> {
    let Target { image: target, mask } = target.into();
    let value = |image: &Tensor<3>, target: &Tensor<3>| -> Result<f64> {
        Ok(ssim(image, target)?.into_data().iter::<f64>().next().unwrap_or(f64::NAN))
    };
    let Some(mask) = mask else { return value(&image, &target) };
    let [image, target] = [image, target].map(|image| mask.filled(image, OF_IGNORED_PIXELS));
    Ok(1.0 - (1.0 - value(&image, &target)?) * mask.pixels_per_counted())
}

#[cfg(test)]
mod tests {
    use dpges_core::testing::random::Random;

    use super::*;
    use crate::metrics::masked::{AREA, counted, image, overpainted, target};

    #[test]
    fn it_depends_on_pixels_that_count_alone() {
        let mut random = Random::new(5);
        let [shown, photograph, garbage, others] = [0; 4].map(|_| random.numbers(3 * AREA, 0.0, 1.0));
        let of = |shown: &[f64], photograph: &[f64]| mean_ssim(image(shown), target(photograph, &counted())).unwrap();
        let found = of(&shown, &photograph);
        assert_eq!(found, of(&overpainted(&shown, &others), &overpainted(&photograph, &garbage)));
        assert!(found < 0.5, "two pictures of noise are not alike: {found}");
        let equal = of(&shown, &overpainted(&shown, &garbage));
        assert!((equal - 1.0).abs() < 1e-12, "{equal}");
    }

    #[test]
    fn a_mask_that_counts_all_pixels_changes_nothing() {
        let mut random = Random::new(4);
        let [shown, photograph] = [0; 2].map(|_| random.numbers(3 * AREA, 0.0, 1.0));
        let plain = mean_ssim(image(&shown), image(&photograph)).unwrap();
        let masked = mean_ssim(image(&shown), target(&photograph, &[true; AREA])).unwrap();
        assert!((masked - plain).abs() < 1e-12, "{masked}, not {plain}");
    }
}

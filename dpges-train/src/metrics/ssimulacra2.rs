//! SSIMULACRA2: structural similarity and errors at edges in an opponent colour space, at six scales, weighted so that the
//! result agrees with the votes of people (Sneyers: *SSIMULACRA 2*, Cloudinary, 2022), by the crate `ssimulacra2`.

use ::ssimulacra2::{ColorPrimaries, Rgb, TransferCharacteristic, compute_frame_ssimulacra2};

/// Pictures with a shorter side have no SSIMULACRA2, px.
const SMALLEST_SIDE: usize = 8;

/// SSIMULACRA2 of two pictures [3 × `height` × `width`], display-referred (sRGB) from 0 to 1: 100 if they are equal, below
/// 0 if they hardly resemble each other. `None` for pictures below 8 px.
///
/// Six scales need 113 px on the shorter side. Smaller pictures have fewer, as in the published program, and their values
/// are not comparable with those of larger ones.
///
/// # Panics
/// If the planes are not of that size.
pub fn ssimulacra2(reference: &[f32], test: &[f32], width: usize, height: usize) -> Option<f64> {
    let area = width * height;
    assert_eq!([reference.len(), test.len()], [3 * area; 2], "pictures of {width}x{height} px");
    if width.min(height) < SMALLEST_SIDE {
        return None;
    }
    let picture = |planes: &[f32]| {
        let pixels = (0..area).map(|pixel| [planes[pixel], planes[area + pixel], planes[2 * area + pixel]]);
        Rgb::new(pixels.collect(), width, height, TransferCharacteristic::SRGB, ColorPrimaries::BT709)
            .expect("as many pixels as the size says")
    };
    Some(compute_frame_ssimulacra2(picture(reference), picture(test)).expect("two sRGB pictures of the same size"))
}

#[cfg(test)]
mod tests {
    use super::super::test_pictures::{discs, moved, noisy, picture, tinted};
    use super::*;

    /// Values of another implementation, the Python package ssimulacra2 0.3.0 with the filter that the metric is
    /// defined with: `tests/reference/make_metrics.py` prints them. Roots and powers are approximate here.
    #[test]
    fn it_agrees_with_another_implementation() {
        let (width, height) = (256, 232);
        let reference = picture(width, height, discs);
        let others: [fn(usize, usize, usize) -> usize; 3] = [moved, noisy, tinted];
        for (of, expected) in others.into_iter().zip([26.4922, 39.7201, 25.5504]) {
            let found = ssimulacra2(&reference, &picture(width, height, of), width, height).unwrap();
            assert!((found - expected).abs() < 0.05, "{found}, expected {expected}");
        }
        assert_eq!(ssimulacra2(&reference, &reference, width, height), Some(100.0));
    }

    #[test]
    fn pictures_below_eight_pixels_have_none() {
        let grey = |width: usize, height: usize| vec![0.5; 3 * width * height];
        assert_eq!(ssimulacra2(&grey(7, 40), &grey(7, 40), 7, 40), None);
        assert_eq!(ssimulacra2(&grey(40, 0), &grey(40, 0), 40, 0), None);
        assert_eq!(ssimulacra2(&grey(8, 8), &grey(8, 8), 8, 8), Some(100.0));
    }
}

//! MS-SSIM: structural similarity at five scales (Wang, Simoncelli, Bovik: *Multiscale Structural Similarity for Image
//! Quality Assessment*. Asilomar 2003).
//!
//! The window is 11 × 11 px with σ = 1.5 px and lies inside the picture as a whole, as in the paper; the SSIM of
//! [`super::mean_ssim`] extends the picture by zeros instead, as 3DGS does.

use super::plane::Plane;

/// Exponents of the scales, finest first.
const WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Radius and standard deviation of the window, px.
const RADIUS: usize = 5;
const DEVIATION: f64 = 1.5;
/// (K₁ L)² and (K₂ L)² with K₁ = 0.01, K₂ = 0.03 and values up to L = 1.
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// MS-SSIM of two pictures [3 × `height` × `width`] with values from 0 to 1, mean over the channels: 1 if they are equal,
/// at least 0. `None` if the window does not fit into the coarsest scale: up to 160 px on the shorter side.
///
/// # Panics
/// If the planes are not of that size.
pub fn ms_ssim(reference: &[f32], test: &[f32], width: usize, height: usize) -> Option<f64> {
    let area = width * height;
    assert_eq!([reference.len(), test.len()], [3 * area; 2], "pictures of {width}x{height} px");
    let coarsest = width.min(height).div_ceil(1 << (WEIGHTS.len() - 1));
    if coarsest <= 2 * RADIUS {
        return None;
    }
    let plane = Plane { width, height };
    let channel = |planes: &[f32], at: usize| planes[at * area..][..area].iter().map(|&v| f64::from(v)).collect();
    let channels = (0..3).map(|at| of_channel(channel(reference, at), channel(test, at), plane));
    Some(channels.sum::<f64>() / 3.0)
}

fn of_channel(mut reference: Vec<f64>, mut test: Vec<f64>, mut plane: Plane) -> f64 {
    let mut product = 1.0;
    for (scale, weight) in WEIGHTS.into_iter().enumerate() {
        let (similarity, contrast) = similarities(&reference, &test, plane);
        let is_last = scale + 1 == WEIGHTS.len();
        // negative means have no real power
        product *= f64::max(if is_last { similarity } else { contrast }, 0.0).powf(weight);
        if !is_last {
            let (half, halved) = plane.halved(&reference);
            (reference, test, plane) = (halved, plane.halved(&test).1, half);
        }
    }
    product
}

/// Means of SSIM, and of its part without luminance.
fn similarities(reference: &[f64], test: &[f64], plane: Plane) -> (f64, f64) {
    let window = window();
    let blurred = |values: &[f64]| plane.convolved(values, &window, &window);
    let products = |a: &[f64], b: &[f64]| blurred(&a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<f64>>());
    let (mean_a, mean_b) = (blurred(reference), blurred(test));
    let (square_a, square_b) = (products(reference, reference), products(test, test));
    let product = products(reference, test);
    let (mut similarity, mut contrast) = (vec![0.0; reference.len()], vec![0.0; reference.len()]);
    for pixel in 0..reference.len() {
        let (a, b) = (mean_a[pixel], mean_b[pixel]);
        let variances = square_a[pixel] - a * a + square_b[pixel] - b * b;
        contrast[pixel] = (2.0 * (product[pixel] - a * b) + C2) / (variances + C2);
        similarity[pixel] = contrast[pixel] * (2.0 * a * b + C1) / (a * a + b * b + C1);
    }
    (plane.mean_within(&similarity, RADIUS), plane.mean_within(&contrast, RADIUS))
}

/// A row of the window, whose sum is 1.
fn window() -> Vec<f64> {
    let radius = RADIUS as f64;
    let weight = |k: usize| (-(k as f64 - radius).powi(2) / (2.0 * DEVIATION * DEVIATION)).exp();
    let sum: f64 = (0..=2 * RADIUS).map(weight).sum();
    (0..=2 * RADIUS).map(|k| weight(k) / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::super::test_pictures::{discs, moved, noisy, picture, tinted};
    use super::*;

    /// `tests/reference/make_metrics.py` prints the values: by pytorch-msssim 1.0.0 where all sides are even at every scale,
    /// and by a computation of its own where not.
    #[test]
    fn it_agrees_with_other_computations() {
        let others: [fn(usize, usize, usize) -> usize; 3] = [moved, noisy, tinted];
        let cases = [
            (192, 176, [0.960_957_277, 0.961_716_417, 0.983_261_765]),
            (181, 165, [0.960_566_713, 0.961_232_742, 0.983_249_716]),
        ];
        for (width, height, expected) in cases {
            let reference = picture(width, height, discs);
            for (of, expected) in others.into_iter().zip(expected) {
                let found = ms_ssim(&reference, &picture(width, height, of), width, height).unwrap();
                assert!((found - expected).abs() < 1e-5, "{width}x{height}: {found}, expected {expected}");
            }
            let equal = ms_ssim(&reference, &reference, width, height).unwrap();
            assert!((equal - 1.0).abs() < 1e-12, "{equal}");
        }
    }

    #[test]
    fn small_pictures_have_none() {
        let of = |side: usize| ms_ssim(&vec![0.5; 3 * side * 200], &vec![0.5; 3 * side * 200], side, 200);
        assert_eq!(of(160), None);
        assert!(of(161).is_some_and(|value| (value - 1.0).abs() < 1e-12));
    }

    #[test]
    fn opposite_pictures_have_none_in_common() {
        let of =
            |inverted: bool| picture(176, 176, |c, y, x| if inverted { 255 - discs(c, y, x) } else { discs(c, y, x) });
        assert_eq!(ms_ssim(&of(false), &of(true), 176, 176), Some(0.0));
    }
}

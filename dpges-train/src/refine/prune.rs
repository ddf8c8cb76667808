//! Selects the primitives to keep (GES, DP-GES). A rule that would remove every row removes none and logs a warning: then
//! its threshold is wrong, not the rows.

use dpges_core::footprint::CUTOFF;

/// Scale above which a surfel is removed, extents (GES).
const SURFEL_MAX_SCALE: f64 = 0.06;

/// The surfels to keep: nearest at more than `min_pixels` px in some view (`max_pixels` `[N]` is the
/// largest count over the views), and [small](small_surfels).
pub fn surfels_to_keep(max_pixels: &[u32], log_scales: &[f32], extent: f64, min_pixels: usize) -> Vec<usize> {
    let small = small_surfels(log_scales, extent);
    let stays = |row: &usize| max_pixels[*row] as usize > min_pixels && small.binary_search(row).is_ok();
    kept(max_pixels.len(), stays, "surfel")
}

/// The surfels with both scales of `log_scales` [N × 2] at most 0.06 of the `extent` (world units). An extent of 0, as of a
/// single camera, limits no scale. NaN is too large.
pub fn small_surfels(log_scales: &[f32], extent: f64) -> Vec<usize> {
    let max_scale = if extent > 0.0 { SURFEL_MAX_SCALE * extent } else { f64::MAX };
    let (scales, _) = log_scales.as_chunks::<2>();
    (0..scales.len()).filter(|&row| scales[row].iter().all(|&scale| f64::from(scale).exp() <= max_scale)).collect()
}

/// The Gaussians to keep: `max_contribution` `[M]`, the largest `max|c| α t / (1 + W)` over pixels and
/// views, is at least `threshold`. Gaussians whose contribution is NaN are removed.
pub fn gaussians_to_keep(max_contribution: &[f32], threshold: f64) -> Vec<usize> {
    let stays = |row: &usize| f64::from(max_contribution[*row]) >= threshold;
    kept(max_contribution.len(), stays, "Gaussian")
}

/// The Gaussians that can draw a pixel. α is at most the opacity, and below 1/255 neither colour nor gradient is left.
/// Adam can push linear opacities below 0. The Gaussians that are kept render the same picture.
pub fn drawn(opacities: &[f32]) -> Vec<usize> {
    // rounded like the constant of the kernels, so that what stays is what they draw
    (0..opacities.len()).filter(|&row| opacities[row] >= CUTOFF as f32).collect()
}

/// The rows below `count` that stay, or all if none would.
fn kept(count: usize, stays: impl FnMut(&usize) -> bool, of: &str) -> Vec<usize> {
    let kept: Vec<usize> = (0..count).filter(stays).collect();
    if count > 0 && kept.is_empty() {
        tracing::warn!("pruning would remove each of {count} {of}s: none is removed, see the thresholds in [refine]");
        return (0..count).collect();
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfels_go_when_hardly_seen_or_too_large() {
        let logs: Vec<f32> = [[0.1, 0.1], [0.1, 0.1], [0.7, 0.1], [0.1, 0.7], [0.6, 0.6], [f32::NAN, 0.1]]
            .into_iter()
            .flatten()
            .map(f32::ln)
            .collect();
        assert_eq!(surfels_to_keep(&[17, 16, 99, 99, 99, 99], &logs, 10.01, 16), [0, 4]);
        assert_eq!(surfels_to_keep(&[17, 16, 99, 99, 99, 99], &logs, 0.0, 16), [0, 2, 3, 4]);
    }

    #[test]
    fn gaussians_that_draw_nothing_go() {
        assert_eq!(drawn(&[0.5, 0.0, -0.1, 1.0 / 255.0, 0.0039, 3.0, f32::NAN]), [0, 3, 5]);
        assert!(drawn(&[-1.0]).is_empty());
    }

    #[test]
    fn gaussians_go_when_they_contribute_too_little() {
        assert_eq!(gaussians_to_keep(&[0.02, 0.5, f32::NAN, 0.0], 0.02), [1]);
        assert_eq!(gaussians_to_keep(&[0.5, f32::INFINITY], 0.5), [0, 1]);
    }

    #[test]
    fn never_all() {
        assert_eq!(surfels_to_keep(&[1, 2], &[0.0; 4], 100.0, 16), [0, 1]);
        assert_eq!(gaussians_to_keep(&[0.0; 3], 0.02), [0, 1, 2]);
        assert!(gaussians_to_keep(&[], 0.02).is_empty());
        assert!(surfels_to_keep(&[], &[], 1.0, 16).is_empty());
    }
}

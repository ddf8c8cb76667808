//! How far away what a view shows is.

use dpges_core::camera::Camera;
use dpges_core::scene::tensors::tensor_to_rows;

use super::Rendered;

/// [height × width] see [`TrainingRenderer::render_with_depth`](super::TrainingRenderer::render_with_depth); 0 everywhere for blended
/// and summed Gaussians without maps.
pub(super) fn median_depth(view: &Rendered, camera: &Camera) -> Vec<f32> {
    let area = camera.width * camera.height;
    match view {
        Rendered::Peeled(view) => {
            first_half_opaque(&tensor_to_rows(&view.layers.depth), &tensor_to_rows(&view.seen.weights), area)
        }
        Rendered::Blended(view) => {
            view.blend.maps.as_ref().map_or_else(|| vec![0.0; area], |maps| tensor_to_rows(&maps.median_depth))
        }
        Rendered::Summed(view) => view.depth.as_ref().map_or_else(
            || vec![0.0; area],
            |depth| mean_where_half(&tensor_to_rows(depth), &tensor_to_rows(&view.alpha)),
        ),
    }
}

/// The mean depths of `weighted` depths where `alpha` is at least ½, 0 elsewhere.
fn mean_where_half(weighted: &[f32], alpha: &[f32]) -> Vec<f32> {
    weighted.iter().zip(alpha).map(|(depth, &alpha)| if alpha >= 0.5 { depth / alpha } else { 0.0 }).collect()
}

/// Median depth from layers of `area` pixels: their depth and weight.
fn first_half_opaque(depth: &[f32], weights: &[f32], area: usize) -> Vec<f32> {
    let of_pixel = |pixel: usize| {
        let mut hidden = 0.0;
        let mut layers = (pixel..depth.len()).step_by(area);
        let median = layers.find(|&layer| {
            hidden += weights[layer];
            hidden >= 0.5
        });
        median.map_or(0.0, |layer| depth[layer])
    };
    (0..area).map(of_pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summed_gaussians_are_at_their_mean_depth_where_they_outweigh_the_background() {
        assert_eq!(mean_where_half(&[2.0, 1.5, 0.4, 0.0], &[1.0, 0.5, 0.4, 0.0]), [2.0, 3.0, 0.0, 0.0]);
    }

    #[test]
    fn the_layer_that_hides_half_of_what_is_behind_it_counts() {
        let infinite = f32::INFINITY;
        // the first layer; the second; none, with and without layers
        let depth = [1.0, 2.0, 3.0, infinite, 4.0, 5.0, infinite, infinite];
        let weights = [0.5, 0.25, 0.125, 0.0, 0.25, 0.375, 0.0, 0.0];
        assert_eq!(first_half_opaque(&depth, &weights, 4), [1.0, 5.0, 0.0, 0.0]);
    }
}

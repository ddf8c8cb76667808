//! How far away what a view shows is.

use dpges_core::camera::Camera;
use dpges_core::scene::tensors::tensor_to_rows;

use super::Rendered;

/// [height × width] see [`Renderer::render_with_depth`](super::Renderer::render_with_depth); 0 everywhere for blended
/// Gaussians without maps.
pub(super) fn median_depth(view: &Rendered, camera: &Camera) -> Vec<f32> {
    let area = camera.width * camera.height;
    match view {
        Rendered::Peeled(view) => {
            let (depth, transmittance) =
                (tensor_to_rows(&view.layers.depth), tensor_to_rows(&view.composite.transmittance));
            first_half_opaque(&depth, &transmittance[area..], area)
        }
        Rendered::Blended(view) => {
            view.blend.maps.as_ref().map_or_else(|| vec![0.0; area], |maps| tensor_to_rows(&maps.median_depth))
        }
    }
}

/// Median depth from layers of `area` pixels: their depth, and the transmittance behind each.
fn first_half_opaque(depth: &[f32], behind: &[f32], area: usize) -> Vec<f32> {
    let of_pixel = |pixel: usize| {
        let mut layers = (pixel..depth.len()).step_by(area);
        layers.find(|&layer| behind[layer] <= 0.5).map_or(0.0, |layer| depth[layer])
    };
    (0..area).map(of_pixel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layer_that_hides_half_of_what_is_behind_it_counts() {
        let infinite = f32::INFINITY;
        // the first layer; the second; none, with and without layers
        let depth = [1.0, 2.0, 3.0, infinite, 4.0, 5.0, infinite, infinite];
        let behind = [0.5, 0.75, 0.875, 1.0, 0.25, 0.375, 0.875, 1.0];
        assert_eq!(first_half_opaque(&depth, &behind, 4), [1.0, 5.0, 0.0, 0.0]);
    }
}

//! Losses for geometry: rendered depth and normals should agree with each other (2DGS) and with those of another
//! rendering (DP-GES, geometric regularisation).
//!
//! Depth ([`crate::camera`]) is in world units, [1, H, W], 0 where there is none; normals are [3, H, W].

#[cfg(test)]
mod tests;

use burn::tensor::Tensor;
use burn::tensor::ops::PadMode;

use super::{Mask, mean_of_counted};
use crate::camera::Camera;
use crate::error::Result;
use crate::footprint::rays::rays;
use crate::ops::composite::{self, uploaded};
use crate::render::Render;
use crate::scene::Surfels;
use crate::scene::tensors::check_shape;

/// Weights of the terms of [`geometry()`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometryWeights {
    /// λ4, per world unit of depth.
    pub depth: f64,
    /// λ5 of the blended normals.
    pub normal: f64,
    /// λ6 of the normals of the blended depth.
    pub depth_normal: f64,
}

impl Default for GeometryWeights {
    /// The paper's.
    fn default() -> Self {
        Self { depth: 0.1, normal: 0.05, depth_normal: 0.05 }
    }
}

/// The depth and normals that the surfels should have from one camera.
#[derive(Clone, Debug)]
pub struct Supervision {
    /// [1, H, W] expected depth, world units, 0 where it is unknown
    pub depth: Tensor<3>,
    /// [3, H, W] unit normals in camera axes towards the camera, 0 where they are unknown
    pub normal: Tensor<3>,
}

impl Supervision {
    /// The same, unknown where pixels do not count.
    #[must_use]
    pub fn within(self, mask: &Mask) -> Self {
        Self { depth: mask.filled(self.depth, 0.0), normal: mask.filled(self.normal, 0.0) }
    }
}

/// Unit normals [3, H, W] of the surface at `depth` [1, H, W], in camera axes, towards the camera: the
/// cross product of central differences of un-projected pixel centres (2DGS, "normal consistency").
///
/// A neighbour of depth 0 lies at the camera's centre. Normals are 0 without gradient on the border of
/// the image and where both neighbours in a row or both in a column have no depth.
pub fn normals_from_depth(depth: Tensor<3>, camera: &Camera) -> Tensor<3> {
    let [_, height, width] = depth.dims();
    if height < 3 || width < 3 {
        return Tensor::zeros([3, height, width], (&depth.device(), depth.dtype()));
    }
    if let Some(rays) = rays(camera) {
        return normals_along_rays(depth, &rays);
    }
    let interior_from = |y: usize, x: usize| depth.clone().slice([0..1, y..y + height - 2, x..x + width - 2]);
    let relative_slope = |before: Tensor<3>, after: Tensor<3>, focal_px: f64| {
        let sum = before.clone() + after.clone();
        let missing = sum.clone().lower_equal_elem(0.0);
        ((after - before) / sum.mask_fill(missing.clone(), 1.0) * focal_px, missing)
    };
    let slopes_of = |focal_px: f64, principal_px: f64, shape: [usize; 3]| {
        let count = shape.into_iter().product::<usize>();
        let slopes: Vec<f64> = (0..count).map(|i| (i as f64 + 1.5 - principal_px) / focal_px).collect();
        uploaded(slopes, shape, &depth)
    };
    // With points as depth · ray (x, y, 1) and rays linear in the pixel, the cross product over both sums of depths is
    // (across, down, −(across x + down y + 1)). Its component along the ray is −1, so it never vanishes.
    let (across, missing_across) = relative_slope(interior_from(1, 0), interior_from(1, 2), camera.fx);
    let (down, missing_down) = relative_slope(interior_from(0, 1), interior_from(2, 1), camera.fy);
    let ray_x = slopes_of(camera.fx, camera.cx, [1, 1, width - 2]);
    let ray_y = slopes_of(camera.fy, camera.cy, [1, height - 2, 1]);
    let forward = (across.clone() * ray_x + down.clone() * ray_y + 1.0) * -1.0;
    let squared = across.clone().powi_scalar(2) + down.clone().powi_scalar(2) + forward.clone().powi_scalar(2);
    let inverse_length = squared.sqrt().recip().mask_fill(missing_across.bool_or(missing_down), 0.0);
    (Tensor::cat(vec![across, down, forward], 0) * inverse_length).pad((1, 1, 1, 1), PadMode::Constant(0.0))
}

/// [`normals_from_depth`] through a lens, from the rays [H × W] of the pixels.
fn normals_along_rays(depth: Tensor<3>, rays: &[[f64; 3]]) -> Tensor<3> {
    let [_, height, width] = depth.dims();
    let planes: Vec<f64> = (0..3).flat_map(|axis| rays.iter().map(move |ray| ray[axis])).collect();
    let points = uploaded(planes, [3, height, width], &depth) * depth.clone();
    let between = |image: &Tensor<3>, [y0, x0]: [usize; 2], [y1, x1]: [usize; 2], sign: f64| {
        let channels = image.dims()[0];
        let from = |y: usize, x: usize| image.clone().slice([0..channels, y..y + height - 2, x..x + width - 2]);
        from(y1, x1) + from(y0, x0) * sign
    };
    let across = between(&points, [1, 0], [1, 2], -1.0);
    let down = between(&points, [0, 1], [2, 1], -1.0);
    let missing_across = between(&depth, [1, 0], [1, 2], 1.0).lower_equal_elem(0.0);
    let missing_down = between(&depth, [0, 1], [2, 1], 1.0).lower_equal_elem(0.0);
    let axis = |of: &Tensor<3>, axis: usize| of.clone().slice([axis..axis + 1, 0..height - 2, 0..width - 2]);
    let minor = |i: usize, j: usize| axis(&down, i) * axis(&across, j) - axis(&down, j) * axis(&across, i);
    let normal = Tensor::cat(vec![minor(1, 2), minor(2, 0), minor(0, 1)], 0);
    let squared = normal.clone().powi_scalar(2).sum_dim(0);
    let missing = missing_across.bool_or(missing_down).bool_or(squared.clone().lower_equal_elem(0.0));
    let inverse_length = squared.mask_fill(missing.clone(), 1.0).sqrt().recip().mask_fill(missing, 0.0);
    (normal * inverse_length).pad((1, 1, 1, 1), PadMode::Constant(0.0))
}

/// `Σ w z / Σ w` [1, H, W] from `depth_sum` = Σ w z and `alpha` = Σ w; 0 without gradient where alpha is 0
/// (2DGS, depth maps).
pub fn expected_depth(depth_sum: Tensor<3>, alpha: Tensor<3>) -> Tensor<3> {
    let empty = alpha.clone().lower_equal_elem(0.0);
    (depth_sum / alpha.mask_fill(empty.clone(), 1.0)).mask_fill(empty, 0.0)
}

/// 1 − a · b of two images of normals, [1, H, W].
fn disagreement(a: Tensor<3>, b: Tensor<3>) -> Tensor<3> {
    (a * b).sum_dim(0) * -1.0 + 1.0
}

/// Mean over all pixels that count of `1 − N · Ñ A` (2DGS, "normal consistency"): `normal` N = Σ w n and `depth_normal` Ñ,
/// that of [`normals_from_depth`], in the same axes; `alpha` A [1, H, W] carries no gradient.
pub fn normal_consistency(
    normal: Tensor<3>,
    depth_normal: Tensor<3>,
    alpha: Tensor<3>,
    mask: Option<&Mask>,
) -> Tensor<1> {
    mean_of_counted(disagreement(normal, depth_normal * alpha.detach()), mask)
}

/// `normal` [3, H, W] of world axes in camera axes.
pub fn in_camera_axes(normal: Tensor<3>, camera: &Camera) -> Tensor<3> {
    let shape = normal.dims();
    let columns = uploaded(camera.camera_from_world.rotation.to_cols_array().to_vec(), [3, 3, 1, 1], &normal);
    (columns * normal.unsqueeze_dim::<4>(1)).sum_dim(0).reshape(shape)
}

/// L_geo of one rendered view: `λ4 mean|D − D_s| + λ5 mean(1 − N · N_s) + λ6 mean(1 − N · ∇D_s)`, with D and N the
/// `supervision`, D_s and N_s the depth and normals of the surfels blended like their colours (see
/// [`composite::Geometry`]), ∇D_s by [`normals_from_depth`]; means over all pixels (DP-GES, geometric regularisation).
///
/// Pixels add nothing to the terms they have no supervision for; where there is supervision but ∇D_s is 0, 1 is
/// averaged. Terms with weight 0 are not evaluated.
/// Gradients reach positions, quaternions and log-scales of the `surfels` through opacities, hit depths and normals.
///
/// # Errors
/// [`crate::Error::Shape`] if the supervision does not fit the layers.
pub fn geometry(
    render: &Render,
    surfels: &Surfels,
    camera: &Camera,
    supervision: &Supervision,
    weights: &GeometryWeights,
) -> Result<Tensor<1>> {
    let [_, height, width] = render.layers.alpha.dims();
    check_shape("supervision.depth", &supervision.depth, [1, height, width])?;
    check_shape("supervision.normal", &supervision.normal, [3, height, width])?;
    let blended = composite::geometry(surfels, &render.layers, &render.seen.weights, camera);
    let without_depth = supervision.depth.clone().lower_equal_elem(0.0);
    let without_normal = supervision.normal.clone().powi_scalar(2).sum_dim(0).lower_equal_elem(0.0);
    let from_supervision = |normal: Tensor<3>| {
        disagreement(supervision.normal.clone(), normal).mask_fill(without_normal.clone(), 0.0).mean()
    };
    let mut total = Tensor::<1>::zeros([1], (&blended.depth.device(), blended.depth.dtype()));
    if weights.depth != 0.0 {
        let difference = (blended.depth.clone() - supervision.depth.clone()).abs().mask_fill(without_depth, 0.0);
        total = total + difference.mean() * weights.depth;
    }
    if weights.normal != 0.0 {
        total = total + from_supervision(in_camera_axes(blended.normal, camera)) * weights.normal;
    }
    if weights.depth_normal != 0.0 {
        total = total + from_supervision(normals_from_depth(blended.depth, camera)) * weights.depth_normal;
    }
    Ok(total)
}

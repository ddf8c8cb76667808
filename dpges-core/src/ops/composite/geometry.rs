//! Depth and normal of the surfel layers, blended like their colours. Only geometry losses and pictures use
//! them, so they are plain tensor operations.

use burn::tensor::{Tensor, TensorData};

use crate::camera::Camera;
use crate::counters::transfers::upload;
use crate::ops::peel::Layers;
use crate::scene::Surfels;

/// Blended geometry of one view.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// [1, H, W] `Σ w_i D_i`, world units
    pub depth: Tensor<3>,
    /// [3, H, W] `Σ w_i N_i`, world axes, towards the camera
    pub normal: Tensor<3>,
}

/// A tensor of the type and on the device of `like`.
pub fn uploaded<const D: usize, const L: usize>(values: Vec<f64>, shape: [usize; D], like: &Tensor<L>) -> Tensor<D> {
    let dtype = like.dtype();
    Tensor::from_data(upload(TensorData::new(values, shape).convert_dtype(dtype)), (&like.device(), dtype))
}

/// Unit normals [N, 3] of surfels with `quaternions` [N, 4] in world axes, on the side of their third axis.
pub fn normals(quaternions: &Tensor<2>) -> Tensor<2> {
    let count = quaternions.dims()[0];
    let squared = quaternions.clone().powi_scalar(2).sum_dim(1);
    let zero = squared.clone().lower_equal_elem(1e-24);
    let unit = quaternions.clone() / squared.mask_fill(zero.clone(), 1.0).sqrt();
    let part = |i: usize| unit.clone().slice([0..count, i..i + 1]);
    let (w, x, y, z) = (part(0), part(1), part(2), part(3));
    Tensor::cat(
        vec![
            (x.clone() * z.clone() + w.clone() * y.clone()) * 2.0,
            (y.clone() * z - w * x.clone()) * 2.0,
            (x.clone() * x + y.clone() * y) * -2.0 + 1.0,
        ],
        1,
    )
}

/// [`normals`] of surfels, towards the camera. The side carries no gradient.
fn normals_towards(surfels: &Surfels, camera: &Camera) -> Tensor<2> {
    let column = normals(&surfels.quaternions);
    let centre = uploaded(camera.centre().to_array().to_vec(), [1, 3], &surfels.positions);
    let offset = surfels.positions.clone().detach() - centre;
    let away = (column.clone().detach() * offset).sum_dim(1).greater_elem(0.0);
    let flip =
        column.clone().detach().slice([0..surfels.len(), 0..1]).zeros_like().add_scalar(1.0).mask_fill(away, -1.0);
    column * flip
}

/// `Σ w_i D_i` [1, H, W], world units, of `layers` with their `weights` [K, H, W].
pub fn layer_depth(layers: &Layers, weights: &Tensor<3>) -> Tensor<3> {
    let missing = layers.ids.clone().lower_elem(0);
    (layers.depth.clone().mask_fill(missing, 0.0) * weights.clone()).sum_dim(0)
}

/// Blends depth and normal of `layers` by their `weights` [K, H, W].
pub fn geometry(surfels: &Surfels, layers: &Layers, weights: &Tensor<3>, camera: &Camera) -> Geometry {
    let [count, height, width] = layers.alpha.dims();
    let missing = layers.ids.clone().lower_elem(0);
    let depth = layer_depth(layers, weights);
    if surfels.is_empty() {
        let normal = Tensor::cat(vec![depth.clone(), depth.clone(), depth.clone()], 0);
        return Geometry { depth, normal };
    }
    let rows = layers.ids.clone().mask_fill(missing, 0).reshape([count * height * width]);
    let normals = normals_towards(surfels, camera).select(0, rows).reshape([count, height * width, 3]).swap_dims(1, 2);
    let normal = (normals.reshape([count, 3, height, width]) * weights.clone().unsqueeze_dim(1)).sum_dim(0);
    Geometry { depth, normal: normal.reshape([3, height, width]) }
}

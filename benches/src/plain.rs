//! Compositing and Adam as plain tensor operations, what Burn's autodiff and optimiser would do.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::ops::composite::{Composite, CompositeOptions};
use dpges_core::ops::peel::Layers;

fn constant<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape).convert_dtype(dtype), (device, dtype))
}

/// The outputs of `dpges_core::ops::composite` for at least one surfel.
pub fn composite(layers: &Layers, colours: Tensor<2>, sums: Tensor<4>, options: &CompositeOptions) -> Composite {
    let [count, height, width] = layers.alpha.dims();
    let plane = height * width;
    let through = (layers.alpha.clone() * -1.0 + 1.0).cumprod(0);
    let first = through.clone().slice([0..1, 0..height, 0..width]).detach().full_like(1.0);
    let transmittance = Tensor::cat(vec![first, through], 0);
    let before = transmittance.clone().slice([0..count, 0..height, 0..width]);
    let last = transmittance.clone().slice([count..count + 1, 0..height, 0..width]);
    let rows = layers.ids.clone().clamp_min(0).reshape([count * plane]);
    let layer_colours = colours.clone().select(0, rows).reshape([count, plane, 3]).swap_dims(1, 2);
    let weights = (layers.alpha.clone() * before.clone()).unsqueeze_dim::<4>(1);
    let surfels = (layer_colours.reshape([count, 3, height, width]) * weights).sum_dim(0).reshape([3, height, width]);
    let background = constant(&options.background, [3, 1, 1], &colours.device(), colours.dtype());
    let surfel_image = surfels + last * background;
    let gate = if options.detach_transmittance { before.detach() } else { before };
    let totals = (sums * gate.unsqueeze_dim::<4>(1)).sum_dim(0).reshape([4, height, width]);
    let gaussian_colour = totals.clone().slice([0..3, 0..height, 0..width]);
    let gaussian_weight = totals.slice([3..4, 0..height, 0..width]);
    let image = (surfel_image.clone() + gaussian_colour.clone()) / (gaussian_weight.clone() + 1.0);
    Composite { image, surfel_image, transmittance, gaussian_colour, gaussian_weight }
}

/// One step of `dpges_core::ops::adam`.
pub fn adam_step<const D: usize>(
    parameter: Tensor<D>,
    [moment_1, moment_2]: [Tensor<D>; 2],
    grad: Tensor<D>,
    step: &dpges_core::ops::adam::AdamStep,
) -> (Tensor<D>, [Tensor<D>; 2]) {
    let time = step.time as i32;
    let rate = step.learning_rate / (1.0 - step.beta_1.powi(time));
    let correction = 1.0 / (1.0 - step.beta_2.powi(time)).sqrt();
    let moment_1 = moment_1 * step.beta_1 + grad.clone() * (1.0 - step.beta_1);
    let moment_2 = moment_2 * step.beta_2 + grad.clone() * grad * (1.0 - step.beta_2);
    let change = moment_1.clone() * rate / (moment_2.clone().sqrt() * correction + step.epsilon);
    (parameter - change, [moment_1, moment_2])
}

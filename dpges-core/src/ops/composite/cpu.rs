//! CPU kernels: one task per band of image rows.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use rayon::prelude::*;

use super::{
    CompositeBackwardOps, CompositeGradients, CompositeInput, CompositeOps, CompositeOptions, CompositeOutput,
    OutputGradients, Reached,
};
use crate::backend::host::{self, Host, for_each_cpu_backend, with_real};
use crate::backend::real::Real;
use crate::math::{V3, add, dot, row, scale};
use crate::ops::peel::MAX_LAYERS;
use crate::tiles::bands::{BAND_COUNT, Bands};

struct Inputs<'a, T: Real> {
    layers: usize,
    height: usize,
    width: usize,
    alpha: &'a [T],
    colours: &'a [T],
    sums: &'a [T],
    ids: &'a [i32],
    background: V3<T>,
    detach_transmittance: bool,
}

/// The number of layers for which loops over layers are unrolled, which saves a third of the time: the default.
const UNROLLED: usize = 3;

/// The parts of one pixel. Arrays are filled up to the number of layers: N if that is [`UNROLLED`], or else at most N.
struct Pixel<T, const N: usize> {
    alpha: [T; N],
    colour: [V3<T>; N],
    /// Sums X and Y of each interval.
    payload: [V3<T>; N],
    weight: [T; N],
    /// Of each layer, and behind the last one.
    transmittance: [T; N],
    behind: T,
    surfel_colour: V3<T>,
    gaussian_colour: V3<T>,
    gaussian_weight: T,
}

impl<T: Real, const N: usize> Pixel<T, N> {
    #[inline(always)]
    fn image(&self) -> V3<T> {
        scale(add(self.surfel_colour, self.gaussian_colour), T::one() / (T::one() + self.gaussian_weight))
    }
}

impl<T: Real> Inputs<'_, T> {
    /// Calls `kernel` with the tensors as slices.
    fn with<B: Host, R>(
        input: &CompositeInput<B>,
        options: &CompositeOptions,
        kernel: impl FnOnce(&Inputs<T>) -> R,
    ) -> R {
        let [layers, height, width] = input.alpha.shape().dims();
        kernel(&Inputs {
            layers,
            height,
            width,
            alpha: &host::floats::<B, T>(&input.alpha),
            colours: &host::floats::<B, T>(&input.colours),
            sums: &host::floats::<B, T>(&input.sums),
            ids: &host::ints::<B>(&input.ids),
            background: options.background.map(T::of),
            detach_transmittance: options.detach_transmittance,
        })
    }

    /// The number of layers, known to the compiler where loops are unrolled.
    #[inline(always)]
    fn count<const N: usize>(&self) -> usize {
        if N == UNROLLED { N } else { self.layers }
    }

    /// The pixel at a position within a plane. Its colours and sums are 0 unless they are asked for.
    #[inline(always)]
    fn pixel<const N: usize>(&self, at: usize, colours: bool, sums: bool) -> Pixel<T, N> {
        let plane = self.height * self.width;
        let zero = [T::zero(); 3];
        let mut pixel = Pixel {
            alpha: [T::zero(); N],
            colour: [zero; N],
            payload: [zero; N],
            weight: [T::zero(); N],
            transmittance: [T::one(); N],
            behind: T::one(),
            surfel_colour: zero,
            gaussian_colour: zero,
            gaussian_weight: T::zero(),
        };
        for k in 0..self.count::<N>() {
            let through = pixel.behind;
            pixel.transmittance[k] = through;
            let (alpha, id) = (self.alpha[k * plane + at], self.ids[k * plane + at]);
            let colour = if colours && id >= 0 { row(self.colours, id as usize) } else { zero };
            let sum = |c: usize| if sums { self.sums[(4 * k + c) * plane + at] } else { T::zero() };
            let (payload, weight) = ([sum(0), sum(1), sum(2)], sum(3));
            (pixel.alpha[k], pixel.colour[k], pixel.payload[k], pixel.weight[k]) = (alpha, colour, payload, weight);
            pixel.behind = through * (T::one() - alpha);
            pixel.surfel_colour = add(pixel.surfel_colour, scale(colour, alpha * through));
            pixel.gaussian_colour = add(pixel.gaussian_colour, scale(payload, through));
            pixel.gaussian_weight = pixel.gaussian_weight + through * weight;
        }
        pixel.surfel_colour = add(pixel.surfel_colour, scale(self.background, pixel.behind));
        pixel
    }
}

/// image, surfel image, transmittance, Gaussian colour, Gaussian weight
fn forward<T: Real, const N: usize>(inputs: &Inputs<T>) -> [Vec<T>; 5] {
    let (plane, bands) = (inputs.height * inputs.width, Bands::new(inputs.height));
    let mut out = [3, 3, inputs.layers + 1, 3, 1].map(|planes| vec![T::zero(); planes * plane]);
    let mut parts = out.each_mut().map(|image| bands.split(image, inputs.width).into_iter());
    let tasks: Vec<_> =
        (0..BAND_COUNT).map(|_| parts.each_mut().map(|p| p.next().expect("one part per band"))).collect();
    tasks.into_par_iter().enumerate().for_each(
        |(band, [mut image, mut surfels, mut transmittance, mut colour, mut weight])| {
            for (local, at) in bands.pixels(band, inputs.width).enumerate() {
                let pixel = inputs.pixel::<N>(at, true, true);
                let blended = pixel.image();
                for c in 0..3 {
                    image[c][local] = blended[c];
                    surfels[c][local] = pixel.surfel_colour[c];
                    colour[c][local] = pixel.gaussian_colour[c];
                }
                weight[0][local] = pixel.gaussian_weight;
                for (k, &through) in pixel.transmittance.iter().enumerate().take(inputs.count::<N>()) {
                    transmittance[k][local] = through;
                }
                transmittance[inputs.count::<N>()][local] = pixel.behind;
            }
        },
    );
    out
}

/// Gradients with respect to a pixel's surfel colour, Gaussian colour and Gaussian weight, and directly to its transmittances.
struct Incoming<T, const N: usize> {
    surfel: V3<T>,
    gaussian: V3<T>,
    weight: T,
    transmittance: [T; N],
    behind: T,
}

/// Gradients with respect to the outputs, those that have arrived.
struct Grads<'a, T> {
    image: Option<&'a [T]>,
    surfel_image: Option<&'a [T]>,
    transmittance: Option<&'a [T]>,
    gaussian_colour: Option<&'a [T]>,
    gaussian_weight: Option<&'a [T]>,
}

impl<T: Real> Grads<'_, T> {
    /// Calls `kernel` with the tensors as slices.
    fn with<B: Host, R>(grads: &OutputGradients<B>, kernel: impl FnOnce(&Grads<T>) -> R) -> R {
        let [image, surfel_image, transmittance, gaussian_colour, gaussian_weight] =
            [&grads.image, &grads.surfel_image, &grads.transmittance, &grads.gaussian_colour, &grads.gaussian_weight]
                .map(|grad| grad.as_ref().map(host::floats::<B, T>));
        kernel(&Grads {
            image: image.as_deref(),
            surfel_image: surfel_image.as_deref(),
            transmittance: transmittance.as_deref(),
            gaussian_colour: gaussian_colour.as_deref(),
            gaussian_weight: gaussian_weight.as_deref(),
        })
    }
}

#[inline(always)]
fn incoming<T: Real, const N: usize>(
    inputs: &Inputs<T>,
    pixel: &Pixel<T, N>,
    grads: &Grads<T>,
    at: usize,
) -> Incoming<T, N> {
    let plane = inputs.height * inputs.width;
    let rgb = |grad: &[T]| -> V3<T> { std::array::from_fn(|c| grad[c * plane + at]) };
    let zero = [T::zero(); 3];
    let none = T::zero();
    let mut out = Incoming { surfel: zero, gaussian: zero, weight: none, transmittance: [none; N], behind: none };
    if let Some(grad) = grads.image {
        let blended = scale(rgb(grad), T::one() / (T::one() + pixel.gaussian_weight));
        (out.surfel, out.gaussian, out.weight) = (blended, blended, -dot(blended, pixel.image()));
    }
    if let Some(grad) = grads.surfel_image {
        out.surfel = add(out.surfel, rgb(grad));
    }
    if let Some(grad) = grads.gaussian_colour {
        out.gaussian = add(out.gaussian, rgb(grad));
    }
    if let Some(grad) = grads.gaussian_weight {
        out.weight = out.weight + grad[at];
    }
    if let Some(grad) = grads.transmittance {
        for k in 0..inputs.count::<N>() {
            out.transmittance[k] = grad[k * plane + at];
        }
        out.behind = grad[inputs.count::<N>() * plane + at];
    }
    out
}

/// Gradients with respect to alpha, colours and sums.
fn backward<T: Real, const N: usize>(inputs: &Inputs<T>, grads: &Grads<T>, reached: Reached) -> [Vec<T>; 3] {
    let (layers, plane, bands) = (inputs.count::<N>(), inputs.height * inputs.width, Bands::new(inputs.height));
    let mut grad_alpha = vec![T::zero(); layers * plane];
    let mut grad_sums = vec![T::zero(); if reached.sums() { 4 * layers * plane } else { 0 }];
    let colour_len = if reached.colours() { inputs.colours.len() } else { 0 };
    let alpha_parts = bands.split(&mut grad_alpha, inputs.width);
    let sum_parts = bands.split(&mut grad_sums, inputs.width);
    let partial: Vec<Vec<T>> = alpha_parts
        .into_par_iter()
        .zip(sum_parts)
        .enumerate()
        .map(|(band, (mut alpha, mut sums))| {
            let mut colours = vec![T::zero(); colour_len];
            for (local, at) in bands.pixels(band, inputs.width).enumerate() {
                let pixel = inputs.pixel::<N>(at, reached.colours(), reached.sums());
                let incoming = incoming(inputs, &pixel, grads, at);
                // total derivative with respect to T_k, everything behind included
                let mut behind = incoming.behind + dot(incoming.surfel, inputs.background);
                for k in (0..layers).rev() {
                    let (opacity, through) = (pixel.alpha[k], pixel.transmittance[k]);
                    let own = dot(incoming.surfel, pixel.colour[k]);
                    alpha[k][local] = through * (own - behind);
                    let gated = dot(incoming.gaussian, pixel.payload[k]) + incoming.weight * pixel.weight[k];
                    let gate = if inputs.detach_transmittance { T::zero() } else { gated };
                    behind = incoming.transmittance[k] + gate + opacity * own + (T::one() - opacity) * behind;
                    if reached.sums() {
                        for c in 0..3 {
                            sums[4 * k + c][local] = through * incoming.gaussian[c];
                        }
                        sums[4 * k + 3][local] = through * incoming.weight;
                    }
                    let id = inputs.ids[k * plane + at];
                    if reached.colours() && id >= 0 {
                        for c in 0..3 {
                            let sum = &mut colours[3 * id as usize + c];
                            *sum = *sum + opacity * through * incoming.surfel[c];
                        }
                    }
                }
            }
            colours
        })
        .collect();
    let grad_colours =
        (0..colour_len).into_par_iter().with_min_len(4096).map(|i| partial.iter().map(|band| band[i]).sum()).collect();
    [grad_alpha, grad_colours, grad_sums]
}

fn composite_on<B: Host>(input: &CompositeInput<B>, options: &CompositeOptions) -> CompositeOutput<B> {
    let device = input.alpha.device();
    with_real!(input.alpha.dtype(), T => Inputs::<T>::with(input, options, |inputs| {
        let [image, surfel_image, transmittance, gaussian_colour, gaussian_weight] =
            if inputs.layers == UNROLLED { forward::<T, UNROLLED>(inputs) } else { forward::<T, MAX_LAYERS>(inputs) };
        let tensor = |values: Vec<T>, planes| image_tensor::<B, T>(values, planes, inputs, &device);
        CompositeOutput {
            image: tensor(image, 3),
            surfel_image: tensor(surfel_image, 3),
            transmittance: tensor(transmittance, inputs.layers + 1),
            gaussian_colour: tensor(gaussian_colour, 3),
            gaussian_weight: tensor(gaussian_weight, 1),
        }
    }))
}

fn image_tensor<B: Backend, T: Real>(
    values: Vec<T>,
    planes: usize,
    inputs: &Inputs<T>,
    device: &B::Device,
) -> FloatTensor<B> {
    host::float_tensor::<B, T, 3>(values, [planes, inputs.height, inputs.width], device)
}

fn composite_backward_on<B: Host>(
    input: &CompositeInput<B>,
    grads: &OutputGradients<B>,
    options: &CompositeOptions,
) -> CompositeGradients<B> {
    let (device, reached) = (input.alpha.device(), grads.reached());
    with_real!(input.alpha.dtype(), T => Inputs::<T>::with(input, options, |inputs| {
        let [alpha, colours, sums] = Grads::<T>::with(grads, |grads| {
            if inputs.layers == UNROLLED {
                backward::<T, UNROLLED>(inputs, grads, reached)
            } else {
                backward::<T, MAX_LAYERS>(inputs, grads, reached)
            }
        });
        let (count, sum_layers) = (colours.len() / 3, if reached.sums() { inputs.layers } else { 0 });
        CompositeGradients {
            alpha: image_tensor::<B, T>(alpha, inputs.layers, inputs, &device),
            colours: host::float_tensor::<B, T, 2>(colours, [count, 3], &device),
            sums: host::float_tensor::<B, T, 4>(sums, [sum_layers, 4, inputs.height, inputs.width], &device),
        }
    }))
}

macro_rules! implement {
    ($backend:ty) => {
        impl CompositeOps for $backend {
            fn composite(input: CompositeInput<Self>, options: CompositeOptions) -> CompositeOutput<Self> {
                composite_on::<Self>(&input, &options)
            }
        }

        impl CompositeBackwardOps for $backend {
            fn composite_backward(
                input: CompositeInput<Self>,
                _: FloatTensor<Self>,
                _: FloatTensor<Self>,
                grads: OutputGradients<Self>,
                options: CompositeOptions,
            ) -> CompositeGradients<Self> {
                composite_backward_on::<Self>(&input, &grads, &options)
            }
        }
    };
}
for_each_cpu_backend!(implement);

//! CPU kernels: one task per band of image rows.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::{
    CompositeBackwardOps, CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, CompositeState,
    OutputGradients, Reached,
};
use crate::backend::host::{self, Host, with_real};
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

/// [`OutputGradients`] as slices.
type Grads<'a, T> = [Option<&'a [T]>; 5];

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
    let [of_image, of_surfel_image, of_transmittance, of_colour, of_weight] = *grads;
    let mut out = Incoming { surfel: zero, gaussian: zero, weight: none, transmittance: [none; N], behind: none };
    if let Some(grad) = of_image {
        let blended = scale(rgb(grad), T::one() / (T::one() + pixel.gaussian_weight));
        (out.surfel, out.gaussian, out.weight) = (blended, blended, -dot(blended, pixel.image()));
    }
    if let Some(grad) = of_surfel_image {
        out.surfel = add(out.surfel, rgb(grad));
    }
    if let Some(grad) = of_colour {
        out.gaussian = add(out.gaussian, rgb(grad));
    }
    if let Some(grad) = of_weight {
        out.weight = out.weight + grad[at];
    }
    if let Some(grad) = of_transmittance {
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

impl<B: Host> CompositeOps for B {
    fn composite(input: CompositeInput<B>, options: CompositeOptions) -> CompositeOutput<B> {
        let device = input.alpha.device();
        with_real!(input.alpha.dtype(), T => Inputs::<T>::with(&input, &options, |inputs| {
            let forward = if inputs.layers == UNROLLED { forward::<T, UNROLLED> } else { forward::<T, MAX_LAYERS> };
            let [image, surfel_image, transmittance, gaussian_colour, gaussian_weight] = forward(inputs).map(|values| {
                let shape = [values.len() / (inputs.height * inputs.width), inputs.height, inputs.width];
                host::float_tensor::<B, T, 3>(values, shape, &device)
            });
            CompositeOutput { image, surfel_image, transmittance, gaussian_colour, gaussian_weight }
        }))
    }
}

impl<B: Host> CompositeBackwardOps for B {
    fn composite_backward(state: CompositeState<B>, grads: OutputGradients<B>) -> [Option<FloatTensor<B>>; 3] {
        let CompositeState { input, options, .. } = state;
        let (device, reached) = (input.alpha.device(), Reached::new::<B>(&grads));
        with_real!(input.alpha.dtype(), T => Inputs::<T>::with(&input, &options, |inputs| {
            let grads = grads.each_ref().map(|grad| grad.as_ref().map(host::floats::<B, T>));
            let grads = grads.each_ref().map(Option::as_deref);
            let backward = if inputs.layers == UNROLLED { backward::<T, UNROLLED> } else { backward::<T, MAX_LAYERS> };
            let [alpha, colours, sums] = backward(inputs, &grads, reached);
            let &Inputs { layers, height, width, .. } = inputs;
            let count = colours.len() / 3;
            [
                Some(host::float_tensor::<B, T, 3>(alpha, [layers, height, width], &device)),
                reached.colours().then(|| host::float_tensor::<B, T, 2>(colours, [count, 3], &device)),
                reached.sums().then(|| host::float_tensor::<B, T, 4>(sums, [layers, 4, height, width], &device)),
            ]
        }))
    }
}

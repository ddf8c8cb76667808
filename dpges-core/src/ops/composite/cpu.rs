//! CPU kernels: one task per band of image rows, a vector of pixels at a time.

use std::ops::Range;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::{CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, CompositeState, Grads, Reached};
use crate::backend::host::{self, Host, with_real};
use crate::backend::lanes::Lanes;
use crate::backend::number::Number;
use crate::backend::real::Real;
use crate::backend::tape::BackwardOfAll;
use crate::backend::vectorised::vectorised;
use crate::math::{V3, add, dot, row, scale};
use crate::tiles::bands::{BAND_COUNT, Bands};

struct Inputs<'a, T: Real> {
    layers: usize,
    height: usize,
    width: usize,
    weights: &'a [T],
    transmittance: &'a [T],
    colours: &'a [T],
    sums: &'a [T],
    ids: &'a [i32],
    background: V3<T>,
    detach_transmittance: bool,
}

/// The parts of pixels.
struct Pixel<N> {
    surfel_colour: V3<N>,
    gaussian_colour: V3<N>,
    gaussian_weight: N,
}

impl<N: Number> Pixel<N> {
    #[inline(always)]
    fn image(&self) -> V3<N> {
        // the surfels' picture weighs 1 against the weights of the Gaussians (GES)
        let one = self.gaussian_weight.constant(1.0);
        scale(add(self.surfel_colour, self.gaussian_colour), one / (one + self.gaussian_weight))
    }
}

impl<T: Real> Inputs<'_, T> {
    /// Calls `kernel` with the tensors as slices.
    fn with<B: Host, R>(
        input: &CompositeInput<B>,
        options: &CompositeOptions,
        kernel: impl FnOnce(&Inputs<T>) -> R,
    ) -> R {
        let [layers, height, width] = input.weights.shape().dims();
        kernel(&Inputs {
            layers,
            height,
            width,
            weights: &host::floats::<B, T>(&input.weights),
            transmittance: &host::floats::<B, T>(&input.transmittance),
            colours: &host::floats::<B, T>(&input.colours),
            sums: &host::floats::<B, T>(&input.sums),
            ids: &host::ints::<B>(&input.ids),
            background: options.background.map(T::of),
            detach_transmittance: options.detach_transmittance,
        })
    }

    fn plane(&self) -> usize {
        self.height * self.width
    }

    /// The `pixels`, as many as there are lanes or fewer, of a plane of `values` [P, H, W].
    #[inline(always)]
    fn load<S: Simd>(&self, simd: S, values: &[T], plane: usize, pixels: &Range<usize>) -> Lanes<T, S> {
        Lanes::load_some(simd, &values[plane * self.plane()..][pixels.clone()])
    }

    /// The surfels of layer k; below 0 where there is none.
    #[inline(always)]
    fn ids(&self, k: usize, pixels: &Range<usize>) -> &[i32] {
        &self.ids[k * self.plane()..][pixels.clone()]
    }

    /// Colours of surfels, black where there is none.
    #[inline(always)]
    fn colours<S: Simd>(&self, simd: S, ids: &[i32]) -> V3<Lanes<T, S>> {
        Lanes::from_rows(simd, |lane| {
            let id = ids.get(lane).and_then(|&id| usize::try_from(id).ok());
            id.map_or([T::zero(); 3], |id| row(self.colours, id))
        })
    }

    /// X and Y of interval k.
    #[inline(always)]
    fn sums<S: Simd>(&self, simd: S, k: usize, pixels: &Range<usize>) -> (V3<Lanes<T, S>>, Lanes<T, S>) {
        let sum = {
            #[inline(always)]
            |c: usize| self.load(simd, self.sums, 4 * k + c, pixels)
        };
        ([sum(0), sum(1), sum(2)], sum(3))
    }

    #[inline(always)]
    fn pixel<S: Simd>(&self, simd: S, pixels: &Range<usize>) -> Pixel<Lanes<T, S>> {
        let open = self.load(simd, self.transmittance, self.layers, pixels);
        let mut parts = Pixel {
            surfel_colour: scale(Lanes::splat_three(simd, self.background), open),
            gaussian_colour: [Lanes::zero(simd); 3],
            gaussian_weight: Lanes::zero(simd),
        };
        for k in 0..self.layers {
            let (payload, weight) = self.sums(simd, k, pixels);
            let through = self.load(simd, self.transmittance, k, pixels);
            let ids = self.ids(k, pixels);
            if ids.iter().any(|&id| id >= 0) {
                let colour = scale(self.colours(simd, ids), self.load(simd, self.weights, k, pixels));
                parts.surfel_colour = add(parts.surfel_colour, colour);
            }
            parts.gaussian_colour = add(parts.gaussian_colour, scale(payload, through));
            parts.gaussian_weight = through.mul_add(weight, parts.gaussian_weight);
        }
        parts
    }
}

/// Writes the images of a band.
struct Forward<'a, 'b, T: Real> {
    inputs: &'a Inputs<'a, T>,
    pixels: Range<usize>,
    out: [Vec<&'b mut [T]>; 4],
}

impl<T: Real> WithSimd for Forward<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { inputs, pixels: band, out: [mut image, mut surfels, mut colour, mut weight] } = self;
        let count = T::lane_count::<S>();
        for start in band.clone().step_by(count) {
            let pixels = start..band.end.min(start + count);
            let local = start - band.start..pixels.end - band.start;
            let pixel = inputs.pixel(simd, &pixels);
            let blended = pixel.image();
            for c in 0..3 {
                blended[c].store_some(&mut image[c][local.clone()]);
                pixel.surfel_colour[c].store_some(&mut surfels[c][local.clone()]);
                pixel.gaussian_colour[c].store_some(&mut colour[c][local.clone()]);
            }
            pixel.gaussian_weight.store_some(&mut weight[0][local]);
        }
    }
}

/// image, surfel image, Gaussian colour, Gaussian weight
fn forward<T: Real>(inputs: &Inputs<T>) -> [Vec<T>; 4] {
    let bands = Bands::new(inputs.height);
    let mut out = [3, 3, 3, 1].map(|planes| vec![T::zero(); planes * inputs.plane()]);
    let mut parts = out.each_mut().map(|image| bands.split(image, inputs.width).into_iter());
    let tasks: Vec<_> =
        (0..BAND_COUNT).map(|_| parts.each_mut().map(|p| p.next().expect("one part per band"))).collect();
    tasks.into_par_iter().enumerate().for_each(|(band, out)| {
        vectorised(Forward { inputs, pixels: bands.pixels(band, inputs.width), out });
    });
    out
}

/// Gradients with respect to the surfel colour, Gaussian colour and Gaussian weight of pixels.
struct Incoming<N> {
    surfel: V3<N>,
    gaussian: V3<N>,
    weight: N,
}

/// [`super::Grads`] as slices, with the values that those of the image need.
struct Outputs<'a, T> {
    grads: [Option<&'a [T]>; 4],
    image: &'a [T],
    gaussian_weight: &'a [T],
}

impl<T: Real> Outputs<'_, T> {
    #[inline(always)]
    fn incoming<S: Simd>(&self, simd: S, inputs: &Inputs<T>, pixels: &Range<usize>) -> Incoming<Lanes<T, S>> {
        let rgb = {
            #[inline(always)]
            |values: &[T]| -> V3<Lanes<T, S>> {
                [
                    inputs.load(simd, values, 0, pixels),
                    inputs.load(simd, values, 1, pixels),
                    inputs.load(simd, values, 2, pixels),
                ]
            }
        };
        let (zero, one) = (Lanes::zero(simd), Lanes::splat(simd, T::one()));
        let [of_image, of_surfel_image, of_colour, of_weight] = self.grads;
        let mut out = Incoming { surfel: [zero; 3], gaussian: [zero; 3], weight: zero };
        // outputs that no loss looks at have no gradient, and are left out
        if let Some(grad) = of_image {
            let weight = inputs.load(simd, self.gaussian_weight, 0, pixels);
            let blended = scale(rgb(grad), one / (one + weight));
            // ∂C / ∂W = −C / (1 + W): the picture itself is in it, so that no sum is divided twice
            (out.surfel, out.gaussian, out.weight) = (blended, blended, -dot(blended, rgb(self.image)));
        }
        if let Some(grad) = of_surfel_image {
            out.surfel = add(out.surfel, rgb(grad));
        }
        if let Some(grad) = of_colour {
            out.gaussian = add(out.gaussian, rgb(grad));
        }
        if let Some(grad) = of_weight {
            out.weight = out.weight + inputs.load(simd, grad, 0, pixels);
        }
        out
    }
}

/// Writes the gradients of a band. Those with respect to colours are sums over its pixels.
struct Backward<'a, 'b, T: Real> {
    inputs: &'a Inputs<'a, T>,
    outputs: &'a Outputs<'a, T>,
    reached: Reached,
    pixels: Range<usize>,
    weights: Vec<&'b mut [T]>,
    through: Vec<&'b mut [T]>,
    sums: Vec<&'b mut [T]>,
    colours: &'b mut [T],
}

impl<T: Real> WithSimd for Backward<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { inputs, outputs, reached, pixels: band, mut weights, mut through, mut sums, colours } = self;
        let (layers, count) = (inputs.layers, T::lane_count::<S>());
        let background = Lanes::splat_three(simd, inputs.background);
        for start in band.clone().step_by(count) {
            let pixels = start..band.end.min(start + count);
            let local = start - band.start..pixels.end - band.start;
            let incoming = outputs.incoming(simd, inputs, &pixels);
            // only the background is seen through the last layer
            dot(incoming.surfel, background).store_some(&mut through[layers][local.clone()]);
            for k in 0..layers {
                if reached.sums() {
                    let through_k = inputs.load(simd, inputs.transmittance, k, &pixels);
                    for c in 0..3 {
                        (through_k * incoming.gaussian[c]).store_some(&mut sums[4 * k + c][local.clone()]);
                    }
                    (through_k * incoming.weight).store_some(&mut sums[4 * k + 3][local.clone()]);
                    // an ablation: Gaussians then teach the surfels before them nothing
                    if !inputs.detach_transmittance {
                        let (payload, weight) = inputs.sums(simd, k, &pixels);
                        let of_through = incoming.weight.mul_add(weight, dot(incoming.gaussian, payload));
                        of_through.store_some(&mut through[k][local.clone()]);
                    }
                }
                // a missing layer still lets Gaussians through, whose gradients are above this line
                let ids = inputs.ids(k, &pixels);
                if !reached.surfels() || ids.iter().all(|&id| id < 0) {
                    continue;
                }
                dot(incoming.surfel, inputs.colours(simd, ids)).store_some(&mut weights[k][local.clone()]);
                let grads = Lanes::to_rows(scale(incoming.surfel, inputs.load(simd, inputs.weights, k, &pixels)));
                for (&id, grad) in ids.iter().zip(grads) {
                    let Ok(id) = usize::try_from(id) else { continue };
                    for (sum, grad) in colours[3 * id..3 * id + 3].iter_mut().zip(grad) {
                        *sum = *sum + grad;
                    }
                }
            }
        }
    }
}

/// Gradients with respect to weights, transmittances, colours and sums; empty where nothing reaches them.
fn backward<T: Real>(inputs: &Inputs<T>, outputs: &Outputs<T>, reached: Reached) -> [Vec<T>; 4] {
    let (layers, plane, bands) = (inputs.layers, inputs.plane(), Bands::new(inputs.height));
    let of_surfels = usize::from(reached.surfels()) * layers;
    let of_sums = usize::from(reached.sums()) * layers;
    let mut images = [of_surfels, layers + 1, 4 * of_sums].map(|planes| vec![T::zero(); planes * plane]);
    let colour_len = if reached.surfels() { inputs.colours.len() } else { 0 };
    let [of_weights, of_through, of_sums] = images.each_mut().map(|image| bands.split(image, inputs.width));
    let partial: Vec<Vec<T>> = of_weights
        .into_par_iter()
        .zip(of_through)
        .zip(of_sums)
        .enumerate()
        .map(|(band, ((weights, through), sums))| {
            // each band has sums of its own, added in the order of the bands: the same bits with any number of threads
            let mut colours = vec![T::zero(); colour_len];
            let (pixels, of_colours) = (bands.pixels(band, inputs.width), &mut colours);
            vectorised(Backward { inputs, outputs, reached, pixels, weights, through, sums, colours: of_colours });
            colours
        })
        .collect();
    let colours =
        (0..colour_len).into_par_iter().with_min_len(4096).map(|i| partial.iter().map(|band| band[i]).sum()).collect();
    let [weights, through, sums] = images;
    [weights, through, colours, sums]
}

impl<B: Host> CompositeOps for B {
    fn composite(input: CompositeInput<B>, options: CompositeOptions) -> CompositeOutput<B> {
        let device = input.weights.device();
        with_real!(input.weights.dtype(), T => Inputs::<T>::with(&input, &options, |inputs| {
            let [image, surfel_image, gaussian_colour, gaussian_weight] = forward(inputs).map(|values| {
                let shape = [values.len() / inputs.plane(), inputs.height, inputs.width];
                host::float_tensor::<B, T, 3>(values, shape, &device)
            });
            CompositeOutput { image, surfel_image, gaussian_colour, gaussian_weight }
        }))
    }
}

impl<B: Host> BackwardOfAll<B, 4, 4> for CompositeState<B> {
    fn parents(&self) -> [&FloatTensor<B>; 4] {
        let CompositeInput { weights, transmittance, colours, sums, .. } = &self.input;
        [weights, transmittance, colours, sums]
    }

    fn backward_from(self, grads: Grads<B>) -> [Option<FloatTensor<B>>; 4] {
        let Self { input, options, image, gaussian_weight } = self;
        let (device, reached) = (input.weights.device(), Reached::new::<B>(&grads));
        with_real!(input.weights.dtype(), T => Inputs::<T>::with(&input, &options, |inputs| {
            let grads = grads.each_ref().map(|grad| grad.as_ref().map(host::floats::<B, T>));
            let [image, gaussian_weight] = [&image, &gaussian_weight].map(host::floats::<B, T>);
            let outputs = Outputs { grads: grads.each_ref().map(Option::as_deref), image: &image, gaussian_weight: &gaussian_weight };
            let [weights, through, colours, sums] = backward(inputs, &outputs, reached);
            let &Inputs { layers, height, width, .. } = inputs;
            let count = colours.len() / 3;
            let planes = |values: Vec<T>, planes: usize| host::float_tensor::<B, T, 3>(values, [planes, height, width], &device);
            [
                reached.surfels().then(|| planes(weights, layers)),
                Some(planes(through, layers + 1)),
                reached.surfels().then(|| host::float_tensor::<B, T, 2>(colours, [count, 3], &device)),
                reached.sums().then(|| host::float_tensor::<B, T, 4>(sums, [layers, 4, height, width], &device)),
            ]
        }))
    }
}

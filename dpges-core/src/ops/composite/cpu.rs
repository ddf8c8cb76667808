//! CPU kernels: one task per band of image rows.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::{CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, CompositeState, Grads, Reached};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::WayBackFromAll;
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

/// The parts of one pixel.
struct Pixel<T> {
    surfel_colour: V3<T>,
    gaussian_colour: V3<T>,
    gaussian_weight: T,
}

impl<T: Real> Pixel<T> {
    #[inline(always)]
    fn image(&self) -> V3<T> {
        // the surfels' picture weighs 1 against the weights of the Gaussians (GES)
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

    /// Colour of layer k, black if there is none.
    #[inline(always)]
    fn colour(&self, k: usize, pixel: usize) -> V3<T> {
        usize::try_from(self.ids[k * self.plane() + pixel]).map_or([T::zero(); 3], |id| row(self.colours, id))
    }

    /// X and Y of interval k.
    #[inline(always)]
    fn sums(&self, k: usize, pixel: usize) -> (V3<T>, T) {
        let sum = |c: usize| self.sums[(4 * k + c) * self.plane() + pixel];
        ([sum(0), sum(1), sum(2)], sum(3))
    }

    #[inline(always)]
    fn pixel(&self, pixel: usize) -> Pixel<T> {
        let plane = self.plane();
        let open = self.transmittance[self.layers * plane + pixel];
        let mut parts = Pixel {
            surfel_colour: scale(self.background, open),
            gaussian_colour: [T::zero(); 3],
            gaussian_weight: T::zero(),
        };
        for k in 0..self.layers {
            let at = k * plane + pixel;
            let (through, (payload, weight)) = (self.transmittance[at], self.sums(k, pixel));
            parts.surfel_colour = add(parts.surfel_colour, scale(self.colour(k, pixel), self.weights[at]));
            parts.gaussian_colour = add(parts.gaussian_colour, scale(payload, through));
            parts.gaussian_weight = parts.gaussian_weight + through * weight;
        }
        parts
    }
}

/// image, surfel image, Gaussian colour, Gaussian weight
fn forward<T: Real>(inputs: &Inputs<T>) -> [Vec<T>; 4] {
    let bands = Bands::new(inputs.height);
    let mut out = [3, 3, 3, 1].map(|planes| vec![T::zero(); planes * inputs.plane()]);
    let mut parts = out.each_mut().map(|image| bands.split(image, inputs.width).into_iter());
    let tasks: Vec<_> =
        (0..BAND_COUNT).map(|_| parts.each_mut().map(|p| p.next().expect("one part per band"))).collect();
    tasks.into_par_iter().enumerate().for_each(|(band, [mut image, mut surfels, mut colour, mut weight])| {
        for (local, at) in bands.pixels(band, inputs.width).enumerate() {
            let pixel = inputs.pixel(at);
            let blended = pixel.image();
            for c in 0..3 {
                image[c][local] = blended[c];
                surfels[c][local] = pixel.surfel_colour[c];
                colour[c][local] = pixel.gaussian_colour[c];
            }
            weight[0][local] = pixel.gaussian_weight;
        }
    });
    out
}

/// Gradients with respect to a pixel's surfel colour, Gaussian colour and Gaussian weight.
struct Incoming<T> {
    surfel: V3<T>,
    gaussian: V3<T>,
    weight: T,
}

/// [`super::Grads`] as slices, with the values that those of the image need.
struct Outputs<'a, T> {
    grads: [Option<&'a [T]>; 4],
    image: &'a [T],
    gaussian_weight: &'a [T],
}

impl<T: Real> Outputs<'_, T> {
    #[inline(always)]
    fn incoming(&self, at: usize) -> Incoming<T> {
        let plane = self.gaussian_weight.len();
        let rgb = |values: &[T]| -> V3<T> { std::array::from_fn(|c| values[c * plane + at]) };
        let zero = [T::zero(); 3];
        let [of_image, of_surfel_image, of_colour, of_weight] = self.grads;
        let mut out = Incoming { surfel: zero, gaussian: zero, weight: T::zero() };
        // outputs that no loss looks at have no gradient, and are left out
        if let Some(grad) = of_image {
            let blended = scale(rgb(grad), T::one() / (T::one() + self.gaussian_weight[at]));
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
            out.weight = out.weight + grad[at];
        }
        out
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
        .map(|(band, ((mut weights, mut through), mut sums))| {
            // each band has sums of its own, added in the order of the bands: the same bits with any number of threads
            let mut colours = vec![T::zero(); colour_len];
            for (local, pixel) in bands.pixels(band, inputs.width).enumerate() {
                let incoming = outputs.incoming(pixel);
                // only the background is seen through the last layer
                through[layers][local] = dot(incoming.surfel, inputs.background);
                for k in 0..layers {
                    let at = k * plane + pixel;
                    if reached.sums() {
                        let through_k = inputs.transmittance[at];
                        for c in 0..3 {
                            sums[4 * k + c][local] = through_k * incoming.gaussian[c];
                        }
                        sums[4 * k + 3][local] = through_k * incoming.weight;
                        // an ablation: Gaussians then teach the surfels before them nothing
                        if !inputs.detach_transmittance {
                            let (payload, weight) = inputs.sums(k, pixel);
                            through[k][local] = dot(incoming.gaussian, payload) + incoming.weight * weight;
                        }
                    }
                    // a missing layer still lets Gaussians through, whose gradients are above this line
                    let Ok(id) = usize::try_from(inputs.ids[at]) else { continue };
                    if reached.surfels() {
                        weights[k][local] = dot(incoming.surfel, row(inputs.colours, id));
                        for c in 0..3 {
                            let sum = &mut colours[3 * id + c];
                            *sum = *sum + inputs.weights[at] * incoming.surfel[c];
                        }
                    }
                }
            }
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

impl<B: Host> WayBackFromAll<B, 4, 4> for CompositeState<B> {
    fn parents(&self) -> [&FloatTensor<B>; 4] {
        let CompositeInput { weights, transmittance, colours, sums, .. } = &self.input;
        [weights, transmittance, colours, sums]
    }

    fn go_back_from(self, grads: Grads<B>) -> [Option<FloatTensor<B>>; 4] {
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

//! CPU kernels: one task per run of pixels.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::autodiff::SurfelLossState;
use super::{FEWEST_LAYERS, SurfelLossInput, SurfelLossOps, SurfelLossOutput, SurfelLossWeights};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;

/// Pixels of a task.
const CHUNK: usize = 1 << 12;

struct Inputs<'a, T: Real> {
    /// H · W
    plane: usize,
    image: &'a [T],
    target: &'a [T],
    /// Behind the last layer.
    transmittance: &'a [T],
    /// Second layers; `None` if there is only one.
    second: Option<&'a [i32]>,
    ignored: Option<&'a [T]>,
}

impl<T: Real> Inputs<'_, T> {
    /// Calls `kernel` with the tensors as slices.
    fn with<B: Host, R>(input: &SurfelLossInput<B>, masked: bool, kernel: impl FnOnce(&Inputs<T>) -> R) -> R {
        let [layers, height, width] = input.ids.shape().dims();
        let plane = height * width;
        let ids = host::ints::<B>(&input.ids);
        let ignored = masked.then(|| host::floats::<B, T>(&input.ignored));
        kernel(&Inputs {
            plane,
            image: &host::floats::<B, T>(&input.image),
            target: &host::floats::<B, T>(&input.target),
            transmittance: &host::floats::<B, T>(&input.transmittance)[layers * plane..],
            second: (layers >= FEWEST_LAYERS).then(|| &ids[plane..2 * plane]),
            ignored: ignored.as_deref(),
        })
    }

    fn counts(&self, pixel: usize) -> bool {
        self.ignored.is_none_or(|ignored| ignored[pixel] <= T::of(0.5))
    }

    /// Whether L_t looks at the pixel.
    fn covered(&self, pixel: usize) -> bool {
        self.second.is_some_and(|second| second[pixel] >= 0) && self.counts(pixel)
    }

    fn difference(&self, at: usize) -> T {
        self.image[at] - self.target[at]
    }
}

/// Shares of a pixel in L_s, where it has three channels, and in L_t.
fn shares(plane: usize, weights: &SurfelLossWeights) -> [f64; 2] {
    let pixel = weights.pixels_per_counted / plane as f64;
    [pixel / 3.0, pixel]
}

/// L_s and L_t.
fn forward<T: Real>(inputs: &Inputs<T>, weights: &SurfelLossWeights) -> [T; 2] {
    let sums = |chunk: usize| {
        let pixels = chunk * CHUNK..inputs.plane.min((chunk + 1) * CHUNK);
        pixels.fold([T::zero(); 2], |[differences, hidden], pixel| {
            let absolute = |channel: usize| inputs.difference(channel * inputs.plane + pixel).abs();
            let difference = if inputs.counts(pixel) { absolute(0) + absolute(1) + absolute(2) } else { T::zero() };
            let opaque = if inputs.covered(pixel) { T::one() - inputs.transmittance[pixel] } else { T::zero() };
            [differences + difference, hidden + opaque * opaque]
        })
    };
    // collected by chunk and added in their order: the same bits with any number of threads
    let sums: Vec<[T; 2]> = (0..inputs.plane.div_ceil(CHUNK)).into_par_iter().map(sums).collect();
    let shares = shares(inputs.plane, weights);
    [0, 1].map(|which| sums.iter().map(|sums| sums[which]).sum::<T>() * T::of(shares[which]))
}

/// Gradients with respect to the image and to the transmittance; `None` of a term of weight 0.
fn backward<T: Real>(inputs: &Inputs<T>, layers: usize, grad: T, weights: &SurfelLossWeights) -> [Option<Vec<T>>; 2] {
    let (plane, [image, transmittance]) = (inputs.plane, shares(inputs.plane, weights));
    let (image, transmittance) =
        (grad * T::of(weights.image * image), grad * T::of(weights.transmittance * transmittance));
    let of_image = |at: usize| {
        let difference = inputs.difference(at);
        // `signum` of 0.0 is 1
        let is_level = difference == T::zero() || !inputs.counts(at % plane);
        if is_level { T::zero() } else { image * difference.signum() }
    };
    let of_transmittance = |at: usize| {
        let (plane_of, pixel) = (at / plane, at % plane);
        let is_last = plane_of == layers && inputs.covered(pixel);
        if is_last { -T::of(2.0) * transmittance * (T::one() - inputs.transmittance[pixel]) } else { T::zero() }
    };
    let places = |planes: usize| (0..planes * plane).into_par_iter().with_min_len(CHUNK);
    [
        (weights.image != 0.0).then(|| places(3).map(of_image).collect()),
        (weights.transmittance != 0.0).then(|| places(layers + 1).map(of_transmittance).collect()),
    ]
}

/// The summand of a term of this weight.
fn term<T: Real>(value: T, weight: f64) -> T {
    // 0 times what is not finite is NaN
    if weight == 0.0 { T::zero() } else { value * T::of(weight) }
}

impl<B: Host> SurfelLossOps for B {
    fn surfel_loss(input: SurfelLossInput<B>, weights: SurfelLossWeights, masked: bool) -> SurfelLossOutput<B> {
        let device = input.image.device();
        with_real!(input.image.dtype(), T => {
            let [image, transmittance] = Inputs::<T>::with(&input, masked, |inputs| forward(inputs, &weights));
            let weighted = term(image, weights.image) + term(transmittance, weights.transmittance);
            let [weighted, image, transmittance] = [weighted, image, transmittance]
                .map(|value| host::float_tensor::<B, T, 1>(vec![value], [1], &device));
            SurfelLossOutput { weighted, image, transmittance }
        })
    }
}

impl<B: Host> BackwardState<B, 2> for SurfelLossState<B> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 2] {
        let Self { input, weights, masked } = self;
        let ([layers, height, width], device) = (input.ids.shape().dims(), input.image.device());
        with_real!(input.image.dtype(), T => {
            let grad = host::floats::<B, T>(&grad)[0];
            Inputs::<T>::with(&input, masked, |inputs| backward(inputs, layers, grad, &weights)).map(|values| {
                let values = values?;
                let planes = values.len() / (height * width);
                Some(host::float_tensor::<B, T, 3>(values, [planes, height, width], &device))
            })
        })
    }
}

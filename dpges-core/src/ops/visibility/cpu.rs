//! CPU kernels: one task per band of image rows.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::autodiff::Grads;
use super::{VisibilityInput, VisibilityOps, VisibilityOutput, VisibilityState};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::WayBackFromAll;
use crate::ops::peel::MAX_LAYERS;
use crate::scene::Peeling;
use crate::scene::peeling::{ORDER, RAMP, STEP};
use crate::tiles::bands::{BAND_COUNT, Bands};

struct Inputs<'a, T: Real> {
    layers: usize,
    height: usize,
    width: usize,
    alpha: &'a [T],
    depth: &'a [T],
    ids: &'a [i32],
    margins: &'a [T],
    peeling: Peeling,
}

/// The layers of a pixel: the first `count` of every array.
struct Stack<T> {
    count: usize,
    alpha: [T; MAX_LAYERS],
    depth: [T; MAX_LAYERS],
    margin: [T; MAX_LAYERS],
    /// T_0 to T_count.
    through: [T; MAX_LAYERS + 1],
}

impl<T: Real> Inputs<'_, T> {
    /// Calls `kernel` with the tensors as slices.
    fn with<B: Host, R>(input: &VisibilityInput<B>, peeling: Peeling, kernel: impl FnOnce(&Inputs<T>) -> R) -> R {
        let [layers, height, width] = input.alpha.shape().dims();
        kernel(&Inputs {
            layers,
            height,
            width,
            alpha: &host::floats::<B, T>(&input.alpha),
            depth: &host::floats::<B, T>(&input.depth),
            ids: &host::ints::<B>(&input.ids),
            margins: &host::floats::<B, T>(&input.margins),
            peeling,
        })
    }

    #[inline(always)]
    fn stack(&self, pixel: usize) -> Stack<T> {
        let (zero, one) = (T::zero(), T::one());
        let mut stack = Stack {
            count: 0,
            alpha: [zero; MAX_LAYERS],
            depth: [zero; MAX_LAYERS],
            margin: [zero; MAX_LAYERS],
            through: [one; MAX_LAYERS + 1],
        };
        for k in 0..self.layers {
            let at = k * self.height * self.width + pixel;
            let Ok(id) = usize::try_from(self.ids[at]) else { break };
            (stack.alpha[k], stack.depth[k], stack.margin[k]) = (self.alpha[at], self.depth[at], self.margins[id]);
            stack.through[k + 1] = stack.through[k] * (one - self.alpha[at]);
            stack.count = k + 1;
        }
        stack
    }
}

impl<T: Real> Stack<T> {
    /// Share of layer i that is behind layer j, and its derivative with respect to the depth of i; that to the depth of j is the
    /// opposite.
    #[inline(always)]
    fn behind(&self, i: usize, j: usize) -> [T; 2] {
        let (zero, one, half) = (T::zero(), T::one(), T::of(0.5));
        let reach = T::of(ORDER) * self.margin[i].min(self.margin[j]);
        let distance = self.depth[i] - self.depth[j];
        // not divided before it is known to be within reach: a margin of 0 leaves the order of the list
        if distance.abs() < reach {
            let slope = half / reach;
            [half + distance * slope, slope]
        } else {
            [if i > j { one } else { zero }, zero]
        }
    }

    /// `Π (1 − A_j s_ij)` over all j but i and `skipped`.
    #[inline(always)]
    fn left(&self, i: usize, skipped: usize) -> T {
        // products of the others, in place of a division by 1 − A, which is 0 for a core
        let others = (0..self.count).filter(|&j| j != i && j != skipped);
        others.fold(T::one(), |left, j| left * (T::one() - self.alpha[j] * self.behind(i, j)[0]))
    }

    /// Weights before they are scaled, their sum, and the factor.
    #[inline(always)]
    fn unscaled(&self) -> ([T; MAX_LAYERS], T, T) {
        let mut weights = [T::zero(); MAX_LAYERS];
        for (i, weight) in weights[..self.count].iter_mut().enumerate() {
            *weight = self.alpha[i] * self.left(i, i);
        }
        let total = weights[..self.count].iter().fold(T::zero(), |sum, &weight| sum + weight);
        // the products of three and more close layers do not add up to what these hide
        let hidden = T::one() - self.through[self.count];
        (weights, total, if total > T::zero() { hidden / total } else { T::zero() })
    }

    /// Whether any two layers are closer than their order is certain. Elsewhere, as in most pixels, they weigh as in strict order.
    #[inline(always)]
    fn is_soft(&self, peeling: Peeling) -> bool {
        let mut others = 1..self.count;
        peeling.is_continuous() && others.any(|i| (0..i).any(|j| self.behind(i, j)[1] > T::zero()))
    }

    /// The weights of the layers in the surfel image.
    #[inline(always)]
    fn weights(&self, peeling: Peeling) -> [T; MAX_LAYERS] {
        if !self.is_soft(peeling) {
            return std::array::from_fn(|k| self.alpha[k] * self.through[k]);
        }
        let (weights, _, factor) = self.unscaled();
        weights.map(|weight| weight * factor)
    }

    /// The limits of the layers, and the slope.
    #[inline(always)]
    fn limits(&self, weights: &[T; MAX_LAYERS], peeling: Peeling, layers: usize) -> ([T; MAX_LAYERS], T) {
        let mut limits = [T::INFINITY; MAX_LAYERS];
        let core = (0..self.count).find(|&k| self.alpha[k] >= T::one());
        if peeling.is_continuous() {
            let sum = |of: &dyn Fn(usize) -> T| (0..self.count).fold(T::zero(), |sum, k| sum + of(k));
            let total = sum(&|k| weights[k]);
            // one margin for the pixel: layers that change places end their intervals at one depth
            let margin = if total > T::zero() { sum(&|k| weights[k] * self.margin[k]) / total } else { T::zero() };
            let end = |k: usize| self.depth[k] + margin * T::of(1.0 + 0.5 * RAMP);
            // nothing is seen behind a core
            for (k, limit) in limits[..self.count].iter_mut().enumerate() {
                *limit = end(core.map_or(k, |core| core.min(k)));
            }
            if let Some(core) = core {
                limits[core..layers].fill(end(core));
            }
            // a margin of 0 has a step, whose slope is finite
            return (limits, T::one() / (T::of(RAMP) * margin).max(T::of(1.0 / STEP)));
        }
        let shifted = |k: usize| self.depth[k] + self.margin[k];
        let is_closed = core.is_some() || self.count == layers;
        let cap = if is_closed { shifted(self.count - 1) } else { T::INFINITY };
        let mut reached = -T::INFINITY;
        for (k, limit) in limits[..layers].iter_mut().enumerate() {
            let end = match peeling {
                _ if k >= self.count => T::INFINITY,
                // only the cap ends the last interval
                Peeling::Literal if k + 1 == layers => T::INFINITY,
                Peeling::Literal => self.depth[k],
                _ => shifted(k),
            };
            // limits ascend, or an interval would be shorter than nothing
            reached = reached.max(end);
            *limit = reached.min(cap);
        }
        (limits, T::of(STEP))
    }

    /// Gradients with respect to opacities and depths, from those with respect to weights and transmittances.
    #[inline(always)]
    fn backward(&self, of_weights: &[T; MAX_LAYERS], of_through: &[T], peeling: Peeling) -> [[T; MAX_LAYERS]; 2] {
        let (zero, one, count) = (T::zero(), T::one(), self.count);
        let (mut alpha, mut depth) = ([zero; MAX_LAYERS], [zero; MAX_LAYERS]);
        // total derivative with respect to T_k, everything behind included; layers that are missing leave T as it is
        let mut behind = of_through[count..].iter().fold(zero, |sum, &grad| sum + grad);
        let soft = self.is_soft(peeling);
        let (weights, total, factor) = if soft { self.unscaled() } else { ([zero; MAX_LAYERS], zero, zero) };
        // of the hidden share 1 − T_K
        let mut mean = zero;
        if soft && total > zero {
            mean = (0..count).fold(zero, |sum, k| sum + of_weights[k] * weights[k]) / total;
            behind = behind - mean;
        }
        for k in (0..count).rev() {
            let own = if soft { zero } else { of_weights[k] };
            alpha[k] = self.through[k] * (own - behind);
            behind = of_through[k] + self.alpha[k] * own + (one - self.alpha[k]) * behind;
        }
        for i in (0..count).filter(|_| soft) {
            let unscaled = factor * (of_weights[i] - mean);
            alpha[i] = alpha[i] + unscaled * self.left(i, i);
            for j in (0..count).filter(|&j| j != i) {
                let [share, slope] = self.behind(i, j);
                let others = unscaled * self.alpha[i] * self.left(i, j);
                alpha[j] = alpha[j] - others * share;
                let steepness = others * self.alpha[j] * slope;
                depth[i] = depth[i] - steepness;
                depth[j] = depth[j] + steepness;
            }
        }
        [alpha, depth]
    }
}

/// weights, transmittance, limits
fn forward<T: Real>(inputs: &Inputs<T>) -> [Vec<T>; 3] {
    let (layers, plane, bands) = (inputs.layers, inputs.height * inputs.width, Bands::new(inputs.height));
    // those of a pixel without layers
    let mut out = [(layers, T::zero()), (layers + 1, T::one()), (layers + 1, T::INFINITY)]
        .map(|(planes, value)| vec![value; planes * plane]);
    let mut parts = out.each_mut().map(|image| bands.split(image, inputs.width).into_iter());
    let tasks: Vec<_> =
        (0..BAND_COUNT).map(|_| parts.each_mut().map(|p| p.next().expect("one part per band"))).collect();
    tasks.into_par_iter().enumerate().for_each(|(band, [mut weights, mut transmittance, mut limits])| {
        for (local, pixel) in bands.pixels(band, inputs.width).enumerate() {
            if inputs.ids[pixel] < 0 {
                limits[layers][local] = T::of(STEP);
                continue;
            }
            let stack = inputs.stack(pixel);
            let own = stack.weights(inputs.peeling);
            let (ends, slope) = stack.limits(&own, inputs.peeling, layers);
            for k in 0..layers {
                weights[k][local] = own[k];
                limits[k][local] = ends[k];
            }
            for (k, through) in transmittance.iter_mut().enumerate() {
                through[local] = stack.through[k.min(stack.count)];
            }
            limits[layers][local] = slope;
        }
    });
    out
}

/// Gradients with respect to alpha and depth, [K, H, W].
fn backward<T: Real>(inputs: &Inputs<T>, grads: [Option<&[T]>; 2]) -> [Vec<T>; 2] {
    let (layers, plane, bands) = (inputs.layers, inputs.height * inputs.width, Bands::new(inputs.height));
    let mut out = [(); 2].map(|()| vec![T::zero(); layers * plane]);
    let [of_alpha, of_depth] = out.each_mut().map(|image| bands.split(image, inputs.width));
    of_alpha.into_par_iter().zip(of_depth).enumerate().for_each(|(band, (mut alpha, mut depth))| {
        let (mut of_weights, mut of_through) = ([T::zero(); MAX_LAYERS], [T::zero(); MAX_LAYERS + 1]);
        for (local, pixel) in bands.pixels(band, inputs.width).enumerate() {
            if inputs.ids[pixel] < 0 {
                continue;
            }
            let stack = inputs.stack(pixel);
            let read = |grads: Option<&[T]>, into: &mut [T]| {
                let Some(grads) = grads else { return };
                into.iter_mut().enumerate().for_each(|(k, grad)| *grad = grads[k * plane + pixel]);
            };
            read(grads[0], &mut of_weights[..layers]);
            read(grads[1], &mut of_through[..=layers]);
            let [own_alpha, own_depth] = stack.backward(&of_weights, &of_through[..=layers], inputs.peeling);
            for k in 0..stack.count {
                (alpha[k][local], depth[k][local]) = (own_alpha[k], own_depth[k]);
            }
        }
    });
    out
}

impl<B: Host> VisibilityOps for B {
    fn visibility(input: VisibilityInput<B>, peeling: Peeling) -> VisibilityOutput<B> {
        let device = input.alpha.device();
        with_real!(input.alpha.dtype(), T => Inputs::<T>::with(&input, peeling, |inputs| {
            let [weights, transmittance, limits] = forward(inputs).map(|values| {
                let shape = [values.len() / (inputs.height * inputs.width), inputs.height, inputs.width];
                host::float_tensor::<B, T, 3>(values, shape, &device)
            });
            VisibilityOutput { weights, transmittance, limits }
        }))
    }
}

impl<B: Host> WayBackFromAll<B, 2, 2> for VisibilityState<B> {
    fn parents(&self) -> [&FloatTensor<B>; 2] {
        [&self.input.alpha, &self.input.depth]
    }

    fn go_back_from(self, grads: Grads<B>) -> [Option<FloatTensor<B>>; 2] {
        let (input, device) = (&self.input, self.input.alpha.device());
        with_real!(input.alpha.dtype(), T => Inputs::<T>::with(input, self.peeling, |inputs| {
            let grads = grads.each_ref().map(|grad| grad.as_ref().map(host::floats::<B, T>));
            let shape = [inputs.layers, inputs.height, inputs.width];
            let found = backward(inputs, grads.each_ref().map(Option::as_deref));
            found.map(|values| Some(host::float_tensor::<B, T, 3>(values, shape, &device)))
        }))
    }
}

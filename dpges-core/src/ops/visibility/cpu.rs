//! CPU kernels: one task per band of image rows, a vector of pixels at a time.

use std::ops::Range;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::autodiff::Grads;
use super::{VisibilityInput, VisibilityOps, VisibilityOutput, VisibilityState};
use crate::backend::host::{self, Host, with_real};
use crate::backend::lanes::Lanes;
use crate::backend::number::Number;
use crate::backend::real::Real;
use crate::backend::tape::BackwardOfAll;
use crate::backend::vectorised::vectorised;
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

/// The layers of as many pixels as there are lanes. Those that are missing have opacity, depth and margin 0.
struct Stack<N> {
    /// Layers of the pixel that has most.
    deepest: usize,
    /// Of each pixel.
    count: N,
    alpha: [N; MAX_LAYERS],
    depth: [N; MAX_LAYERS],
    margin: [N; MAX_LAYERS],
    /// T_0 to T_deepest.
    through: [N; MAX_LAYERS + 1],
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
    fn stack<S: Simd>(&self, simd: S, pixels: &Range<usize>) -> Stack<Lanes<T, S>> {
        let (zero, one) = (Lanes::zero(simd), Lanes::splat(simd, T::one()));
        let mut stack = Stack {
            deepest: 0,
            count: zero,
            alpha: [zero; MAX_LAYERS],
            depth: [zero; MAX_LAYERS],
            margin: [zero; MAX_LAYERS],
            through: [one; MAX_LAYERS + 1],
        };
        for k in 0..self.layers {
            let at = k * self.height * self.width;
            let at = at + pixels.start..at + pixels.end;
            let ids = &self.ids[at.clone()];
            // what lies behind the last layer of all these pixels is not looked at
            if ids.iter().all(|&id| id < 0) {
                break;
            }
            let [margin, present] = Lanes::from_rows(simd, |lane| {
                let id = ids.get(lane).and_then(|&id| usize::try_from(id).ok());
                id.map_or([T::zero(); 2], |id| [self.margins[id], T::one()])
            });
            let is_present = zero.below(present);
            stack.alpha[k] = Lanes::load_some(simd, &self.alpha[at.clone()]).only(is_present);
            // not infinite, as that of a missing layer is: differences of two of them would not be numbers
            stack.depth[k] = Lanes::load_some(simd, &self.depth[at]).only(is_present);
            stack.margin[k] = margin;
            stack.through[k + 1] = stack.through[k] * (one - stack.alpha[k]);
            stack.count = stack.count + present;
            stack.deepest = k + 1;
        }
        stack
    }
}

impl<N: Number> Stack<N> {
    /// Where layer k is there.
    #[inline(always)]
    fn has(&self, k: usize) -> N::Mask {
        self.count.constant(k as f64).below(self.count)
    }

    /// Share of layer i that is behind layer j, and its derivative with respect to the depth of i; that to the depth of j is the
    /// opposite.
    #[inline(always)]
    fn behind(&self, i: usize, j: usize) -> [N; 2] {
        let (distance, is_close, reach) = self.distance(i, j);
        let half = reach.constant(0.5);
        // a margin of 0 leaves the order of the list
        let slope = N::select(is_close, half / reach, reach.constant(0.0));
        let order = reach.constant(if i > j { 1.0 } else { 0.0 });
        [N::select(is_close, half + distance * slope, order), slope]
    }

    /// From layer j to layer i, whether that is within reach, and the reach.
    #[inline(always)]
    fn distance(&self, i: usize, j: usize) -> (N, N::Mask, N) {
        let reach = self.count.constant(ORDER) * self.margin[i].min(self.margin[j]);
        let distance = self.depth[i] - self.depth[j];
        (distance, distance.abs().below(reach), reach)
    }

    /// `Π (1 − A_j s_ij)` over all j but i and `skipped`.
    #[inline(always)]
    fn left(&self, i: usize, skipped: usize) -> N {
        let one = self.count.constant(1.0);
        let mut left = one;
        for j in (0..self.deepest).filter(|&j| j != i && j != skipped) {
            // products of the others, in place of a division by 1 − A, which is 0 for a core
            left = left * (one - self.alpha[j] * self.behind(i, j)[0]);
        }
        left
    }

    /// Weights before they are scaled, their sum, and the factor.
    #[inline(always)]
    fn unscaled(&self) -> ([N; MAX_LAYERS], N, N) {
        let (zero, one) = (self.count.constant(0.0), self.count.constant(1.0));
        let (mut weights, mut total) = ([zero; MAX_LAYERS], zero);
        for (i, weight) in weights[..self.deepest].iter_mut().enumerate() {
            *weight = self.alpha[i] * self.left(i, i);
            total = total + *weight;
        }
        // the products of three and more close layers do not add up to what these hide
        let hidden = one - self.through[self.deepest];
        (weights, total, N::select(zero.below(total), hidden / total, zero))
    }

    /// Where any two layers are closer than their order is certain. Elsewhere, as in most pixels, they weigh as in strict order.
    #[inline(always)]
    fn is_soft(&self, peeling: Peeling) -> N::Mask {
        let mut is_soft = self.count.below(self.count);
        if peeling.is_continuous() {
            for i in 1..self.deepest {
                for j in 0..i {
                    is_soft = is_soft | self.distance(i, j).1;
                }
            }
        }
        is_soft
    }

    /// The weights of the layers in the surfel image.
    #[inline(always)]
    fn weights(&self, peeling: Peeling) -> [N; MAX_LAYERS] {
        let mut strict = self.alpha;
        for (weight, &through) in strict[..self.deepest].iter_mut().zip(&self.through) {
            *weight = *weight * through;
        }
        let is_soft = self.is_soft(peeling);
        if N::any(is_soft) {
            let (weights, _, factor) = self.unscaled();
            for (own, &weight) in strict[..self.deepest].iter_mut().zip(&weights) {
                *own = N::select(is_soft, weight * factor, *own);
            }
        }
        strict
    }

    /// The limits of the layers, and the slope.
    #[inline(always)]
    fn limits(&self, weights: &[N; MAX_LAYERS], peeling: Peeling, layers: usize) -> ([N; MAX_LAYERS], N) {
        let all = |value: f64| self.count.constant(value);
        let (zero, one, infinity) = (all(0.0), all(1.0), all(f64::INFINITY));
        let mut limits = [infinity; MAX_LAYERS];
        let mut is_closed = one.below(zero);
        if peeling.is_continuous() {
            let (mut total, mut margin) = (zero, zero);
            for (&weight, &own) in weights[..self.deepest].iter().zip(&self.margin) {
                (total, margin) = (total + weight, margin + weight * own);
            }
            // one margin for the pixel: layers that change places end their intervals at one depth
            let margin = N::select(zero.below(total), margin / total, zero);
            let mut last = infinity;
            for (k, limit) in limits[..layers].iter_mut().enumerate() {
                let end = N::select(self.has(k), self.depth[k] + margin * all(1.0 + 0.5 * RAMP), infinity);
                // nothing is seen behind a core
                last = N::select(is_closed, last, end);
                is_closed = is_closed | self.alpha[k].at_least(one);
                *limit = last;
            }
            // a margin of 0 has a step, whose slope is finite
            return (limits, one / (all(RAMP) * margin).max(all(1.0 / STEP)));
        }
        is_closed = self.count.at_least(all(layers as f64));
        let (mut shifted, mut cap) = ([infinity; MAX_LAYERS], infinity);
        for (k, shifted) in shifted[..self.deepest].iter_mut().enumerate() {
            *shifted = N::select(self.has(k), self.depth[k] + self.margin[k], infinity);
            cap = N::select(self.has(k), *shifted, cap);
            is_closed = is_closed | self.alpha[k].at_least(one);
        }
        let cap = N::select(is_closed, cap, infinity);
        let mut reached = -infinity;
        for (k, limit) in limits[..layers].iter_mut().enumerate() {
            let end = match peeling {
                // only the cap ends the last interval
                Peeling::Literal if k + 1 == layers => infinity,
                Peeling::Literal => N::select(self.has(k), self.depth[k], infinity),
                _ => shifted[k],
            };
            // limits ascend, or an interval would be shorter than nothing
            reached = reached.max(end);
            *limit = reached.min(cap);
        }
        (limits, all(STEP))
    }

    /// Gradients with respect to opacities and depths, from those with respect to weights and to T_0 to T_deepest.
    #[inline(always)]
    fn backward(&self, of_weights: &[N; MAX_LAYERS], of_through: &[N], peeling: Peeling) -> [[N; MAX_LAYERS]; 2] {
        let (zero, one, count) = (self.count.constant(0.0), self.count.constant(1.0), self.deepest);
        let (mut alpha, mut depth) = ([zero; MAX_LAYERS], [zero; MAX_LAYERS]);
        // total derivative with respect to T_k, everything behind included; layers that are missing leave T as it is
        let mut behind = of_through[count];
        let is_soft = self.is_soft(peeling);
        let some_soft = N::any(is_soft);
        let (weights, total, factor) = if some_soft { self.unscaled() } else { ([zero; MAX_LAYERS], zero, zero) };
        let factor = N::select(is_soft, factor, zero);
        // of the hidden share 1 − T_K
        let mut mean = zero;
        if some_soft {
            for k in 0..count {
                mean = mean + of_weights[k] * weights[k];
            }
            mean = N::select(is_soft & zero.below(total), mean / total, zero);
            behind = behind - mean;
        }
        for k in (0..count).rev() {
            let own = N::select(is_soft, zero, of_weights[k]);
            alpha[k] = self.through[k] * (own - behind);
            behind = of_through[k] + self.alpha[k] * own + (one - self.alpha[k]) * behind;
        }
        for i in (0..count).filter(|_| some_soft) {
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
        for (k, alpha) in alpha[..count].iter_mut().enumerate() {
            *alpha = N::select(self.has(k), *alpha, zero);
        }
        [alpha, depth]
    }
}

/// Writes weights, transmittances and limits of the pixels of a band.
struct Forward<'a, 'b, T: Real> {
    inputs: &'a Inputs<'a, T>,
    pixels: Range<usize>,
    out: [Vec<&'b mut [T]>; 3],
}

impl<T: Real> WithSimd for Forward<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { inputs, pixels: band, out: [mut weights, mut transmittance, mut limits] } = self;
        let (layers, count) = (inputs.layers, T::lane_count::<S>());
        for start in band.clone().step_by(count) {
            let pixels = start..band.end.min(start + count);
            let local = start - band.start..pixels.end - band.start;
            let stack = inputs.stack(simd, &pixels);
            if stack.deepest == 0 {
                limits[layers][local].fill(T::of(STEP));
                continue;
            }
            let own = stack.weights(inputs.peeling);
            let (ends, slope) = stack.limits(&own, inputs.peeling, layers);
            for k in 0..layers {
                own[k].store_some(&mut weights[k][local.clone()]);
                ends[k].store_some(&mut limits[k][local.clone()]);
            }
            for (k, through) in transmittance.iter_mut().enumerate() {
                stack.through[k.min(stack.deepest)].store_some(&mut through[local.clone()]);
            }
            slope.store_some(&mut limits[layers][local]);
        }
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
    tasks.into_par_iter().enumerate().for_each(|(band, out)| {
        vectorised(Forward { inputs, pixels: bands.pixels(band, inputs.width), out });
    });
    out
}

/// Writes the gradients with respect to alpha and depth of the pixels of a band.
struct Backward<'a, 'b, T: Real> {
    inputs: &'a Inputs<'a, T>,
    grads: [Option<&'a [T]>; 2],
    pixels: Range<usize>,
    alpha: Vec<&'b mut [T]>,
    depth: Vec<&'b mut [T]>,
}

impl<T: Real> WithSimd for Backward<'_, '_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { inputs, grads, pixels: band, mut alpha, mut depth } = self;
        let (plane, count, zero) = (inputs.height * inputs.width, T::lane_count::<S>(), Lanes::zero(simd));
        for start in band.clone().step_by(count) {
            let pixels = start..band.end.min(start + count);
            let local = start - band.start..pixels.end - band.start;
            let stack = inputs.stack(simd, &pixels);
            if stack.deepest == 0 {
                continue;
            }
            let read = {
                #[inline(always)]
                |grads: Option<&[T]>, k: usize| {
                    grads.map_or(zero, |grads| Lanes::load_some(simd, &grads[k * plane..][pixels.clone()]))
                }
            };
            let (mut of_weights, mut of_through) = ([zero; MAX_LAYERS], [zero; MAX_LAYERS + 1]);
            for (k, grad) in of_weights[..stack.deepest].iter_mut().enumerate() {
                *grad = read(grads[0], k);
            }
            for k in 0..=inputs.layers {
                let at = k.min(stack.deepest);
                of_through[at] = of_through[at] + read(grads[1], k);
            }
            let [own_alpha, own_depth] = stack.backward(&of_weights, &of_through, inputs.peeling);
            for k in 0..stack.deepest {
                own_alpha[k].store_some(&mut alpha[k][local.clone()]);
                own_depth[k].store_some(&mut depth[k][local.clone()]);
            }
        }
    }
}

/// Gradients with respect to alpha and depth, [K, H, W].
fn backward<T: Real>(inputs: &Inputs<T>, grads: [Option<&[T]>; 2]) -> [Vec<T>; 2] {
    let (layers, plane, bands) = (inputs.layers, inputs.height * inputs.width, Bands::new(inputs.height));
    let mut out = [(); 2].map(|()| vec![T::zero(); layers * plane]);
    let [of_alpha, of_depth] = out.each_mut().map(|image| bands.split(image, inputs.width));
    of_alpha.into_par_iter().zip(of_depth).enumerate().for_each(|(band, (alpha, depth))| {
        vectorised(Backward { inputs, grads, pixels: bands.pixels(band, inputs.width), alpha, depth });
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

impl<B: Host> BackwardOfAll<B, 2, 2> for VisibilityState<B> {
    fn parents(&self) -> [&FloatTensor<B>; 2] {
        [&self.input.alpha, &self.input.depth]
    }

    fn backward_from(self, grads: Grads<B>) -> [Option<FloatTensor<B>>; 2] {
        let (input, device) = (&self.input, self.input.alpha.device());
        with_real!(input.alpha.dtype(), T => Inputs::<T>::with(input, self.peeling, |inputs| {
            let grads = grads.each_ref().map(|grad| grad.as_ref().map(host::floats::<B, T>));
            let shape = [inputs.layers, inputs.height, inputs.width];
            let found = backward(inputs, grads.each_ref().map(Option::as_deref));
            found.map(|values| Some(host::float_tensor::<B, T, 3>(values, shape, &device)))
        }))
    }
}

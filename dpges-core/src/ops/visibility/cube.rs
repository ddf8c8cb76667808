//! GPU kernels: one unit per pixel.

use burn::backend::TensorMetadata;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::autodiff::Grads;
use super::{VisibilityInput, VisibilityOps, VisibilityOutput, VisibilityState};
use crate::backend::tape::BackwardOfAll;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, integers, units};
use crate::scene::Peeling;
use crate::scene::peeling::{ORDER, RAMP, STEP};

/// The layers of a pixel. Those that are missing have opacity 0.
#[derive(CubeType)]
struct Stack {
    count: u32,
    alpha: Array<f32>,
    depth: Array<f32>,
    margin: Array<f32>,
}

#[cube]
fn stack(
    alpha: &[f32],
    depth: &[f32],
    ids: &[i32],
    margins: &[f32],
    pixel: usize,
    pixels: usize,
    #[comptime] layers: usize,
) -> Stack {
    let mut stack = Stack {
        count: 0u32.runtime(),
        alpha: Array::<f32>::new(layers),
        depth: Array::<f32>::new(layers),
        margin: Array::<f32>::new(layers),
    };
    #[unroll]
    for k in 0..layers {
        let at = k * pixels + pixel;
        let id = ids[at];
        stack.alpha[k] = alpha[at];
        // not infinite, as that of a missing layer is: differences of two of them would be NaN
        stack.depth[k] = 0.0f32;
        stack.margin[k] = 0.0f32;
        // selected values would be read without surfels, too
        if id >= 0i32 {
            stack.depth[k] = depth[at];
            stack.margin[k] = margins[id as usize];
            stack.count += 1u32;
        }
    }
    stack
}

/// Share of layer i that is behind layer j, and its derivative with respect to the depth of i; that to the depth of j is the
/// opposite.
#[cube]
fn behind(stack: &Stack, #[comptime] i: usize, #[comptime] j: usize) -> (f32, f32) {
    let reach = comptime!(ORDER as f32) * min(stack.margin[i], stack.margin[j]);
    let distance = stack.depth[i] - stack.depth[j];
    let mut share = 0.0f32.runtime();
    let mut slope = 0.0f32.runtime();
    if comptime!(i > j) {
        share = 1.0f32;
    }
    // not divided before it is known to be within reach: a margin of 0 leaves the order of the list
    if f32::abs(distance) < reach {
        slope = 0.5f32 / reach;
        share = 0.5f32 + distance * slope;
    }
    (share, slope)
}

/// `Π (1 − A_j s_ij)` over all j but i and `skipped`.
#[cube]
fn left(stack: &Stack, #[comptime] i: usize, #[comptime] skipped: usize, #[comptime] layers: usize) -> f32 {
    let mut left = 1.0f32.runtime();
    #[unroll]
    for j in 0..layers {
        if comptime!(j != i && j != skipped) {
            let (share, _) = behind(stack, i, j);
            // products of the others, in place of a division by 1 − A, which is 0 for a core
            left *= 1.0f32 - stack.alpha[j] * share;
        }
    }
    left
}

/// Weights before they are scaled.
#[cube]
fn unscaled(stack: &Stack, #[comptime] layers: usize) -> Array<f32> {
    let mut weights = Array::<f32>::new(layers);
    #[unroll]
    for i in 0..layers {
        weights[i] = stack.alpha[i] * left(stack, i, i, layers);
    }
    weights
}

#[cube]
fn sum(numbers: &Array<f32>, #[comptime] layers: usize) -> f32 {
    let mut sum = 0.0f32.runtime();
    #[unroll]
    for k in 0..layers {
        sum += numbers[k];
    }
    sum
}

#[cube(launch)]
fn visibility_kernel(
    alpha: &[f32],
    depth: &[f32],
    ids: &[i32],
    margins: &[f32],
    weights: &mut [f32],
    transmittance: &mut [f32],
    limits: &mut [f32],
    pixels: u32,
    infinity: f32,
    #[comptime] layers: usize,
    #[comptime] peeling: Peeling,
) {
    let pixel = ABSOLUTE_POS;
    let plane = pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    let stack = stack(alpha, depth, ids, margins, pixel, plane, layers);
    let mut own = Array::<f32>::new(layers);
    let mut through = 1.0f32.runtime();
    transmittance[pixel] = 1.0f32;
    #[unroll]
    for k in 0..layers {
        own[k] = stack.alpha[k] * through;
        through *= 1.0f32 - stack.alpha[k];
        transmittance[(k + 1) * plane + pixel] = through;
    }
    // one layer, as in most pixels, has no other
    #[expect(clippy::collapsible_if, reason = "the outer condition is known before")]
    if comptime!(peeling.is_continuous()) {
        if stack.count > 1u32 {
            own = unscaled(&stack, layers);
            let total = sum(&own, layers);
            // the products of three and more close layers do not add up to what these hide
            let factor = select(total > 0.0f32, (1.0f32 - through) / total, 0.0f32);
            #[unroll]
            for k in 0..layers {
                own[k] *= factor;
            }
        }
    }
    #[unroll]
    for k in 0..layers {
        weights[k * plane + pixel] = own[k];
    }

    let mut cap = infinity;
    let mut slope = comptime!(STEP as f32).runtime();
    let mut ends = Array::<f32>::new(layers);
    if comptime!(peeling.is_continuous()) {
        let total = sum(&own, layers);
        let mut margin = 0.0f32.runtime();
        #[unroll]
        for k in 0..layers {
            margin += own[k] * stack.margin[k];
        }
        // one margin for the pixel: layers that change places end their intervals at one depth
        margin = select(total > 0.0f32, margin / total, 0.0f32);
        slope = 1.0f32 / max(comptime!(RAMP as f32) * margin, comptime!(1.0 / STEP as f32));
        #[unroll]
        for k in 0..layers {
            let end = stack.depth[k] + margin * comptime!((1.0 + 0.5 * RAMP) as f32);
            let present = (k as u32) < stack.count;
            ends[k] = select(present, end, infinity);
            // nothing is seen behind a core
            cap = select(present && stack.alpha[k] >= 1.0f32, min(cap, end), cap);
        }
    } else {
        let mut reached = -infinity;
        let mut last = infinity;
        let mut closed = stack.count == layers as u32;
        #[unroll]
        for k in 0..layers {
            let mut end = infinity;
            if (k as u32) < stack.count {
                last = stack.depth[k] + stack.margin[k];
                end = last;
                closed = closed || stack.alpha[k] >= 1.0f32;
                if comptime!(peeling == Peeling::Literal) {
                    end = stack.depth[k];
                }
            }
            // only the cap ends the last interval
            if comptime!(peeling == Peeling::Literal && k + 1 == layers) {
                end = infinity;
            }
            // limits ascend, or an interval would be shorter than nothing
            reached = max(reached, end);
            ends[k] = reached;
        }
        cap = select(closed, last, infinity);
    }
    #[unroll]
    for k in 0..layers {
        limits[k * plane + pixel] = min(ends[k], cap);
    }
    limits[layers * plane + pixel] = slope;
}

/// Gradients with respect to opacities and depths. `grads` holds those with respect to weights, then those with respect to
/// transmittances, in one buffer: WebGPU binds eight at most.
#[cube(launch)]
fn backward_kernel(
    alpha: &[f32],
    depth: &[f32],
    ids: &[i32],
    margins: &[f32],
    grads: &[f32],
    grad_alpha: &mut [f32],
    grad_depth: &mut [f32],
    pixels: u32,
    #[comptime] layers: usize,
    #[comptime] peeling: Peeling,
    #[comptime] of_weights: bool,
    #[comptime] of_transmittance: bool,
) {
    let pixel = ABSOLUTE_POS;
    let plane = pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    let stack = stack(alpha, depth, ids, margins, pixel, plane, layers);
    let mut incoming = zeros(layers);
    let mut own_alpha = zeros(layers);
    let mut own_depth = zeros(layers);
    let mut through = Array::<f32>::new(layers);
    let mut left_over = 1.0f32.runtime();
    #[unroll]
    for k in 0..layers {
        if comptime!(of_weights) {
            incoming[k] = grads[k * plane + pixel];
        }
        through[k] = left_over;
        left_over *= 1.0f32 - stack.alpha[k];
    }
    let soft = comptime!(peeling.is_continuous()) && stack.count > 1u32;
    // total derivative with respect to T_k, everything behind included
    let mut behind_all = 0.0f32.runtime();
    let before = comptime!(if of_weights { layers } else { 0 });
    if comptime!(of_transmittance) {
        behind_all = grads[(before + layers) * plane + pixel];
    }
    #[expect(clippy::collapsible_if, reason = "the outer condition is known before")]
    if comptime!(peeling.is_continuous() && of_weights) {
        if soft {
            let weights = unscaled(&stack, layers);
            let total = sum(&weights, layers);
            // of the hidden share 1 − T_K
            let mut mean = 0.0f32.runtime();
            #[unroll]
            for k in 0..layers {
                mean += incoming[k] * weights[k];
            }
            mean = select(total > 0.0f32, mean / total, 0.0f32);
            behind_all -= mean;
            let factor = select(total > 0.0f32, (1.0f32 - left_over) / total, 0.0f32);
            #[unroll]
            for i in 0..layers {
                let of_unscaled = factor * (incoming[i] - mean);
                own_alpha[i] += of_unscaled * left(&stack, i, i, layers);
                #[unroll]
                for j in 0..layers {
                    if comptime!(j != i) {
                        let (share, slope) = behind(&stack, i, j);
                        let others = of_unscaled * stack.alpha[i] * left(&stack, i, j, layers);
                        own_alpha[j] -= others * share;
                        let steepness = others * stack.alpha[j] * slope;
                        own_depth[i] -= steepness;
                        own_depth[j] += steepness;
                    }
                }
            }
        }
    }
    #[unroll]
    for step in 0..layers {
        let k = comptime!(layers - 1 - step);
        let own = select(soft, 0.0f32, incoming[k]);
        own_alpha[k] += through[k] * (own - behind_all);
        behind_all = stack.alpha[k] * own + (1.0f32 - stack.alpha[k]) * behind_all;
        if comptime!(of_transmittance) {
            behind_all += grads[(before + k) * plane + pixel];
        }
        let present = (k as u32) < stack.count;
        grad_alpha[k * plane + pixel] = select(present, own_alpha[k], 0.0f32);
        grad_depth[k * plane + pixel] = own_depth[k];
    }
}

fn contiguous(input: VisibilityInput<CubeBackend>) -> VisibilityInput<CubeBackend> {
    VisibilityInput {
        alpha: floats(input.alpha),
        depth: floats(input.depth),
        ids: integers(input.ids),
        margins: floats(input.margins),
    }
}

impl VisibilityOps for CubeBackend {
    fn visibility(input: VisibilityInput<Self>, peeling: Peeling) -> VisibilityOutput<Self> {
        let VisibilityInput { alpha, depth, ids, margins } = contiguous(input);
        let [layers, height, width]: [usize; 3] = alpha.shape().dims();
        let out = VisibilityOutput {
            weights: empty_f32(&alpha, [layers, height, width]),
            transmittance: empty_f32(&alpha, [layers + 1, height, width]),
            limits: empty_f32(&alpha, [layers + 1, height, width]),
        };
        visibility_kernel::launch(
            &alpha.client.clone(),
            units(height * width),
            cube_dim(),
            buffer(&alpha),
            buffer(&depth),
            buffer(&ids),
            buffer(&margins),
            buffer(&out.weights),
            buffer(&out.transmittance),
            buffer(&out.limits),
            (height * width) as u32,
            f32::INFINITY,
            layers,
            peeling,
        );
        out
    }
}

impl BackwardOfAll<CubeBackend, 2, 2> for VisibilityState<CubeBackend> {
    fn parents(&self) -> [&FloatTensor<CubeBackend>; 2] {
        [&self.input.alpha, &self.input.depth]
    }

    fn backward_from(self, grads: Grads<CubeBackend>) -> [Option<FloatTensor<CubeBackend>>; 2] {
        let VisibilityInput { alpha, depth, ids, margins } = contiguous(self.input);
        let [layers, height, width]: [usize; 3] = alpha.shape().dims();
        let [of_weights, of_transmittance] = grads.each_ref().map(Option::is_some);
        let grads = floats(CubeBackend::float_cat(grads.into_iter().flatten().collect(), 0));
        let found = [(); 2].map(|()| empty_f32(&alpha, [layers, height, width]));
        backward_kernel::launch(
            &alpha.client.clone(),
            units(height * width),
            cube_dim(),
            buffer(&alpha),
            buffer(&depth),
            buffer(&ids),
            buffer(&margins),
            buffer(&grads),
            buffer(&found[0]),
            buffer(&found[1]),
            (height * width) as u32,
            layers,
            self.peeling,
            of_weights,
            of_transmittance,
        );
        found.map(Some)
    }
}

//! Pixels that blend their nearest fragments in order, and mix the others behind them (HTGS). One unit keeps the core of its
//! pixel in registers. Backward, it finds the core again, and says of every entry of the list of the tile what a pixel does in
//! sorted blending.

use cubecl::prelude::*;

use super::Thresholds;
use super::fold::{ENTRIES, GROUP, Layout, NUMBERS, fold_entries};
use super::fragments::{FEATURES, Payload};
use super::order::NO_KEY;
use crate::footprint::gaussian::cube::whitened::{WHITENED, Whitened};
use crate::gpu::gather::zeros;
use crate::gpu::launch::UNITS;
use crate::gpu::record::Record;
use crate::gpu::tile::{own_pixel, plane_of};
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::{CORE, CORE_ALPHA};
use crate::scene::Transparency;
use crate::tiles::binning::cube::TileList;

const LEAST_ALPHA: f32 = CORE_ALPHA as f32;
/// Position of nothing.
const NOTHING: u32 = NO_KEY;
/// Smallest 1 − α that is divided by.
const LEAST_THROUGH: f32 = 1e-8;

/// Numbers of a fragment that are mixed by weight, by place: colour, z, normal, m and m².
const PAYLOAD: usize = 9;
const Z: usize = 3;
const NORMAL: usize = 4;
const M: usize = 7;
/// State of the tail of a pixel behind Σ α payload: Σ α, Π (1 − α); and 1 / z of the first fragment in the list.
const ALPHA: usize = PAYLOAD;
const THROUGH: usize = PAYLOAD + 1;
const REFERENCE: usize = PAYLOAD + 2;
pub const TAIL: usize = PAYLOAD + 3;
/// State of its weights behind Σ w payload: Σ w; the weight of a fragment of the tail over its α; T behind the core, 0
/// if the pixel has ended there; median depth.
const TOTAL: usize = PAYLOAD;
pub const SHARE: usize = PAYLOAD + 1;
const BEHIND: usize = PAYLOAD + 2;
const MEDIAN: usize = PAYLOAD + 3;
pub const WEIGHTS: usize = PAYLOAD + 4;

/// The fragments of a pixel that have an order, nearest first; what comes first in the list if equal.
#[derive(CubeType)]
pub struct Core {
    depths: Array<f32>,
    /// α before it is capped.
    weights: Array<f32>,
    /// In the list of the tile, or [`NOTHING`].
    pub positions: Array<u32>,
    /// αT
    pub covered: Array<f32>,
}

/// Adds a share of what is mixed by weight to sums.
#[cube]
fn add_payload(
    sums: &mut Array<f32>,
    features: &[f32],
    i: usize,
    share: f32,
    depth: f32,
    reference: f32,
    slope: f32,
    #[comptime] maps: bool,
) {
    let payload = Payload::load(features, i * FEATURES);
    sums[0] += share * payload.colour.x;
    sums[1] += share * payload.colour.y;
    sums[2] += share * payload.colour.z;
    if comptime!(maps) {
        let mapped = slope * (reference - 1.0f32 / depth);
        sums[Z] += share * depth;
        sums[NORMAL] += share * payload.normal.x;
        sums[NORMAL + 1] += share * payload.normal.y;
        sums[NORMAL + 2] += share * payload.normal.z;
        sums[M] += share * mapped;
        sums[M + 1] += share * mapped * mapped;
    }
}

/// `coefficients · payload` of a fragment.
#[cube]
fn weighted(
    coefficients: &Array<f32>,
    features: &[f32],
    i: usize,
    depth: f32,
    reference: f32,
    slope: f32,
    #[comptime] maps: bool,
) -> f32 {
    let payload = Payload::load(features, i * FEATURES);
    let mut value =
        coefficients[0] * payload.colour.x + coefficients[1] * payload.colour.y + coefficients[2] * payload.colour.z;
    if comptime!(maps) {
        let mapped = slope * (reference - 1.0f32 / depth);
        value += coefficients[Z] * depth;
        value += coefficients[NORMAL] * payload.normal.x;
        value += coefficients[NORMAL + 1] * payload.normal.y;
        value += coefficients[NORMAL + 2] * payload.normal.z;
        value += mapped * (coefficients[M] + coefficients[M + 1] * mapped);
    }
    value
}

/// Finds the core of the pixel at (`x`, `y`) px, and sums its `tail`, [[`TAIL`]] zeros so far.
#[cube]
pub fn find_core(
    tail: &mut Array<f32>,
    shapes: &[f32],
    features: &[f32],
    list: TileList,
    ids: &[u32],
    inside: bool,
    x: f32,
    y: f32,
    view: CameraUniforms,
    thresholds: Thresholds,
    #[comptime] transparency: Transparency,
    #[comptime] maps: bool,
) -> Core {
    // only constants index these arrays, so that they stay in registers
    let mut depths = Array::<f32>::new(CORE);
    let mut weights = Array::<f32>::new(CORE);
    let mut positions = Array::<u32>::new(CORE);
    let mut covered = Array::<f32>::new(CORE);
    #[unroll]
    for place in 0..CORE {
        depths[place] = view.infinity;
        weights[place] = 0.0f32;
        positions[place] = NOTHING;
        covered[place] = 0.0f32;
    }
    tail[THROUGH] = 1.0f32;
    let end = select(inside, list.length, 0u32);
    for entry in 0..end {
        let i = list.entry(ids, entry) as usize;
        let (alpha, at) = Whitened::load(shapes, i * WHITENED).fragment(view, x, y);
        if alpha > 0.0f32 {
            let mut weight = alpha;
            let mut depth = at;
            let mut position = entry;
            tail[REFERENCE] = select(tail[REFERENCE] == 0.0f32, 1.0f32 / depth, tail[REFERENCE]);
            // `<` leaves what came first before others of the same depth
            #[expect(clippy::collapsible_if, reason = "the outer condition is known before")]
            if comptime!(transparency != Transparency::Tail) {
                if weight >= LEAST_ALPHA && depth < depths[comptime!(CORE - 1)] {
                    let mut moves = false;
                    #[unroll]
                    for place in 0..CORE {
                        // `select` in place of branches: the units of a cube insert at different places
                        moves = moves || depth < depths[place];
                        let (other_depth, other_weight) = (depths[place], weights[place]);
                        let other = positions[place];
                        depths[place] = select(moves, depth, other_depth);
                        weights[place] = select(moves, weight, other_weight);
                        positions[place] = select(moves, position, other);
                        depth = select(moves, other_depth, depth);
                        weight = select(moves, other_weight, weight);
                        position = select(moves, other, position);
                    }
                }
            }
            if comptime!(transparency != Transparency::Nearest) {
                // an empty place has left if the core was not full
                if position != NOTHING {
                    let share = min(weight, thresholds.max_alpha);
                    let reference = tail[REFERENCE];
                    let i = list.entry(ids, position) as usize;
                    add_payload(tail, features, i, share, depth, reference, thresholds.slope, maps);
                    tail[ALPHA] += share;
                    tail[THROUGH] *= 1.0f32 - share;
                }
            }
        }
    }
    Core { depths, weights, positions, covered }
}

/// Weighs the fragments of a pixel into `sums`, [[`WEIGHTS`]] zeros so far.
#[cube]
pub fn weigh(
    core: &mut Core,
    tail: &Array<f32>,
    sums: &mut Array<f32>,
    features: &[f32],
    list: TileList,
    ids: &[u32],
    thresholds: Thresholds,
    #[comptime] maps: bool,
) {
    let mut through = 1.0f32;
    let mut open = true;
    #[unroll]
    for place in 0..CORE {
        if open && core.positions[place] != NOTHING {
            let alpha = min(core.weights[place], thresholds.max_alpha);
            let covered = alpha * through;
            core.covered[place] = covered;
            let i = list.entry(ids, core.positions[place]) as usize;
            let depth = core.depths[place];
            add_payload(sums, features, i, covered, depth, tail[REFERENCE], thresholds.slope, maps);
            through *= 1.0f32 - alpha;
            sums[MEDIAN] = select(through <= 0.5f32 && sums[MEDIAN] == 0.0f32, depth, sums[MEDIAN]);
            open = through >= thresholds.min_transmittance;
        }
    }
    sums[BEHIND] = select(open, through, 0.0f32);
    if open && tail[ALPHA] > 0.0f32 {
        // together the tail covers 1 − Π (1 − α), as it would in any order
        let share = through * (1.0f32 - tail[THROUGH]) / tail[ALPHA];
        sums[SHARE] = share;
        #[unroll]
        for number in 0..PAYLOAD {
            sums[number] += share * tail[number];
        }
        through *= tail[THROUGH];
        if comptime!(maps) {
            let mean = tail[Z] / tail[ALPHA];
            sums[MEDIAN] = select(through <= 0.5f32 && sums[MEDIAN] == 0.0f32, mean, sums[MEDIAN]);
        }
    }
    sums[TOTAL] = 1.0f32 - through;
}

/// Blends the pixel of this unit in a `tile`.
#[cube]
pub fn blend_pixel(
    planes: &mut [f32],
    median_depth: &mut [f32],
    shapes: &[f32],
    features: &[f32],
    list: TileList,
    ids: &[u32],
    tile: u32,
    view: CameraUniforms,
    thresholds: Thresholds,
    #[comptime] transparency: Transparency,
    #[comptime] maps: bool,
) {
    let own = own_pixel(view, tile);
    let (x, y) = (own.x, own.y);
    let mut tail = zeros(TAIL);
    let mut sums = zeros(WEIGHTS);
    let mut core =
        find_core(&mut tail, shapes, features, list, ids, own.inside, x, y, view, thresholds, transparency, maps);
    weigh(&mut core, &tail, &mut sums, features, list, ids, thresholds, maps);
    if own.inside {
        let (plane, pixel) = (plane_of(view), own.at);
        #[unroll]
        for channel in 0..3usize {
            planes[pixel + channel * plane] = sums[channel];
        }
        planes[pixel + 3 * plane] = sums[TOTAL];
        if comptime!(maps) {
            planes[pixel + 4 * plane] = sums[Z];
            #[unroll]
            for axis in 0..3usize {
                planes[pixel + (5 + axis) * plane] = sums[NORMAL + axis];
            }
            // a variance cannot be negative, but its two terms cancel, and rounding may leave them so
            planes[pixel + 8 * plane] = max(sums[TOTAL] * sums[M + 1] - sums[M] * sums[M], 0.0f32);
            median_depth[pixel] = sums[MEDIAN];
        }
    }
}

/// Gradients that all fragments of the tail of a pixel share.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct TailGrad {
    share: f32,
    /// Mean of `coefficients · payload` over the tail by α. `rest` is no part of it: by Σ α it changes nothing, and the
    /// difference would be rounding alone where the tail is opaque.
    mean: f32,
    /// Gradient with respect to its α through Π (1 − α), times its 1 − α.
    of_through: f32,
}

/// Gradient with respect to z over the weight.
#[cube]
fn depth_gradient(coefficients: &Array<f32>, depth: f32, reference: f32, slope: f32, #[comptime] maps: bool) -> f32 {
    let mut gradient = 0.0f32;
    if comptime!(maps) {
        let inverse = 1.0f32 / depth;
        let mapped = slope * (reference - inverse);
        let of_mapped = coefficients[M] + 2.0f32 * coefficients[M + 1] * mapped;
        gradient = coefficients[Z] + of_mapped * slope * inverse * inverse;
    }
    gradient
}

/// Sums over the pixels of a tile for the entries of its `list`, into their slots from `slot` on. All units of the cube must call
/// this together.
#[cube]
pub fn gather_mixed(
    slots: &mut [f32],
    shapes: &[f32],
    features: &[f32],
    list: TileList,
    slot: u32,
    ids: &[u32],
    grad: &[f32],
    tile: u32,
    view: CameraUniforms,
    thresholds: Thresholds,
    #[comptime] transparency: Transparency,
    #[comptime] layout: Layout,
) {
    let maps = comptime!(layout.maps);
    let unit = UNIT_POS as usize;
    let mut partial = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * GROUP));

    let place = own_pixel(view, tile);
    let (x, y, pixel, plane) = (place.x, place.y, place.at, plane_of(view));
    let mut tail = zeros(TAIL);
    let mut sums = zeros(WEIGHTS);
    let mut core =
        find_core(&mut tail, shapes, features, list, ids, place.inside, x, y, view, thresholds, transparency, maps);
    weigh(&mut core, &tail, &mut sums, features, list, ids, thresholds, maps);
    let (reference, slope) = (tail[REFERENCE], thresholds.slope);

    // w of a fragment has coefficients · payload + rest
    let mut coefficients = zeros(PAYLOAD);
    #[unroll]
    for channel in 0..3usize {
        coefficients[channel] = grad[pixel + channel * plane];
    }
    let mut rest = grad[pixel + 3 * plane];
    if comptime!(maps) {
        coefficients[Z] = grad[pixel + 4 * plane];
        #[unroll]
        for axis in 0..3usize {
            coefficients[NORMAL + axis] = grad[pixel + (5 + axis) * plane];
        }
        // distortion is Σ w Σ w m² − (Σ w m)²
        let of_distortion = grad[pixel + 8 * plane];
        coefficients[M] = -2.0f32 * of_distortion * sums[M];
        coefficients[M + 1] = of_distortion * sums[TOTAL];
        rest += of_distortion * sums[M + 1];
    }

    let mut of_tail = TailGrad { share: sums[SHARE], mean: 0.0f32, of_through: 0.0f32 };
    // derivative with respect to T behind the fragment that is next
    let mut behind = 0.0f32;
    if of_tail.share > 0.0f32 {
        let mut whole = 0.0f32;
        #[unroll]
        for number in 0..PAYLOAD {
            whole += coefficients[number] * tail[number];
        }
        of_tail.mean = whole / tail[ALPHA];
        let mean = of_tail.mean + rest;
        behind = (1.0f32 - tail[THROUGH]) * mean;
        of_tail.of_through = sums[BEHIND] * tail[THROUGH] * mean;
    }
    // gradients of the exponents and of the depths take the places of what they are made of
    #[unroll]
    for step in 0..CORE {
        let k = comptime!(CORE - 1 - step);
        let (weight, depth, covered) = (core.weights[k], core.depths[k], core.covered[k]);
        let mut power = 0.0f32;
        let mut of_depth = 0.0f32;
        if covered > 0.0f32 {
            let alpha = min(weight, thresholds.max_alpha);
            let i = list.entry(ids, core.positions[k]) as usize;
            let value = weighted(&coefficients, features, i, depth, reference, slope, maps) + rest;
            power = select(weight < thresholds.max_alpha, covered * (value - behind), 0.0f32);
            of_depth = covered * depth_gradient(&coefficients, depth, reference, slope, maps);
            behind = alpha * value + (1.0f32 - alpha) * behind;
        }
        core.weights[k] = power;
        core.depths[k] = of_depth;
    }

    let rounds = list.length.div_ceil(ENTRIES);
    for round in 0..rounds {
        let top = list.length - round * ENTRIES;
        let entries = min(top, ENTRIES);
        for entry in 0..ENTRIES {
            let mut power = 0.0f32;
            let mut covered = 0.0f32;
            let mut grad_depth = 0.0f32;
            // beyond the first entry of the list this is large
            let position = top - 1u32 - entry;
            if entry < entries && place.inside {
                let mut in_core = false;
                #[unroll]
                for k in 0..CORE {
                    let is_here = core.positions[k] == position;
                    in_core = in_core || is_here;
                    power = select(is_here, core.weights[k], power);
                    covered = select(is_here, core.covered[k], covered);
                    grad_depth = select(is_here, core.depths[k], grad_depth);
                }
                #[expect(clippy::collapsible_if, reason = "the outer condition is known before")]
                if comptime!(transparency != Transparency::Nearest) {
                    if !in_core && of_tail.share > 0.0f32 {
                        let i = list.entry(ids, position) as usize;
                        let (weight, depth) = Whitened::load(shapes, i * WHITENED).fragment(view, x, y);
                        if weight > 0.0f32 {
                            let alpha = min(weight, thresholds.max_alpha);
                            let value = weighted(&coefficients, features, i, depth, reference, slope, maps);
                            // divided by its own 1 − α, the product over the tail is that over the others
                            let through = max(1.0f32 - alpha, LEAST_THROUGH);
                            let grad_alpha = of_tail.share * (value - of_tail.mean) + of_tail.of_through / through;
                            power = select(weight < thresholds.max_alpha, alpha * grad_alpha, 0.0f32);
                            covered = of_tail.share * alpha;
                            grad_depth = covered * depth_gradient(&coefficients, depth, reference, slope, maps);
                        }
                    }
                }
            }
            let at = entry as usize * NUMBERS * UNITS as usize + unit;
            partial[at] = power;
            partial[at + UNITS as usize] = covered;
            partial[at + 2 * UNITS as usize] = grad_depth;
        }
        sync_cube();
        fold_entries(&mut partial, slots, shapes, features, ids, grad, list, top, slot, tile, view, layout);
    }
}

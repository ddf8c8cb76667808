//! The backward pass: from the gradients of the planes to those of the parameters.

use rayon::prelude::*;

use super::distortion::{self, Spread};
use super::normal::normal_backward;
use super::projected::{CameraPair, Group, Layout, Projected, Sums, WORK_ROWS};
use super::walk::{Fragments, Progress, Sorted, Thresholds, group, is_nothing, walk_tile};
use crate::backend::real::Real;
use crate::backend::simd::{LANES, vectorised};
use crate::camera::Camera;
use crate::footprint::gaussian::cpu::ParameterGrad;
use crate::footprint::gaussian::tensors::GaussianRows;
use crate::math::V3;
use crate::ops::blend::{ALPHA_PLANE, BlendOptions, COLOUR_PLANES, DEPTH_PLANE, DISTORTION_PLANE, NORMAL_PLANE};
use crate::tiles::TILE_PIXELS;
use crate::tiles::for_each_group;
use crate::tiles::layout::to_tiles;

/// Tiles whose sums are held at a time.
const BATCH: usize = 64;
/// Primitives that one task adds sums to.
const CHUNK: usize = 4096;

/// Lanes that the backward pass works on, on the heap as in `splat`.
struct Scratch<T> {
    /// α before it is capped, z, derivative of the payload, αT, gradient of the exponent, gradient of z.
    pixel: Vec<[T; LANES]>,
    work: Vec<[T; LANES]>,
    /// As in [`Layout`].
    sums: Vec<[T; LANES]>,
}

impl<T: Real> Scratch<T> {
    fn new(layout: &Layout) -> Self {
        let rows = |count: usize| vec![[T::zero(); LANES]; count];
        Self { pixel: rows(6), work: rows(WORK_ROWS), sums: rows(layout.width()) }
    }
}

/// One primitive of a tile's list.
struct Entry<'a, T, F> {
    /// A whole number.
    position: T,
    footprint: &'a F,
    colour: V3<T>,
    /// Zero without maps.
    normal: V3<T>,
}

/// The pixels of a tile in the backward pass.
struct WayBack<'a, T> {
    /// T behind the primitive that is next.
    progress: Progress<T>,
    /// Derivative with respect to that T.
    behind: [T; TILE_PIXELS],
    /// [planes, `TILE_PIXELS`]
    grad: &'a [T],
    max_alpha: T,
    /// Spread of all fragments; unused without maps.
    spread: Spread<T>,
    /// 1 − T behind the last.
    alpha: [T; TILE_PIXELS],
    slope: T,
}

/// Three planes of a group of pixels, from `first` on.
#[inline(always)]
fn three<T: Real>(grad: &[T], first: usize, start: usize) -> [&[T; LANES]; 3] {
    [0, 1, 2].map(|plane| lanes(grad, (first + plane) * TILE_PIXELS + start))
}

#[inline(always)]
fn lanes<T: Real>(values: &[T], start: usize) -> &[T; LANES] {
    (&values[start..start + LANES]).try_into().expect("one group")
}

#[inline(always)]
fn add_payload<T: Real>(own: &mut [T; LANES], grads: [&[T; LANES]; 3], payload: V3<T>) {
    for (grad, value) in grads.into_iter().zip(payload) {
        for lane in 0..LANES {
            own[lane] = own[lane] + grad[lane] * value;
        }
    }
}

#[inline(always)]
fn add_covered<T: Real>(sums: &mut [[T; LANES]], grads: [&[T; LANES]; 3], covered: &[T; LANES]) {
    for (sum, grad) in sums.iter_mut().zip(grads) {
        for lane in 0..LANES {
            sum[lane] = sum[lane] + covered[lane] * grad[lane];
        }
    }
}

impl<T: Real> WayBack<'_, T> {
    /// Adds to `own` what depth, normal and distortion make of an αT; sets `grad_depth` to the gradient
    /// with respect to z over αT.
    #[inline(always)]
    fn add_maps(
        &self,
        start: usize,
        normal: V3<T>,
        [weight, depth]: [&[T; LANES]; 2],
        own: &mut [T; LANES],
        grad_depth: &mut [T; LANES],
    ) {
        let two = T::of(2.0);
        let of_depth = lanes(self.grad, DEPTH_PLANE * TILE_PIXELS + start);
        let of_distortion = lanes(self.grad, DISTORTION_PLANE * TILE_PIXELS + start);
        let (first, second) = (lanes(&self.spread.first, start), lanes(&self.spread.second, start));
        let (reference, total) = (lanes(&self.spread.reference, start), lanes(&self.alpha, start));
        add_payload(own, three(self.grad, NORMAL_PLANE, start), normal);
        for lane in 0..LANES {
            let inverse = if weight[lane] > T::zero() { T::one() / depth[lane] } else { T::zero() };
            let m = self.slope * (reference[lane] - inverse);
            let apart = m * m * total[lane] + second[lane] - two * m * first[lane];
            own[lane] = own[lane] + of_depth[lane] * depth[lane] + of_distortion[lane] * apart;
            let grad_m = of_distortion[lane] * two * (m * total[lane] - first[lane]);
            grad_depth[lane] = of_depth[lane] + grad_m * self.slope * inverse * inverse;
        }
    }

    /// Removes one primitive from a group of pixels and adds its gradients to the sums.
    #[inline(always)]
    fn pass<F: Projected<T>, const MAPS: bool>(
        &mut self,
        entry: &Entry<T, F>,
        start: usize,
        (dx, dy): (&[T; LANES], T),
        (pixel, work): (&mut [[T; LANES]], &mut [[T; LANES]; WORK_ROWS]),
        sums: &mut Sums<[T; LANES]>,
    ) {
        let [weight, depth, own, covered, power, grad_depth] = pixel else {
            unreachable!("six rows of lanes");
        };
        entry.footprint.fragments(dx, dy, weight, depth);
        let end = group(&mut self.progress.end, start);
        for lane in 0..LANES {
            let blended = if entry.position < end[lane] { T::one() } else { T::zero() };
            weight[lane] = weight[lane] * blended;
        }
        if is_nothing(weight) {
            return;
        }
        own.fill(T::zero());
        let of_colour = three(self.grad, 0, start);
        add_payload(own, of_colour, entry.colour);
        if MAPS {
            self.add_maps(start, entry.normal, [&*weight, &*depth], own, grad_depth);
        }
        let through = group(&mut self.progress.through, start);
        let behind = group(&mut self.behind, start);
        for lane in 0..LANES {
            let alpha = weight[lane].min(self.max_alpha);
            let before = through[lane] / (T::one() - alpha);
            let free = if weight[lane] < self.max_alpha { T::one() } else { T::zero() };
            covered[lane] = alpha * before;
            power[lane] = free * covered[lane] * (own[lane] - behind[lane]);
            behind[lane] = alpha * own[lane] + (T::one() - alpha) * behind[lane];
            through[lane] = before;
        }
        add_covered(sums.colour, of_colour, covered);
        if MAPS {
            add_covered(sums.maps, three(self.grad, NORMAL_PLANE, start), covered);
            for lane in 0..LANES {
                grad_depth[lane] = covered[lane] * grad_depth[lane];
            }
        }
        let group = Group { dx, dy, covered, power, depth, grad_depth };
        entry.footprint.gather::<MAPS>(&group, work, sums);
    }
}

/// Sums over the pixels of a tile for the primitives of its list, up to where the last pixel ends, each as
/// in [`Layout`]; `grad` is [planes, `TILE_PIXELS`], zero outside the image.
#[inline(always)]
fn gather_tile<T: Real, F: Projected<T>, const MAPS: bool>(
    sorted: &Sorted<T, F>,
    tile: usize,
    grad: &[T],
    layout: &Layout,
    thresholds: &Thresholds<T>,
    slope: T,
) -> Vec<T> {
    let mut spread = Spread::new(slope);
    let progress = walk_tile(
        sorted,
        tile,
        thresholds,
        #[inline(always)]
        |_, start, Fragments { covered, through, depth, .. }| {
            if MAPS {
                spread.add(start, covered, through, depth);
            }
        },
    );
    let (list, origin, width) = (sorted.lists.of(tile), sorted.grid.origin(tile), layout.width());
    let mut sums = vec![T::zero(); progress.last_end() * width];
    let of_alpha = &grad[ALPHA_PLANE * TILE_PIXELS..][..TILE_PIXELS];
    let behind: [T; TILE_PIXELS] = std::array::from_fn(|pixel| -of_alpha[pixel]);
    let alpha: [T; TILE_PIXELS] = std::array::from_fn(|pixel| T::one() - progress.through[pixel]);
    let max_alpha = thresholds.max_alpha;
    let mut way = WayBack { progress, behind, grad, max_alpha, spread, alpha, slope };
    let mut scratch = Scratch::new(layout);
    let Scratch { pixel, work, sums: rows } = &mut scratch;
    let work: &mut [[T; LANES]; WORK_ROWS] = work.as_mut_slice().try_into().expect("as many rows");
    for (position, sums) in sums.chunks_exact_mut(width).enumerate().rev() {
        let id = list[position] as usize;
        let footprint = &sorted.footprints[id];
        let normal = if MAPS { sorted.normals[id] } else { [T::zero(); 3] };
        let entry = Entry { position: T::of(position as f64), footprint, colour: footprint.colour(), normal };
        rows.fill([T::zero(); LANES]);
        let mut parts = layout.split(rows);
        for_each_group(
            footprint.anchor(),
            &sorted.rects[id],
            origin,
            #[inline(always)]
            |start, dx, dy| way.pass::<F, MAPS>(&entry, start, (&dx, dy), (&mut pixel[..], &mut *work), &mut parts),
        );
        for (sum, row) in sums.iter_mut().zip(rows.iter()) {
            *sum = total(row);
        }
    }
    sums
}

/// By halves, so that the first step is one instruction.
#[inline(always)]
fn total<T: Real>(row: &[T; LANES]) -> T {
    let [a, b, c, d, e, f, g, h] = *row;
    let [a, b, c, d] = [a + e, b + f, c + g, d + h];
    (a + c) + (b + d)
}

/// Sums over all pixels for every sorted primitive, each as in `layout`; `grad` is [P, H, W].
fn gather<T: Real, F: Projected<T>>(
    sorted: &Sorted<T, F>,
    grad: &[T],
    layout: &Layout,
    slope: T,
    options: &BlendOptions,
) -> Vec<T> {
    let (thresholds, width) = (Thresholds::new(options), layout.width());
    let grad = to_tiles(grad, options.planes(), sorted.grid, T::zero());
    let block = options.planes() * TILE_PIXELS;
    let mut sums = vec![T::zero(); sorted.footprints.len() * width];
    let of_tile = |tile: usize| {
        let grad = &grad[tile * block..][..block];
        let (of_colour, of_maps) = grad.split_at(COLOUR_PLANES * TILE_PIXELS);
        let reached = |grad: &[T]| grad.iter().any(|&value| value != T::zero());
        vectorised(
            #[inline(always)]
            || {
                if reached(of_maps) {
                    gather_tile::<T, F, true>(sorted, tile, grad, layout, &thresholds, slope)
                } else if reached(of_colour) {
                    gather_tile::<T, F, false>(sorted, tile, grad, layout, &thresholds, slope)
                } else {
                    Vec::new()
                }
            },
        )
    };
    for first_tile in (0..sorted.grid.len()).step_by(BATCH) {
        let batch = first_tile..sorted.grid.len().min(first_tile + BATCH);
        let parts: Vec<Vec<T>> = batch.clone().into_par_iter().map(of_tile).collect();
        sums.par_chunks_mut(CHUNK * width).enumerate().for_each(|(chunk, sums)| {
            let ids = chunk * CHUNK..chunk * CHUNK + sums.len() / width;
            for (tile, parts) in batch.clone().zip(&parts) {
                let list = sorted.lists.of(tile);
                let from = list.partition_point(|&id| (id as usize) < ids.start);
                let parts = parts.get(from * width..).unwrap_or_default();
                let entries = list[from..].iter().map(|&id| id as usize).zip(parts.chunks_exact(width));
                for (id, part) in entries.take_while(|(id, _)| ids.contains(id)) {
                    let first = (id - ids.start) * width;
                    for (sum, &value) in sums[first..first + width].iter_mut().zip(part) {
                        *sum = *sum + value;
                    }
                }
            }
        });
    }
    sums
}

/// Gradients of one primitive.
struct PrimitiveGrad<T> {
    parameters: ParameterGrad<T>,
    colour: V3<T>,
    probe: [T; 4],
}

/// Gradients with respect to positions, quaternions, log-scales, opacities, colours and the probe, the last
/// empty unless it is `probed`; `grad` is [P, H, W].
pub fn backward<T: Real, F: Projected<T>>(
    gaussians: &GaussianRows<T>,
    grad: &[T],
    probed: bool,
    camera: &Camera,
    options: &BlendOptions,
) -> [Vec<T>; 6] {
    let view = CameraPair::<T>::new(camera, options.filter);
    let sorted = Sorted::<T, F>::new(gaussians, &view, options);
    let layout = Layout { footprint: F::SUMS, probe: probed, maps: options.maps };
    let mut sums = gather(&sorted, grad, &layout, distortion::slope(&view.camera), options);
    let [half_width, half_height] = [camera.width, camera.height].map(|size| T::of(0.5 * size as f64));
    let units = [half_width, half_height, half_width, half_height];
    let to_parameters = |(at, sums): (usize, &mut [T])| {
        let (parameters, sums) = (gaussians.parameters(sorted.rows[at]), layout.split(sums));
        let mut grad = sorted.footprints[at].backward(&view, &parameters, &sums);
        if let [x, y, z, _] = *sums.maps {
            let turn = normal_backward(&view.camera, &parameters, F::normal_axis(&parameters), [x, y, z]);
            for (sum, value) in grad.quaternion.iter_mut().zip(turn) {
                *sum = *sum + value;
            }
        }
        let colour = std::array::from_fn(|c| sums.colour[c]);
        let probe = std::array::from_fn(|i| sums.probe.get(i).map_or(T::zero(), |&sum| sum * units[i]));
        PrimitiveGrad { parameters: grad, colour, probe }
    };
    let grads: Vec<PrimitiveGrad<T>> = sums.par_chunks_mut(layout.width()).enumerate().map(to_parameters).collect();
    let probe_width = if probed { 4 } else { 0 };
    let mut out = [3, 4, 3, 1, 3, probe_width].map(|width| vec![T::zero(); gaussians.len() * width]);
    let [positions, quaternions, log_scales, opacities, colours, probes] = &mut out;
    for (&row, PrimitiveGrad { parameters, colour, probe }) in sorted.rows.iter().zip(&grads) {
        positions[3 * row..3 * row + 3].copy_from_slice(&parameters.position);
        quaternions[4 * row..4 * row + 4].copy_from_slice(&parameters.quaternion);
        log_scales[3 * row..3 * row + 3].copy_from_slice(&parameters.log_scales);
        opacities[row] = parameters.opacity;
        colours[3 * row..3 * row + 3].copy_from_slice(colour);
        if probed {
            probes[4 * row..4 * row + 4].copy_from_slice(probe);
        }
    }
    out
}

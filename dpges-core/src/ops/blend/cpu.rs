//! CPU kernels: one task per tile, its Gaussians front to back. Backward goes through them once more
//! from the back, where dividing by 1 − α recovers T. Its sums are made per tile and added in the
//! order of the tiles, so that the result does not depend on the number of threads.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::{BlendBackwardOps, BlendOps, BlendOptions, BlendOutput, OutputKind};
use crate::camera::Camera;
use crate::host::{self, Host, for_each_cpu_backend, with_real};
use crate::math::{CameraOf, V3, add, scale};
use crate::ops::binning::layout::{to_planes, to_tiles};
use crate::ops::binning::{LANES, PixelRect, TILE, TILE_PIXELS, TileGrid, TileLists, bin};
use crate::ops::splat::footprint::{self, ParameterGrad, Splat, SplatGrad};
use crate::ops::splat::{GaussianRows, SplatInput, for_each_group};
use crate::real::Real;
use crate::simd::vectorised;

/// Planes of the forward pass: colour, expected depth, median depth, alpha.
const PLANES: usize = 6;
const DEPTH: usize = 3;
const MEDIAN: usize = 4;
const ALPHA: usize = 5;
/// Whether all pixels of a tile have ended is looked up after this many Gaussians.
const LOOK_EVERY: usize = 16;
/// Tiles whose sums are held at a time.
const BATCH: usize = 64;
/// Gaussians that one task adds sums to.
const CHUNK: usize = 4096;

/// Visible Gaussians front to back.
struct Sorted<T> {
    /// Row of each in the parameters.
    rows: Vec<usize>,
    splats: Vec<Splat<T>>,
    rects: Vec<PixelRect>,
    grid: TileGrid,
    /// Positions in this order; ascending, thus front to back.
    lists: TileLists,
}

impl<T: Real> Sorted<T> {
    fn new(gaussians: &GaussianRows<T>, camera: &CameraOf<T>) -> Self {
        let grid = TileGrid::new(camera.width, camera.height);
        let mut visible: Vec<(usize, Splat<T>)> = (0..gaussians.len())
            .into_par_iter()
            .filter_map(|row| gaussians.splat(camera, row).map(|splat| (row, splat)))
            .collect();
        // stable: ties stay in the order of their rows
        visible.par_sort_by(|(_, a), (_, b)| a.depth.as_f64().total_cmp(&b.depth.as_f64()));
        let (rows, splats): (Vec<usize>, Vec<Splat<T>>) = visible.into_iter().unzip();
        let rects: Vec<PixelRect> = splats.par_iter().map(|splat| splat.reach(grid.width, grid.height)).collect();
        let lists = bin(&rects, grid, |i, tx, ty| splats[i].touches(tx, ty));
        Self { rows, splats, rects, grid, lists }
    }
}

struct Thresholds<T> {
    max_alpha: T,
    min_transmittance: T,
}

impl<T: Real> Thresholds<T> {
    fn new(options: &BlendOptions) -> Self {
        Self { max_alpha: T::of(options.max_alpha), min_transmittance: T::of(options.min_transmittance) }
    }
}

/// How far the pixels of a tile got.
struct Progress<T> {
    /// T
    through: [T; TILE_PIXELS],
    /// Entry of the tile's list before which a pixel ends; 0 outside the image.
    end: [u32; TILE_PIXELS],
}

impl<T: Real> Progress<T> {
    /// No pixel ends before the last of `entries`.
    #[inline(always)]
    fn new(entries: usize, origin: (usize, usize), grid: TileGrid) -> Self {
        let mut progress = Self { through: [T::one(); TILE_PIXELS], end: [0; TILE_PIXELS] };
        let (columns, rows) = (TILE.min(grid.width - origin.0), TILE.min(grid.height - origin.1));
        for line in progress.end.chunks_mut(TILE).take(rows) {
            line[..columns].fill(entries as u32);
        }
        progress
    }

    /// Entry before which all pixels have ended.
    #[inline(always)]
    fn last_end(&self) -> usize {
        self.end.iter().fold(0, |last: u32, &end| last.max(end)) as usize
    }
}

#[inline(always)]
fn group<V>(values: &mut [V], start: usize) -> &mut [V; LANES] {
    (&mut values[start..start + LANES]).try_into().expect("one group")
}

/// Goes through a tile front to back. Calls `visit(splat, start, covered, through)` for every group
/// of lanes that a Gaussian can reach: its αT, 0 where it is not blended, and T behind it.
#[inline(always)]
fn walk_tile<T: Real>(
    sorted: &Sorted<T>,
    tile: usize,
    thresholds: &Thresholds<T>,
    mut visit: impl FnMut(&Splat<T>, usize, [T; LANES], [T; LANES]),
) -> Progress<T> {
    let (list, origin) = (sorted.lists.of(tile), sorted.grid.origin(tile));
    let mut progress = Progress::<T>::new(list.len(), origin, sorted.grid);
    for (entry, &id) in list.iter().enumerate() {
        if entry.is_multiple_of(LOOK_EVERY) && progress.last_end() <= entry {
            break;
        }
        let (entry, id) = (entry as u32, id as usize);
        let splat = &sorted.splats[id];
        for_each_group(
            splat,
            &sorted.rects[id],
            origin,
            #[inline(always)]
            |start, dx, dy| {
                let through = group(&mut progress.through, start);
                let end = group(&mut progress.end, start);
                let mut covered = [T::zero(); LANES];
                for lane in 0..LANES {
                    let alpha = splat.weight(dx[lane], dy).min(thresholds.max_alpha);
                    let behind = through[lane] * (T::one() - alpha);
                    let open = entry < end[lane];
                    let blended = open & (behind >= thresholds.min_transmittance);
                    end[lane] = if open & !blended { entry } else { end[lane] };
                    covered[lane] = if blended { alpha * through[lane] } else { T::zero() };
                    through[lane] = if blended { behind } else { through[lane] };
                }
                visit(splat, start, covered, *through);
            },
        );
    }
    progress
}

/// Adds one tile to `block` [`PLANES`, `TILE_PIXELS`], zero so far.
#[inline(always)]
fn blend_tile<T: Real>(sorted: &Sorted<T>, tile: usize, thresholds: &Thresholds<T>, block: &mut [T]) {
    let half = T::of(0.5);
    let progress = walk_tile(
        sorted,
        tile,
        thresholds,
        #[inline(always)]
        |splat, start, covered, through| {
            let [red, green, blue] = splat.colour;
            for (plane, value) in [red, green, blue, splat.depth].into_iter().enumerate() {
                let sum = group(block, plane * TILE_PIXELS + start);
                for lane in 0..LANES {
                    sum[lane] = sum[lane] + covered[lane] * value;
                }
            }
            let median = group(block, MEDIAN * TILE_PIXELS + start);
            for lane in 0..LANES {
                let first = (covered[lane] > T::zero()) & (through[lane] <= half) & (median[lane] == T::zero());
                median[lane] = if first { splat.depth } else { median[lane] };
            }
        },
    );
    for (alpha, through) in block[ALPHA * TILE_PIXELS..].iter_mut().zip(progress.through) {
        *alpha = T::one() - through;
    }
}

/// Colour, alpha, expected and median depth.
fn forward<T: Real>(gaussians: &GaussianRows<T>, camera: &Camera, options: &BlendOptions) -> [Vec<T>; 4] {
    let sorted = Sorted::new(gaussians, &CameraOf::<T>::new(camera));
    let thresholds = Thresholds::new(options);
    let mut blocks = vec![T::zero(); sorted.grid.len() * PLANES * TILE_PIXELS];
    blocks.par_chunks_mut(PLANES * TILE_PIXELS).enumerate().for_each(|(tile, block)| {
        vectorised(
            #[inline(always)]
            || blend_tile(&sorted, tile, &thresholds, block),
        );
    });
    let pixels = camera.width * camera.height;
    let mut colour = to_planes(&blocks, PLANES, sorted.grid);
    let alpha = colour.split_off(ALPHA * pixels);
    let median_depth = colour.split_off(MEDIAN * pixels);
    let depth = colour.split_off(DEPTH * pixels);
    [colour, alpha, depth, median_depth]
}

/// Sums over the pixels of one Gaussian.
#[derive(Clone, Copy)]
struct Sums<T> {
    /// As in [`SplatGrad`].
    moments: [T; 6],
    /// Gradient with respect to the payload.
    payload: V3<T>,
}

impl<T: Real> Sums<T> {
    fn zero() -> Self {
        Self { moments: [T::zero(); 6], payload: [T::zero(); 3] }
    }

    fn add(&mut self, other: &Self) {
        for (sum, &value) in self.moments.iter_mut().zip(&other.moments) {
            *sum = *sum + value;
        }
        self.payload = add(self.payload, other.payload);
    }
}

/// What an output is the sum of, weighted by αT, plane by plane. Alpha is not such a sum but 1 − T.
#[inline(always)]
fn payload<T: Real>(kind: OutputKind, splat: &Splat<T>) -> V3<T> {
    match kind {
        OutputKind::Colour => splat.colour,
        OutputKind::Alpha => [T::zero(); 3],
        OutputKind::Depth => [splat.depth, T::zero(), T::zero()],
    }
}

/// Lanes that the way back works on; in memory that outlives it, as in `splat`.
struct Scratch<T> {
    /// Weight, derivative of the payload, αT, gradient of the exponent.
    pixel: Vec<[T; LANES]>,
    /// Six moments and three sums of the payload, as in [`Sums`].
    sums: Vec<[T; LANES]>,
}

impl<T: Real> Scratch<T> {
    fn new() -> Self {
        Self { pixel: vec![[T::zero(); LANES]; 4], sums: vec![[T::zero(); LANES]; 9] }
    }

    #[inline(always)]
    fn total(&self) -> Sums<T> {
        let total = |sum: usize| self.sums[sum].iter().copied().sum::<T>();
        Sums { moments: std::array::from_fn(total), payload: std::array::from_fn(|c| total(6 + c)) }
    }
}

/// One Gaussian of a tile's list.
struct Entry<'a, T> {
    position: u32,
    splat: &'a Splat<T>,
    payload: V3<T>,
}

/// The pixels of a tile on the way from the back to the front.
struct WayBack<'a, T> {
    /// T behind the Gaussian that is next.
    progress: Progress<T>,
    /// Derivative with respect to that T.
    behind: [T; TILE_PIXELS],
    /// [planes, `TILE_PIXELS`]
    grad: &'a [T],
    max_alpha: T,
}

impl<T: Real> WayBack<'_, T> {
    /// Takes one Gaussian away from a group of pixels and adds what they pass on to it to the sums.
    #[inline(always)]
    fn pass(&mut self, entry: &Entry<T>, start: usize, dx: &[T; LANES], dy: T, scratch: &mut Scratch<T>) {
        let [weight, own, covered, power] = scratch.pixel.as_mut_slice() else {
            unreachable!("four rows of lanes");
        };
        for lane in 0..LANES {
            weight[lane] = entry.splat.weight(dx[lane], dy);
        }
        own.fill(T::zero());
        for (plane, &value) in self.grad.chunks_exact(TILE_PIXELS).zip(&entry.payload) {
            let grad = &plane[start..start + LANES];
            for lane in 0..LANES {
                own[lane] = own[lane] + grad[lane] * value;
            }
        }
        let through = group(&mut self.progress.through, start);
        let end = group(&mut self.progress.end, start);
        let behind = group(&mut self.behind, start);
        for lane in 0..LANES {
            let blended = entry.position < end[lane];
            let alpha = if blended { weight[lane].min(self.max_alpha) } else { T::zero() };
            let before = through[lane] / (T::one() - alpha);
            let free = blended & (weight[lane] < self.max_alpha);
            covered[lane] = alpha * before;
            power[lane] = if free { covered[lane] * (own[lane] - behind[lane]) } else { T::zero() };
            behind[lane] = alpha * own[lane] + (T::one() - alpha) * behind[lane];
            through[lane] = before;
        }
        let [sum, sum_x, sum_y, sum_xx, sum_xy, sum_yy, of_payload @ ..] = scratch.sums.as_mut_slice() else {
            unreachable!("nine rows of lanes");
        };
        for lane in 0..LANES {
            sum[lane] = sum[lane] + power[lane];
        }
        for lane in 0..LANES {
            sum_x[lane] = sum_x[lane] + power[lane] * dx[lane];
        }
        for lane in 0..LANES {
            sum_y[lane] = sum_y[lane] + power[lane] * dy;
        }
        for lane in 0..LANES {
            sum_xx[lane] = sum_xx[lane] + power[lane] * dx[lane] * dx[lane];
        }
        for lane in 0..LANES {
            sum_xy[lane] = sum_xy[lane] + power[lane] * dx[lane] * dy;
        }
        for lane in 0..LANES {
            sum_yy[lane] = sum_yy[lane] + power[lane] * dy * dy;
        }
        for (plane, sum) in self.grad.chunks_exact(TILE_PIXELS).zip(of_payload) {
            let grad = &plane[start..start + LANES];
            for lane in 0..LANES {
                sum[lane] = sum[lane] + covered[lane] * grad[lane];
            }
        }
    }
}

/// Sums over the pixels of a tile for the Gaussians of its list, up to where the last pixel ends;
/// `grad` is [planes, `TILE_PIXELS`], zero outside the image.
#[inline(always)]
fn gather_tile<T: Real>(
    sorted: &Sorted<T>,
    tile: usize,
    grad: &[T],
    kind: OutputKind,
    thresholds: &Thresholds<T>,
) -> Vec<Sums<T>> {
    let progress = walk_tile(
        sorted,
        tile,
        thresholds,
        #[inline(always)]
        |_, _, _, _| {},
    );
    let (list, origin) = (sorted.lists.of(tile), sorted.grid.origin(tile));
    let mut sums = vec![Sums::<T>::zero(); progress.last_end()];
    let behind: [T; TILE_PIXELS] = match kind {
        OutputKind::Alpha => std::array::from_fn(|pixel| -grad[pixel]),
        OutputKind::Colour | OutputKind::Depth => [T::zero(); TILE_PIXELS],
    };
    let mut way = WayBack { progress, behind, grad, max_alpha: thresholds.max_alpha };
    let mut scratch = Scratch::new();
    for (position, sums) in sums.iter_mut().enumerate().rev() {
        let id = list[position] as usize;
        let splat = &sorted.splats[id];
        let entry = Entry { position: position as u32, splat, payload: payload(kind, splat) };
        scratch.sums.fill([T::zero(); LANES]);
        for_each_group(
            splat,
            &sorted.rects[id],
            origin,
            #[inline(always)]
            |start, dx, dy| way.pass(&entry, start, &dx, dy, &mut scratch),
        );
        *sums = scratch.total();
    }
    sums
}

/// Sums over all pixels for every sorted Gaussian.
fn gather<T: Real>(sorted: &Sorted<T>, grad: &[T], kind: OutputKind, thresholds: &Thresholds<T>) -> Vec<Sums<T>> {
    let grad = to_tiles(grad, kind.planes(), sorted.grid, T::zero());
    let block = kind.planes() * TILE_PIXELS;
    let mut sums = vec![Sums::<T>::zero(); sorted.splats.len()];
    for first_tile in (0..sorted.grid.len()).step_by(BATCH) {
        let batch = first_tile..sorted.grid.len().min(first_tile + BATCH);
        let of_tile = |tile: usize| {
            vectorised(
                #[inline(always)]
                || gather_tile(sorted, tile, &grad[tile * block..][..block], kind, thresholds),
            )
        };
        let parts: Vec<Vec<Sums<T>>> = batch.clone().into_par_iter().map(of_tile).collect();
        sums.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, sums)| {
            let ids = chunk * CHUNK..chunk * CHUNK + sums.len();
            for (tile, parts) in batch.clone().zip(&parts) {
                let list = sorted.lists.of(tile);
                let from = list.partition_point(|&id| (id as usize) < ids.start);
                let parts = parts.get(from..).unwrap_or_default();
                let entries = list[from..].iter().map(|&id| id as usize).zip(parts);
                for (id, part) in entries.take_while(|(id, _)| ids.contains(id)) {
                    sums[id - ids.start].add(part);
                }
            }
        });
    }
    sums
}

/// Gradients with respect to positions, quaternions, log-scales, opacities and colours, the last
/// empty where the output does not depend on them.
fn backward<T: Real>(
    gaussians: &GaussianRows<T>,
    grad: &[T],
    kind: OutputKind,
    camera: &Camera,
    options: &BlendOptions,
) -> [Vec<T>; 5] {
    let camera = CameraOf::<T>::new(camera);
    let sorted = Sorted::new(gaussians, &camera);
    let sums = gather(&sorted, grad, kind, &Thresholds::new(options));
    let to_parameters = |at: usize| {
        let Sums { moments, payload } = sums[at];
        let (parameters, sum) = (gaussians.parameters(sorted.rows[at]), SplatGrad { moments, colour: payload });
        let mut grads = footprint::backward(&camera, &parameters, &sorted.splats[at], &sum);
        if kind == OutputKind::Depth {
            grads.position = add(grads.position, scale(camera.rotation[2], payload[0]));
        }
        grads
    };
    let grads: Vec<ParameterGrad<T>> = (0..sorted.rows.len()).into_par_iter().map(to_parameters).collect();
    let colour_width = if kind.reaches_colours() { 3 } else { 0 };
    let mut out = [3, 4, 3, 1, colour_width].map(|width| vec![T::zero(); gaussians.len() * width]);
    let [positions, quaternions, log_scales, opacities, colours] = &mut out;
    for ((&row, grads), sums) in sorted.rows.iter().zip(&grads).zip(&sums) {
        positions[3 * row..3 * row + 3].copy_from_slice(&grads.position);
        quaternions[4 * row..4 * row + 4].copy_from_slice(&grads.quaternion);
        log_scales[3 * row..3 * row + 3].copy_from_slice(&grads.log_scales);
        opacities[row] = grads.opacity;
        if kind.reaches_colours() {
            colours[3 * row..3 * row + 3].copy_from_slice(&sums.payload);
        }
    }
    out
}

fn blend_on<B: Host>(gaussians: &SplatInput<B>, camera: &Camera, options: &BlendOptions) -> BlendOutput<B> {
    let (height, width, device) = (camera.height, camera.width, gaussians.positions.device());
    with_real!(gaussians.positions.dtype(), T => {
        let [colour, alpha, depth, median_depth] = forward(&GaussianRows::<T>::new(gaussians), camera, options);
        BlendOutput {
            colour: host::float_tensor::<B, T, 3>(colour, [3, height, width], &device),
            alpha: host::float_tensor::<B, T, 3>(alpha, [1, height, width], &device),
            depth: host::float_tensor::<B, T, 3>(depth, [1, height, width], &device),
            median_depth: host::float_tensor::<B, T, 3>(median_depth, [1, height, width], &device),
        }
    })
}

fn blend_backward_on<B: Host>(
    gaussians: &SplatInput<B>,
    grad: &FloatTensor<B>,
    kind: OutputKind,
    camera: &Camera,
    options: &BlendOptions,
) -> SplatInput<B> {
    let (count, device) = (host::rows(&gaussians.opacities), grad.device());
    with_real!(grad.dtype(), T => {
        let (rows, grad) = (GaussianRows::<T>::new(gaussians), host::floats::<B, T>(grad));
        let [positions, quaternions, log_scales, opacities, colours] = backward(&rows, &grad, kind, camera, options);
        let coloured = colours.len() / 3;
        SplatInput {
            positions: host::float_tensor::<B, T, 2>(positions, [count, 3], &device),
            quaternions: host::float_tensor::<B, T, 2>(quaternions, [count, 4], &device),
            log_scales: host::float_tensor::<B, T, 2>(log_scales, [count, 3], &device),
            opacities: host::float_tensor::<B, T, 1>(opacities, [count], &device),
            colours: host::float_tensor::<B, T, 2>(colours, [coloured, 3], &device),
        }
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl BlendOps for $backend {
            fn blend(gaussians: SplatInput<Self>, camera: Camera, options: BlendOptions) -> BlendOutput<Self> {
                blend_on::<Self>(&gaussians, &camera, &options)
            }
        }

        impl BlendBackwardOps for $backend {
            fn blend_backward(
                gaussians: SplatInput<Self>,
                grad: FloatTensor<Self>,
                kind: OutputKind,
                camera: Camera,
                options: BlendOptions,
            ) -> SplatInput<Self> {
                blend_backward_on::<Self>(&gaussians, &grad, kind, &camera, &options)
            }
        }
    };
}
for_each_cpu_backend!(implement);

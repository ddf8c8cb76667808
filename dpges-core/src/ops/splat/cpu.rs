//! CPU kernels. Forward, one task handles one tile. Backward and contributions gather over the pixels of each
//! Gaussian.

use std::ops::Range;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::autodiff::SplatState;
use super::{SplatInput, SplatOps, with_probe};
use crate::backend::host::{self, Host, with_real};
use crate::backend::kept::Kept;
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;
use crate::backend::vectorised::vectorised;
use crate::backend::vectors::MOST;
use crate::camera::Camera;
use crate::footprint::gaussian::cpu as splat;
use crate::footprint::gaussian::cpu::in_view::{InView, UNSEEN};
use crate::footprint::gaussian::cpu::lanes::{At, SplatLanes};
use crate::footprint::gaussian::cpu::{Splat, SplatGrad};
use crate::footprint::gaussian::tensors::{GaussianRows, GaussianTensors};
use crate::footprint::moments::{MOMENTS, add_moments};
use crate::math::CameraOf;
use crate::scene::ScreenFilter;
use crate::tiles::binning::cpu::bin;
use crate::tiles::layout::{to_planes, to_tiles};
use crate::tiles::{PixelRect, TILE_PIXELS, TileGrid, for_each_lanes};

const CHANNELS: usize = 4;
const CHUNK: usize = 256;

/// Limits of the pixels of a tile, [K + 1, `TILE_PIXELS`], and for each interval of the whole tile the range of depths at
/// which a Gaussian falls into it at some pixel.
struct TileLimits<'a, T> {
    of_pixels: &'a [T],
    ranges: &'a [[T; 2]],
}

/// Limits of an image in tile blocks. All intervals are empty outside the image.
struct LimitBlocks<T> {
    layers: usize,
    of_pixels: Vec<T>,
    ranges: Vec<[T; 2]>,
}

impl<T: Real> LimitBlocks<T> {
    /// From limits [K + 1, H, W].
    fn new(limits: &[T], grid: TileGrid) -> Self {
        let layers = limits.len() / (grid.width * grid.height) - 1;
        // no depth is before −∞: pixels outside the image take nothing
        let of_pixels = to_tiles(limits, layers + 1, grid, -T::INFINITY);
        let mut ranges = vec![[T::INFINITY, -T::INFINITY]; grid.len() * layers];
        ranges.par_chunks_mut(layers).zip(of_pixels.par_chunks((layers + 1) * TILE_PIXELS)).for_each(
            |(ranges, of_pixels)| {
                let limit = |k: usize, pixel: usize| of_pixels[k * TILE_PIXELS + pixel];
                // outside the image the slope is −∞, too
                for pixel in (0..TILE_PIXELS).filter(|&pixel| limit(layers, pixel) > T::zero()) {
                    let ramp = T::one() / limit(layers, pixel);
                    let mut low = -T::INFINITY;
                    for (k, range) in ranges.iter_mut().enumerate() {
                        let high = limit(k, pixel);
                        if low < high {
                            // from where the layer before begins to hide: the ramp belongs to both intervals
                            *range = [range[0].min(low - ramp), range[1].max(high)];
                        }
                        low = high;
                    }
                }
            },
        );
        Self { layers, of_pixels, ranges }
    }

    fn tile(&self, tile: usize) -> TileLimits<'_, T> {
        let (layers, block) = (self.layers, (self.layers + 1) * TILE_PIXELS);
        let of_pixels = &self.of_pixels[tile * block..][..block];
        TileLimits { of_pixels, ranges: &self.ranges[tile * layers..][..layers] }
    }
}

impl<T: Real> TileLimits<'_, T> {
    /// From the first to the last interval that a Gaussian at this depth falls into at some pixel of the tile.
    #[inline(always)]
    fn intervals(&self, depth: T) -> Range<usize> {
        // `<` since at the limit itself the share before it is 0
        let falls = |range: &[T; 2]| depth >= range[0] && depth < range[1];
        let first = self.ranges.iter().position(falls).unwrap_or(self.ranges.len());
        first..self.ranges.iter().rposition(falls).map_or(first, |last| last + 1)
    }

    /// Calls `visit(k, share)` with the shares of a Gaussian at `depth` in the `intervals` k of the pixels from `start` on, for those
    /// that are not all 0.
    #[inline(always)]
    fn for_each_share<S: Simd>(
        &self,
        intervals: &Range<usize>,
        start: usize,
        depth: Lanes<T, S>,
        mut visit: impl FnMut(usize, Lanes<T, S>),
    ) {
        let simd = depth.simd();
        let none = Lanes::zero(simd);
        let slope = self.load(self.ranges.len(), start, simd);
        let mut nearer =
            if intervals.start == 0 { none } else { self.before(intervals.start - 1, start, depth, slope) };
        for k in intervals.clone() {
            let before = self.before(k, start, depth, slope);
            // most Gaussians are in one interval, and each visit reads and writes four planes
            if nearer.below(before).any() {
                visit(k, before - nearer);
            }
            nearer = before;
        }
    }

    #[inline(always)]
    fn load<S: Simd>(&self, plane: usize, start: usize, simd: S) -> Lanes<T, S> {
        Lanes::load(simd, &self.of_pixels[plane * TILE_PIXELS + start..])
    }

    /// Share of a Gaussian at `depth` that is before layer `k` of the pixels from `start` on.
    #[inline(always)]
    fn before<S: Simd>(&self, k: usize, start: usize, depth: Lanes<T, S>, slope: Lanes<T, S>) -> Lanes<T, S> {
        let simd = depth.simd();
        let ahead = (self.load(k, start, simd) - depth) * slope;
        ahead.min(Lanes::splat(simd, T::one())).max(Lanes::zero(simd))
    }
}

/// Sums as [K, 4, H, W].
fn forward<T: Real>(
    gaussians: &GaussianRows<T>,
    limits: &[T],
    camera: &Camera,
    filter: ScreenFilter,
    kept: &Kept,
) -> Vec<T> {
    let grid = TileGrid::new(camera.width, camera.height);
    let seen = InView::new(gaussians, &CameraOf::new(camera), filter, grid);
    // culling by the ellipse, not its box, which a thin one fills by a small part
    let lists = bin(&seen.rects, grid, |i, tx, ty| seen.splats[i].touches(tx, ty));
    let limits = LimitBlocks::new(limits, grid);
    let (layers, block) = (limits.layers, limits.layers * CHANNELS * TILE_PIXELS);
    let mut sums = vec![T::zero(); grid.len() * block];
    sums.par_chunks_mut(block).enumerate().for_each(|(tile, sums)| {
        let (candidates, origin, limits) = (lists.of(tile), grid.origin(tile), limits.tile(tile));
        vectorised(SplatTile { candidates, seen: &seen, origin, limits, sums });
    });
    // the backward pass takes the same footprints, in place of projecting again
    kept.put(seen);
    to_planes(&sums, layers * CHANNELS, grid)
}

/// Adds the Gaussians of the list of a tile to its sums, [K, 4, `TILE_PIXELS`].
struct SplatTile<'a, T> {
    candidates: &'a [u32],
    seen: &'a InView<T>,
    origin: (usize, usize),
    limits: TileLimits<'a, T>,
    sums: &'a mut [T],
}

impl<T: Real> WithSimd for SplatTile<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { candidates, seen, origin, limits, sums } = self;
        for &id in candidates {
            let (splat, rect) = (&seen.splats[id as usize], &seen.rects[id as usize]);
            let intervals = limits.intervals(splat.depth);
            // hidden in every pixel of the tile: no exponential is computed
            if intervals.is_empty() {
                continue;
            }
            let all = |value: T| Lanes::splat(simd, value);
            let (footprint, depth) = (SplatLanes::new(simd, splat), all(splat.depth));
            let [red, green, blue] = splat.colour;
            let payload = [all(red), all(green), all(blue), all(T::one())];
            for_each_lanes(
                simd,
                splat.mean,
                rect,
                origin,
                #[inline(always)]
                |start, dx, dy| {
                    let Some(At { weight, .. }) = footprint.at(dx, dy) else { return };
                    limits.for_each_share(
                        &intervals,
                        start,
                        depth,
                        #[inline(always)]
                        |k, share| {
                            let weight = weight * share;
                            for (channel, &value) in payload.iter().enumerate() {
                                let sums = &mut sums[(k * CHANNELS + channel) * TILE_PIXELS + start..];
                                weight.mul_add(value, Lanes::load(simd, sums)).store(sums);
                            }
                        },
                    );
                },
            );
        }
    }
}

/// A Gaussian of a view, in all its tiles.
struct Reached<'a, T> {
    splat: &'a Splat<T>,
    rect: &'a PixelRect,
    grid: TileGrid,
    limits: &'a LimitBlocks<T>,
}

impl<T: Real> Reached<'_, T> {
    /// Calls `visit(tile, start, limits, intervals, at)` for the pixels from `start` on of every tile in which the Gaussian can
    /// add to some pixel, in these intervals.
    #[inline(always)]
    fn for_each<S: Simd>(&self, simd: S, mut visit: impl FnMut(usize, usize, &TileLimits<T>, &Range<usize>, At<T, S>)) {
        let footprint = SplatLanes::new(simd, self.splat);
        let [tx0, tx1, ty0, ty1] = self.rect.tiles();
        for ty in ty0..ty1 {
            for tx in tx0..tx1 {
                let tile = ty * self.grid.columns + tx;
                let limits = self.limits.tile(tile);
                let intervals = limits.intervals(self.splat.depth);
                if intervals.is_empty() || !self.splat.touches(tx, ty) {
                    continue;
                }
                for_each_lanes(
                    simd,
                    self.splat.mean,
                    self.rect,
                    self.grid.origin(tile),
                    #[inline(always)]
                    |start, dx, dy| {
                        if let Some(at) = footprint.at(dx, dy) {
                            visit(tile, start, &limits, &intervals, at);
                        }
                    },
                );
            }
        }
    }
}

/// Sums the gradients of Gaussians from `first` on over their pixels; `grad` is [tile, K, 4, `TILE_PIXELS`].
struct Gather<'a, T> {
    seen: &'a InView<T>,
    first: usize,
    grid: TileGrid,
    limits: &'a LimitBlocks<T>,
    grad: &'a [T],
    sums: &'a mut [SplatGrad<T>],
}

impl<T: Real> WithSimd for Gather<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        for i in 0..self.sums.len() {
            self.sums[i] = self.gather(self.first + i, simd);
        }
    }
}

impl<T: Real> Gather<'_, T> {
    #[inline(always)]
    fn gather<S: Simd>(&self, i: usize, simd: S) -> SplatGrad<T> {
        let splat = &self.seen.splats[i];
        let all = |value: T| Lanes::splat(simd, value);
        let (depth, colour) = (all(splat.depth), Lanes::splat_three(simd, splat.colour));
        let mut moments = [all(T::zero()); MOMENTS];
        let mut colours = [all(T::zero()); 3];
        let block = self.limits.layers * CHANNELS * TILE_PIXELS;
        Reached { splat, rect: &self.seen.rects[i], grid: self.grid, limits: self.limits }.for_each(
            simd,
            #[inline(always)]
            |tile, start, limits, intervals, At { u, v, weight }| {
                let grad = &self.grad[tile * block..][..block];
                let [red, green, blue, alpha] = read_gradients(grad, limits, intervals, depth, start);
                // the weight multiplies (c, 1) in the four sums, so that its gradient is (c, 1) times theirs
                let payload = colour[0].mul_add(red, colour[1].mul_add(green, colour[2].mul_add(blue, alpha)));
                for (sum, grad) in colours.iter_mut().zip([red, green, blue]) {
                    *sum = weight.mul_add(grad, *sum);
                }
                add_moments(&mut moments, weight * payload, u, all(v));
            },
        );
        SplatGrad { moments: moments.map(Lanes::sum), colour: colours.map(Lanes::sum) }
    }
}

/// Gradients of the sums that a Gaussian at `depth` adds to, for each channel.
#[inline(always)]
fn read_gradients<T: Real, S: Simd>(
    grad: &[T],
    limits: &TileLimits<T>,
    intervals: &Range<usize>,
    depth: Lanes<T, S>,
    start: usize,
) -> [Lanes<T, S>; CHANNELS] {
    let simd = depth.simd();
    let mut pixel = [Lanes::zero(simd); CHANNELS];
    limits.for_each_share(
        intervals,
        start,
        depth,
        #[inline(always)]
        |k, share| {
            for (channel, pixel) in pixel.iter_mut().enumerate() {
                let grad = Lanes::load(simd, &grad[(k * CHANNELS + channel) * TILE_PIXELS + start..]);
                *pixel = share.mul_add(grad, *pixel);
            }
        },
    );
    pixel
}

/// Turns the sums over pixels of the first `count` of `rows`, all of one chunk, into the gradients of its positions,
/// quaternions, log-scales and opacities.
struct Backward<'a, T: Real> {
    gaussians: &'a GaussianRows<'a, T>,
    camera: &'a CameraOf<T>,
    filter: ScreenFilter,
    seen: &'a InView<T>,
    sums: &'a [SplatGrad<T>],
    /// By row.
    places: &'a [u32],
    rows: &'a [usize],
    count: usize,
    parts: [&'a mut [T]; 4],
}

impl<T: Real> WithSimd for Backward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { gaussians, filter, seen, sums, places, rows, count, parts, .. } = self;
        let [positions, quaternions, log_scales, opacities] = parts;
        let camera = self.camera.in_lanes(simd);
        for first in (0..count).step_by(T::lane_count::<S>()) {
            let rows: &[usize; MOST] = rows[first..].first_chunk().expect("rows are padded");
            let place = |lane: usize| places[rows[lane]] as usize;
            let parameters = gaussians.parameters_in_lanes(simd, rows);
            let splat = Splat::together(simd, |lane| &seen.splats[place(lane)]);
            let moments = Lanes::from_rows(simd, |lane| sums[place(lane)].moments);
            let sum = SplatGrad { moments, colour: [Lanes::zero(simd); 3] };
            let grads = splat::backward(&camera, &parameters, &splat, &sum, filter);
            let position = Lanes::to_rows(grads.position);
            let quaternion = Lanes::to_rows(grads.quaternion);
            let log_scale = Lanes::to_rows(grads.log_scales);
            let opacity = Lanes::to_rows([grads.opacity]);
            for lane in 0..T::lane_count::<S>().min(count - first) {
                let j = rows[lane] % CHUNK;
                positions[3 * j..3 * j + 3].copy_from_slice(&position[lane]);
                quaternions[4 * j..4 * j + 4].copy_from_slice(&quaternion[lane]);
                log_scales[3 * j..3 * j + 3].copy_from_slice(&log_scale[lane]);
                [opacities[j]] = opacity[lane];
            }
        }
    }
}

/// Gradients with respect to positions, quaternions, log-scales, opacities, colours and the probe, the last empty unless it
/// is `probed`.
fn backward<T: Real>(
    gaussians: &GaussianRows<T>,
    limits: &[T],
    grad: &[T],
    camera: &Camera,
    filter: ScreenFilter,
    probed: bool,
    kept: &Kept,
) -> [Vec<T>; 6] {
    let grid = TileGrid::new(camera.width, camera.height);
    let half_image = [camera.width, camera.height].map(|size| T::of(0.5 * size as f64));
    let camera = CameraOf::<T>::new(camera);
    let limits = LimitBlocks::new(limits, grid);
    let grad = to_tiles(grad, limits.layers * CHANNELS, grid, T::zero());
    let seen = kept.get_or(|| InView::new(gaussians, &camera, filter, grid));
    let mut sums: Vec<SplatGrad<T>> = vec![SplatGrad::default(); seen.rows.len()];
    // a Gaussian is summed by one task, in the order of its tiles: the same bits with any number of threads
    sums.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, sums)| {
        vectorised(Gather { seen: &seen, first: chunk * CHUNK, grid, limits: &limits, grad: &grad, sums });
    });
    let places = seen.places(gaussians.len());
    let probe_width = if probed { 2 } else { 0 };
    let mut out = [3, 4, 3, 1, 3, probe_width].map(|width| vec![T::zero(); gaussians.len() * width]);
    let [positions, quaternions, log_scales, opacities, colours, probes] = &mut out;
    // an empty probe has as many empty chunks
    let mut probes: Vec<&mut [T]> = probes.chunks_mut(2 * CHUNK).collect();
    probes.resize_with(gaussians.len().div_ceil(CHUNK), || &mut []);
    positions
        .par_chunks_mut(3 * CHUNK)
        .zip(quaternions.par_chunks_mut(4 * CHUNK))
        .zip(log_scales.par_chunks_mut(3 * CHUNK))
        .zip(opacities.par_chunks_mut(CHUNK))
        .zip(colours.par_chunks_mut(3 * CHUNK))
        .zip(probes)
        .enumerate()
        .for_each(|(chunk, (((((positions, quaternions), log_scales), opacities), colours), probes))| {
            let first = chunk * CHUNK;
            // out of view nothing has a gradient, and all are 0 so far
            let mut rows: Vec<usize> = (first..first + opacities.len()).filter(|&row| places[row] != UNSEEN).collect();
            let count = rows.len();
            // the last row again in lanes that are left over
            rows.extend(std::iter::repeat_n(rows.last().copied().unwrap_or(0), MOST));
            let parts = [positions, quaternions, log_scales, opacities];
            vectorised(Backward {
                gaussians,
                camera: &camera,
                filter,
                seen: &seen,
                sums: &sums,
                places: &places,
                rows: &rows,
                count,
                parts,
            });
            for &row in &rows[..count] {
                let (place, j) = (places[row] as usize, row - first);
                let (splat, sum) = (&seen.splats[place], &sums[place]);
                colours[3 * j..3 * j + 3].copy_from_slice(&sum.colour);
                if probed {
                    let [x, y] = splat.mean_gradient(sum);
                    probes[2 * j..2 * j + 2].copy_from_slice(&[x * half_image[0], y * half_image[1]]);
                }
            }
        });
    out
}

/// The largest contribution of a Gaussian to any pixel; `gates` are [tile, K, `TILE_PIXELS`].
struct Largest<'a, T> {
    seen: &'a InView<T>,
    i: usize,
    grid: TileGrid,
    limits: &'a LimitBlocks<T>,
    gates: &'a [T],
}

impl<T: Real> WithSimd for Largest<'_, T> {
    type Output = T;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> T {
        let (splat, rect) = (&self.seen.splats[self.i], &self.seen.rects[self.i]);
        let (depth, mut largest) = (Lanes::splat(simd, splat.depth), Lanes::zero(simd));
        let block = self.limits.layers * TILE_PIXELS;
        Reached { splat, rect, grid: self.grid, limits: self.limits }.for_each(
            simd,
            #[inline(always)]
            |tile, start, limits, intervals, At { weight, .. }| {
                let gates = &self.gates[tile * block..][..block];
                limits.for_each_share(
                    intervals,
                    start,
                    depth,
                    #[inline(always)]
                    |k, share| {
                        let gate = Lanes::load(simd, &gates[k * TILE_PIXELS + start..]);
                        largest = largest.max(weight * gate * share);
                    },
                );
            },
        );
        // the colour is that of all pixels: one product after the maximum
        largest.largest() * splat.colour.iter().fold(T::zero(), |most, channel| most.max(channel.abs()))
    }
}

/// Largest contribution of each Gaussian to any pixel.
fn contributions<T: Real>(gaussians: &GaussianRows<T>, limits: &[T], gates: &[T], camera: &Camera) -> Vec<T> {
    let grid = TileGrid::new(camera.width, camera.height);
    let camera = CameraOf::<T>::new(camera);
    let limits = LimitBlocks::new(limits, grid);
    let gates = to_tiles(gates, limits.layers, grid, T::zero());
    let seen = InView::new(gaussians, &camera, ScreenFilter::Compensated, grid);
    let largest = |i: usize| vectorised(Largest { seen: &seen, i, grid, limits: &limits, gates: &gates });
    let of_seen: Vec<T> = (0..seen.rows.len()).into_par_iter().map(largest).collect();
    let mut of_all = vec![T::zero(); gaussians.len()];
    for (&row, largest) in seen.rows.iter().zip(of_seen) {
        of_all[row as usize] = largest;
    }
    of_all
}

impl<B: Host> SplatOps for B {
    fn splat(input: SplatInput<B>, camera: Camera, filter: ScreenFilter, kept: Kept) -> FloatTensor<B> {
        let SplatInput { gaussians, limits, .. } = input;
        let layers = host::rows(&limits) - 1;
        with_real!(limits.dtype(), T => {
            let (rows, limit) = (GaussianRows::<T>::new(&gaussians), host::floats::<B, T>(&limits));
            let sums = forward(&rows, &limit, &camera, filter, &kept);
            host::float_tensor::<B, T, 4>(sums, [layers, CHANNELS, camera.height, camera.width], &limits.device())
        })
    }

    fn splat_contributions(
        gaussians: GaussianTensors<B>,
        limits: FloatTensor<B>,
        gates: FloatTensor<B>,
        camera: Camera,
    ) -> FloatTensor<B> {
        with_real!(limits.dtype(), T => {
            let rows = GaussianRows::<T>::new(&gaussians);
            let [limit, gates] = [&limits, &gates].map(host::floats::<B, T>);
            let values = contributions(&rows, &limit, &gates, &camera);
            host::float_tensor::<B, T, 1>(values, [rows.len()], &limits.device())
        })
    }
}

impl<B: Host> BackwardState<B, 6> for SplatState<B> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 6] {
        let Self { input: SplatInput { gaussians, probe, limits }, camera, filter, kept } = self;
        let (probed, device) = (host::rows(&probe) > 0, limits.device());
        with_real!(limits.dtype(), T => {
            let rows = GaussianRows::<T>::new(&gaussians);
            let [limits, grad] = [&limits, &grad].map(host::floats::<B, T>);
            let [positions, quaternions, log_scales, opacities, colours, probe] =
                backward(&rows, &limits, &grad, &camera, filter, probed, &kept);
            let count = rows.len();
            let probe = probed.then(|| host::float_tensor::<B, T, 2>(probe, [count, 2], &device));
            let gaussians =
                GaussianTensors::<B>::from_rows([positions, quaternions, log_scales, opacities, colours], &device);
            with_probe(gaussians.into_array().map(Some), probe)
        })
    }
}

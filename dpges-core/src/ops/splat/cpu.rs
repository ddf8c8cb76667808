//! CPU kernels. Forward, one task handles one tile. Backward and contributions gather over the pixels of each
//! Gaussian.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::{SplatBackwardOps, SplatGradients, SplatOps};
use crate::backend::host::{self, Host, for_each_cpu_backend, with_real};
use crate::backend::real::Real;
use crate::backend::simd::{LANES, vectorised};
use crate::camera::Camera;
use crate::footprint::gaussian::cpu as splat;
use crate::footprint::gaussian::cpu::{Splat, SplatGrad};
use crate::footprint::gaussian::tensors::{GaussianRows, GaussianTensors};
use crate::footprint::moments::{MOMENTS, add_moments};
use crate::math::CameraOf;
use crate::scene::ScreenFilter;
use crate::tiles::binning::cpu::bin;
use crate::tiles::layout::{to_planes, to_tiles};
use crate::tiles::{PixelRect, TILE_PIXELS, TileGrid, for_each_group};

const CHANNELS: usize = 4;
const CHUNK: usize = 256;

/// Interval limits of the pixels of a tile, [K, `TILE_PIXELS`], and of the whole tile: for each interval, the
/// smallest lower and the largest upper limit among the pixels where it is not empty.
struct TileLimits<'a, T> {
    upper: &'a [T],
    ranges: &'a [[T; 2]],
}

/// Interval limits of an image in tile blocks. All intervals are empty outside the image.
struct LimitBlocks<T> {
    layers: usize,
    upper: Vec<T>,
    ranges: Vec<[T; 2]>,
}

impl<T: Real> LimitBlocks<T> {
    fn new(limits: &[T], layers: usize, grid: TileGrid) -> Self {
        let upper = to_tiles(limits, layers, grid, -T::INFINITY);
        let mut ranges = vec![[T::INFINITY, -T::INFINITY]; grid.len() * layers];
        ranges.par_chunks_mut(layers).zip(upper.par_chunks(layers * TILE_PIXELS)).for_each(|(ranges, upper)| {
            for (k, range) in ranges.iter_mut().enumerate() {
                for pixel in 0..TILE_PIXELS {
                    let low = if k == 0 { -T::INFINITY } else { upper[(k - 1) * TILE_PIXELS + pixel] };
                    let high = upper[k * TILE_PIXELS + pixel];
                    if low < high {
                        *range = [range[0].min(low), range[1].max(high)];
                    }
                }
            }
        });
        Self { layers, upper, ranges }
    }

    fn tile(&self, tile: usize) -> TileLimits<'_, T> {
        let (layers, block) = (self.layers, self.layers * TILE_PIXELS);
        TileLimits { upper: &self.upper[tile * block..][..block], ranges: &self.ranges[tile * layers..][..layers] }
    }
}

impl<T: Real> TileLimits<'_, T> {
    /// Intervals that a Gaussian at this depth falls into at some pixel of the tile.
    #[inline(always)]
    fn intervals(&self, depth: T) -> impl Iterator<Item = usize> + Clone {
        self.ranges.iter().enumerate().filter(move |(_, range)| depth >= range[0] && depth < range[1]).map(|(k, _)| k)
    }

    /// For each lane 1 if `depth` falls into interval `k`, else 0.
    #[inline(always)]
    fn mask(&self, k: usize, start: usize, depth: T) -> [T; LANES] {
        let upper = lanes(self.upper, k * TILE_PIXELS + start);
        let lower = if k == 0 { [-T::INFINITY; LANES] } else { lanes(self.upper, (k - 1) * TILE_PIXELS + start) };
        let mut mask = [T::zero(); LANES];
        for lane in 0..LANES {
            mask[lane] = if (depth >= lower[lane]) & (depth < upper[lane]) { T::one() } else { T::zero() };
        }
        mask
    }
}

#[inline(always)]
fn lanes<T: Real>(values: &[T], start: usize) -> [T; LANES] {
    values[start..start + LANES].try_into().expect("one group")
}

/// Sums as [K, 4, H, W].
fn forward<T: Real>(
    gaussians: &GaussianRows<T>,
    limits: &[T],
    layers: usize,
    camera: &Camera,
    filter: ScreenFilter,
) -> Vec<T> {
    let grid = TileGrid::new(camera.width, camera.height);
    let camera = CameraOf::<T>::new(camera);
    let splats: Vec<Option<Splat<T>>> =
        (0..gaussians.len()).into_par_iter().map(|i| gaussians.splat(&camera, i, filter)).collect();
    let reach =
        |splat: &Option<Splat<T>>| splat.as_ref().map_or(PixelRect::EMPTY, |s| s.reach(grid.width, grid.height));
    let rects: Vec<PixelRect> = splats.par_iter().map(reach).collect();
    let lists = bin(&rects, grid, |i, tx, ty| splats[i].as_ref().is_some_and(|s| s.touches(tx, ty)));
    let limits = LimitBlocks::new(limits, layers, grid);
    let block = layers * CHANNELS * TILE_PIXELS;
    let mut sums = vec![T::zero(); grid.len() * block];
    sums.par_chunks_mut(block).enumerate().for_each(|(tile, sums)| {
        vectorised(
            #[inline(always)]
            || splat_tile(lists.of(tile), &splats, &rects, grid.origin(tile), &limits.tile(tile), sums),
        );
    });
    to_planes(&sums, layers * CHANNELS, grid)
}

#[inline(always)]
fn splat_tile<T: Real>(
    candidates: &[u32],
    splats: &[Option<Splat<T>>],
    rects: &[PixelRect],
    origin: (usize, usize),
    limits: &TileLimits<T>,
    sums: &mut [T],
) {
    for &id in candidates {
        let Some(splat) = &splats[id as usize] else { continue };
        let intervals = limits.intervals(splat.depth);
        if intervals.clone().next().is_none() {
            continue;
        }
        let payload = [splat.colour[0], splat.colour[1], splat.colour[2], T::one()];
        for_each_group(
            splat.mean,
            &rects[id as usize],
            origin,
            #[inline(always)]
            |start, dx, dy| {
                let mut weight = [T::zero(); LANES];
                for lane in 0..LANES {
                    let [u, v] = splat.in_deviations(dx[lane], dy);
                    weight[lane] = splat.weight(u, v);
                }
                for k in intervals.clone() {
                    let mask = limits.mask(k, start, splat.depth);
                    let mut masked = [T::zero(); LANES];
                    for lane in 0..LANES {
                        masked[lane] = weight[lane] * mask[lane];
                    }
                    for (channel, &value) in payload.iter().enumerate() {
                        let at = (k * CHANNELS + channel) * TILE_PIXELS + start;
                        let sums: &mut [T; LANES] = (&mut sums[at..at + LANES]).try_into().expect("one group");
                        for lane in 0..LANES {
                            sums[lane] = sums[lane] + masked[lane] * value;
                        }
                    }
                }
            },
        );
    }
}

/// Calls `visit(tile, limits)` for every tile in which a splat can add to some pixel.
#[inline(always)]
fn for_each_lit_tile<T: Real>(
    splat: &Splat<T>,
    rect: &PixelRect,
    grid: TileGrid,
    limits: &LimitBlocks<T>,
    mut visit: impl FnMut(usize, TileLimits<T>),
) {
    let [tx0, tx1, ty0, ty1] = rect.tiles();
    for ty in ty0..ty1 {
        for tx in tx0..tx1 {
            let tile = ty * grid.columns + tx;
            let limits = limits.tile(tile);
            if splat.touches(tx, ty) && limits.intervals(splat.depth).next().is_some() {
                visit(tile, limits);
            }
        }
    }
}

/// Lanes that [`gather`] works on. They are on the heap because the compiler splits local arrays into scalars
/// and then does not vectorise.
struct Scratch<T> {
    /// Red, green, blue and alpha gradients of the pixels, weight, gradient of the exponent, u.
    pixel: Vec<[T; LANES]>,
    /// Moments and three colour sums, as in [`SplatGrad`].
    sums: Vec<[T; LANES]>,
}

impl<T: Real> Scratch<T> {
    fn new() -> Self {
        Self { pixel: vec![[T::zero(); LANES]; 7], sums: vec![[T::zero(); LANES]; MOMENTS + 3] }
    }
}

/// Sums the gradients of one Gaussian over its pixels; `grad` is [tile, K, 4, `TILE_PIXELS`].
#[inline(always)]
fn gather<T: Real>(
    splat: &Splat<T>,
    grid: TileGrid,
    limits: &LimitBlocks<T>,
    grad: &[T],
    scratch: &mut Scratch<T>,
) -> SplatGrad<T> {
    scratch.sums.fill([T::zero(); LANES]);
    let rect = splat.reach(grid.width, grid.height);
    let block = limits.layers * CHANNELS * TILE_PIXELS;
    for_each_lit_tile(
        splat,
        &rect,
        grid,
        limits,
        #[inline(always)]
        |tile, limits| {
            let grad = &grad[tile * block..][..block];
            let intervals = limits.intervals(splat.depth);
            for_each_group(
                splat.mean,
                &rect,
                grid.origin(tile),
                #[inline(always)]
                |start, dx, dy| {
                    read_gradients(grad, &limits, intervals.clone(), splat.depth, start, &mut scratch.pixel);
                    add_group(splat, &dx, dy, scratch);
                },
            );
        },
    );
    let total = |sum: usize| scratch.sums[sum].iter().copied().sum::<T>();
    SplatGrad { moments: std::array::from_fn(total), colour: std::array::from_fn(|c| total(MOMENTS + c)) }
}

/// Gradients of the sums that a Gaussian at `depth` adds to, for each channel and lane.
#[inline(always)]
fn read_gradients<T: Real>(
    grad: &[T],
    limits: &TileLimits<T>,
    intervals: impl Iterator<Item = usize>,
    depth: T,
    start: usize,
    pixel: &mut [[T; LANES]],
) {
    pixel[..CHANNELS].fill([T::zero(); LANES]);
    for k in intervals {
        let mask = limits.mask(k, start, depth);
        for (channel, pixel) in pixel[..CHANNELS].iter_mut().enumerate() {
            let grad = lanes(grad, (k * CHANNELS + channel) * TILE_PIXELS + start);
            for lane in 0..LANES {
                pixel[lane] = pixel[lane] + mask[lane] * grad[lane];
            }
        }
    }
}

/// Adds one group of pixels to the sums of a Gaussian.
#[inline(always)]
fn add_group<T: Real>(splat: &Splat<T>, dx: &[T; LANES], dy: T, scratch: &mut Scratch<T>) {
    let [red, green, blue, alpha, weight, power, u] = scratch.pixel.as_mut_slice() else {
        unreachable!("seven rows of lanes");
    };
    let [p, q, r] = splat.root;
    let v = r * dy;
    for lane in 0..LANES {
        u[lane] = p * dx[lane] + q * dy;
        weight[lane] = splat.weight(u[lane], v);
    }
    let [r, g, b] = splat.colour;
    for lane in 0..LANES {
        power[lane] = weight[lane] * (alpha[lane] + r * red[lane] + g * green[lane] + b * blue[lane]);
    }
    let (moments, colours) = scratch.sums.split_at_mut(MOMENTS);
    for (sum, grad) in colours.iter_mut().zip([&*red, &*green, &*blue]) {
        for lane in 0..LANES {
            sum[lane] = sum[lane] + weight[lane] * grad[lane];
        }
    }
    add_moments(moments, power, u, v);
}

/// Gradients with respect to positions, quaternions, log-scales, opacities, colours and the probe, the last empty unless it
/// is `probed`.
fn backward<T: Real>(
    gaussians: &GaussianRows<T>,
    limits: &[T],
    grad: &[T],
    layers: usize,
    camera: &Camera,
    filter: ScreenFilter,
    probed: bool,
) -> [Vec<T>; 6] {
    let grid = TileGrid::new(camera.width, camera.height);
    let half_image = [camera.width, camera.height].map(|size| T::of(0.5 * size as f64));
    let camera = CameraOf::<T>::new(camera);
    let limits = LimitBlocks::new(limits, layers, grid);
    let grad = to_tiles(grad, layers * CHANNELS, grid, T::zero());
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
            vectorised(
                #[inline(always)]
                || {
                    let mut scratch = Scratch::new();
                    for j in 0..opacities.len() {
                        let i = chunk * CHUNK + j;
                        let Some(splat) = gaussians.splat(&camera, i, filter) else { continue };
                        let sum = gather(&splat, grid, &limits, &grad, &mut scratch);
                        let grads = splat::backward(&camera, &gaussians.parameters(i), &splat, &sum, filter);
                        positions[3 * j..3 * j + 3].copy_from_slice(&grads.position);
                        quaternions[4 * j..4 * j + 4].copy_from_slice(&grads.quaternion);
                        log_scales[3 * j..3 * j + 3].copy_from_slice(&grads.log_scales);
                        opacities[j] = grads.opacity;
                        colours[3 * j..3 * j + 3].copy_from_slice(&sum.colour);
                        if probed {
                            let [x, y] = splat.mean_gradient(&sum);
                            probes[2 * j..2 * j + 2].copy_from_slice(&[x * half_image[0], y * half_image[1]]);
                        }
                    }
                },
            );
        });
    out
}

/// Largest contribution of each Gaussian to any pixel.
fn contributions<T: Real>(
    gaussians: &GaussianRows<T>,
    limits: &[T],
    gates: &[T],
    layers: usize,
    camera: &Camera,
) -> Vec<T> {
    let grid = TileGrid::new(camera.width, camera.height);
    let camera = CameraOf::<T>::new(camera);
    let limits = LimitBlocks::new(limits, layers, grid);
    let gates = to_tiles(gates, layers, grid, T::zero());
    let largest = |splat: Splat<T>| {
        let rect = splat.reach(grid.width, grid.height);
        let mut largest = [T::zero(); LANES];
        for_each_lit_tile(&splat, &rect, grid, &limits, |tile, limits| {
            let gates = &gates[tile * layers * TILE_PIXELS..][..layers * TILE_PIXELS];
            for_each_group(splat.mean, &rect, grid.origin(tile), |start, dx, dy| {
                for k in limits.intervals(splat.depth) {
                    let mask = limits.mask(k, start, splat.depth);
                    let gate = lanes(gates, k * TILE_PIXELS + start);
                    for lane in 0..LANES {
                        let [u, v] = splat.in_deviations(dx[lane], dy);
                        largest[lane] = largest[lane].max(splat.weight(u, v) * mask[lane] * gate[lane]);
                    }
                }
            });
        });
        let brightest = splat.colour.iter().fold(T::zero(), |m, c| m.max(c.abs()));
        largest.into_iter().fold(T::zero(), T::max) * brightest
    };
    let splat = |i| gaussians.splat(&camera, i, ScreenFilter::Compensated);
    (0..gaussians.len()).into_par_iter().map(|i| splat(i).map_or(T::zero(), largest)).collect()
}

fn splat_on<B: Host>(
    gaussians: &GaussianTensors<B>,
    limits: &FloatTensor<B>,
    camera: &Camera,
    filter: ScreenFilter,
) -> FloatTensor<B> {
    let layers = host::rows(limits);
    with_real!(limits.dtype(), T => {
        let sums = forward(&GaussianRows::<T>::new(gaussians), &host::floats::<B, T>(limits), layers, camera, filter);
        host::float_tensor::<B, T, 4>(sums, [layers, CHANNELS, camera.height, camera.width], &limits.device())
    })
}

fn splat_backward_on<B: Host>(
    gaussians: &GaussianTensors<B>,
    limits: &FloatTensor<B>,
    grad: &FloatTensor<B>,
    camera: &Camera,
    filter: ScreenFilter,
    probed: bool,
) -> SplatGradients<B> {
    let device = limits.device();
    with_real!(limits.dtype(), T => {
        let rows = GaussianRows::<T>::new(gaussians);
        let (limit, grad) = (host::floats::<B, T>(limits), host::floats::<B, T>(grad));
        let layers = host::rows(limits);
        let [positions, quaternions, log_scales, opacities, colours, probe] =
            backward(&rows, &limit, &grad, layers, camera, filter, probed);
        let count = probe.len() / 2;
        SplatGradients {
            gaussians: GaussianTensors::from_rows([positions, quaternions, log_scales, opacities, colours], &device),
            probe: host::float_tensor::<B, T, 2>(probe, [count, 2], &device),
        }
    })
}

fn contributions_on<B: Host>(
    gaussians: &GaussianTensors<B>,
    limits: &FloatTensor<B>,
    gates: &FloatTensor<B>,
    camera: &Camera,
) -> FloatTensor<B> {
    with_real!(limits.dtype(), T => {
        let rows = GaussianRows::<T>::new(gaussians);
        let (limit, gates) = (host::floats::<B, T>(limits), host::floats::<B, T>(gates));
        let values = contributions(&rows, &limit, &gates, host::rows(limits), camera);
        host::float_tensor::<B, T, 1>(values, [rows.len()], &limits.device())
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl SplatOps for $backend {
            fn splat(
                gaussians: GaussianTensors<Self>,
                _: FloatTensor<Self>,
                limits: FloatTensor<Self>,
                camera: Camera,
                filter: ScreenFilter,
            ) -> FloatTensor<Self> {
                splat_on::<Self>(&gaussians, &limits, &camera, filter)
            }

            fn splat_contributions(
                gaussians: GaussianTensors<Self>,
                limits: FloatTensor<Self>,
                gates: FloatTensor<Self>,
                camera: Camera,
            ) -> FloatTensor<Self> {
                contributions_on::<Self>(&gaussians, &limits, &gates, &camera)
            }
        }

        impl SplatBackwardOps for $backend {
            fn splat_backward(
                gaussians: GaussianTensors<Self>,
                limits: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                camera: Camera,
                filter: ScreenFilter,
                probed: bool,
            ) -> SplatGradients<Self> {
                splat_backward_on::<Self>(&gaussians, &limits, &grad, &camera, filter, probed)
            }
        }
    };
}
for_each_cpu_backend!(implement);

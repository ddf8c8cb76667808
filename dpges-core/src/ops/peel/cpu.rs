//! CPU kernels. Forward, one task handles one tile; backward, one band of rows.

use std::borrow::Cow;

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};
use rayon::prelude::*;

use super::{PeelBackwardOps, PeelGradient, PeelOps, PeelOptions, PeelOutput, SurfelShapes};
use crate::backend::host::{self, Host, for_each_cpu_backend, with_real};
use crate::backend::real::Real;
use crate::backend::simd::{LANES, vectorised};
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::rays::rays;
use crate::footprint::surfel::cpu::{Disc, DiscGrad, Hit, MIN_FACING, Parameters, Plane};
use crate::math::{CameraOf, V3, row};
use crate::scene::Footprint;
use crate::tiles::bands::{BAND_COUNT, Bands};
use crate::tiles::binning::cpu::bin;
use crate::tiles::layout::to_planes;
use crate::tiles::{PixelRect, TILE, TILE_PIXELS, TileGrid};

/// Parameters of all surfels, row-major.
struct SurfelRows<'a, T: Real> {
    positions: Cow<'a, [T]>,
    quaternions: Cow<'a, [T]>,
    log_scales: Cow<'a, [T]>,
}

impl<'a, T: Real> SurfelRows<'a, T> {
    fn new<B: Host>(surfels: &'a SurfelShapes<B>) -> Self {
        Self {
            positions: host::floats::<B, T>(&surfels.positions),
            quaternions: host::floats::<B, T>(&surfels.quaternions),
            log_scales: host::floats::<B, T>(&surfels.log_scales),
        }
    }

    fn len(&self) -> usize {
        self.positions.len() / 3
    }

    fn parameters(&self, i: usize) -> Parameters {
        Parameters {
            position: row::<T, 3>(&self.positions, i).map(T::as_f64),
            quaternion: row::<T, 4>(&self.quaternions, i).map(T::as_f64),
            log_scales: row::<T, 2>(&self.log_scales, i).map(T::as_f64),
        }
    }

    fn discs(&self, camera: &CameraOf<f64>) -> Vec<Disc> {
        (0..self.len()).into_par_iter().map(|i| Disc::new(camera, &self.parameters(i))).collect()
    }
}

/// The sorted fragment lists of one tile: slot k of every pixel.
struct TileLayers<'a, T> {
    ids: &'a mut [i32],
    alpha: &'a mut [T],
    depth: &'a mut [T],
}

/// The nearest opaque fragment of every pixel of a tile.
struct TileCores<T> {
    ids: [i32; TILE_PIXELS],
    depth: [T; TILE_PIXELS],
}

impl<T: Real> TileCores<T> {
    fn none() -> Self {
        Self { ids: [-1; TILE_PIXELS], depth: [T::INFINITY; TILE_PIXELS] }
    }

    /// Takes the opaque ones of a group of fragments that are nearer. Candidates ascend by index, so a strict comparison
    /// breaks ties in depth by index.
    #[inline(always)]
    fn take_nearer(&mut self, id: i32, alpha: [T; LANES], depth: [T; LANES], start: usize) {
        let ids: &mut [i32; LANES] = (&mut self.ids[start..][..LANES]).try_into().expect("one group");
        let nearest: &mut [T; LANES] = (&mut self.depth[start..][..LANES]).try_into().expect("one group");
        for lane in 0..LANES {
            let nearer = (alpha[lane] >= T::one()) & (depth[lane] < nearest[lane]);
            nearest[lane] = if nearer { depth[lane] } else { nearest[lane] };
            ids[lane] = if nearer { id } else { ids[lane] };
        }
    }

    /// Makes the core the last layer of the pixels whose other layers are all rims before it.
    fn stop(&self, layers: usize, slots: &mut TileLayers<T>) {
        for pixel in (0..TILE_PIXELS).filter(|&pixel| self.ids[pixel] >= 0) {
            let has_core = (0..layers).any(|layer| slots.alpha[layer * TILE_PIXELS + pixel] >= T::one());
            if !has_core {
                let at = (layers - 1) * TILE_PIXELS + pixel;
                (slots.ids[at], slots.alpha[at], slots.depth[at]) = (self.ids[pixel], T::one(), self.depth[pixel]);
            }
        }
    }
}

/// ids, alpha and depth as [K, H, W].
fn forward<T: Real>(surfels: &SurfelRows<T>, camera: &Camera, options: &PeelOptions) -> (Vec<i32>, Vec<T>, Vec<T>) {
    let grid = TileGrid::new(camera.width, camera.height);
    let rays = rays(camera);
    let camera = CameraOf::<f64>::new(camera);
    let discs = surfels.discs(&camera);
    let radius = options.footprint.radius(options.modulation);
    let reach = |disc: &Disc| radius.map_or(PixelRect::EMPTY, |radius| disc.reach(&camera, radius));
    let rects: Vec<PixelRect> = discs.par_iter().map(reach).collect();
    let planes: Vec<Plane<T>> = discs.par_iter().map(|disc| disc.plane.cast()).collect();
    let near = T::of(camera.near);
    let lists = bin(&rects, grid, |_, _, _| true);
    let layers = options.layer_count;
    let block = layers * TILE_PIXELS;
    let mut ids = vec![-1i32; grid.len() * block];
    let mut alpha = vec![T::zero(); grid.len() * block];
    let mut depth = vec![T::INFINITY; grid.len() * block];
    ids.par_chunks_mut(block).zip(alpha.par_chunks_mut(block)).zip(depth.par_chunks_mut(block)).enumerate().for_each(
        |(tile, ((ids, alpha), depth))| {
            let slots = TileLayers { ids, alpha, depth };
            let (candidates, origin) = (lists.of(tile), grid.origin(tile));
            let Some(rays) = &rays else {
                vectorised(
                    #[inline(always)]
                    || {
                        peel_tile(
                            candidates,
                            &planes,
                            &rects,
                            origin,
                            near,
                            options,
                            slots,
                            #[inline(always)]
                            |plane, x, y, _| plane.hit(x, y),
                        );
                    },
                );
                return;
            };
            let rays = rays_of_tile::<T>(rays, grid, origin);
            vectorised(
                #[inline(always)]
                || {
                    peel_tile(
                        candidates,
                        &planes,
                        &rects,
                        origin,
                        near,
                        options,
                        slots,
                        #[inline(always)]
                        |plane, _, _, at| plane.hit_by(rays[at]),
                    );
                },
            );
        },
    );
    (to_planes(&ids, layers, grid), to_planes(&alpha, layers, grid), to_planes(&depth, layers, grid))
}

/// Rays of the pixels of a tile; 0 outside the image.
fn rays_of_tile<T: Real>(rays: &[V3<f64>], grid: TileGrid, (left, top): (usize, usize)) -> Vec<V3<T>> {
    let ray = |at: usize| {
        let (x, y) = (left + at % TILE, top + at / TILE);
        let inside = x < grid.width && y < grid.height;
        if inside { rays[y * grid.width + x].map(T::of) } else { [T::zero(); 3] }
    };
    (0..TILE_PIXELS).map(ray).collect()
}

/// `meet` finds the hit at a point (x, y) px, which is a pixel at this place in the tile.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "what a tile is made of")]
fn peel_tile<T: Real>(
    candidates: &[u32],
    planes: &[Plane<T>],
    rects: &[PixelRect],
    origin: (usize, usize),
    near: T,
    options: &PeelOptions,
    mut slots: TileLayers<T>,
    meet: impl Fn(&Plane<T>, T, T, usize) -> Hit<T>,
) {
    let mut cores = options.backstop.then(TileCores::none);
    let modulation = T::of(options.modulation);
    let (cutoff, min_facing) = (T::of(CUTOFF), T::of(MIN_FACING));
    let by_kernel = options.footprint == Footprint::Kernel;
    let last = (options.layer_count - 1) * TILE_PIXELS;
    let offsets: [T; LANES] = std::array::from_fn(|lane| T::of(lane as f64 + 0.5));
    for &id in candidates {
        let plane = &planes[id as usize];
        let [x0, x1, y0, y1] = rects[id as usize].within_tile(origin);
        for line in y0..y1 {
            let y = T::of((origin.1 + line) as f64 + 0.5);
            for group in x0 / LANES..x1.div_ceil(LANES) {
                let start = line * TILE + group * LANES;
                let left = T::of((origin.0 + group * LANES) as f64);
                let mut alpha = [T::zero(); LANES];
                let mut depth = [T::INFINITY; LANES];
                let mut nearer = false;
                let furthest: &[T; LANES] = slots.depth[last + start..][..LANES].try_into().expect("one group");
                for lane in 0..LANES {
                    let hit = meet(plane, left + offsets[lane], y, start + lane);
                    let opacity = if modulation * hit.kernel < T::one() { modulation * hit.kernel } else { T::one() };
                    let inside = if by_kernel { hit.kernel } else { opacity } >= cutoff;
                    let exists = (hit.facing.abs() > min_facing) & (hit.depth > near) & inside;
                    alpha[lane] = if exists { opacity } else { T::zero() };
                    depth[lane] = if exists { hit.depth } else { T::INFINITY };
                    nearer |= depth[lane] < furthest[lane];
                }
                if let Some(cores) = &mut cores {
                    cores.take_nearer(id as i32, alpha, depth, start);
                }
                if nearer {
                    insert(id as i32, alpha, depth, start, options.layer_count, slots.ids, slots.alpha, slots.depth);
                }
            }
        }
    }
    if let Some(cores) = cores {
        cores.stop(options.layer_count, &mut slots);
    }
    end_behind_opaque(options.layer_count, slots);
}

/// Inserts one fragment per lane into the sorted lists and moves those behind it by one. Candidates ascend by
/// index, so a strict comparison breaks ties in depth by index.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "three parallel arrays on each side")]
fn insert<T: Real>(
    id: i32,
    mut alpha: [T; LANES],
    mut depth: [T; LANES],
    start: usize,
    layers: usize,
    ids: &mut [i32],
    alphas: &mut [T],
    depths: &mut [T],
) {
    let mut moving = [id; LANES];
    for layer in 0..layers {
        let at = layer * TILE_PIXELS + start;
        let slot_ids: &mut [i32; LANES] = (&mut ids[at..at + LANES]).try_into().expect("one group");
        let slot_alpha: &mut [T; LANES] = (&mut alphas[at..at + LANES]).try_into().expect("one group");
        let slot_depth: &mut [T; LANES] = (&mut depths[at..at + LANES]).try_into().expect("one group");
        for lane in 0..LANES {
            let swap = (depth[lane] < slot_depth[lane]) | (moving[lane] != id);
            let (d, a, i) = (slot_depth[lane], slot_alpha[lane], slot_ids[lane]);
            slot_depth[lane] = if swap { depth[lane] } else { d };
            slot_alpha[lane] = if swap { alpha[lane] } else { a };
            slot_ids[lane] = if swap { moving[lane] } else { i };
            depth[lane] = if swap { d } else { depth[lane] };
            alpha[lane] = if swap { a } else { alpha[lane] };
            moving[lane] = if swap { i } else { moving[lane] };
        }
    }
}

#[inline(always)]
fn end_behind_opaque<T: Real>(layers: usize, slots: TileLayers<T>) {
    for pixel in 0..TILE_PIXELS {
        let mut opaque = false;
        for at in (0..layers).map(|layer| layer * TILE_PIXELS + pixel) {
            if opaque {
                (slots.ids[at], slots.alpha[at], slots.depth[at]) = (-1, T::zero(), T::INFINITY);
            }
            opaque |= slots.alpha[at] >= T::one();
        }
    }
}

/// Gradients with respect to positions, quaternions and log-scales.
fn backward<T: Real>(
    surfels: &SurfelRows<T>,
    ids: &[i32],
    grad: &[T],
    of: PeelGradient,
    camera: &Camera,
    options: &PeelOptions,
) -> (Vec<T>, Vec<T>, Vec<T>) {
    let (width, height) = (camera.width, camera.height);
    let rays = rays(camera);
    let camera = CameraOf::<f64>::new(camera);
    let discs = surfels.discs(&camera);
    let bands = Bands::new(height);
    let partial: Vec<Vec<DiscGrad>> = (0..BAND_COUNT)
        .into_par_iter()
        .map(|band| {
            let mut sums = vec![DiscGrad::default(); surfels.len()];
            for (layer, y) in (0..options.layer_count).flat_map(|layer| bands.rows(band).map(move |y| (layer, y))) {
                let start = (layer * height + y) * width;
                for x in 0..width {
                    let (id, grad) = (ids[start + x], grad[start + x].as_f64());
                    if id < 0 || grad == 0.0 {
                        continue;
                    }
                    let disc = &discs[id as usize];
                    let pixel = [x as f64 + 0.5, y as f64 + 0.5];
                    let (hit, offset) = match &rays {
                        None => (disc.plane.hit(pixel[0], pixel[1]), disc.offset(&camera, pixel)),
                        Some(rays) => {
                            let ray = rays[y * width + x];
                            (disc.plane.hit_by(ray), [ray[2], ray[0], ray[1]])
                        }
                    };
                    let (grad_kernel, grad_depth) = match of {
                        PeelGradient::Depth => (0.0, grad),
                        PeelGradient::Alpha if options.modulation * hit.kernel < 1.0 => {
                            (options.modulation * grad, 0.0)
                        }
                        PeelGradient::Alpha => continue,
                    };
                    disc.accumulate(offset, &hit, grad_kernel, grad_depth, &mut sums[id as usize]);
                }
            }
            sums
        })
        .collect();
    let mut out =
        (vec![T::zero(); surfels.len() * 3], vec![T::zero(); surfels.len() * 4], vec![T::zero(); surfels.len() * 2]);
    out.0.par_chunks_mut(3).zip(out.1.par_chunks_mut(4)).zip(out.2.par_chunks_mut(2)).enumerate().for_each(
        |(i, ((position, quaternion), log_scales))| {
            let mut sum = partial[0][i];
            partial[1..].iter().for_each(|band| sum.add(&band[i]));
            let grads = discs[i].backward(&camera, surfels.parameters(i).quaternion, &sum);
            position.copy_from_slice(&grads.0.map(T::of));
            quaternion.copy_from_slice(&grads.1.map(T::of));
            log_scales.copy_from_slice(&grads.2.map(T::of));
        },
    );
    out
}

fn peel_on<B: Host>(surfels: &SurfelShapes<B>, camera: &Camera, options: &PeelOptions) -> PeelOutput<B> {
    let device = surfels.positions.device();
    let shape = [options.layer_count, camera.height, camera.width];
    with_real!(surfels.positions.dtype(), T => {
        let (ids, alpha, depth) = forward(&SurfelRows::<T>::new(surfels), camera, options);
        PeelOutput {
            ids: host::int_tensor::<B, 3>(ids, shape, &device),
            alpha: host::float_tensor::<B, T, 3>(alpha, shape, &device),
            depth: host::float_tensor::<B, T, 3>(depth, shape, &device),
        }
    })
}

fn peel_backward_on<B: Host>(
    surfels: &SurfelShapes<B>,
    ids: &IntTensor<B>,
    grad: &FloatTensor<B>,
    of: PeelGradient,
    camera: &Camera,
    options: &PeelOptions,
) -> SurfelShapes<B> {
    let (count, device) = (host::rows(&surfels.positions), surfels.positions.device());
    with_real!(surfels.positions.dtype(), T => {
        let rows = SurfelRows::<T>::new(surfels);
        let grads = backward(&rows, &host::ints::<B>(ids), &host::floats::<B, T>(grad), of, camera, options);
        SurfelShapes {
            positions: host::float_tensor::<B, T, 2>(grads.0, [count, 3], &device),
            quaternions: host::float_tensor::<B, T, 2>(grads.1, [count, 4], &device),
            log_scales: host::float_tensor::<B, T, 2>(grads.2, [count, 2], &device),
        }
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl PeelOps for $backend {
            fn peel(surfels: SurfelShapes<Self>, camera: Camera, options: PeelOptions) -> PeelOutput<Self> {
                peel_on::<Self>(&surfels, &camera, &options)
            }
        }

        impl PeelBackwardOps for $backend {
            fn peel_backward(
                surfels: SurfelShapes<Self>,
                ids: IntTensor<Self>,
                grad: FloatTensor<Self>,
                of: PeelGradient,
                camera: Camera,
                options: PeelOptions,
            ) -> SurfelShapes<Self> {
                peel_backward_on::<Self>(&surfels, &ids, &grad, of, &camera, &options)
            }
        }
    };
}
for_each_cpu_backend!(implement);

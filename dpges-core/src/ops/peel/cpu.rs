//! CPU kernels. Forward, one task handles one tile; backward, one band of rows.

use std::borrow::Cow;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::autodiff::PeelState;
use super::{PeelGradient, PeelOps, PeelOptions, PeelOutput, SurfelShapes};
use crate::backend::host::{self, Host, with_real};
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::backend::simd::vectorised;
use crate::backend::tape::WayBack;
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::rays::rays;
use crate::footprint::surfel::cpu::{Disc, DiscGrad, MIN_FACING, Parameters, Plane};
use crate::math::{CameraOf, V3, row};
use crate::scene::Footprint;
use crate::tiles::bands::{BAND_COUNT, Bands};
use crate::tiles::binning::cpu::bin;
use crate::tiles::layout::to_planes;
use crate::tiles::{PixelRect, TILE, TILE_PIXELS, TileGrid, for_each_lanes};

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

/// The nearest opaque fragment of every pixel of a tile. A primitive is its place in the list of the tile, a whole number of type `T`, which
/// vectors move.
struct TileCores<T> {
    places: [T; TILE_PIXELS],
    depth: [T; TILE_PIXELS],
}

/// Stands for no primitive.
const NONE: f64 = -1.0;

impl<T: Real> TileCores<T> {
    fn none() -> Self {
        Self { places: [T::of(NONE); TILE_PIXELS], depth: [T::INFINITY; TILE_PIXELS] }
    }

    /// Takes the opaque ones of the fragments of a primitive that are nearer. Candidates ascend by index, so a strict
    /// comparison breaks ties in depth by index.
    #[inline(always)]
    fn take_nearer<S: Simd>(&mut self, start: usize, [place, alpha, depth]: [Lanes<T, S>; 3]) {
        let simd = depth.simd();
        let nearest = Lanes::load(simd, &self.depth[start..]);
        let nearer = alpha.at_least(Lanes::splat(simd, T::one())) & depth.below(nearest);
        if nearer.any() {
            Lanes::select(nearer, depth, nearest).store(&mut self.depth[start..]);
            let places = Lanes::load(simd, &self.places[start..]);
            Lanes::select(nearer, place, places).store(&mut self.places[start..]);
        }
    }
}

/// The sorted fragment lists of one tile: slot k of every pixel, [K, `TILE_PIXELS`].
struct TileLayers<'a, T> {
    count: usize,
    places: Vec<T>,
    alpha: &'a mut [T],
    depth: &'a mut [T],
}

impl<T: Real> TileLayers<'_, T> {
    /// Inserts a fragment of one primitive per lane into the sorted lists and moves those behind it by one, ties by index.
    #[inline(always)]
    fn insert<S: Simd>(&mut self, start: usize, fragments: [Lanes<T, S>; 3]) {
        let [mut place, mut alpha, mut depth] = fragments;
        let simd = depth.simd();
        let last = (self.count - 1) * TILE_PIXELS + start;
        let mut moves = depth.below(Lanes::load(simd, &self.depth[last..]));
        if !moves.any() {
            return;
        }
        for layer in 0..self.count {
            let at = layer * TILE_PIXELS + start;
            let slot_depth = Lanes::load(simd, &self.depth[at..]);
            moves = if layer == 0 { depth.below(slot_depth) } else { moves | depth.below(slot_depth) };
            let swap = |moving: &mut Lanes<T, S>, slot: &mut [T]| {
                let own = Lanes::load(simd, slot);
                Lanes::select(moves, *moving, own).store(slot);
                *moving = Lanes::select(moves, own, *moving);
            };
            swap(&mut depth, &mut self.depth[at..]);
            swap(&mut alpha, &mut self.alpha[at..]);
            swap(&mut place, &mut self.places[at..]);
        }
    }

    /// Makes the core the last layer of the pixels whose other layers are all rims before it.
    fn stop(&mut self, cores: &TileCores<T>) {
        for pixel in (0..TILE_PIXELS).filter(|&pixel| cores.depth[pixel] < T::INFINITY) {
            let has_core = (0..self.count).any(|layer| self.alpha[layer * TILE_PIXELS + pixel] >= T::one());
            if !has_core {
                let at = (self.count - 1) * TILE_PIXELS + pixel;
                (self.places[at], self.alpha[at], self.depth[at]) = (cores.places[pixel], T::one(), cores.depth[pixel]);
            }
        }
    }

    #[inline(always)]
    fn end_behind_opaque(&mut self) {
        for pixel in 0..TILE_PIXELS {
            let mut opaque = false;
            for at in (0..self.count).map(|layer| layer * TILE_PIXELS + pixel) {
                if opaque {
                    (self.places[at], self.alpha[at], self.depth[at]) = (T::of(NONE), T::zero(), T::INFINITY);
                }
                opaque |= self.alpha[at] >= T::one();
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
            let (candidates, origin) = (lists.of(tile), grid.origin(tile));
            let rays = rays.as_ref().map(|rays| rays_of_tile(rays, grid, origin));
            let places = vec![T::of(NONE); block];
            let layers = TileLayers { count: layers, places, alpha, depth };
            let (planes, rects) = (&planes, &rects);
            vectorised(PeelTile { candidates, planes, rects, origin, near, options, rays, ids, layers });
        },
    );
    (to_planes(&ids, layers, grid), to_planes(&alpha, layers, grid), to_planes(&depth, layers, grid))
}

/// Rays of the pixels of a tile, by coordinates; 0 outside the image.
fn rays_of_tile<T: Real>(rays: &[V3<f64>], grid: TileGrid, (left, top): (usize, usize)) -> V3<[T; TILE_PIXELS]> {
    let ray = |at: usize| {
        let (x, y) = (left + at % TILE, top + at / TILE);
        let inside = x < grid.width && y < grid.height;
        if inside { rays[y * grid.width + x].map(T::of) } else { [T::zero(); 3] }
    };
    [0, 1, 2].map(|axis| std::array::from_fn(|at| ray(at)[axis]))
}

/// Peels a tile.
struct PeelTile<'a, T> {
    candidates: &'a [u32],
    planes: &'a [Plane<T>],
    rects: &'a [PixelRect],
    origin: (usize, usize),
    near: T,
    options: &'a PeelOptions,
    /// Through a lens.
    rays: Option<V3<[T; TILE_PIXELS]>>,
    /// −1 so far.
    ids: &'a mut [i32],
    layers: TileLayers<'a, T>,
}

impl<T: Real> WithSimd for PeelTile<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { candidates, planes, rects, origin, near, options, rays, ids, mut layers } = self;
        let mut cores = options.backstop.then(TileCores::none);
        let all = |value: T| Lanes::splat(simd, value);
        let (modulation, near, one) = (all(T::of(options.modulation)), all(near), all(T::one()));
        let (cutoff, min_facing) = (all(T::of(CUTOFF)), all(T::of(MIN_FACING)));
        let by_kernel = options.footprint == Footprint::Kernel;
        for (place, &id) in candidates.iter().enumerate() {
            let (plane, place) = (&planes[id as usize], all(T::of(place as f64)));
            for_each_lanes(
                simd,
                plane.anchor,
                &rects[id as usize],
                origin,
                #[inline(always)]
                |start, dx, dy| {
                    let [u, v, depth, facing] = match &rays {
                        None => plane.meet(dx, dy),
                        Some(rays) => {
                            let axis = |axis: usize| Lanes::load(simd, &rays[axis][start..]);
                            plane.meet_by([axis(0), axis(1), axis(2)])
                        }
                    };
                    let kernel = (all(T::of(-0.5)) * u.mul_add(u, v * v)).exp_nonpositive();
                    let opacity = (modulation * kernel).min(one);
                    let inside = if by_kernel { kernel } else { opacity }.at_least(cutoff);
                    let exists = min_facing.below(facing.abs()) & near.below(depth) & inside;
                    if !exists.any() {
                        return;
                    }
                    let depth = Lanes::select(exists, depth, all(T::INFINITY));
                    let fragments = [place, opacity.only(exists), depth];
                    if let Some(cores) = &mut cores {
                        cores.take_nearer(start, fragments);
                    }
                    layers.insert(start, fragments);
                },
            );
        }
        if let Some(cores) = cores {
            layers.stop(&cores);
        }
        layers.end_behind_opaque();
        for (id, place) in ids.iter_mut().zip(&layers.places) {
            if *place >= T::zero() {
                *id = candidates[place.as_f64() as usize] as i32;
            }
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
) -> [Vec<T>; 3] {
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
    let mut out = [3, 4, 2].map(|width| vec![T::zero(); surfels.len() * width]);
    let [positions, quaternions, log_scales] = &mut out;
    let rows = positions.par_chunks_mut(3).zip(quaternions.par_chunks_mut(4)).zip(log_scales.par_chunks_mut(2));
    rows.enumerate().for_each(|(i, ((position, quaternion), log_scales))| {
        let mut sum = partial[0][i];
        partial[1..].iter().for_each(|band| sum.add(&band[i]));
        let grads = discs[i].backward(&camera, surfels.parameters(i).quaternion, &sum);
        position.copy_from_slice(&grads.0.map(T::of));
        quaternion.copy_from_slice(&grads.1.map(T::of));
        log_scales.copy_from_slice(&grads.2.map(T::of));
    });
    out
}

impl<B: Host> PeelOps for B {
    fn peel(surfels: SurfelShapes<B>, camera: Camera, options: PeelOptions) -> PeelOutput<B> {
        let device = surfels.positions.device();
        let shape = [options.layer_count, camera.height, camera.width];
        with_real!(surfels.positions.dtype(), T => {
            let (ids, alpha, depth) = forward(&SurfelRows::<T>::new(&surfels), &camera, &options);
            PeelOutput {
                ids: host::int_tensor::<B, 3>(ids, shape, &device),
                alpha: host::float_tensor::<B, T, 3>(alpha, shape, &device),
                depth: host::float_tensor::<B, T, 3>(depth, shape, &device),
            }
        })
    }
}

impl<B: Host> WayBack<B, 3> for PeelState<B> {
    fn go_back(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 3] {
        let Self { surfels, ids, of, camera, options } = self;
        let (count, device) = (host::rows(&surfels.positions), surfels.positions.device());
        with_real!(surfels.positions.dtype(), T => {
            let rows = SurfelRows::<T>::new(&surfels);
            let grad = host::floats::<B, T>(&grad);
            let [positions, quaternions, log_scales] = backward(&rows, &host::ints::<B>(&ids), &grad, of, &camera, &options);
            [(positions, 3), (quaternions, 4), (log_scales, 2)]
                .map(|(values, width)| Some(host::float_tensor::<B, T, 2>(values, [count, width], &device)))
        })
    }
}

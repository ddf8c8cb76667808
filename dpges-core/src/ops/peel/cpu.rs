//! CPU kernels. Forward, one task handles one tile; backward, one band of rows.

use std::borrow::Cow;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::autodiff::Grads;
use super::{PeelOps, PeelOptions, PeelOutput, PeelState, SurfelShapes};
use crate::backend::host::{self, Host, with_real};
use crate::backend::lanes::{Lanes, Mask};
use crate::backend::real::Real;
use crate::backend::tape::BackwardOfAll;
use crate::backend::vectorised::vectorised;
use crate::camera::Camera;
use crate::footprint::rays::rays;
use crate::footprint::surfel::cpu::{Disc, DiscGrad, MIN_FACING, Parameters, Plane};
use crate::math::{CameraOf, V3, row};
use crate::scene::peeling::ORDER;
use crate::tiles::bands::{BAND_COUNT, Bands};
use crate::tiles::binning::cpu::bin;
use crate::tiles::layout::to_planes;
use crate::tiles::{PixelRect, TILE, TILE_PIXELS, TileGrid, for_each_lanes};

/// Parameters of all surfels, row-major.
struct SurfelRows<'a, T: Real> {
    positions: Cow<'a, [T]>,
    quaternions: Cow<'a, [T]>,
    log_scales: Cow<'a, [T]>,
    margins: Cow<'a, [T]>,
}

impl<'a, T: Real> SurfelRows<'a, T> {
    fn new<B: Host>(surfels: &'a SurfelShapes<B>) -> Self {
        Self {
            positions: host::floats::<B, T>(&surfels.positions),
            quaternions: host::floats::<B, T>(&surfels.quaternions),
            log_scales: host::floats::<B, T>(&surfels.log_scales),
            margins: host::floats::<B, T>(&surfels.margins),
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

/// Stands for no primitive.
const NONE: f64 = -1.0;

/// A fragment per lane: its primitive, opacity and depth. A primitive is its place in the list of the tile, a whole number of type
/// `T`, which vectors move. Absent ones are at infinity.
type Fragments<T, S> = [Lanes<T, S>; 3];

/// The nearest core of every pixel of a tile so far.
struct TileCores<T> {
    places: [T; TILE_PIXELS],
    depth: [T; TILE_PIXELS],
    /// The depth up to which other fragments are layers.
    ends: [T; TILE_PIXELS],
    /// No surfel of the tile reaches further behind itself. A nearer core may have a further end.
    furthest: T,
}

impl<T: Real> TileCores<T> {
    fn none(furthest: T) -> Self {
        let [depth, ends] = [[T::INFINITY; TILE_PIXELS]; 2];
        Self { places: [T::of(NONE); TILE_PIXELS], depth, ends, furthest }
    }

    /// Whether fragments at these depths can be layers, as far as is known.
    #[inline(always)]
    fn reach<S: Simd>(&self, start: usize, depth: Lanes<T, S>) -> Mask<T, S> {
        let simd = depth.simd();
        (Lanes::load(simd, &self.depth[start..]) + Lanes::splat(simd, self.furthest)).at_least(depth)
    }

    /// Takes those of the fragments of a primitive that are nearer cores, in exchange for the cores so far, which become fragments
    /// like others. `reach` is how far behind such a core other fragments are layers.
    #[inline(always)]
    fn exchange<S: Simd>(&mut self, start: usize, [place, alpha, depth]: Fragments<T, S>, reach: T) -> Fragments<T, S> {
        let simd = depth.simd();
        let one = Lanes::splat(simd, T::one());
        let (own_place, own_depth) =
            (Lanes::load(simd, &self.places[start..]), Lanes::load(simd, &self.depth[start..]));
        let nearer = alpha.at_least(one) & is_before([place, alpha, depth], [own_place, one, own_depth]);
        if !nearer.any() {
            return [place, alpha, depth];
        }
        let end = Lanes::load(simd, &self.ends[start..]);
        Lanes::select(nearer, place, own_place).store(&mut self.places[start..]);
        Lanes::select(nearer, depth, own_depth).store(&mut self.depth[start..]);
        Lanes::select(nearer, depth + Lanes::splat(simd, reach), end).store(&mut self.ends[start..]);
        [Lanes::select(nearer, own_place, place), alpha, Lanes::select(nearer, own_depth, depth)]
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
    #[inline(always)]
    fn load<S: Simd>(&self, at: usize, simd: S) -> Fragments<T, S> {
        // not by `map`: closures that are not inlined call every instruction
        let [places, alpha, depth] = [&self.places[at..], &self.alpha[at..], &self.depth[at..]];
        [Lanes::load(simd, places), Lanes::load(simd, alpha), Lanes::load(simd, depth)]
    }

    #[inline(always)]
    fn store<S: Simd>(&mut self, at: usize, [place, alpha, depth]: Fragments<T, S>) {
        place.store(&mut self.places[at..]);
        alpha.store(&mut self.alpha[at..]);
        depth.store(&mut self.depth[at..]);
    }

    /// Inserts fragments into the first `slots` of the sorted lists and moves those behind them by one.
    #[inline(always)]
    fn insert<S: Simd>(&mut self, start: usize, slots: usize, mut fragments: Fragments<T, S>) {
        let simd = fragments[2].simd();
        let Some(last) = slots.checked_sub(1) else { return };
        // most fragments lie behind a full list
        if !is_before(fragments, self.load(last * TILE_PIXELS + start, simd)).any() {
            return;
        }
        for layer in 0..slots {
            let at = layer * TILE_PIXELS + start;
            let own = self.load(at, simd);
            let moves = is_before(fragments, own);
            self.store(at, select(moves, fragments, own));
            fragments = select(moves, own, fragments);
        }
    }

    /// Leaves out what lies behind the `cores`, and puts these where they belong. They are not among the first `others` slots,
    /// and the last slot is empty.
    #[inline(always)]
    fn stop<S: Simd>(&mut self, cores: &TileCores<T>, others: usize, simd: S) {
        let absent = [T::of(NONE), T::zero(), T::INFINITY].map(|value| Lanes::splat(simd, value));
        for start in (0..TILE_PIXELS).step_by(T::lane_count::<S>()) {
            for at in (0..others).map(|layer| layer * TILE_PIXELS + start) {
                let own = self.load(at, simd);
                let is_layer = Lanes::load(simd, &cores.ends[start..]).at_least(own[2]);
                self.store(at, select(is_layer, own, absent));
            }
            let (place, depth) = (Lanes::load(simd, &cores.places[start..]), Lanes::load(simd, &cores.depth[start..]));
            self.insert(start, self.count, [place, Lanes::splat(simd, T::one()), depth]);
        }
    }

    /// Leaves out what lies behind an opaque layer.
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

/// `a` where `mask` is set, else `b`.
#[inline(always)]
fn select<T: Real, S: Simd>(mask: Mask<T, S>, a: Fragments<T, S>, b: Fragments<T, S>) -> Fragments<T, S> {
    [Lanes::select(mask, a[0], b[0]), Lanes::select(mask, a[1], b[1]), Lanes::select(mask, a[2], b[2])]
}

/// Which fragments `a` come before `b` in the order of (depth, index).
#[inline(always)]
fn is_before<T: Real, S: Simd>(a: Fragments<T, S>, b: Fragments<T, S>) -> Mask<T, S> {
    // places in the list of a tile ascend with indices, so that ties do not depend on the tile
    a[2].below(b[2]) | (b[2].at_least(a[2]) & a[0].below(b[0]))
}

/// ids, alpha and depth as [K, H, W].
fn forward<T: Real>(surfels: &SurfelRows<T>, camera: &Camera, options: &PeelOptions) -> (Vec<i32>, Vec<T>, Vec<T>) {
    let grid = TileGrid::new(camera.width, camera.height);
    let rays = rays(camera);
    let camera = CameraOf::<f64>::new(camera);
    let discs = surfels.discs(&camera);
    let squared_radius = options.footprint.squared_radius(options.modulation);
    let seen = |(id, disc): (usize, &Disc)| {
        let (rect, nearest) = (disc.reach(&camera, squared_radius), T::of(disc.nearest(squared_radius)));
        Candidate { id: id as u32, rect, nearest, plane: disc.plane.cast() }
    };
    let mut candidates: Vec<Candidate<T>> = discs.par_iter().enumerate().map(seen).collect();
    candidates.retain(|candidate| !candidate.rect.is_empty());
    let rects: Vec<PixelRect> = candidates.iter().map(|candidate| candidate.rect).collect();
    let near = T::of(camera.near);
    let lists = bin(&rects, grid, |_, _, _| true);
    let layers = options.layer_count;
    let block = layers * TILE_PIXELS;
    let mut ids = vec![-1i32; grid.len() * block];
    let mut alpha = vec![T::zero(); grid.len() * block];
    let mut depth = vec![T::INFINITY; grid.len() * block];
    ids.par_chunks_mut(block).zip(alpha.par_chunks_mut(block)).zip(depth.par_chunks_mut(block)).enumerate().for_each(
        |(tile, ((ids, alpha), depth))| {
            let (list, origin) = (lists.of(tile), grid.origin(tile));
            let rays = rays.as_ref().map(|rays| rays_of_tile(rays, grid, origin));
            let places = vec![T::of(NONE); block];
            let layers = TileLayers { count: layers, places, alpha, depth };
            let (candidates, margins) = (&candidates, &surfels.margins);
            vectorised(PeelTile { list, candidates, margins, origin, near, options, rays, ids, layers });
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

/// A surfel in view.
struct Candidate<T> {
    id: u32,
    rect: PixelRect,
    /// No fragment is before this depth.
    nearest: T,
    plane: Plane<T>,
}

/// Peels a tile.
struct PeelTile<'a, T> {
    list: &'a [u32],
    candidates: &'a [Candidate<T>],
    margins: &'a [T],
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
        let Self { list, candidates, margins, origin, near, options, rays, ids, mut layers } = self;
        let PeelOptions { layer_count, modulation, footprint, peeling } = *options;
        let candidate = |place: u32| &candidates[list[place as usize] as usize];
        // from near to far: a core is then known before most of what it hides
        let mut order: Vec<u32> = (0..list.len() as u32).collect();
        // unstable: layers are sorted by depth and index, in whatever order surfels come
        order.sort_unstable_by(|&a, &b| candidate(a).nearest.as_f64().total_cmp(&candidate(b).nearest.as_f64()));
        let reach = |id: u32| T::of(ORDER) * margins[id as usize];
        let furthest = || list.iter().map(|&at| reach(candidates[at as usize].id)).fold(T::zero(), T::max);
        let mut cores = peeling.is_continuous().then(|| TileCores::none(furthest()));
        // cores have a slot of their own
        // so that rims before a core, however many, never push it out
        let others = layer_count - usize::from(cores.is_some());
        let all = |value: f64| Lanes::splat(simd, T::of(value));
        let (end, slope) = (all(footprint.squared_radius(modulation)), all(footprint.rim_slope(modulation)));
        let (near, one, min_facing) = (Lanes::splat(simd, near), all(1.0), all(MIN_FACING));
        let (half, modulation) = (all(-0.5), all(modulation));
        for place in order {
            let Candidate { id, rect, nearest, plane } = candidate(place);
            let (place, nearest, reach) = (all(f64::from(place)), Lanes::splat(simd, *nearest), reach(*id));
            for_each_lanes(
                simd,
                plane.anchor,
                rect,
                origin,
                #[inline(always)]
                |start, dx, dy| {
                    // behind the cores of all pixels of the vector not even the hit is computed
                    if cores.as_ref().is_some_and(|cores| !cores.reach(start, nearest).any()) {
                        return;
                    }
                    let [u, v, depth, facing] = match &rays {
                        None => plane.meet(dx, dy),
                        Some(rays) => {
                            let axis = |axis: usize| Lanes::load(simd, &rays[axis][start..]);
                            plane.meet_by([axis(0), axis(1), axis(2)])
                        }
                    };
                    let squared = u.mul_add(u, v * v);
                    // `<` and not `<=`: at its end a surfel has opacity 0
                    let mut exists = min_facing.below(facing.abs()) & near.below(depth) & squared.below(end);
                    if let Some(cores) = &cores {
                        exists = exists & cores.reach(start, depth);
                    }
                    if !exists.any() {
                        return;
                    }
                    let opacity = match &cores {
                        Some(_) => (end - squared) * slope,
                        None => modulation * (half * squared).exp_nonpositive(),
                    };
                    let depth = Lanes::select(exists, depth, Lanes::splat(simd, T::INFINITY));
                    let mut fragments = [place, opacity.min(one).only(exists), depth];
                    if let Some(cores) = &mut cores {
                        fragments = cores.exchange(start, fragments, reach);
                    }
                    layers.insert(start, others, fragments);
                },
            );
        }
        match cores {
            Some(cores) => layers.stop(&cores, others, simd),
            None => layers.end_behind_opaque(),
        }
        for (id, place) in ids.iter_mut().zip(&layers.places) {
            if *place >= T::zero() {
                *id = candidates[list[place.as_f64() as usize] as usize].id as i32;
            }
        }
    }
}

/// Gradients with respect to positions, quaternions and log-scales, from those with respect to alpha and depth.
fn backward<T: Real>(
    surfels: &SurfelRows<T>,
    ids: &[i32],
    [of_alpha, of_depth]: [Option<&[T]>; 2],
    camera: &Camera,
    options: &PeelOptions,
) -> [Vec<T>; 3] {
    let (width, height) = (camera.width, camera.height);
    let rays = rays(camera);
    let camera = CameraOf::<f64>::new(camera);
    let discs = surfels.discs(&camera);
    let PeelOptions { layer_count, modulation, footprint, peeling } = *options;
    let (end, slope) = (footprint.squared_radius(modulation), footprint.rim_slope(modulation));
    // derivative of opacity with respect to the exponent −(u² + v²) / 2
    let steepness = |squared: f64| {
        if peeling.is_continuous() {
            // a core stays opaque, whatever moves a little
            let is_rim = (end - squared) * slope < 1.0;
            return if is_rim { 2.0 * slope } else { 0.0 };
        }
        let opacity = modulation * (-0.5 * squared).exp();
        if opacity < 1.0 { opacity } else { 0.0 }
    };
    let bands = Bands::new(height);
    let partial: Vec<Vec<DiscGrad>> = (0..BAND_COUNT)
        .into_par_iter()
        .map(|band| {
            let mut sums = vec![DiscGrad::default(); surfels.len()];
            for (layer, y) in (0..layer_count).flat_map(|layer| bands.rows(band).map(move |y| (layer, y))) {
                let start = (layer * height + y) * width;
                for x in 0..width {
                    let Ok(id) = usize::try_from(ids[start + x]) else { continue };
                    let [of_alpha, of_depth] =
                        [of_alpha, of_depth].map(|grads| grads.map_or(0.0, |grads| grads[start + x].as_f64()));
                    if of_alpha == 0.0 && of_depth == 0.0 {
                        continue;
                    }
                    let disc = &discs[id];
                    let pixel = [x as f64 + 0.5, y as f64 + 0.5];
                    let (hit, offset) = match &rays {
                        None => (disc.plane.hit(pixel[0], pixel[1]), disc.offset(&camera, pixel)),
                        Some(rays) => {
                            let ray = rays[y * width + x];
                            (disc.plane.hit_by(ray), [ray[2], ray[0], ray[1]])
                        }
                    };
                    // the hit is found again in f64: gradients are divided by the square of the facing
                    let power = of_alpha * steepness(hit.squared());
                    disc.accumulate(offset, &hit, power, of_depth, &mut sums[id]);
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
        // in the order of the bands: the same bits with any number of threads
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

impl<B: Host> BackwardOfAll<B, 3, 2> for PeelState<B> {
    fn parents(&self) -> [&FloatTensor<B>; 3] {
        [&self.surfels.positions, &self.surfels.quaternions, &self.surfels.log_scales]
    }

    fn backward_from(self, grads: Grads<B>) -> [Option<FloatTensor<B>>; 3] {
        let Self { surfels, ids, camera, options } = self;
        let (count, device) = (host::rows(&surfels.positions), surfels.positions.device());
        with_real!(surfels.positions.dtype(), T => {
            let rows = SurfelRows::<T>::new(&surfels);
            let grads = grads.each_ref().map(|grad| grad.as_ref().map(host::floats::<B, T>));
            let grads = grads.each_ref().map(Option::as_deref);
            let [positions, quaternions, log_scales] = backward(&rows, &host::ints::<B>(&ids), grads, &camera, &options);
            [(positions, 3), (quaternions, 4), (log_scales, 2)]
                .map(|(values, width)| Some(host::float_tensor::<B, T, 2>(values, [count, width], &device)))
        })
    }
}

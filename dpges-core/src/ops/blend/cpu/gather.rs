//! The backward pass: from the gradients of the planes to those of the parameters.

use pulp::{Scalar, Simd, WithSimd};
use rayon::prelude::*;

use super::distortion::{self, Spread};
use super::hybrid::HybridTile;
use super::normal::normal_backward;
use super::projected::{CameraPair, Drawn, Group, Layout, MOST_SUMS, Projected, Sums};
use super::rays::walk_rays;
use super::walk::{Progress, Said, Sorted, Thresholds, Tile, capped, walk_tile};
use crate::backend::kept::Kept;
use crate::backend::lanes::{Lanes, Mask};
use crate::backend::real::Real;
use crate::backend::vectorised::vectorised;
use crate::camera::Camera;
use crate::footprint::gaussian::cpu::ParameterGrad;
use crate::footprint::gaussian::tensors::GaussianRows;
use crate::math::{CameraOf, V3, dot};
use crate::ops::blend::{ALPHA_PLANE, BlendOptions, COLOUR_PLANES, DEPTH_PLANE, DISTORTION_PLANE, NORMAL_PLANE};
use crate::scene::{BlendOrder, Transparency};
use crate::tiles::layout::to_tiles;
use crate::tiles::{TILE_PIXELS, for_each_lanes, pixel_offset};

/// Tiles whose sums are held at a time.
const BATCH: usize = 64;
/// Primitives that one task adds sums to.
const CHUNK: usize = 4096;

/// Sums of a primitive over the pixels of a tile. Arrays of their own, so that those of constant size stay in registers.
struct PrimitiveSums<T: Real, S: Simd> {
    footprint: [Lanes<T, S>; MOST_SUMS],
    colour: [Lanes<T, S>; 3],
    probe: [Lanes<T, S>; 4],
    maps: [Lanes<T, S>; 4],
}

impl<T: Real, S: Simd> PrimitiveSums<T, S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = Lanes::zero(simd);
        Self { footprint: [zero; MOST_SUMS], colour: [zero; 3], probe: [zero; 4], maps: [zero; 4] }
    }

    /// Adds the gradients of a primitive at some pixels; `grad` is [planes, `TILE_PIXELS`].
    #[inline(always)]
    fn add<F: Projected<T>, const MAPS: bool>(
        &mut self,
        footprint: &F,
        grad: &[T],
        start: usize,
        group: &Group<T, S>,
        probed: bool,
    ) {
        let simd = group.dx.simd();
        add_covered(&mut self.colour, three(simd, grad, 0, start), group.covered);
        if MAPS {
            add_covered(&mut self.maps, three(simd, grad, NORMAL_PLANE, start), group.covered);
        }
        let mut sums = Sums {
            footprint: &mut self.footprint[..F::SUMS],
            colour: &mut self.colour,
            probe: if probed { &mut self.probe } else { &mut [] },
            maps: if MAPS { &mut self.maps } else { &mut [] },
        };
        footprint.gather::<S, MAPS>(group, &mut sums);
    }

    /// The totals, as in [`Layout`].
    #[inline(always)]
    fn write(&self, layout: &Layout, totals: &mut [T]) {
        let sums = layout.split(totals);
        let parts = [
            (&self.footprint[..], sums.footprint),
            (&self.colour, sums.colour),
            (&self.probe, sums.probe),
            (&self.maps, sums.maps),
        ];
        for (lanes, totals) in parts {
            for (lanes, total) in lanes.iter().zip(totals) {
                *total = lanes.sum();
            }
        }
    }
}

/// One primitive of a tile's list.
struct Entry<'a, T, F> {
    /// A whole number, in the list of the tile or, in the order of rays, 0.
    position: T,
    footprint: &'a F,
    colour: V3<T>,
    /// Zero without maps.
    normal: V3<T>,
}

/// The pixels of a tile in the backward pass.
struct BackwardState<'a, T> {
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

/// Three planes of the pixels from `start` on, from `first` on.
#[inline(always)]
fn three<T: Real, S: Simd>(simd: S, grad: &[T], first: usize, start: usize) -> V3<Lanes<T, S>> {
    let plane = |plane: usize| Lanes::load(simd, &grad[(first + plane) * TILE_PIXELS + start..]);
    [plane(0), plane(1), plane(2)]
}

#[inline(always)]
fn add_covered<T: Real, S: Simd>(sums: &mut [Lanes<T, S>], grads: V3<Lanes<T, S>>, covered: Lanes<T, S>) {
    for (sum, grad) in sums.iter_mut().zip(grads) {
        *sum = covered.mul_add(grad, *sum);
    }
}

impl<T: Real> BackwardState<'_, T> {
    /// The gradient with respect to αT through depth, normal and distortion, and that with respect to z over αT.
    #[inline(always)]
    fn maps<S: Simd>(&self, start: usize, normal: V3<T>, blended: Mask<T, S>, depth: Lanes<T, S>) -> [Lanes<T, S>; 2] {
        let simd = depth.simd();
        let all = |value: T| Lanes::splat(simd, value);
        let plane = |plane: usize| Lanes::load(simd, &self.grad[plane * TILE_PIXELS + start..]);
        let of_pixel = |values: &[T; TILE_PIXELS]| Lanes::load(simd, &values[start..]);
        let (of_depth, of_distortion) = (plane(DEPTH_PLANE), plane(DISTORTION_PLANE));
        let (first, second) = (of_pixel(&self.spread.first), of_pixel(&self.spread.second));
        let (reference, total) = (of_pixel(&self.spread.reference), of_pixel(&self.alpha));
        let (slope, two) = (all(self.slope), all(T::of(2.0)));
        // the depth of what is not blended may be 0
        let inverse = (all(T::one()) / depth).only(blended);
        let m = slope * (reference - inverse);
        let apart = m * m * total + second - two * m * first;
        let of_normal = dot(three(simd, self.grad, NORMAL_PLANE, start), Lanes::splat_three(simd, normal));
        let grad_m = of_distortion * two * (m * total - first);
        [of_normal + of_depth * depth + of_distortion * apart, of_depth + grad_m * slope * inverse * inverse]
    }

    /// Removes one primitive from the pixels from `start` on. `None` if it was blended in none.
    #[inline(always)]
    fn pass<F: Projected<T>, S: Simd, const MAPS: bool>(
        &mut self,
        entry: &Entry<T, F>,
        start: usize,
        dx: Lanes<T, S>,
        dy: T,
    ) -> Option<Group<T, S>> {
        let simd = dx.simd();
        let all = |value: T| Lanes::splat(simd, value);
        let Drawn { drawn, weight, depth } = entry.footprint.draw(dx, dy)?;
        let blended = drawn & all(entry.position).below(Lanes::load(simd, &self.progress.end[start..]));
        if !blended.any() {
            return None;
        }
        let mut own = dot(three(simd, self.grad, 0, start), Lanes::splat_three(simd, entry.colour));
        let mut grad_depth = all(T::zero());
        if MAPS {
            let [of_maps, of_depth] = self.maps(start, entry.normal, blended, depth);
            (own, grad_depth) = (own + of_maps, of_depth);
        }
        let through = Lanes::load(simd, &self.progress.through[start..]);
        let behind = Lanes::load(simd, &self.behind[start..]);
        let alpha = capped(weight, self.max_alpha).only(blended);
        let passed = all(T::one()) - alpha;
        // α is capped below 1, so that a division recovers T
        let before = through / passed;
        let covered = alpha * before;
        // a capped α does not change with its exponent
        let free = weight.abs().below(all(self.max_alpha));
        before.store(&mut self.progress.through[start..]);
        alpha.mul_add(own, passed * behind).store(&mut self.behind[start..]);
        let power = (covered * (own - behind)).only(free);
        Some(Group { dx, dy, blended, covered, power, depth, grad_depth: covered * grad_depth })
    }
}

/// The backward pass of a tile.
struct GatherTile<'a, T, F> {
    tile: Tile<'a, T, F>,
    /// [planes, `TILE_PIXELS`], zero outside the image.
    grad: &'a [T],
    layout: &'a Layout,
}

impl<T: Real, F: Projected<T>> WithSimd for GatherTile<'_, T, F> {
    /// Sums over the pixels of the tile for the primitives of its list, up to where the last pixel ends, each as in
    /// [`Layout`].
    type Output = Vec<T>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Vec<T> {
        let (of_colour, of_maps) = self.grad.split_at(COLOUR_PLANES * TILE_PIXELS);
        let reached = |grad: &[T]| grad.iter().any(|&value| value != T::zero());
        // losses of most stages look at no maps, and masks leave tiles without any gradient
        if reached(of_maps) {
            self.gather::<S, true>(simd)
        } else if reached(of_colour) {
            self.gather::<S, false>(simd)
        } else {
            Vec::new()
        }
    }
}

impl<T: Real, F: Projected<T>> GatherTile<'_, T, F> {
    #[inline(always)]
    fn gather<S: Simd, const MAPS: bool>(&self, simd: S) -> Vec<T> {
        match self.tile.order {
            BlendOrder::Centres | BlendOrder::Whitened(Transparency::Sorted) => self.by_centres::<S, MAPS>(simd),
            BlendOrder::Rays => self.said::<S, MAPS>(simd, &self.by_rays::<MAPS>()),
            BlendOrder::Whitened(transparency) => {
                let tile = HybridTile::new(simd, &self.tile, transparency);
                self.said::<S, MAPS>(simd, &tile.backward::<MAPS>(self.grad))
            }
        }
    }

    #[inline(always)]
    fn entry<const MAPS: bool>(&self, position: usize, number: T) -> (usize, Entry<'_, T, F>) {
        let id = self.tile.list()[position] as usize;
        let footprint = &self.tile.sorted.footprints[id];
        let normal = if MAPS { self.tile.sorted.normals[id] } else { [T::zero(); 3] };
        (id, Entry { position: number, footprint, colour: footprint.colour(), normal })
    }

    /// The backward pass from pixels whose T behind everything is known.
    #[inline(always)]
    fn way_back(&self, progress: Progress<T>, spread: Spread<T>) -> BackwardState<'_, T> {
        let of_alpha = &self.grad[ALPHA_PLANE * TILE_PIXELS..][..TILE_PIXELS];
        BackwardState {
            behind: std::array::from_fn(|pixel| -of_alpha[pixel]),
            grad: self.grad,
            max_alpha: self.tile.thresholds.max_alpha,
            spread,
            alpha: std::array::from_fn(|pixel| T::one() - progress.through[pixel]),
            slope: self.tile.slope,
            progress,
        }
    }

    #[inline(always)]
    fn by_centres<S: Simd, const MAPS: bool>(&self, simd: S) -> Vec<T> {
        // front to back once more: where pixels end is not kept, and 1 − alpha has lost the digits of a small T
        let mut spread = Spread::new(self.tile.slope);
        let progress = walk_tile(
            simd,
            &self.tile,
            #[inline(always)]
            |_, start, fragments| {
                if MAPS {
                    spread.add(start, fragments);
                }
            },
        );
        let (origin, width) = (self.tile.origin(), self.layout.width());
        let mut totals = vec![T::zero(); progress.last_end(simd) * width];
        let mut way = self.way_back(progress, spread);
        for (position, totals) in totals.chunks_exact_mut(width).enumerate().rev() {
            let (id, entry) = self.entry::<MAPS>(position, T::of(position as f64));
            let mut sums = PrimitiveSums::new(simd);
            for_each_lanes(
                simd,
                entry.footprint.anchor(),
                &self.tile.sorted.rects[id],
                origin,
                #[inline(always)]
                |start, dx, dy| {
                    if let Some(group) = way.pass::<F, S, MAPS>(&entry, start, dx, dy) {
                        sums.add::<F, MAPS>(entry.footprint, self.grad, start, &group, self.layout.probe);
                    }
                },
            );
            sums.write(self.layout, totals);
        }
        totals
    }

    /// First back through every pixel by itself, in the order of its own ray.
    fn by_rays<const MAPS: bool>(&self) -> Vec<Said<T>> {
        let mut spread = Spread::new(self.tile.slope);
        let mut orders: Vec<Vec<usize>> = vec![Vec::new(); TILE_PIXELS];
        let through = walk_rays(&self.tile, |position, pixel, fragments| {
            if MAPS {
                spread.add(pixel, fragments);
            }
            orders[pixel].push(position);
        });
        let entries = orders.iter().flatten().max().map_or(0, |last| last + 1);
        let mut way = self.way_back(Progress::ended(through), spread);
        let mut said: Vec<Said<T>> = vec![[[T::zero(); TILE_PIXELS]; 3]; entries];
        for (pixel, order) in orders.iter().enumerate() {
            // entries have the number 0 in this order, so that this end blends them all
            way.progress.end[pixel] = T::one();
            for &position in order.iter().rev() {
                let (_, entry) = self.entry::<MAPS>(position, T::zero());
                let [dx, dy] = pixel_offset(entry.footprint.anchor(), self.tile.origin(), pixel);
                let dx = Lanes::splat(Scalar::new(), dx);
                if let Some(group) = way.pass::<F, Scalar, MAPS>(&entry, pixel, dx, dy) {
                    let numbers = [group.covered, group.power, group.grad_depth];
                    for (said, number) in said[position].iter_mut().zip(numbers) {
                        said[pixel] = number.sum();
                    }
                }
            }
        }
        said
    }

    /// Over the pixels of the primitives, from what these say about them.
    #[inline(always)]
    fn said<S: Simd, const MAPS: bool>(&self, simd: S, said: &[Said<T>]) -> Vec<T> {
        let (origin, width) = (self.tile.origin(), self.layout.width());
        let mut totals = vec![T::zero(); said.len() * width];
        for (position, (totals, said)) in totals.chunks_exact_mut(width).zip(said).enumerate() {
            let (id, Entry { footprint, .. }) = self.entry::<MAPS>(position, T::zero());
            let depth = Lanes::splat(simd, footprint.centre_depth());
            let mut sums = PrimitiveSums::new(simd);
            for_each_lanes(
                simd,
                footprint.anchor(),
                &self.tile.sorted.rects[id],
                origin,
                #[inline(always)]
                |start, dx, dy| {
                    let row = |at: usize| Lanes::load(simd, &said[at][start..]);
                    let (covered, power, grad_depth) = (row(0), row(1), row(2));
                    let blended = Lanes::zero(simd).below(covered);
                    if blended.any() {
                        let group = Group { dx, dy, blended, covered, power, depth, grad_depth };
                        sums.add::<F, MAPS>(footprint, self.grad, start, &group, self.layout.probe);
                    }
                },
            );
            sums.write(self.layout, totals);
        }
        totals
    }
}

/// Sums over all pixels for every sorted primitive, each as in `layout`; `grad` is [P, H, W].
fn gather<T: Real, F: Projected<T>>(
    sorted: &Sorted<T, F>,
    grad: &[T],
    layout: &Layout,
    camera: &CameraOf<T>,
    options: &BlendOptions,
) -> Vec<T> {
    let slope = distortion::slope(camera);
    let (thresholds, width) = (Thresholds::new(options), layout.width());
    let grad = to_tiles(grad, options.planes(), sorted.grid, T::zero());
    let block = options.planes() * TILE_PIXELS;
    let mut sums = vec![T::zero(); sorted.footprints.len() * width];
    let of_tile = |tile: usize| {
        let grad = &grad[tile * block..][..block];
        let tile = Tile { sorted, camera, number: tile, thresholds: &thresholds, slope, order: options.order };
        vectorised(GatherTile { tile, grad, layout })
    };
    // the sums of all tiles at once would take several numbers for every entry of every list
    for first_tile in (0..sorted.grid.len()).step_by(BATCH) {
        let batch = first_tile..sorted.grid.len().min(first_tile + BATCH);
        let parts: Vec<Vec<T>> = batch.clone().into_par_iter().map(of_tile).collect();
        sums.par_chunks_mut(CHUNK * width).enumerate().for_each(|(chunk, sums)| {
            let ids = chunk * CHUNK..chunk * CHUNK + sums.len() / width;
            // tiles in their order, whatever thread is first: the same bits with any number of threads
            for (tile, parts) in batch.clone().zip(&parts) {
                let list = sorted.lists.of(tile);
                // lists ascend, so that a task finds its own primitives without going through those of others
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

/// Gradients with respect to positions, quaternions, log-scales, opacities, colours, degrees of freedom and the probe,
/// the last empty unless it is `probed`, that before it unless kernels have some; `grad` is [P, H, W].
pub fn backward<T: Real, F: Projected<T>>(
    gaussians: &GaussianRows<T>,
    grad: &[T],
    probed: bool,
    camera: &Camera,
    options: &BlendOptions,
    kept: &Kept,
) -> [Vec<T>; 7] {
    let view = CameraPair::<T>::new(camera, options.filter);
    let sorted = kept.get_or(|| Sorted::<T, F>::new(gaussians, &view, options));
    let layout = Layout { footprint: F::SUMS, probe: probed, maps: options.maps };
    let mut sums = gather(&sorted, grad, &layout, &view.camera, options);
    let units = F::probe_units(camera);
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
    let (degrees_width, probe_width) = (usize::from(F::HAS_DEGREES), if probed { 4 } else { 0 });
    let widths = [3, 4, 3, 1, 3, degrees_width, probe_width];
    let mut out = widths.map(|width| vec![T::zero(); gaussians.len() * width]);
    let [positions, quaternions, log_scales, opacities, colours, degrees, probes] = &mut out;
    for (&row, PrimitiveGrad { parameters, colour, probe }) in sorted.rows.iter().zip(&grads) {
        positions[3 * row..3 * row + 3].copy_from_slice(&parameters.position);
        quaternions[4 * row..4 * row + 4].copy_from_slice(&parameters.quaternion);
        log_scales[3 * row..3 * row + 3].copy_from_slice(&parameters.log_scales);
        opacities[row] = parameters.opacity;
        colours[3 * row..3 * row + 3].copy_from_slice(colour);
        if F::HAS_DEGREES {
            degrees[row] = parameters.degrees_of_freedom;
        }
        if probed {
            probes[4 * row..4 * row + 4].copy_from_slice(probe);
        }
    }
    out
}

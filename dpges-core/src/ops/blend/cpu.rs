//! CPU kernels: one task per tile goes front to back. Backward then goes back to front, where a division by
//! 1 − α recovers T; in the order of rays pixel by pixel, and then over the pixels of each primitive. Sums belong to
//! a tile and are added in the order of the tiles, so that the result does not depend on the number of threads.

mod disc;
mod distortion;
mod gather;
mod hybrid;
mod normal;
mod projected;
mod rays;
mod student;
mod walk;
mod whitened;

use std::sync::atomic::{AtomicI32, Ordering};

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};
use pulp::{Scalar, Simd, WithSimd};
use rayon::prelude::*;

use self::disc::DiscFootprint;
use self::distortion::Spread;
use self::gather::backward;
use self::hybrid::HybridTile;
use self::projected::{CameraPair, Ellipse, Projected};
use self::rays::walk_rays;
use self::walk::{Fragments, Sorted, Thresholds, Tile, walk_tile};
use self::whitened::WhitenedFootprint;
use super::autodiff::BlendState;
use super::{
    ALL_PLANES, ALPHA_PLANE, BlendInput, BlendLists, BlendOps, BlendOptions, BlendOutput, COLOUR_PLANES,
    ContributionOps, DEPTH_PLANE, DISTORTION_PLANE, Form, NORMAL_PLANE,
};
use crate::backend::host::{self, Host, with_real};
use crate::backend::kept::Kept;
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;
use crate::backend::vectorised::vectorised;
use crate::camera::Camera;
use crate::footprint::gaussian::cpu::student::Student;
use crate::footprint::gaussian::tensors::{GaussianRows, GaussianTensors};
use crate::scene::{BlendOrder, Transparency};
use crate::tiles::TILE_PIXELS;
use crate::tiles::layout::to_planes;

/// Median depth follows the planes where there are maps.
const MEDIAN: usize = ALL_PLANES;

/// State of the maps of a tile besides their sums.
struct TileSums<'a, T, F> {
    sorted: &'a Sorted<T, F>,
    spread: Spread<T>,
    /// [planes, `TILE_PIXELS`]
    block: &'a mut [T],
}

impl<T: Real, F: Projected<T>> TileSums<'_, T, F> {
    /// Adds the fragments of a primitive at the pixels from `start` on.
    #[inline(always)]
    fn add<S: Simd, const MAPS: bool>(&mut self, id: usize, start: usize, fragments: &Fragments<T, S>) {
        let &Fragments { depth, covered, through, .. } = fragments;
        self.add_weighted(0, start, covered, self.sorted.footprints[id].colour());
        if MAPS {
            let simd = depth.simd();
            self.add_weighted(NORMAL_PLANE, start, covered, self.sorted.normals[id]);
            self.add_to(DEPTH_PLANE, start, covered * depth);
            let growth = self.spread.add(start, fragments);
            self.add_to(DISTORTION_PLANE, start, growth);
            let median = &mut self.block[MEDIAN * TILE_PIXELS + start..];
            let found = Lanes::load(simd, median);
            let zero = Lanes::zero(simd);
            let half = Lanes::splat(simd, T::of(0.5));
            // 0 is no depth of a fragment, since all are beyond the near plane: it stands for none so far
            let first = zero.below(covered) & half.at_least(through) & zero.at_least(found);
            Lanes::select(first, depth, found).store(median);
        }
    }

    /// Adds αT, weighted by the values of three planes from `first` on.
    #[inline(always)]
    fn add_weighted<S: Simd>(&mut self, first: usize, start: usize, covered: Lanes<T, S>, values: [T; 3]) {
        for (plane, value) in values.into_iter().enumerate() {
            self.add_to(first + plane, start, covered * Lanes::splat(covered.simd(), value));
        }
    }

    #[inline(always)]
    fn add_to<S: Simd>(&mut self, plane: usize, start: usize, values: Lanes<T, S>) {
        let sums = &mut self.block[plane * TILE_PIXELS + start..];
        (Lanes::load(values.simd(), sums) + values).store(sums);
    }

    #[inline(always)]
    fn set_alpha(self, through: &[T; TILE_PIXELS]) {
        for (alpha, &through) in self.block[ALPHA_PLANE * TILE_PIXELS..].iter_mut().zip(through) {
            *alpha = T::one() - through;
        }
    }
}

/// The forward pass of a tile, into `block` [planes, `TILE_PIXELS`], zero so far.
struct BlendTile<'a, T, F> {
    tile: Tile<'a, T, F>,
    maps: bool,
    block: &'a mut [T],
}

impl<T: Real, F: Projected<T>> WithSimd for BlendTile<'_, T, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // compiled twice: pictures without maps do not pay for them
        if self.maps {
            self.blend::<S, true>(simd);
        } else {
            self.blend::<S, false>(simd);
        }
    }
}

impl<T: Real, F: Projected<T>> BlendTile<'_, T, F> {
    #[inline(always)]
    fn blend<S: Simd, const MAPS: bool>(self, simd: S) {
        let Self { tile, block, .. } = self;
        let mut sums = TileSums { sorted: tile.sorted, spread: Spread::new(tile.slope), block };
        match tile.order {
            BlendOrder::Centres | BlendOrder::Whitened(Transparency::Sorted) => {
                let progress = walk_tile(
                    simd,
                    &tile,
                    #[inline(always)]
                    |id, start, fragments| sums.add::<S, MAPS>(id, start, fragments),
                );
                sums.set_alpha(&progress.through);
            }
            BlendOrder::Rays => {
                let through = walk_rays(&tile, |position, pixel, fragment| {
                    sums.add::<Scalar, MAPS>(tile.list()[position] as usize, pixel, fragment);
                });
                sums.set_alpha(&through);
            }
            BlendOrder::Whitened(transparency) => HybridTile::new(simd, &tile, transparency).blend::<MAPS>(sums.block),
        }
    }
}

/// Planes and median depth, the latter empty without maps.
fn forward<T: Real, F: Projected<T>>(
    gaussians: &GaussianRows<T>,
    camera: &Camera,
    options: &BlendOptions,
    kept: &Kept,
) -> [Vec<T>; 2] {
    let view = CameraPair::<T>::new(camera, options.filter);
    let sorted = Sorted::<T, F>::new(gaussians, &view, options);
    let (thresholds, slope) = (Thresholds::new(options), distortion::slope(&view.camera));
    let count = if options.maps { ALL_PLANES + 1 } else { COLOUR_PLANES };
    let mut blocks = vec![T::zero(); sorted.grid.len() * count * TILE_PIXELS];
    blocks.par_chunks_mut(count * TILE_PIXELS).enumerate().for_each(|(tile, block)| {
        let (sorted, camera, thresholds, order) = (&sorted, &view.camera, &thresholds, options.order);
        let tile = Tile { sorted, camera, number: tile, thresholds, slope, order };
        vectorised(BlendTile { tile, maps: options.maps, block });
    });
    let mut planes = to_planes(&blocks, count, sorted.grid);
    // the backward pass takes the same footprints and lists, in place of projecting and sorting again
    kept.put(sorted);
    let median_depth = planes.split_off(options.planes() * camera.width * camera.height);
    [planes, median_depth]
}

impl<B: Host> BlendOps for B {
    fn blend(input: BlendInput<B>, camera: Camera, options: BlendOptions, kept: Kept) -> BlendOutput<B> {
        let (height, width, device) = (camera.height, camera.width, input.gaussians.positions.device());
        with_real!(input.gaussians.positions.dtype(), T => {
            let rows = GaussianRows::<T>::new(&input.gaussians).with_kernels::<B>(&input.degrees_of_freedom);
            let forward = match options.form {
                Form::Ellipsoids => forward::<T, Ellipse<T>>,
                Form::Discs => forward::<T, DiscFootprint<T>>,
                Form::Students => forward::<T, Student<T>>,
                Form::Whitened => forward::<T, WhitenedFootprint<T>>,
            };
            let [planes, median_depth] = forward(&rows, &camera, &options, &kept);
            let medians = usize::from(options.maps);
            BlendOutput {
                planes: host::float_tensor::<B, T, 3>(planes, [options.planes(), height, width], &device),
                median_depth: host::float_tensor::<B, T, 3>(median_depth, [medians, height, width], &device),
                // the lists of a CPU are in `kept`: these tensors are for GPUs
                lists: BlendLists::from_array(std::array::from_fn(|_| host::int_tensor::<B, 1>(Vec::new(), [0], &device))),
            }
        })
    }
}

impl<B: Host> BackwardState<B, 7> for BlendState<B> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 7] {
        let Self { input, camera, options, kept, .. } = self;
        let [degrees, probed] = [&input.degrees_of_freedom, &input.probe].map(host::rows);
        let device = grad.device();
        with_real!(grad.dtype(), T => {
            let rows = GaussianRows::<T>::new(&input.gaussians).with_kernels::<B>(&input.degrees_of_freedom);
            let backward = match options.form {
                Form::Ellipsoids => backward::<T, Ellipse<T>>,
                Form::Discs => backward::<T, DiscFootprint<T>>,
                Form::Students => backward::<T, Student<T>>,
                Form::Whitened => backward::<T, WhitenedFootprint<T>>,
            };
            let [positions, quaternions, log_scales, opacities, colours, degrees_of_freedom, probe] =
                backward(&rows, &host::floats::<B, T>(&grad), probed > 0, &camera, &options, &kept);
            let grads = BlendInput::<B> {
                gaussians: GaussianTensors::from_rows([positions, quaternions, log_scales, opacities, colours], &device),
                degrees_of_freedom: host::float_tensor::<B, T, 1>(degrees_of_freedom, [degrees], &device),
                probe: host::float_tensor::<B, T, 2>(probe, [probed, 4], &device),
            };
            grads.into_array().map(Some)
        })
    }
}

impl<B: Host> ContributionOps for B {
    fn contributing(input: BlendInput<B>, camera: Camera, options: BlendOptions, least: f64) -> IntTensor<B> {
        let (count, device) = (host::rows(&input.gaussians.positions), input.gaussians.positions.device());
        let transparency = options.order.transparency().expect("that of whitened Gaussians");
        let marks: Vec<i32> = with_real!(input.gaussians.positions.dtype(), T => {
            let rows = GaussianRows::<T>::new(&input.gaussians);
            let view = CameraPair::<T>::new(&camera, options.filter);
            let sorted = Sorted::<T, WhitenedFootprint<T>>::new(&rows, &view, &options);
            let (thresholds, least) = (Thresholds::new(&options), T::of(least));
            // one pixel at a time: this runs twice in a training
            let simd = Scalar::new();
            let marks: Vec<AtomicI32> = (0..count).map(|_| AtomicI32::new(0)).collect();
            (0..sorted.grid.len()).into_par_iter().for_each(|tile| {
                let mark = |id: usize, weight: T| {
                    if weight >= least {
                        // all write the same 1, so that the order of threads does not show
                        marks[sorted.rows[id]].store(1, Ordering::Relaxed);
                    }
                };
                let (sorted, camera, thresholds, order) = (&sorted, &view.camera, &thresholds, options.order);
                let tile = Tile { sorted, camera, number: tile, thresholds, slope: distortion::slope(camera), order };
                if transparency == Transparency::Sorted {
                    walk_tile(simd, &tile, |id, _, fragments| mark(id, fragments.covered.largest()));
                } else {
                    HybridTile::new(simd, &tile, transparency).for_each_weight(mark);
                }
            });
            marks.into_iter().map(AtomicI32::into_inner).collect()
        });
        host::int_tensor::<B, 1>(marks, [count], &device)
    }
}

//! Which primitives have at least some weight at some pixel.

use burn::backend::TensorMetadata;
use burn::backend::ops::IntTensorOps;
use burn::tensor::IntDType;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::Thresholds;
use super::fragments::Fragments;
use super::hybrid::{SHARE, TAIL, WEIGHTS, find_core, weigh};
use crate::camera::Camera;
use crate::footprint::gaussian::cube::whitened::{WHITENED, Whitened};
use crate::gpu::gather::zeros;
use crate::gpu::launch::{buffer, cube_dim, cubes};
use crate::gpu::record::Record;
use crate::gpu::tile::own_pixel;
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::{BlendLists, BlendOptions, CORE};
use crate::scene::Transparency;
use crate::tiles::TileGrid;
use crate::tiles::binning::cube::TileList;

/// Marks the primitives, in the order of the parameters, whose weight is at least `least` at some pixel.
#[cube(launch)]
fn contributing_kernel(
    shapes: &[f32],
    features: &[f32],
    offsets: &[u32],
    ids: &[u32],
    order: &[u32],
    marks: &[Atomic<i32>],
    view: CameraUniforms,
    thresholds: Thresholds,
    capacity: u32,
    count: u32,
    least: f32,
    #[comptime] transparency: Transparency,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let list = TileList::own(offsets, capacity, count);
    let own = own_pixel(view, CUBE_POS as u32);
    let (x, y) = (own.x, own.y);
    let end = select(own.inside, list.length, 0u32);
    if comptime!(transparency == Transparency::Sorted) {
        let mut through = 1.0f32;
        let mut entry = 0u32;
        let mut last = end;
        while entry < last {
            let i = list.entry(ids, entry) as usize;
            let (weight, _depth) = Whitened::load(shapes, i * WHITENED).fragment(view, x, y);
            let alpha = min(weight, thresholds.max_alpha);
            let behind = through * (1.0f32 - alpha);
            let goes_on = behind >= thresholds.min_transmittance;
            if alpha * through >= least {
                // idempotent: many units may mark one primitive, in any order
                marks[order[i] as usize].fetch_max(1i32);
            }
            through = behind;
            // the fragment that takes T below the least is still blended: the pixel ends behind it
            last = select(goes_on, last, 0u32);
            entry += 1u32;
        }
    } else {
        let mut tail = zeros(TAIL);
        let mut sums = zeros(WEIGHTS);
        let mut core =
            find_core(&mut tail, shapes, features, list, ids, own.inside, x, y, view, thresholds, transparency, false);
        weigh(&mut core, &tail, &mut sums, features, list, ids, thresholds, false);
        #[unroll]
        for k in 0..CORE {
            // an empty place covers 0, which is below the threshold
            if core.covered[k] >= least {
                let i = list.entry(ids, core.positions[k]) as usize;
                marks[order[i] as usize].fetch_max(1i32);
            }
        }
        let share = sums[SHARE];
        // α is at most 1
        let last = select(share >= least, end, 0u32);
        for entry in 0..last {
            let i = list.entry(ids, entry) as usize;
            let (weight, _depth) = Whitened::load(shapes, i * WHITENED).fragment(view, x, y);
            let mut in_core = false;
            #[unroll]
            for k in 0..CORE {
                in_core = in_core || core.positions[k] == entry;
            }
            if !in_core && share * min(weight, thresholds.max_alpha) >= least {
                marks[order[i] as usize].fetch_max(1i32);
            }
        }
    }
}

/// `[M]` 1 for every primitive whose weight is at least `least` at some pixel, else 0.
pub fn contributing(
    fragments: &Fragments,
    lists: &BlendLists<CubeBackend>,
    camera: &Camera,
    options: &BlendOptions,
    least: f64,
) -> CubeTensor {
    let count = lists.order.shape()[0];
    let marks = CubeBackend::int_zeros([count].into(), &lists.order.device, IntDType::I32);
    contributing_kernel::launch(
        &marks.client.clone(),
        cubes(TileGrid::new(camera.width, camera.height).len()),
        cube_dim(),
        buffer(&fragments.shapes),
        buffer(&fragments.features),
        buffer(&lists.offsets),
        buffer(&lists.primitives),
        buffer(&lists.order),
        buffer(&marks),
        CameraUniforms::launch(camera),
        Thresholds::launch(camera, options),
        lists.primitives.shape()[0] as u32,
        count as u32,
        least as f32,
        options.order.transparency().expect("that of whitened Gaussians"),
    );
    marks
}

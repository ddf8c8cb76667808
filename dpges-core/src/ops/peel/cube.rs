//! GPU kernels. Forward, one cube handles one tile. Backward gathers over pieces of the rectangle around the pixels in
//! which each surfel is a layer.

use burn::backend::TensorMetadata;
use burn::backend::ops::FloatTensorOps;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::autodiff::Grads;
use super::{PeelOps, PeelOptions, PeelOutput, PeelState, SurfelShapes};
use crate::backend::tape::BackwardOfAll;
use crate::camera::Camera;
use crate::footprint::surfel::cube as disc_cube;
use crate::footprint::surfel::cube::{
    DISC_SUMS, DiscPixel, DiscTensors, Hit, MIN_FACING, PLANE, Plane, Planes, add_sums, bounded_scale, exact_hit_by,
};
use crate::gpu::gather::zeros;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty, empty_f32, floats, integers};
use crate::gpu::record::Record;
use crate::gpu::tile::{own_pixel, plane_of};
use crate::gpu::view::{CameraUniforms, sight};
use crate::gpu::work_split::{Piece, WORKERS, cube_has_pieces, store_gathered};
use crate::scene::peeling::ORDER;
use crate::tiles::TileGrid;
use crate::tiles::binning::boxes::visible_pieces;
use crate::tiles::binning::capacity::ListKind;
use crate::tiles::binning::cube::{TileList, bin};

/// Index of a layer that is missing: −1 as unsigned.
const NONE: u32 = u32::MAX;

/// How opaque surfels are, see [`Footprint`](crate::scene::Footprint).
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Rim {
    /// Squared radius in σ² at which a surfel ends.
    end: f32,
    slope: f32,
    modulation: f32,
}

/// Opacity at a squared distance from the centre, before it is bounded by 1.
#[cube]
fn unbounded_opacity(rim: Rim, squared: f32, #[comptime] continuous: bool) -> f32 {
    let mut opacity = (rim.end - squared) * rim.slope;
    if comptime!(!continuous) {
        // bounded, since an edge-on disc is met far away and devices may assume that no number is infinite
        opacity = rim.modulation * f32::exp(max(-0.5f32 * squared, -100.0f32));
    }
    opacity
}

#[cube]
fn squared_distance(hit: Hit) -> f32 {
    hit.u * hit.u + hit.v * hit.v
}

/// The sorted fragments of a pixel, by (depth, id); empty slots are at infinity.
#[derive(CubeType)]
struct Slots {
    depth: Array<f32>,
    alpha: Array<f32>,
    id: Array<u32>,
}

/// Inserts a fragment into the first `count` slots and moves those behind it by one.
#[cube]
fn insert(slots: &mut Slots, fragment_depth: f32, fragment_alpha: f32, fragment_id: u32, #[comptime] count: usize) {
    let mut depth = fragment_depth;
    let mut alpha = fragment_alpha;
    let mut id = fragment_id;
    #[unroll]
    for k in 0..count {
        let before = depth < slots.depth[k] || (depth == slots.depth[k] && id < slots.id[k]);
        let (d, a, i) = (slots.depth[k], slots.alpha[k], slots.id[k]);
        slots.depth[k] = select(before, depth, d);
        slots.alpha[k] = select(before, alpha, a);
        slots.id[k] = select(before, id, i);
        depth = select(before, d, depth);
        alpha = select(before, a, alpha);
        id = select(before, i, id);
    }
}

#[cube(launch)]
fn peel_kernel(
    planes: &[f32],
    margins: &[f32],
    offsets: &[u32],
    ids: &[u32],
    out_ids: &mut [i32],
    out_alpha: &mut [f32],
    out_depth: &mut [f32],
    view: CameraUniforms,
    rim: Rim,
    capacity: u32,
    count: u32,
    #[comptime] layers: usize,
    #[comptime] continuous: bool,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let list = TileList::own(offsets, capacity, count);
    let pixel = own_pixel(view, CUBE_POS as u32);
    let sight = sight(view, pixel.x, pixel.y);
    let mut staged = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * PLANE));
    // cores have a slot of their own
    let others = comptime!(if continuous { layers - 1 } else { layers });
    // arrays that only constants index, so that they stay in registers
    let mut slots =
        Slots { depth: Array::<f32>::new(layers), alpha: Array::<f32>::new(layers), id: Array::<u32>::new(layers) };
    #[unroll]
    for k in 0..layers {
        slots.depth[k] = view.infinity;
        slots.alpha[k] = 0.0f32;
        slots.id[k] = NONE;
    }
    // the nearest core so far, and the depth up to which other fragments are layers
    let mut core_depth = view.infinity;
    let mut core_id = NONE.runtime();
    let mut end = view.infinity;

    let batches = list.batches();
    for batch in 0..batches {
        let entries = list.stage(ids, batch, planes, planes, &mut staged, (PLANE, 0));
        for j in 0..entries {
            // f32 is enough to find layers; gradients are divided by the square of the facing, and take pairs
            let found = Plane::load(&staged, j as usize * PLANE).hit_by(view, sight);
            let squared = squared_distance(found);
            let exists = f32::abs(found.facing) > MIN_FACING && found.depth > view.near && squared < rim.end;
            if exists {
                let alpha = min(unbounded_opacity(rim, squared, continuous), 1.0f32);
                let own_id = list.entry(ids, batch * UNITS + j);
                let mut is_core = false;
                if comptime!(continuous) {
                    let nearer = found.depth < core_depth || (found.depth == core_depth && own_id < core_id);
                    is_core = alpha >= 1.0f32 && nearer;
                }
                // a core so far becomes a fragment like others
                let depth = select(is_core, core_depth, found.depth);
                let id = select(is_core, core_id, own_id);
                if is_core {
                    end = found.depth + comptime!(ORDER as f32) * margins[own_id as usize];
                    core_depth = found.depth;
                    core_id = own_id;
                }
                // `<=` since of equal depths the index decides, in `insert`
                #[expect(clippy::collapsible_if, reason = "the outer condition is known before")]
                if comptime!(others > 0) {
                    if depth <= slots.depth[others - 1] && id != NONE {
                        insert(&mut slots, depth, alpha, id, others);
                    }
                }
            }
        }
    }

    if pixel.inside {
        let plane = plane_of(view);
        if comptime!(continuous) {
            #[unroll]
            for k in 0..others {
                let is_layer = slots.depth[k] <= end;
                slots.depth[k] = select(is_layer, slots.depth[k], view.infinity);
                slots.alpha[k] = select(is_layer, slots.alpha[k], 0.0f32);
                slots.id[k] = select(is_layer, slots.id[k], NONE);
            }
            if core_id != NONE {
                insert(&mut slots, core_depth, 1.0f32, core_id, layers);
            }
        }
        let mut closed = false;
        #[unroll]
        for k in 0..layers {
            let at = k * plane + pixel.at;
            out_ids[at] = select(closed, -1i32, i32::reinterpret(slots.id[k]));
            out_alpha[at] = select(closed, 0.0f32, slots.alpha[k]);
            out_depth[at] = select(closed, view.infinity, slots.depth[k]);
            if comptime!(!continuous) {
                // nothing is behind an opaque layer, although its fragments took places of the list
                closed = closed || slots.alpha[k] >= 1.0f32;
            }
        }
    }
}

/// Sums of gradients over the pixels of each piece in which its surfel is a layer. `grads` holds those of alpha, then those of
/// depth, in one buffer: WebGPU binds eight at most.
#[cube(launch)]
fn gather_kernel(
    planes: &[f32],
    lows: &[f32],
    pieces: &[u32],
    ids: &[i32],
    grads: &[f32],
    sums: &mut [f32],
    view: CameraUniforms,
    rim: Rim,
    log_scales: &[f32],
    most: u32,
    #[comptime] layers: usize,
    #[comptime] continuous: bool,
    #[comptime] of_alpha: bool,
    #[comptime] of_depth: bool,
) {
    if !cube_has_pieces(pieces, most) {
        terminate!();
    }
    let mut own = zeros(DISC_SUMS);
    let piece = Piece::own(pieces);
    let mut p = piece.first();
    if p < piece.end {
        let surfel = piece.primitive as usize;
        let scale_u = bounded_scale(log_scales[2 * surfel]);
        let scale_v = bounded_scale(log_scales[2 * surfel + 1]);
        let plane_size = plane_of(view);
        let stride = piece.stride();
        let (first_column, first_row) = piece.pixel(p);
        let mut column = first_column;
        let mut row = first_row;
        while p < piece.end {
            let pixel = (row * view.width + column) as usize;
            let mut incoming_alpha = 0.0f32;
            let mut incoming_depth = 0.0f32;
            #[unroll]
            for k in 0..layers {
                if ids[k * plane_size + pixel] == surfel as i32 {
                    if comptime!(of_alpha) {
                        incoming_alpha = grads[k * plane_size + pixel];
                    }
                    if comptime!(of_depth) {
                        let before = comptime!(if of_alpha { layers } else { 0 });
                        incoming_depth = grads[(before + k) * plane_size + pixel];
                    }
                }
            }
            // a hit in pairs costs many times as much as one in f32: only layers with a gradient are met again
            if incoming_alpha != 0.0f32 || incoming_depth != 0.0f32 {
                let sight = sight(view, f32::cast_from(column) + 0.5f32, f32::cast_from(row) + 0.5f32);
                let plane = Plane::load(planes, surfel * PLANE);
                let hit = exact_hit_by(view, plane, Plane::load(lows, surfel * PLANE), sight);
                let shares = plane.shares(view, sight);
                let (across, down) = (shares.y, shares.z);
                // a core's opacity does not change
                let opacity = unbounded_opacity(rim, squared_distance(hit), continuous);
                let mut steepness = 2.0f32 * rim.slope;
                if comptime!(!continuous) {
                    steepness = opacity;
                }
                let power = select(opacity < 1.0f32, steepness * incoming_alpha, 0.0f32);
                let pixel = DiscPixel { hit, across, down, scale_u, scale_v, power, grad_depth: incoming_depth };
                add_sums(&mut own, pixel, shares.x, of_alpha, of_depth);
            }
            let (next_column, next_row) = piece.next(stride, column, row);
            column = next_column;
            row = next_row;
            p += WORKERS;
        }
    }
    store_gathered(&own, sums, most, DISC_SUMS, true);
}

fn discs(surfels: &SurfelShapes<CubeBackend>) -> DiscTensors<'_> {
    DiscTensors { positions: &surfels.positions, quaternions: &surfels.quaternions, log_scales: &surfels.log_scales }
}

fn setup(surfels: &SurfelShapes<CubeBackend>, camera: &Camera, options: &PeelOptions) -> Planes {
    let squared = options.footprint.squared_radius(options.modulation);
    let radius = if squared < 0.0 { -1.0 } else { squared.sqrt() as f32 };
    disc_cube::planes(&discs(surfels), None, Some(radius), camera)
}

impl RimLaunch {
    fn of(options: &PeelOptions) -> Self {
        let PeelOptions { footprint, modulation, .. } = *options;
        let [end, slope] = [footprint.squared_radius(modulation), footprint.rim_slope(modulation)];
        Self::new(end as f32, slope as f32, modulation as f32)
    }
}

fn contiguous(surfels: SurfelShapes<CubeBackend>) -> SurfelShapes<CubeBackend> {
    SurfelShapes::from_array(surfels.into_array().map(floats))
}

impl PeelOps for CubeBackend {
    fn peel(surfels: SurfelShapes<Self>, camera: Camera, options: PeelOptions) -> PeelOutput<Self> {
        let surfels = contiguous(surfels);
        let like = surfels.positions.clone();
        let count = like.shape()[0];
        let Planes { planes, rects, .. } = setup(&surfels, &camera, &options);
        // discs have no test that is finer than their rectangle
        let lists = bin(&rects, None, &camera, ListKind::Surfels);
        let shape = [options.layer_count, camera.height, camera.width];
        let (ids, alpha, depth) = (empty(&like, shape, DType::I32), empty_f32(&like, shape), empty_f32(&like, shape));
        peel_kernel::launch(
            &like.client.clone(),
            cubes(TileGrid::new(camera.width, camera.height).len()),
            cube_dim(),
            buffer(&planes),
            buffer(&surfels.margins),
            buffer(&lists.offsets),
            buffer(&lists.ids),
            buffer(&ids),
            buffer(&alpha),
            buffer(&depth),
            CameraUniforms::launch(&camera),
            RimLaunch::of(&options),
            lists.capacity,
            count as u32,
            options.layer_count,
            options.peeling.is_continuous(),
        );
        PeelOutput { ids, alpha, depth }
    }
}

impl BackwardOfAll<CubeBackend, 3, 2> for PeelState<CubeBackend> {
    fn parents(&self) -> [&CubeTensor; 3] {
        [&self.surfels.positions, &self.surfels.quaternions, &self.surfels.log_scales]
    }

    fn backward_from(self, grads: Grads<CubeBackend>) -> [Option<CubeTensor>; 3] {
        let Self { surfels, ids, camera, options } = self;
        let (surfels, ids) = (contiguous(surfels), integers(ids));
        let like = surfels.positions.clone();
        let (client, count) = (like.client.clone(), like.shape()[0]);
        let [of_alpha, of_depth] = grads.each_ref().map(Option::is_some);
        let grads = floats(CubeBackend::float_cat(grads.into_iter().flatten().collect(), 0));
        let Planes { planes, lows, .. } = setup(&surfels, &camera, &options);
        let pieces = visible_pieces(&ids, count);
        let gathered = empty_f32(&like, [pieces.most, DISC_SUMS]);
        gather_kernel::launch(
            &client,
            pieces.gatherers(),
            cube_dim(),
            buffer(&planes),
            buffer(&lows),
            buffer(&pieces.pieces),
            buffer(&ids),
            buffer(&grads),
            buffer(&gathered),
            CameraUniforms::launch(&camera),
            RimLaunch::of(&options),
            buffer(&surfels.log_scales),
            pieces.most as u32,
            options.layer_count,
            options.peeling.is_continuous(),
            of_alpha,
            of_depth,
        );
        let sums = pieces.collect(&gathered, 0, DISC_SUMS);
        let [positions, quaternions, log_scales] = [3, 4, 2].map(|width| empty_f32(&like, [count, width]));
        let out = DiscTensors { positions: &positions, quaternions: &quaternions, log_scales: &log_scales };
        disc_cube::backward(&discs(&surfels), &sums, &camera, &out);
        [positions, quaternions, log_scales].map(Some)
    }
}

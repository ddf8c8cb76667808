//! GPU kernels. Forward, one cube handles one tile. Backward gathers over pieces of the rectangle around the pixels in
//! which each surfel is a layer.

use burn::backend::TensorMetadata;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::autodiff::PeelState;
use super::{PeelGradient, PeelOps, PeelOptions, PeelOutput, SurfelShapes};
use crate::backend::tape::WayBack;
use crate::camera::Camera;
use crate::footprint::gaussian::cube::CUTOFF_F32;
use crate::footprint::surfel::cube as disc_cube;
use crate::footprint::surfel::cube::{
    DISC_SUMS, DiscPixel, DiscTensors, MIN_FACING, PLANE, Plane, Planes, add_sums, bounded_scale, exact_hit_by,
};
use crate::gpu::gather::zeros;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty, empty_f32, floats, integers};
use crate::gpu::record::Record;
use crate::gpu::tile::{own_pixel, plane_of};
use crate::gpu::view::{CameraUniforms, sight};
use crate::gpu::work_split::{Piece, WORKERS, cube_has_pieces, store_gathered};
use crate::scene::Footprint;
use crate::tiles::TileGrid;
use crate::tiles::binning::boxes::visible_pieces;
use crate::tiles::binning::capacity::ListKind;
use crate::tiles::binning::cube::{TileList, bin};

/// Index of a layer that is missing: −1 as unsigned.
const NONE: u32 = u32::MAX;

#[cube(launch)]
fn peel_kernel(
    planes: &[f32],
    offsets: &[u32],
    ids: &[u32],
    out_ids: &mut [i32],
    out_alpha: &mut [f32],
    out_depth: &mut [f32],
    view: CameraUniforms,
    modulation: f32,
    capacity: u32,
    count: u32,
    #[comptime] layers: usize,
    #[comptime] by_kernel: bool,
    #[comptime] backstop: bool,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let list = TileList::own(offsets, capacity, count);
    let pixel = own_pixel(view, CUBE_POS as u32);
    let sight = sight(view, pixel.x, pixel.y);
    let mut staged = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * PLANE));
    // slots in ascending order of (depth, id); an empty one is at infinity
    let mut slot_depth = Array::<f32>::new(layers);
    let mut slot_alpha = Array::<f32>::new(layers);
    let mut slot_id = Array::<u32>::new(layers);
    #[unroll]
    for k in 0..layers {
        slot_depth[k] = view.infinity;
        slot_alpha[k] = 0.0f32;
        slot_id[k] = NONE;
    }
    // the nearest opaque fragment, which more than K rims would push out of the slots
    let mut core_depth = view.infinity;
    let mut core_id = NONE.runtime();

    let batches = list.batches();
    for batch in 0..batches {
        let entries = list.stage(ids, batch, planes, planes, &mut staged, (PLANE, 0));
        for j in 0..entries {
            let found = Plane::load(&staged, j as usize * PLANE).hit_by(view, sight);
            let opacity = min(modulation * found.kernel, 1.0f32);
            let mut measure = opacity;
            if comptime!(by_kernel) {
                measure = found.kernel;
            }
            let exists = f32::abs(found.facing) > MIN_FACING && found.depth > view.near && measure >= CUTOFF_F32;
            if comptime!(backstop) {
                let is_core = exists && opacity >= 1.0f32 && found.depth <= core_depth;
                if is_core {
                    let id = list.entry(ids, batch * UNITS + j);
                    let before = found.depth < core_depth || id < core_id;
                    core_depth = select(before, found.depth, core_depth);
                    core_id = select(before, id, core_id);
                }
            }
            if exists && found.depth <= slot_depth[layers - 1] {
                let mut depth = found.depth;
                let mut alpha = opacity;
                let mut id = list.entry(ids, batch * UNITS + j);
                #[unroll]
                for k in 0..layers {
                    let before = depth < slot_depth[k] || (depth == slot_depth[k] && id < slot_id[k]);
                    let (d, a, i) = (slot_depth[k], slot_alpha[k], slot_id[k]);
                    slot_depth[k] = select(before, depth, d);
                    slot_alpha[k] = select(before, alpha, a);
                    slot_id[k] = select(before, id, i);
                    depth = select(before, d, depth);
                    alpha = select(before, a, alpha);
                    id = select(before, i, id);
                }
            }
        }
    }

    if pixel.inside {
        let plane = plane_of(view);
        if comptime!(backstop) {
            let mut has_core = false;
            #[unroll]
            for k in 0..layers {
                has_core = has_core || slot_alpha[k] >= 1.0f32;
            }
            if core_id != NONE && !has_core {
                slot_depth[layers - 1] = core_depth;
                slot_alpha[layers - 1] = 1.0f32;
                slot_id[layers - 1] = core_id;
            }
        }
        let mut opaque = false;
        #[unroll]
        for k in 0..layers {
            let at = k * plane + pixel.at;
            out_ids[at] = select(opaque, -1i32, i32::reinterpret(slot_id[k]));
            out_alpha[at] = select(opaque, 0.0f32, slot_alpha[k]);
            out_depth[at] = select(opaque, view.infinity, slot_depth[k]);
            opaque = opaque || slot_alpha[k] >= 1.0f32;
        }
    }
}

/// Sums of gradients over the pixels of each piece in which its surfel is a layer.
#[cube(launch)]
fn gather_kernel(
    planes: &[f32],
    lows: &[f32],
    pieces: &[u32],
    ids: &[i32],
    grad: &[f32],
    sums: &mut [f32],
    view: CameraUniforms,
    modulation: f32,
    log_scales: &[f32],
    most: u32,
    #[comptime] layers: usize,
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
            let mut incoming = 0.0f32;
            #[unroll]
            for k in 0..layers {
                if ids[k * plane_size + pixel] == surfel as i32 {
                    incoming = grad[k * plane_size + pixel];
                }
            }
            if incoming != 0.0f32 {
                let sight = sight(view, f32::cast_from(column) + 0.5f32, f32::cast_from(row) + 0.5f32);
                let plane = Plane::load(planes, surfel * PLANE);
                let hit = exact_hit_by(view, plane, Plane::load(lows, surfel * PLANE), sight);
                let shares = plane.shares(view, sight);
                let (across, down) = (shares.y, shares.z);
                if comptime!(of_depth) {
                    let pixel = DiscPixel { hit, across, down, scale_u, scale_v, power: 0.0f32, grad_depth: incoming };
                    add_sums(&mut own, pixel, shares.x, false, true);
                } else if modulation * hit.kernel < 1.0f32 {
                    let power = modulation * incoming * hit.kernel;
                    let pixel = DiscPixel { hit, across, down, scale_u, scale_v, power, grad_depth: 0.0f32 };
                    add_sums(&mut own, pixel, shares.x, true, false);
                }
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
    let radius = options.footprint.radius(options.modulation).map_or(-1.0, |radius| radius as f32);
    disc_cube::planes(&discs(surfels), None, Some(radius), camera)
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
        let lists = bin(&rects, None, &camera, ListKind::Surfels);
        let shape = [options.layer_count, camera.height, camera.width];
        let (ids, alpha, depth) = (empty(&like, shape, DType::I32), empty_f32(&like, shape), empty_f32(&like, shape));
        peel_kernel::launch(
            &like.client.clone(),
            cubes(TileGrid::new(camera.width, camera.height).len()),
            cube_dim(),
            buffer(&planes),
            buffer(&lists.offsets),
            buffer(&lists.ids),
            buffer(&ids),
            buffer(&alpha),
            buffer(&depth),
            CameraUniforms::launch(&camera),
            options.modulation as f32,
            lists.capacity,
            count as u32,
            options.layer_count,
            options.footprint == Footprint::Kernel,
            options.backstop,
        );
        PeelOutput { ids, alpha, depth }
    }
}

impl WayBack<CubeBackend, 3> for PeelState<CubeBackend> {
    fn go_back(self, grad: CubeTensor) -> [Option<CubeTensor>; 3] {
        let Self { surfels, ids, of, camera, options } = self;
        let surfels = contiguous(surfels);
        let (ids, grad) = (integers(ids), floats(grad));
        let like = surfels.positions.clone();
        let (client, count) = (like.client.clone(), like.shape()[0]);
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
            buffer(&grad),
            buffer(&gathered),
            CameraUniforms::launch(&camera),
            options.modulation as f32,
            buffer(&surfels.log_scales),
            pieces.most as u32,
            options.layer_count,
            of == PeelGradient::Depth,
        );
        let sums = pieces.collect(&gathered, 0, DISC_SUMS);
        let out = SurfelShapes::from_array([3, 4, 2].map(|width| empty_f32(&like, [count, width])));
        disc_cube::backward(&discs(&surfels), &sums, &camera, &discs(&out));
        out.into_array().map(Some)
    }
}

//! GPU kernels: one cube per tile forward; backward every surfel gathers over the pixels in which it
//! is a layer, so that nothing is accumulated across cubes.

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::{PeelBackwardOps, PeelGradient, PeelOps, PeelOptions, PeelOutput, SurfelShapes};
use crate::binning::boxes::visible_boxes;
use crate::binning::capacity::ListKind;
use crate::binning::cube::{bin, entry, own_pixel, tile_list};
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::disc::MIN_FACING;
use crate::footprint::disc_cube::{
    LARGEST_LOG_SCALE, PLANE, SUMS, disc, disc_backward, exact_disc, exact_hit, hit, write_plane, write_reach,
};
use crate::gpu::launch::{buffer, cube_dim, cubes, empty, empty_f32, empty_u32, floats, gatherers, integers, units};
use crate::gpu::vector::{row3, row4, write3, write4};
use crate::gpu::view::{Rests, View};
use crate::scene::Footprint;
use crate::tiles::TileGrid;

const CUTOFF_F32: f32 = CUTOFF as f32;
const MIN_FACING_F32: f32 = MIN_FACING as f32;

#[cube(launch)]
fn setup_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    planes: &mut [f32],
    lows: &mut [f32],
    rects: &mut [u32],
    view: View,
    rests: Rests,
    radius: f32,
    count: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let exact = exact_disc(view, rests, row3(positions, i), row4(quaternions, i));
    let disc = disc(view, exact, log_scales[2 * i], log_scales[2 * i + 1]);
    write_plane(view, rests, exact, disc, planes, lows, i);
    write_reach(view, disc, radius, rects, i);
}

#[cube(launch)]
fn peel_kernel(
    planes: &[f32],
    offsets: &[u32],
    ids: &[u32],
    out_ids: &mut [i32],
    out_alpha: &mut [f32],
    out_depth: &mut [f32],
    view: View,
    modulation: f32,
    capacity: u32,
    count: u32,
    #[comptime] layers: usize,
    #[comptime] by_kernel: bool,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let (start, length, listed) = tile_list(offsets, capacity, count);
    let (column, row) = own_pixel(view);
    let x = f32::cast_from(column) + 0.5f32;
    let y = f32::cast_from(row) + 0.5f32;
    let unit = UNIT_POS as usize;

    let mut staged = Shared::<[f32]>::new_slice(256usize * PLANE);
    let mut staged_ids = Shared::<[u32]>::new_slice(256usize);
    // slots in ascending order of (depth, id); an empty one is at infinity
    let mut slot_depth = Array::<f32>::new(layers);
    let mut slot_alpha = Array::<f32>::new(layers);
    let mut slot_id = Array::<u32>::new(layers);
    #[unroll]
    for k in 0..layers {
        slot_depth[k] = view.infinity;
        slot_alpha[k] = 0.0f32;
        slot_id[k] = 0xffff_ffffu32;
    }

    let rounds = length.div_ceil(256u32);
    for round in 0..rounds {
        let at = round * 256u32 + UNIT_POS;
        sync_cube();
        if at < length {
            let id = entry(ids, start, at, listed);
            staged_ids[unit] = id;
            #[unroll]
            for number in 0..PLANE {
                staged[unit * PLANE + number] = planes[id as usize * PLANE + number];
            }
        }
        sync_cube();
        let batch = min(256u32, length - round * 256u32);
        for j in 0..batch {
            let found = hit(&staged, j as usize * PLANE, x, y);
            let opacity = min(modulation * found.kernel, 1.0f32);
            let mut measure = opacity;
            if comptime!(by_kernel) {
                measure = found.kernel;
            }
            let exists = f32::abs(found.facing) > MIN_FACING_F32 && found.depth > view.near && measure >= CUTOFF_F32;
            if exists && found.depth <= slot_depth[layers - 1] {
                let mut depth = found.depth;
                let mut alpha = opacity;
                let mut id = staged_ids[j as usize];
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

    if column < view.width && row < view.height {
        let plane = (view.width * view.height) as usize;
        let pixel = (row * view.width + column) as usize;
        let mut opaque = false;
        #[unroll]
        for k in 0..layers {
            let at = k * plane + pixel;
            out_ids[at] = select(opaque, -1i32, i32::reinterpret(slot_id[k]));
            out_alpha[at] = select(opaque, 0.0f32, slot_alpha[k]);
            out_depth[at] = select(opaque, view.infinity, slot_depth[k]);
            opaque = opaque || slot_alpha[k] >= 1.0f32;
        }
    }
}

/// Sums of gradients over the pixels in which each surfel is a layer: 32 units per surfel.
#[cube(launch)]
fn gather_kernel(
    planes: &[f32],
    lows: &[f32],
    boxes: &[u32],
    ids: &[i32],
    grad: &[f32],
    sums: &mut [f32],
    view: View,
    modulation: f32,
    scales: &[f32],
    count: u32,
    #[comptime] layers: usize,
    #[comptime] of_depth: bool,
) {
    if CUBE_POS * 8 >= count as usize {
        terminate!();
    }
    let mut partial = Shared::<[f32]>::new_slice(256usize * SUMS);
    let mut own = Array::<f32>::new(SUMS);
    #[unroll]
    for s in 0..SUMS {
        own[s] = 0.0f32;
    }
    let surfel = CUBE_POS * 8 + (UNIT_POS / 32u32) as usize;
    if surfel < count as usize {
        let (x0, x1) = (boxes[4 * surfel], boxes[4 * surfel + 1]);
        let (y0, y1) = (boxes[4 * surfel + 2], boxes[4 * surfel + 3]);
        let o = surfel * PLANE;
        let scale_u = f32::exp(min(scales[2 * surfel], LARGEST_LOG_SCALE));
        let scale_v = f32::exp(min(scales[2 * surfel + 1], LARGEST_LOG_SCALE));
        let plane = (view.width * view.height) as usize;
        let width = x1 - x0;
        let area = width * (y1 - y0);
        let mut p = UNIT_POS % 32u32;
        while p < area {
            let (column, row) = (x0 + p % width, y0 + p / width);
            let pixel = (row * view.width + column) as usize;
            let mut incoming = 0.0f32;
            #[unroll]
            for k in 0..layers {
                if ids[k * plane + pixel] == surfel as i32 {
                    incoming = grad[k * plane + pixel];
                }
            }
            if incoming != 0.0f32 {
                let (x, y) = (f32::cast_from(column) + 0.5f32, f32::cast_from(row) + 0.5f32);
                let found = exact_hit(planes, lows, o, x, y, view.zero);
                let (across, down) = ((x - planes[o]) / view.fx, (y - planes[o + 1]) / view.fy);
                if comptime!(of_depth) {
                    let towards_facing = -incoming * found.depth / found.facing;
                    own[6] += towards_facing;
                    own[7] += towards_facing * across;
                    own[8] += towards_facing * down;
                    own[9] += incoming / found.facing;
                } else if modulation * found.kernel < 1.0f32 {
                    let grad_kernel = modulation * incoming * found.kernel;
                    let (grad_u, grad_v) = (-grad_kernel * found.u, -grad_kernel * found.v);
                    let towards_u = grad_u / (found.facing * scale_u);
                    let towards_v = grad_v / (found.facing * scale_v);
                    let towards_facing = -(grad_u * found.u + grad_v * found.v) / found.facing;
                    own[0] += towards_u;
                    own[1] += towards_u * across;
                    own[2] += towards_u * down;
                    own[3] += towards_v;
                    own[4] += towards_v * across;
                    own[5] += towards_v * down;
                    own[6] += towards_facing;
                    own[7] += towards_facing * across;
                    own[8] += towards_facing * down;
                    own[10] -= grad_u * found.u;
                    own[11] -= grad_v * found.v;
                }
            }
            p += 32u32;
        }
    }
    #[unroll]
    for s in 0..SUMS {
        partial[UNIT_POS as usize * SUMS + s] = own[s];
    }
    sync_cube();
    if UNIT_POS < 96u32 {
        let (slot, s) = ((UNIT_POS / 12u32) as usize, (UNIT_POS % 12u32) as usize);
        let target = CUBE_POS * 8 + slot;
        if target < count as usize {
            let mut sum = 0.0f32;
            for lane in 0..32u32 {
                sum += partial[(slot * 32 + lane as usize) * SUMS + s];
            }
            sums[target * SUMS + s] = sum;
        }
    }
}

#[cube(launch)]
fn disc_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    sums: &[f32],
    grad_positions: &mut [f32],
    grad_quaternions: &mut [f32],
    grad_log_scales: &mut [f32],
    view: View,
    rests: Rests,
    count: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let quaternion = row4(quaternions, i);
    let exact = exact_disc(view, rests, row3(positions, i), quaternion);
    let disc = disc(view, exact, log_scales[2 * i], log_scales[2 * i + 1]);
    let gradient = disc_backward(view, disc, quaternion, sums, i);
    write3(grad_positions, i, gradient.position);
    write4(grad_quaternions, i, gradient.quaternion);
    grad_log_scales[2 * i] = sums[i * SUMS + 10];
    grad_log_scales[2 * i + 1] = sums[i * SUMS + 11];
}

/// What does not depend on the pixel.
struct Setup {
    /// [N, [`PLANE`]], and what rounding took from it
    planes: CubeTensor,
    lows: CubeTensor,
    /// [N, 4] pixel rectangles
    rects: CubeTensor,
}

fn setup(surfels: &SurfelShapes<CubeBackend>, camera: &Camera, options: &PeelOptions) -> Setup {
    let (like, count) = (&surfels.positions, surfels.positions.shape()[0]);
    let (planes, lows) = (empty_f32(like, [count, PLANE]), empty_f32(like, [count, PLANE]));
    let rects = empty_u32(like, [count, 4]);
    let radius = options.footprint.radius(options.modulation).map_or(-1.0, |radius| radius as f32);
    setup_kernel::launch(
        &surfels.positions.client.clone(),
        units(count),
        cube_dim(),
        buffer(&surfels.positions),
        buffer(&surfels.quaternions),
        buffer(&surfels.log_scales),
        buffer(&planes),
        buffer(&lows),
        buffer(&rects),
        View::launch(camera),
        Rests::launch(camera),
        radius,
        count as u32,
    );
    Setup { planes, lows, rects }
}

fn contiguous(surfels: SurfelShapes<CubeBackend>) -> SurfelShapes<CubeBackend> {
    SurfelShapes {
        positions: floats(surfels.positions),
        quaternions: floats(surfels.quaternions),
        log_scales: floats(surfels.log_scales),
    }
}

impl PeelOps for CubeBackend {
    fn peel(surfels: SurfelShapes<Self>, camera: Camera, options: PeelOptions) -> PeelOutput<Self> {
        let surfels = contiguous(surfels);
        let like = surfels.positions.clone();
        let count = like.shape()[0];
        let Setup { planes, rects, .. } = setup(&surfels, &camera, &options);
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
            View::launch(&camera),
            options.modulation as f32,
            lists.capacity,
            count as u32,
            options.layer_count,
            options.footprint == Footprint::Kernel,
        );
        PeelOutput { ids, alpha, depth }
    }
}

impl PeelBackwardOps for CubeBackend {
    fn peel_backward(
        surfels: SurfelShapes<Self>,
        ids: IntTensor<Self>,
        grad: FloatTensor<Self>,
        of: PeelGradient,
        camera: Camera,
        options: PeelOptions,
    ) -> SurfelShapes<Self> {
        let surfels = contiguous(surfels);
        let (ids, grad) = (integers(ids), floats(grad));
        let like = surfels.positions.clone();
        let (client, count) = (like.client.clone(), like.shape()[0]);
        let Setup { planes, lows, .. } = setup(&surfels, &camera, &options);
        let boxes = visible_boxes(&ids, count);
        let sums = empty_f32(&like, [count, SUMS]);
        gather_kernel::launch(
            &client,
            gatherers(count),
            cube_dim(),
            buffer(&planes),
            buffer(&lows),
            buffer(&boxes),
            buffer(&ids),
            buffer(&grad),
            buffer(&sums),
            View::launch(&camera),
            options.modulation as f32,
            buffer(&surfels.log_scales),
            count as u32,
            options.layer_count,
            of == PeelGradient::Depth,
        );
        let out = SurfelShapes {
            positions: empty_f32(&like, [count, 3]),
            quaternions: empty_f32(&like, [count, 4]),
            log_scales: empty_f32(&like, [count, 2]),
        };
        disc_backward_kernel::launch(
            &client,
            units(count),
            cube_dim(),
            buffer(&surfels.positions),
            buffer(&surfels.quaternions),
            buffer(&surfels.log_scales),
            buffer(&sums),
            buffer(&out.positions),
            buffer(&out.quaternions),
            buffer(&out.log_scales),
            View::launch(&camera),
            Rests::launch(&camera),
            count as u32,
        );
        out
    }
}

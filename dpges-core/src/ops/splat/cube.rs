//! GPU kernels: one cube per tile forward; backward and contributions gather, 32 units for each
//! Gaussian over its own pixels, so that nothing is accumulated across cubes.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::{SplatBackwardOps, SplatOps};
use crate::binning::capacity::ListKind;
use crate::binning::cube::{Ellipses, SPLAT, bin, entry, own_pixel, tile_list};
use crate::camera::Camera;
use crate::device::is_deterministic;
use crate::footprint::gaussians::GaussianTensors;
use crate::footprint::splat_cube::{MOMENTS, SplatGradient, project, splat_backward, weight, write_splat};
use crate::gpu::launch::{buffer, cube_dim, cubes, empty_f32, empty_u32, floats, gatherers, units};
use crate::gpu::vector::{Quaternion, row3, row4, vec3, write3, write4};
use crate::gpu::view::View;
use crate::tiles::TileGrid;

const CHANNELS: usize = 4;
/// Splat and colour.
const STAGED: usize = SPLAT + 3;

#[cube(launch)]
fn project_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    splats: &mut [f32],
    rects: &mut [u32],
    view: View,
    count: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let projection = project(view, row3(positions, i), row4(quaternions, i), row3(log_scales, i));
    write_splat(view, projection, opacities[i], splats, rects, i);
}

/// Depth at and behind which no pixel of a tile sees anything: the largest of its last limits.
#[cube(launch)]
fn ends_kernel(limits: &[f32], ends: &mut [f32], view: View, #[comptime] layers: usize) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let (column, row) = own_pixel(view);
    let unit = UNIT_POS as usize;
    let mut furthest = Shared::<[f32]>::new_slice(256usize);
    let mut own = -view.infinity;
    if column < view.width && row < view.height {
        let plane = (view.width * view.height) as usize;
        own = limits[(layers - 1) * plane + (row * view.width + column) as usize];
    }
    furthest[unit] = own;
    let mut step = 128usize;
    while step > 0usize {
        sync_cube();
        if unit < step {
            furthest[unit] = max(furthest[unit], furthest[unit + step]);
        }
        step /= 2;
    }
    if UNIT_POS == 0u32 {
        ends[CUBE_POS] = furthest[0];
    }
}

#[cube(launch)]
fn splat_kernel(
    splats: &[f32],
    colours: &[f32],
    limits: &[f32],
    offsets: &[u32],
    ids: &[u32],
    sums: &mut [f32],
    view: View,
    capacity: u32,
    count: u32,
    #[comptime] layers: usize,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let (start, length, listed) = tile_list(offsets, capacity, count);
    let (column, row) = own_pixel(view);
    let x = f32::cast_from(column) + 0.5f32;
    let y = f32::cast_from(row) + 0.5f32;
    let unit = UNIT_POS as usize;
    let plane = (view.width * view.height) as usize;
    let pixel = (row * view.width + column) as usize;
    let inside = column < view.width && row < view.height;

    let mut staged = Shared::<[f32]>::new_slice(256usize * STAGED);
    let mut upper = Array::<f32>::new(layers);
    let mut own = Array::<f32>::new(layers * CHANNELS);
    #[unroll]
    for k in 0..layers {
        upper[k] = -view.infinity;
        if inside {
            upper[k] = limits[k * plane + pixel];
        }
        #[unroll]
        for channel in 0..CHANNELS {
            own[k * CHANNELS + channel] = 0.0f32;
        }
    }

    let rounds = length.div_ceil(256u32);
    for round in 0..rounds {
        let at = round * 256u32 + UNIT_POS;
        sync_cube();
        if at < length {
            let id = entry(ids, start, at, listed) as usize;
            #[unroll]
            for number in 0..SPLAT {
                staged[unit * STAGED + number] = splats[id * SPLAT + number];
            }
            #[unroll]
            for channel in 0..3usize {
                staged[unit * STAGED + SPLAT + channel] = colours[id * 3 + channel];
            }
        }
        sync_cube();
        let batch = min(256u32, length - round * 256u32);
        for j in 0..batch {
            let o = j as usize * STAGED;
            let (depth, visible) = (staged[o + 6], staged[o + 6] > view.near);
            if visible && depth < upper[layers - 1] {
                let weight = weight(&staged, o, x - staged[o], y - staged[o + 1]);
                if weight > 0.0f32 {
                    #[unroll]
                    for k in 0..layers {
                        let mut lower = -view.infinity;
                        if comptime!(k > 0) {
                            lower = upper[k - 1];
                        }
                        if depth >= lower && depth < upper[k] {
                            own[k * CHANNELS] += weight * staged[o + SPLAT];
                            own[k * CHANNELS + 1] += weight * staged[o + SPLAT + 1];
                            own[k * CHANNELS + 2] += weight * staged[o + SPLAT + 2];
                            own[k * CHANNELS + 3] += weight;
                        }
                    }
                }
            }
        }
    }
    if inside {
        #[unroll]
        for number in 0..layers * CHANNELS {
            sums[number * plane + pixel] = own[number];
        }
    }
}

/// Moments and colour sums of every Gaussian over its pixels.
#[cube(launch)]
fn gather_kernel(
    splats: &[f32],
    rects: &[u32],
    colours: &[f32],
    limits: &[f32],
    grad: &[f32],
    moments: &mut [f32],
    grad_colours: &mut [f32],
    view: View,
    count: u32,
    #[comptime] layers: usize,
) {
    if CUBE_POS * 8 >= count as usize {
        terminate!();
    }
    let mut partial = Shared::<[f32]>::new_slice(256usize * 9);
    let mut own = Array::<f32>::new(9usize);
    #[unroll]
    for s in 0..9usize {
        own[s] = 0.0f32;
    }
    let i = CUBE_POS * 8 + (UNIT_POS / 32u32) as usize;
    if i < count as usize {
        let (x0, x1) = (rects[4 * i], rects[4 * i + 1]);
        let (y0, y1) = (rects[4 * i + 2], rects[4 * i + 3]);
        let colour = row3(colours, i);
        let o = i * SPLAT;
        let depth = splats[o + 6];
        let plane = (view.width * view.height) as usize;
        let width = x1 - x0;
        let area = width * (y1 - y0);
        let mut p = UNIT_POS % 32u32;
        while p < area {
            let (column, row) = (x0 + p % width, y0 + p / width);
            let pixel = (row * view.width + column) as usize;
            let dx = f32::cast_from(column) + 0.5f32 - splats[o];
            let dy = f32::cast_from(row) + 0.5f32 - splats[o + 1];
            let weight = weight(splats, o, dx, dy);
            if weight > 0.0f32 && depth < limits[(layers - 1) * plane + pixel] {
                let mut lower = -view.infinity;
                #[unroll]
                for k in 0..layers {
                    let upper = limits[k * plane + pixel];
                    if depth >= lower && depth < upper {
                        let at = k * CHANNELS * plane + pixel;
                        let (red, green) = (grad[at], grad[at + plane]);
                        let (blue, alpha) = (grad[at + 2 * plane], grad[at + 3 * plane]);
                        let power = weight * (alpha + colour.x * red + colour.y * green + colour.z * blue);
                        own[0] += power;
                        own[1] += power * dx;
                        own[2] += power * dy;
                        own[3] += power * dx * dx;
                        own[4] += power * dx * dy;
                        own[5] += power * dy * dy;
                        own[6] += weight * red;
                        own[7] += weight * green;
                        own[8] += weight * blue;
                    }
                    lower = upper;
                }
            }
            p += 32u32;
        }
    }
    #[unroll]
    for s in 0..9usize {
        partial[UNIT_POS as usize * 9 + s] = own[s];
    }
    sync_cube();
    if UNIT_POS < 72u32 {
        let (slot, s) = ((UNIT_POS / 9u32) as usize, (UNIT_POS % 9u32) as usize);
        let target = CUBE_POS * 8 + slot;
        if target < count as usize {
            let mut sum = 0.0f32;
            for lane in 0..32u32 {
                sum += partial[(slot * 32 + lane as usize) * 9 + s];
            }
            if s < MOMENTS {
                moments[target * MOMENTS + s] = sum;
            } else {
                grad_colours[target * 3 + s - MOMENTS] = sum;
            }
        }
    }
}

#[cube(launch)]
fn place_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: &[f32],
    grad_positions: &mut [f32],
    grad_opacities: &mut [f32],
    view: View,
    count: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    if touched(moments, i) {
        let gradient = gradient(positions, quaternions, log_scales, opacities, moments, view, i);
        write3(grad_positions, i, gradient.position);
        grad_opacities[i] = gradient.opacity;
    } else {
        write3(grad_positions, i, vec3(0.0f32, 0.0f32, 0.0f32));
        grad_opacities[i] = 0.0f32;
    }
}

#[cube(launch)]
fn shape_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: &[f32],
    grad_quaternions: &mut [f32],
    grad_log_scales: &mut [f32],
    view: View,
    count: u32,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    if touched(moments, i) {
        let gradient = gradient(positions, quaternions, log_scales, opacities, moments, view, i);
        write4(grad_quaternions, i, gradient.quaternion);
        write3(grad_log_scales, i, gradient.log_scales);
    } else {
        write4(grad_quaternions, i, Quaternion { w: 0.0f32, x: 0.0f32, y: 0.0f32, z: 0.0f32 });
        write3(grad_log_scales, i, vec3(0.0f32, 0.0f32, 0.0f32));
    }
}

/// Gradients of one Gaussian that was touched. Two kernels write them, since one would need more
/// buffers than every device has.
#[cube]
fn gradient(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: &[f32],
    view: View,
    i: usize,
) -> SplatGradient {
    let quaternion = row4(quaternions, i);
    let projection = project(view, row3(positions, i), quaternion, row3(log_scales, i));
    splat_backward(view, projection, quaternion, opacities[i], moments, i)
}

/// Whether anything reached a Gaussian; what is not visible has no projection to go back through.
#[cube]
fn touched(moments: &[f32], i: usize) -> bool {
    let mut any = false;
    #[unroll]
    for s in 0..MOMENTS {
        any = any || moments[i * MOMENTS + s] != 0.0f32;
    }
    any
}

/// Largest contribution of every Gaussian to a pixel.
#[cube(launch)]
fn contributions_kernel(
    splats: &[f32],
    rects: &[u32],
    colours: &[f32],
    limits: &[f32],
    gates: &[f32],
    largest: &mut [f32],
    view: View,
    count: u32,
    #[comptime] layers: usize,
) {
    if CUBE_POS * 8 >= count as usize {
        terminate!();
    }
    let mut partial = Shared::<[f32]>::new_slice(256usize);
    let mut own = 0.0f32;
    let i = CUBE_POS * 8 + (UNIT_POS / 32u32) as usize;
    if i < count as usize {
        let (x0, x1) = (rects[4 * i], rects[4 * i + 1]);
        let (y0, y1) = (rects[4 * i + 2], rects[4 * i + 3]);
        let o = i * SPLAT;
        let depth = splats[o + 6];
        let plane = (view.width * view.height) as usize;
        let width = x1 - x0;
        let area = width * (y1 - y0);
        let mut p = UNIT_POS % 32u32;
        while p < area {
            let (column, row) = (x0 + p % width, y0 + p / width);
            let pixel = (row * view.width + column) as usize;
            let dx = f32::cast_from(column) + 0.5f32 - splats[o];
            let dy = f32::cast_from(row) + 0.5f32 - splats[o + 1];
            let weight = weight(splats, o, dx, dy);
            let mut lower = -view.infinity;
            #[unroll]
            for k in 0..layers {
                let upper = limits[k * plane + pixel];
                if depth >= lower && depth < upper {
                    own = max(own, weight * gates[k * plane + pixel]);
                }
                lower = upper;
            }
            p += 32u32;
        }
    }
    partial[UNIT_POS as usize] = own;
    sync_cube();
    let lane = UNIT_POS % 32u32;
    if lane == 0u32 && i < count as usize {
        let mut most = 0.0f32;
        for lane in 0..32u32 {
            most = max(most, partial[(UNIT_POS + lane) as usize]);
        }
        let colour = row3(colours, i);
        let brightest = max(f32::abs(colour.x), max(f32::abs(colour.y), f32::abs(colour.z)));
        largest[i] = most * brightest;
    }
}

/// Splats [M, [`SPLAT`]] and pixel rectangles [M, 4].
fn projected(gaussians: &GaussianTensors<CubeBackend>, camera: &Camera) -> (CubeTensor, CubeTensor) {
    let like = &gaussians.positions;
    let count = like.shape()[0];
    let (splats, rects) = (empty_f32(like, [count, SPLAT]), empty_u32(like, [count, 4]));
    project_kernel::launch(
        &like.client.clone(),
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(&splats),
        buffer(&rects),
        View::launch(camera),
        count as u32,
    );
    (splats, rects)
}

/// Gradients with respect to positions, quaternions, log-scales and opacities, into `out`, from the
/// `moments` [M, [`MOMENTS`]].
pub(in crate::ops) fn footprint_backward(
    gaussians: &GaussianTensors<CubeBackend>,
    moments: &CubeTensor,
    camera: &Camera,
    out: &GaussianTensors<CubeBackend>,
) {
    let (client, count) = (moments.client.clone(), moments.shape()[0]);
    place_backward_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(moments),
        buffer(&out.positions),
        buffer(&out.opacities),
        View::launch(camera),
        count as u32,
    );
    shape_backward_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(moments),
        buffer(&out.quaternions),
        buffer(&out.log_scales),
        View::launch(camera),
        count as u32,
    );
}

impl SplatOps for CubeBackend {
    fn splat(gaussians: GaussianTensors<Self>, limits: FloatTensor<Self>, camera: Camera) -> FloatTensor<Self> {
        let (gaussians, limits) = (gaussians.contiguous(), floats(limits));
        let (client, layers, count) = (limits.client.clone(), limits.shape()[0], gaussians.opacities.shape()[0]);
        let tiles = TileGrid::new(camera.width, camera.height).len();
        let (splats, rects) = projected(&gaussians, &camera);
        let ends = empty_f32(&limits, [tiles]);
        ends_kernel::launch(
            &client,
            cubes(tiles),
            cube_dim(),
            buffer(&limits),
            buffer(&ends),
            View::launch(&camera),
            layers,
        );
        let ellipses = Ellipses { splats: &splats, ends: &ends };
        let mut lists = bin(&rects, Some(ellipses), &camera, ListKind::Gaussians);
        if is_deterministic() {
            lists = lists.ranked(tiles);
        }
        let sums = empty_f32(&limits, [layers, CHANNELS, camera.height, camera.width]);
        splat_kernel::launch(
            &client,
            cubes(tiles),
            cube_dim(),
            buffer(&splats),
            buffer(&gaussians.colours),
            buffer(&limits),
            buffer(&lists.offsets),
            buffer(&lists.ids),
            buffer(&sums),
            View::launch(&camera),
            lists.capacity,
            count as u32,
            layers,
        );
        sums
    }

    fn splat_contributions(
        gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        gates: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self> {
        let (gaussians, limits, gates) = (gaussians.contiguous(), floats(limits), floats(gates));
        let (layers, count) = (limits.shape()[0], gaussians.opacities.shape()[0]);
        let (splats, rects) = projected(&gaussians, &camera);
        let largest = empty_f32(&limits, [count]);
        contributions_kernel::launch(
            &limits.client.clone(),
            gatherers(count),
            cube_dim(),
            buffer(&splats),
            buffer(&rects),
            buffer(&gaussians.colours),
            buffer(&limits),
            buffer(&gates),
            buffer(&largest),
            View::launch(&camera),
            count as u32,
            layers,
        );
        largest
    }
}

impl SplatBackwardOps for CubeBackend {
    fn splat_backward(
        gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        camera: Camera,
    ) -> GaussianTensors<Self> {
        let (gaussians, limits, grad) = (gaussians.contiguous(), floats(limits), floats(grad));
        let (client, layers, count) = (limits.client.clone(), limits.shape()[0], gaussians.opacities.shape()[0]);
        let (splats, rects) = projected(&gaussians, &camera);
        let moments = empty_f32(&limits, [count, MOMENTS]);
        let out = GaussianTensors {
            positions: empty_f32(&limits, [count, 3]),
            quaternions: empty_f32(&limits, [count, 4]),
            log_scales: empty_f32(&limits, [count, 3]),
            opacities: empty_f32(&limits, [count]),
            colours: empty_f32(&limits, [count, 3]),
        };
        gather_kernel::launch(
            &client,
            gatherers(count),
            cube_dim(),
            buffer(&splats),
            buffer(&rects),
            buffer(&gaussians.colours),
            buffer(&limits),
            buffer(&grad),
            buffer(&moments),
            buffer(&out.colours),
            View::launch(&camera),
            count as u32,
            layers,
        );
        footprint_backward(&gaussians, &moments, &camera, &out);
        out
    }
}

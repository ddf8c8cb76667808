//! GPU kernels. Forward, one cube handles one tile. Backward and contributions gather over the pixels
//! of each Gaussian.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::{SplatBackwardOps, SplatOps, SplatOptions};
use crate::binning::capacity::ListKind;
use crate::binning::cube::{Ellipses, TileList, bin};
use crate::camera::Camera;
use crate::footprint::gaussians::GaussianTensors;
use crate::footprint::moments::MOMENTS;
use crate::footprint::splat_cube::{self, SPLAT, Splat, add_moments};
use crate::gpu::gather::{lane, largest, primitive, total, zeros};
use crate::gpu::launch::{GATHERED, HALVINGS, LANES, UNITS, buffer, cube_dim, cubes, empty_f32, floats, gatherers};
use crate::gpu::record::Record;
use crate::gpu::rect::Rect;
use crate::gpu::tile::{own_pixel, plane_of};
use crate::gpu::vector::{Vec3, row3};
use crate::gpu::view::CameraUniforms;
use crate::scene::ScreenFilter;
use crate::tiles::TileGrid;

const CHANNELS: usize = 4;
/// Red, green and blue.
const COLOUR: usize = 3;
/// A splat and its colour.
const STAGED: usize = SPLAT + COLOUR;
/// What is gathered for a Gaussian: moments and the gradient of its colour.
const SUMS: usize = MOMENTS + COLOUR;

/// Depth at and behind which no pixel of a tile sees a Gaussian: the largest of its last limits.
#[cube(launch)]
fn ends_kernel(limits: &[f32], ends: &mut [f32], view: CameraUniforms, #[comptime] layers: usize) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let pixel = own_pixel(view, CUBE_POS as u32);
    let unit = UNIT_POS as usize;
    let mut furthest = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    let mut own = -view.infinity;
    if pixel.inside {
        own = limits[(layers - 1) * plane_of(view) + pixel.at];
    }
    furthest[unit] = own;
    #[unroll]
    for halving in 0..HALVINGS {
        let step = comptime!((UNITS >> (halving + 1)) as usize);
        sync_cube();
        if unit < step {
            furthest[unit] = max(furthest[unit], furthest[unit + step]);
        }
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
    view: CameraUniforms,
    capacity: u32,
    count: u32,
    #[comptime] layers: usize,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let list = TileList::own(offsets, capacity, count);
    let pixel = own_pixel(view, CUBE_POS as u32);
    let plane = plane_of(view);

    let mut staged = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * STAGED));
    let mut upper = Array::<f32>::new(layers);
    let mut own = zeros(comptime!(layers * CHANNELS));
    #[unroll]
    for k in 0..layers {
        upper[k] = -view.infinity;
        if pixel.inside {
            upper[k] = limits[k * plane + pixel.at];
        }
    }

    let batches = list.batches();
    for batch in 0..batches {
        let entries = list.stage(ids, batch, splats, colours, &mut staged, (SPLAT, COLOUR));
        for j in 0..entries {
            let o = j as usize * STAGED;
            let splat = Splat::load(&staged, o);
            if splat.depth > view.near && splat.depth < upper[layers - 1] {
                let dy = pixel.y - splat.mean_y;
                let weight = splat.weight(splat.u(pixel.x - splat.mean_x, dy), splat.r * dy);
                if weight > 0.0f32 {
                    let colour = Vec3::load(&staged, o + SPLAT);
                    #[unroll]
                    for k in 0..layers {
                        let mut lower = -view.infinity;
                        if comptime!(k > 0) {
                            lower = upper[k - 1];
                        }
                        if splat.depth >= lower && splat.depth < upper[k] {
                            own[k * CHANNELS] += weight * colour.x;
                            own[k * CHANNELS + 1] += weight * colour.y;
                            own[k * CHANNELS + 2] += weight * colour.z;
                            own[k * CHANNELS + 3] += weight;
                        }
                    }
                }
            }
        }
    }
    if pixel.inside {
        #[unroll]
        for number in 0..layers * CHANNELS {
            sums[number * plane + pixel.at] = own[number];
        }
    }
}

/// Sums the moments and the gradient of the colour of every Gaussian over its pixels.
#[cube(launch)]
fn gather_kernel(
    splats: &[f32],
    rects: &[u32],
    colours: &[f32],
    limits: &[f32],
    grad: &[f32],
    moments: &mut [f32],
    grad_colours: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] layers: usize,
) {
    if CUBE_POS * GATHERED >= count as usize {
        terminate!();
    }
    let mut own = zeros(SUMS);
    let i = primitive();
    if i < count as usize {
        let rect = Rect::load(rects, i);
        let colour = row3(colours, i);
        let splat = Splat::load(splats, i * SPLAT);
        let plane = plane_of(view);
        let area = rect.area();
        let mut p = lane();
        while p < area {
            let (column, row) = rect.pixel(p);
            let pixel = (row * view.width + column) as usize;
            let dx = f32::cast_from(column) + 0.5f32 - splat.mean_x;
            let dy = f32::cast_from(row) + 0.5f32 - splat.mean_y;
            let (u, v) = (splat.u(dx, dy), splat.r * dy);
            let weight = splat.weight(u, v);
            if weight > 0.0f32 && splat.depth < limits[(layers - 1) * plane + pixel] {
                let mut lower = -view.infinity;
                #[unroll]
                for k in 0..layers {
                    let upper = limits[k * plane + pixel];
                    if splat.depth >= lower && splat.depth < upper {
                        let at = k * CHANNELS * plane + pixel;
                        let (red, green) = (grad[at], grad[at + plane]);
                        let (blue, alpha) = (grad[at + 2 * plane], grad[at + 3 * plane]);
                        let power = weight * (alpha + colour.x * red + colour.y * green + colour.z * blue);
                        add_moments(&mut own, power, u, v);
                        own[MOMENTS] += weight * red;
                        own[MOMENTS + 1] += weight * green;
                        own[MOMENTS + 2] += weight * blue;
                    }
                    lower = upper;
                }
            }
            p += LANES;
        }
    }
    let sum = total(&own, count, SUMS);
    if sum.present {
        if sum.number < MOMENTS {
            moments[sum.primitive * MOMENTS + sum.number] = sum.value;
        } else {
            grad_colours[sum.primitive * COLOUR + sum.number - MOMENTS] = sum.value;
        }
    }
}

/// Largest contribution of every Gaussian to a pixel.
#[cube(launch)]
fn contributions_kernel(
    splats: &[f32],
    rects: &[u32],
    colours: &[f32],
    limits: &[f32],
    gates: &[f32],
    contributions: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] layers: usize,
) {
    if CUBE_POS * GATHERED >= count as usize {
        terminate!();
    }
    let mut own = zeros(1usize);
    let i = primitive();
    if i < count as usize {
        let rect = Rect::load(rects, i);
        let splat = Splat::load(splats, i * SPLAT);
        let plane = plane_of(view);
        let area = rect.area();
        let mut p = lane();
        while p < area {
            let (column, row) = rect.pixel(p);
            let pixel = (row * view.width + column) as usize;
            let dx = f32::cast_from(column) + 0.5f32 - splat.mean_x;
            let dy = f32::cast_from(row) + 0.5f32 - splat.mean_y;
            let weight = splat.weight(splat.u(dx, dy), splat.r * dy);
            let mut lower = -view.infinity;
            #[unroll]
            for k in 0..layers {
                let upper = limits[k * plane + pixel];
                if splat.depth >= lower && splat.depth < upper {
                    own[0] = max(own[0], weight * gates[k * plane + pixel]);
                }
                lower = upper;
            }
            p += LANES;
        }
    }
    let most = largest(&own, count, 1usize);
    if most.present {
        let colour = row3(colours, most.primitive);
        let brightest = max(f32::abs(colour.x), max(f32::abs(colour.y), f32::abs(colour.z)));
        contributions[most.primitive] = most.value * brightest;
    }
}

impl SplatOps for CubeBackend {
    fn splat(
        gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        camera: Camera,
        options: SplatOptions,
    ) -> FloatTensor<Self> {
        let (gaussians, limits) = (gaussians.contiguous(), floats(limits));
        let (client, layers, count) = (limits.client.clone(), limits.shape()[0], gaussians.opacities.shape()[0]);
        let tiles = TileGrid::new(camera.width, camera.height).len();
        let (splats, rects) = splat_cube::splats(&gaussians, None, &camera, ScreenFilter::Compensated);
        let ends = empty_f32(&limits, [tiles]);
        ends_kernel::launch(
            &client,
            cubes(tiles),
            cube_dim(),
            buffer(&limits),
            buffer(&ends),
            CameraUniforms::launch(&camera),
            layers,
        );
        let ellipses = Ellipses { splats: &splats, ends: &ends };
        let mut lists = bin(&rects, Some(ellipses), &camera, ListKind::Gaussians);
        if options.deterministic {
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
            CameraUniforms::launch(&camera),
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
        let (splats, rects) = splat_cube::splats(&gaussians, None, &camera, ScreenFilter::Compensated);
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
            CameraUniforms::launch(&camera),
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
        let (splats, rects) = splat_cube::splats(&gaussians, None, &camera, ScreenFilter::Compensated);
        let moments = empty_f32(&limits, [count, MOMENTS]);
        let out = GaussianTensors::empty(&limits, count);
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
            CameraUniforms::launch(&camera),
            count as u32,
            layers,
        );
        splat_cube::backward(&gaussians, &moments, &camera, ScreenFilter::Compensated, &out);
        out
    }
}

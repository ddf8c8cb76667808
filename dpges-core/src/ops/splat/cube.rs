//! GPU kernels. Forward, one cube handles one tile. Backward and contributions gather over pieces of the pixels
//! of each Gaussian.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::autodiff::SplatState;
use super::{SplatInput, SplatOps, with_probe};
use crate::backend::kept::Kept;
use crate::backend::tape::BackwardState;
use crate::camera::Camera;
use crate::footprint::gaussian::cube as splat_cube;
use crate::footprint::gaussian::cube::regions::{WORDS, list_regions, mark_regions};
use crate::footprint::gaussian::cube::{Moments, SPLAT, Splat, add_moments};
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::footprint::moments::MOMENTS;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{LANES, UNITS, buffer, cube_dim, cubes, empty_f32, floats, units};
use crate::gpu::record::Record;
use crate::gpu::reduce::max_units;
use crate::gpu::tile::{REGIONS, own_pixel, plane_of};
use crate::gpu::vector::{Vec3, row3};
use crate::gpu::view::CameraUniforms;
use crate::gpu::work_split::{
    Piece, WORKERS, collectors, cube_has_pieces, cube_has_rectangles, own_number, split_work, store_gathered, worker,
};
use crate::scene::ScreenFilter;
use crate::tiles::TileGrid;
use crate::tiles::binning::capacity::ListKind;
use crate::tiles::binning::cube::{Ellipses, TileList, bin};

const CHANNELS: usize = 4;
/// Red, green and blue.
const COLOUR: usize = 3;
/// A splat and its colour.
const STAGED: usize = SPLAT + COLOUR;
/// Sums gathered for a Gaussian: moments and the gradient of its colour.
const SUMS: usize = MOMENTS + COLOUR;

/// Depth at and behind which no pixel of a tile sees a Gaussian: the largest of its last limits.
#[cube(launch)]
fn ends_kernel(limits: &[f32], ends: &mut [f32], view: CameraUniforms, #[comptime] layers: usize) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let pixel = own_pixel(view, CUBE_POS as u32);
    // no depth is before −∞: pixels outside the image hide nothing and show nothing
    let mut own = -view.infinity;
    if pixel.inside {
        own = limits[(layers - 1) * plane_of(view) + pixel.at];
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    max_units(own, &mut memory);
    if UNIT_POS == 0u32 {
        ends[CUBE_POS] = memory[0];
    }
}

/// One cube handles a tile. It finds out which regions of the tile an entry of the list can add to, and the units of a
/// region visit those entries only.
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
    let unit = UNIT_POS as usize;
    let region = unit / LANES as usize;

    // this and what follows takes 13 of the 16 KiB of workgroup memory that WebGPU guarantees
    let mut staged = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * STAGED));
    let mut masks = Shared::<[u32]>::new_slice(comptime!(UNITS as usize));
    let mut visits = Shared::<[u32]>::new_slice(comptime!(REGIONS * WORDS));
    let mut last = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    let mut ends = Shared::<[f32]>::new_slice(REGIONS);
    // limits and sums are only indexed by constants, so that they stay in registers
    let mut upper = Array::<f32>::new(layers);
    let mut slope = 1.0f32.runtime();
    if pixel.inside {
        slope = limits[layers * plane + pixel.at];
    }
    let mut own = zeros(comptime!(layers * CHANNELS));
    #[unroll]
    for k in 0..layers {
        upper[k] = -view.infinity;
        if pixel.inside {
            upper[k] = limits[k * plane + pixel.at];
        }
    }
    last[unit] = upper[layers - 1];
    sync_cube();
    if unit < REGIONS {
        // a unit for each region, in the order of its pixels
        let mut furthest = -view.infinity;
        for lane in 0..LANES {
            furthest = max(furthest, last[unit * LANES as usize + lane as usize]);
        }
        ends[unit] = furthest;
    }

    let batches = list.batches();
    for batch in 0..batches {
        let entries = list.stage(ids, batch, splats, colours, &mut staged, (SPLAT, COLOUR));
        mark_regions(&staged, entries, &ends, &mut masks, CUBE_POS as u32, view, STAGED);
        list_regions(&masks, &mut visits);
        for word in 0..WORDS {
            let mut bits = visits[region * WORDS + word];
            while bits != 0u32 {
                let o = (word * 32usize + bits.trailing_zeros() as usize) * STAGED;
                bits &= bits - 1u32;
                let splat = Splat::load(&staged, o);
                let dy = pixel.y - splat.mean_y;
                let weight = splat.weight(splat.u(pixel.x - splat.mean_x, dy), splat.r * dy);
                // `<` since at the limit itself the share before it is 0
                if weight > 0.0f32 && splat.depth < upper[layers - 1] {
                    let colour = Vec3::load(&staged, o + SPLAT);
                    let mut nearer = 0.0f32;
                    #[unroll]
                    for k in 0..layers {
                        // most Gaussians are in one interval: the others are not added to
                        if nearer < 1.0f32 {
                            let before = share_before(upper[k], slope, splat.depth);
                            let share = weight * (before - nearer);
                            own[k * CHANNELS] += share * colour.x;
                            own[k * CHANNELS + 1] += share * colour.y;
                            own[k * CHANNELS + 2] += share * colour.z;
                            own[k * CHANNELS + 3] += share;
                            nearer = before;
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

/// Share of a Gaussian at `depth` that is before a layer.
#[cube]
fn share_before(limit: f32, slope: f32, depth: f32) -> f32 {
    clamp((limit - depth) * slope, 0.0f32, 1.0f32)
}

/// Sums the moments and the gradient of the colour of every Gaussian over the pixels of each piece.
#[cube(launch)]
fn gather_kernel(
    splats: &[f32],
    colours: &[f32],
    pieces: &[u32],
    limits: &[f32],
    grad: &[f32],
    sums: &mut [f32],
    view: CameraUniforms,
    most: u32,
    #[comptime] layers: usize,
) {
    if !cube_has_pieces(pieces, most) {
        terminate!();
    }
    let mut own = zeros(SUMS);
    let piece = Piece::own(pieces);
    let mut p = piece.first();
    if p < piece.end {
        let i = piece.primitive as usize;
        let colour = row3(colours, i);
        let splat = Splat::load(splats, i * SPLAT);
        let plane = plane_of(view);
        let stride = piece.stride();
        let (first_column, first_row) = piece.pixel(p);
        let mut column = first_column;
        let mut row = first_row;
        while p < piece.end {
            let pixel = (row * view.width + column) as usize;
            let dx = f32::cast_from(column) + 0.5f32 - splat.mean_x;
            let dy = f32::cast_from(row) + 0.5f32 - splat.mean_y;
            let (u, v) = (splat.u(dx, dy), splat.r * dy);
            let weight = splat.weight(u, v);
            // most pixels of a rectangle end here: nothing of their gradients is loaded
            if weight > 0.0f32 && splat.depth < limits[(layers - 1) * plane + pixel] {
                let slope = limits[layers * plane + pixel];
                let mut red = 0.0f32;
                let mut green = 0.0f32;
                let mut blue = 0.0f32;
                let mut alpha = 0.0f32;
                let mut nearer = 0.0f32;
                #[unroll]
                for k in 0..layers {
                    if nearer < 1.0f32 {
                        let at = k * CHANNELS * plane + pixel;
                        let before = share_before(limits[k * plane + pixel], slope, splat.depth);
                        let share = before - nearer;
                        red += share * grad[at];
                        green += share * grad[at + plane];
                        blue += share * grad[at + 2 * plane];
                        alpha += share * grad[at + 3 * plane];
                        nearer = before;
                    }
                }
                // the weight multiplies (c, 1) in the four sums; times itself its gradient is that of the exponent
                let power = weight * (alpha + colour.x * red + colour.y * green + colour.z * blue);
                add_moments(&mut own, power, u, v);
                own[MOMENTS] += weight * red;
                own[MOMENTS + 1] += weight * green;
                own[MOMENTS + 2] += weight * blue;
            }
            let (next_column, next_row) = piece.next(stride, column, row);
            column = next_column;
            row = next_row;
            p += WORKERS;
        }
    }
    store_gathered(&own, sums, most, SUMS, true);
}

/// Gradient of every Gaussian with respect to its projected centre, in units of half the image.
#[cube(launch)]
fn probe_kernel(splats: &[f32], moments: &[f32], probe: &mut [f32], view: CameraUniforms, count: u32) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let splat = Splat::load(splats, i * SPLAT);
    let sums = Moments::load(moments, i * MOMENTS);
    // an invisible one has no p, q and r
    let mut x = 0.0f32;
    let mut y = 0.0f32;
    if splat.strength > 0.0f32 {
        x = splat.p * sums.u * 0.5f32 * f32::cast_from(view.width);
        y = (splat.q * sums.u + splat.r * sums.v) * 0.5f32 * f32::cast_from(view.height);
    }
    probe[2 * i] = x;
    probe[2 * i + 1] = y;
}

/// Largest weight times gate of every Gaussian over the pixels of each piece.
#[cube(launch)]
fn contributions_kernel(
    splats: &[f32],
    pieces: &[u32],
    limits: &[f32],
    gates: &[f32],
    largest_of_pieces: &mut [f32],
    view: CameraUniforms,
    most: u32,
    #[comptime] layers: usize,
) {
    if !cube_has_pieces(pieces, most) {
        terminate!();
    }
    let mut own = zeros(1usize);
    let piece = Piece::own(pieces);
    let mut p = piece.first();
    if p < piece.end {
        let splat = Splat::load(splats, piece.primitive as usize * SPLAT);
        let plane = plane_of(view);
        let stride = piece.stride();
        let (first_column, first_row) = piece.pixel(p);
        let mut column = first_column;
        let mut row = first_row;
        while p < piece.end {
            let pixel = (row * view.width + column) as usize;
            let dx = f32::cast_from(column) + 0.5f32 - splat.mean_x;
            let dy = f32::cast_from(row) + 0.5f32 - splat.mean_y;
            let weight = splat.weight(splat.u(dx, dy), splat.r * dy);
            if weight > 0.0f32 {
                let slope = limits[layers * plane + pixel];
                let mut nearer = 0.0f32;
                #[unroll]
                for k in 0..layers {
                    let before = share_before(limits[k * plane + pixel], slope, splat.depth);
                    own[0] = max(own[0], weight * gates[k * plane + pixel] * (before - nearer));
                    nearer = before;
                }
            }
            let (next_column, next_row) = piece.next(stride, column, row);
            column = next_column;
            row = next_row;
            p += WORKERS;
        }
    }
    store_gathered(&own, largest_of_pieces, most, 1usize, false);
}

/// Largest contribution of every Gaussian to a pixel.
#[cube(launch)]
fn brightest_kernel(largest_of_pieces: &[f32], starts: &[u32], colours: &[f32], contributions: &mut [f32], count: u32) {
    if !cube_has_rectangles(count) {
        terminate!();
    }
    let mut own = zeros(1usize);
    let i = own_number();
    if i < count as usize {
        let end = starts[i + 1];
        let mut piece = starts[i] + worker();
        while piece < end {
            own[0] = max(own[0], largest_of_pieces[piece as usize]);
            piece += WORKERS;
        }
        let colour = row3(colours, i);
        let brightest = max(f32::abs(colour.x), max(f32::abs(colour.y), f32::abs(colour.z)));
        // the colour is that of all pixels: one product after the maximum
        own[0] *= brightest;
    }
    store_gathered(&own, contributions, count, 1usize, false);
}

impl SplatOps for CubeBackend {
    fn splat(input: SplatInput<Self>, camera: Camera, filter: ScreenFilter, _: Kept) -> FloatTensor<Self> {
        let (gaussians, limits) = (input.gaussians.contiguous(), floats(input.limits));
        let (client, layers, count) = (limits.client.clone(), limits.shape()[0] - 1, gaussians.opacities.shape()[0]);
        let tiles = TileGrid::new(camera.width, camera.height).len();
        let (splats, rects) = splat_cube::splats(&gaussians, None, &camera, filter);
        // with these the lists leave out what every pixel of a tile hides
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
        let lists = bin(&rects, Some(ellipses), &camera, ListKind::Gaussians);
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
        let (layers, count) = (limits.shape()[0] - 1, gaussians.opacities.shape()[0]);
        let (splats, rects) = splat_cube::splats(&gaussians, None, &camera, ScreenFilter::Compensated);
        let pieces = split_work(&rects);
        let of_pieces = empty_f32(&limits, [pieces.most]);
        contributions_kernel::launch(
            &limits.client.clone(),
            pieces.gatherers(),
            cube_dim(),
            buffer(&splats),
            buffer(&pieces.pieces),
            buffer(&limits),
            buffer(&gates),
            buffer(&of_pieces),
            CameraUniforms::launch(&camera),
            pieces.most as u32,
            layers,
        );
        let largest = empty_f32(&limits, [count]);
        brightest_kernel::launch(
            &limits.client.clone(),
            collectors(count),
            cube_dim(),
            buffer(&of_pieces),
            buffer(&pieces.starts),
            buffer(&gaussians.colours),
            buffer(&largest),
            count as u32,
        );
        largest
    }
}

impl BackwardState<CubeBackend, 6> for SplatState<CubeBackend> {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 6] {
        let Self { input: SplatInput { gaussians, probe, limits }, camera, filter, .. } = self;
        let probed = probe.shape()[0] > 0;
        let (gaussians, limits, grad) = (gaussians.contiguous(), floats(limits), floats(grad));
        let (client, layers, count) = (limits.client.clone(), limits.shape()[0] - 1, gaussians.opacities.shape()[0]);
        let (splats, rects) = splat_cube::splats(&gaussians, None, &camera, filter);
        let pieces = split_work(&rects);
        let sums = empty_f32(&limits, [pieces.most, SUMS]);
        gather_kernel::launch(
            &client,
            pieces.gatherers(),
            cube_dim(),
            buffer(&splats),
            buffer(&gaussians.colours),
            buffer(&pieces.pieces),
            buffer(&limits),
            buffer(&grad),
            buffer(&sums),
            CameraUniforms::launch(&camera),
            pieces.most as u32,
            layers,
        );
        // pieces are added in their order, without atomics: the same bits in every run
        let moments = pieces.collect(&sums, 0, MOMENTS);
        let mut out = GaussianTensors::empty(&limits, count);
        out.colours = pieces.collect(&sums, MOMENTS, COLOUR);
        splat_cube::backward(&gaussians, &moments, &camera, filter, &out);
        let probe = probed.then(|| empty_f32(&limits, [count, 2]));
        if let Some(probe) = &probe {
            probe_kernel::launch(
                &client,
                units(count),
                cube_dim(),
                buffer(&splats),
                buffer(&moments),
                buffer(probe),
                CameraUniforms::launch(&camera),
                count as u32,
            );
        }
        with_probe(out.into_array().map(Some), probe)
    }
}

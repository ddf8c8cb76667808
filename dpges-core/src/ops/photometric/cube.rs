//! GPU kernels: one cube per tile, separable windows in workgroup memory.

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::autodiff::PhotometricState;
use super::{PhotometricInput, PhotometricOps, PhotometricOutput, PhotometricWeights};
use super::{RADIUS, taps};
use crate::backend::tape::BackwardState;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty_f32, floats};
use crate::gpu::mask::counts;
use crate::gpu::reduce::{sum_parts, sum_units};
use crate::gpu::tile::TILE;
use crate::gpu::vector::sign;
use crate::tiles;

/// Reach of the window on either side, px.
const REACH: u32 = RADIUS as u32;
/// Weights along one axis of the window.
const TAPS: u32 = 2 * REACH + 1;
/// Edge of a tile padded by the reach of the window, px.
const PADDED: u32 = TILE + 2 * REACH;
/// Pixels of a padded tile.
const PADDED_PIXELS: usize = (PADDED * PADDED) as usize;
/// Pixels of a tile padded in y only.
const ROWS: usize = (PADDED * TILE) as usize;
/// Windowed means: of a, b, a² + b² and a·b.
const MEANS: usize = 4;
/// Partial derivatives of SSIM: [`PhotometricOutput::partials`].
const PARTIALS: usize = 3;
/// Sums of a cube: absolute differences, SSIM, squared errors.
const SUMS: usize = 3;
/// Neighbours along a row that a unit finds the windows of together.
const ACROSS: u32 = 2;
/// Neighbours along a column that a unit finds the windows of one quantity of together.
const DOWN: u32 = 4;
const _: () = assert!(SUMS * UNITS as usize <= ROWS * MEANS, "the sums take the place of the rows");
const _: () = assert!(PADDED * TILE / ACROSS <= UNITS, "each unit has one place of a row");
const _: () = assert!(TILE * TILE / DOWN * MEANS as u32 <= UNITS, "each unit has one place of a column of a quantity");
const C1: f32 = super::C1 as f32;
const C2: f32 = super::C2 as f32;

/// Weights of the window by distance from its centre, and the tiles of the images.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Window {
    w0: f32,
    w1: f32,
    w2: f32,
    w3: f32,
    w4: f32,
    w5: f32,
    width: u32,
    height: u32,
    columns: u32,
    tiles: u32,
    /// Cubes that have work: tiles × channels.
    cubes: u32,
}

#[cube]
fn tap(window: Window, #[comptime] t: u32) -> f32 {
    match comptime!(t.abs_diff(REACH)) {
        0 => window.w0,
        1 => window.w1,
        2 => window.w2,
        3 => window.w3,
        4 => window.w4,
        _ => window.w5,
    }
}

/// Offset of a pixel of this cube's padded tile in its channel, and whether it is in the image.
#[cube]
fn padded_pixel(window: Window, index: u32) -> (usize, bool) {
    let tile = CUBE_POS as u32 % window.tiles;
    // column 0 and row 0 are the first of the padding
    let column = tile % window.columns * TILE + index % PADDED;
    let row = tile / window.columns * TILE + index / PADDED;
    let inside = column >= REACH && row >= REACH && column < window.width + REACH && row < window.height + REACH;
    let at = select(inside, (row - REACH) * window.width + column - REACH, 0u32);
    (at as usize, inside)
}

/// Adds `value`, `at` pixels from the first that the windows of `neighbours` reach, to the sums of those that reach it.
#[cube]
fn add_to_windows(
    sums: &mut Array<f32>,
    value: f32,
    window: Window,
    #[comptime] at: u32,
    #[comptime] quantity: u32,
    #[comptime] neighbours: u32,
) {
    // a value is read once for all windows of a unit that reach it
    #[unroll]
    for neighbour in 0..neighbours {
        if comptime!(neighbour <= at && at - neighbour < TAPS) {
            sums[comptime!((quantity * neighbours + neighbour) as usize)] +=
                tap(window, comptime!(at - neighbour)) * value;
        }
    }
}

/// Where this unit finds windows along rows: the first pixel that they reach, in a padded tile, and its place in the rows.
#[cube]
fn place_across() -> (u32, u32, bool) {
    let places = comptime!(TILE / ACROSS);
    let (line, column) = (UNIT_POS / places, UNIT_POS % places * ACROSS);
    (line * PADDED + column, line * TILE + column, line < PADDED)
}

/// Writes the sums that a unit found along rows to `rows`, [quantities, [`PADDED`], [`TILE`]].
#[cube]
fn store_across(sums: &Array<f32>, rows: &mut [f32], place: u32, #[comptime] quantities: usize) {
    #[unroll]
    for number in 0..quantities {
        #[unroll]
        for neighbour in 0..ACROSS {
            rows[number * ROWS + (place + neighbour) as usize] = sums[number * ACROSS as usize + neighbour as usize];
        }
    }
}

/// Replaces `rows`, [quantities, [`PADDED`], [`TILE`]], by their windows along y, [quantities, [`UNITS`]]. All units of the
/// cube must call this together.
#[cube]
fn window_columns(rows: &mut [f32], window: Window, #[comptime] quantities: usize) {
    let places = comptime!(TILE * TILE / DOWN);
    let quantity = (UNIT_POS / places) as usize;
    let (column, row) = (UNIT_POS % TILE, UNIT_POS % places / TILE * DOWN);
    // the rows are read into registers before what takes their place is written
    let mut sums = zeros(comptime!(DOWN as usize));
    sync_cube();
    if quantity < quantities {
        #[unroll]
        for t in 0..TAPS + DOWN - 1 {
            let value = rows[quantity * ROWS + ((row + t) * TILE + column) as usize];
            add_to_windows(&mut sums, value, window, t, 0u32, DOWN);
        }
    }
    sync_cube();
    if quantity < quantities {
        #[unroll]
        for neighbour in 0..DOWN {
            rows[quantity * UNITS as usize + ((row + neighbour) * TILE + column) as usize] = sums[neighbour as usize];
        }
    }
    sync_cube();
}

/// Shares of the sums over all pixels and channels in the value and in the squared error, or those of a pixel in a gradient.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Shares {
    offset: f32,
    difference: f32,
    similarity: f32,
    error: f32,
}

#[cube(launch)]
fn compare_kernel(
    image: &[f32],
    target: &[f32],
    ignored: &[f32],
    sums: &mut [f32],
    partials: &mut [f32],
    window: Window,
    total: u32,
    #[comptime] masked: bool,
) {
    if CUBE_POS >= window.cubes as usize {
        terminate!();
    }
    let plane = (window.width * window.height) as usize;
    let channel = (CUBE_POS as u32 / window.tiles) as usize * plane;
    // two padded tiles and the rows take 12 of the 16 KiB of workgroup memory that WebGPU guarantees
    let mut a = Shared::<[f32]>::new_slice(PADDED_PIXELS);
    let mut b = Shared::<[f32]>::new_slice(PADDED_PIXELS);
    let mut rows = Shared::<[f32]>::new_slice(comptime!(ROWS * MEANS));
    let mut index = UNIT_POS;
    while index < PADDED * PADDED {
        let (at, inside) = padded_pixel(window, index);
        let shown = image[channel + at];
        // where pixels do not count both are equal, so that no window sees the border of a mask
        let wanted = select(counts(ignored, at, masked), target[channel + at], shown);
        // the window sees zeros beyond the image
        a[index as usize] = select(inside, shown, 0.0f32);
        b[index as usize] = select(inside, wanted, 0.0f32);
        index += UNITS;
    }
    sync_cube();
    let (start, place, has_place) = place_across();
    if has_place {
        let mut means = zeros(comptime!(MEANS * ACROSS as usize));
        // along x first, then along y: 22 products in place of 121
        #[unroll]
        for t in 0..TAPS + ACROSS - 1 {
            let (va, vb) = (a[(start + t) as usize], b[(start + t) as usize]);
            add_to_windows(&mut means, va, window, t, 0u32, ACROSS);
            add_to_windows(&mut means, vb, window, t, 1u32, ACROSS);
            add_to_windows(&mut means, va * va + vb * vb, window, t, 2u32, ACROSS);
            add_to_windows(&mut means, va * vb, window, t, 3u32, ACROSS);
        }
        store_across(&means, &mut rows, place, MEANS);
    }
    window_columns(&mut rows, window, MEANS);
    let tile = CUBE_POS as u32 % window.tiles;
    let (x, y) = (UNIT_POS % TILE, UNIT_POS / TILE);
    let (column, row) = (tile % window.columns * TILE + x, tile / window.columns * TILE + y);
    let mut own = zeros(SUMS);
    if column < window.width && row < window.height {
        let unit = UNIT_POS as usize;
        let (mean_a, mean_b) = (rows[unit], rows[UNITS as usize + unit]);
        let (squares, product) = (rows[2 * UNITS as usize + unit], rows[3 * UNITS as usize + unit]);
        let covariance = product - mean_a * mean_b;
        let luminance = 2.0f32 * mean_a * mean_b + C1;
        let structure = 2.0f32 * covariance + C2;
        let means = mean_a * mean_a + mean_b * mean_b + C1;
        let variances = squares - mean_a * mean_a - mean_b * mean_b + C2;
        let inverse = 1.0f32 / (means * variances);
        let value = luminance * structure * inverse;
        let by_variance = -value / variances;
        let by_covariance = 2.0f32 * luminance * inverse;
        let by_mean = 2.0f32 * mean_b * structure * inverse - 2.0f32 * mean_a * value / means;
        let pixel = (row * window.width + column) as usize;
        let at = channel + pixel;
        let share = 1.0f32 / f32::cast_from(total);
        let middle = ((y + REACH) * PADDED + x + REACH) as usize;
        let (shown, wanted) = (a[middle], b[middle]);
        // clamped, since PSNR is that of the picture as it is shown
        let error = min(max(shown, 0.0f32), 1.0f32) - wanted;
        own[0] = f32::abs(shown - wanted);
        own[1] = value;
        own[2] = select(counts(ignored, pixel, masked), error * error, 0.0f32);
        partials[at] = (by_mean - 2.0f32 * mean_a * by_variance - mean_b * by_covariance) * share;
        partials[total as usize + at] = by_variance * share;
        partials[2 * total as usize + at] = by_covariance * share;
    }
    sum_units(&own, &mut rows, SUMS);
    if UNIT_POS == 0u32 {
        #[unroll]
        for sum in 0..SUMS {
            sums[CUBE_POS * SUMS + sum] = rows[sum];
        }
    }
}

/// The value and the squared error from the sums of `cubes` cubes.
#[cube(launch)]
fn value_kernel(sums: &[f32], value: &mut [f32], squared_error: &mut [f32], shares: Shares, cubes: u32) {
    if CUBE_POS > 0usize {
        terminate!();
    }
    let mut total = Shared::<[f32]>::new_slice(comptime!(SUMS * UNITS as usize));
    // one cube, always in the same order: the same bits in every run
    sum_parts(sums, cubes, &mut total, SUMS);
    if UNIT_POS == 0u32 {
        value[0] = shares.offset + (shares.difference * total[0] + shares.similarity * total[1]);
        squared_error[0] = shares.error * total[2];
    }
}

#[cube(launch)]
fn backward_kernel(
    image: &[f32],
    target: &[f32],
    ignored: &[f32],
    partials: &[f32],
    grad: &[f32],
    grad_image: &mut [f32],
    window: Window,
    shares: Shares,
    total: u32,
    #[comptime] masked: bool,
) {
    if CUBE_POS >= window.cubes as usize {
        terminate!();
    }
    let plane = (window.width * window.height) as usize;
    let channel = (CUBE_POS as u32 / window.tiles) as usize * plane;
    // 13 of the 16 KiB of workgroup memory that WebGPU guarantees
    let mut padded = Shared::<[f32]>::new_slice(comptime!(PADDED_PIXELS * PARTIALS));
    let mut rows = Shared::<[f32]>::new_slice(comptime!(ROWS * PARTIALS));
    let mut index = UNIT_POS;
    while index < PADDED * PADDED {
        let (at, inside) = padded_pixel(window, index);
        #[unroll]
        for quantity in 0..PARTIALS {
            padded[quantity * PADDED_PIXELS + index as usize] =
                select(inside, partials[quantity * total as usize + channel + at], 0.0f32);
        }
        index += UNITS;
    }
    sync_cube();
    let (start, place, has_place) = place_across();
    if has_place {
        let mut sums = zeros(comptime!(PARTIALS * ACROSS as usize));
        #[unroll]
        for t in 0..TAPS + ACROSS - 1 {
            let o = (start + t) as usize;
            add_to_windows(&mut sums, padded[o], window, t, 0u32, ACROSS);
            add_to_windows(&mut sums, padded[PADDED_PIXELS + o], window, t, 1u32, ACROSS);
            add_to_windows(&mut sums, padded[2 * PADDED_PIXELS + o], window, t, 2u32, ACROSS);
        }
        store_across(&sums, &mut rows, place, PARTIALS);
    }
    window_columns(&mut rows, window, PARTIALS);
    let tile = CUBE_POS as u32 % window.tiles;
    let (x, y) = (UNIT_POS % TILE, UNIT_POS / TILE);
    let (column, row) = (tile % window.columns * TILE + x, tile / window.columns * TILE + y);
    if column < window.width && row < window.height {
        let pixel = (row * window.width + column) as usize;
        let at = channel + pixel;
        let (shown, wanted) = (image[at], target[at]);
        let unit = UNIT_POS as usize;
        let (by_mean, by_square) = (rows[unit], rows[UNITS as usize + unit]);
        let by_product = rows[2 * UNITS as usize + unit];
        // a window is its own transpose, so that the partial derivatives are windowed like the images
        let by_similarity = by_mean + 2.0f32 * shown * by_square + wanted * by_product;
        let gradient = shares.similarity * by_similarity + shares.difference * sign(shown - wanted);
        grad_image[at] = select(counts(ignored, pixel, masked), grad[0] * gradient, 0.0f32);
    }
}

/// Uniforms and number of cubes for images of `shape`.
fn window(shape: [usize; 3]) -> (WindowLaunch, usize) {
    let [channels, height, width] = shape;
    let taps = taps::<f32>();
    let [w0, w1, w2, w3, w4, w5]: [f32; RADIUS + 1] = std::array::from_fn(|distance| taps[RADIUS + distance]);
    let (columns, rows) = (width.div_ceil(tiles::TILE), height.div_ceil(tiles::TILE));
    let count = columns * rows * channels;
    let launch = WindowLaunch::new(
        w0,
        w1,
        w2,
        w3,
        w4,
        w5,
        width as u32,
        height as u32,
        columns as u32,
        (columns * rows) as u32,
        count as u32,
    );
    (launch, count)
}

fn contiguous(input: PhotometricInput<CubeBackend>) -> PhotometricInput<CubeBackend> {
    PhotometricInput { image: floats(input.image), target: floats(input.target), ignored: floats(input.ignored) }
}

impl PhotometricOps for CubeBackend {
    fn photometric(
        input: PhotometricInput<Self>,
        weights: PhotometricWeights,
        masked: bool,
    ) -> PhotometricOutput<Self> {
        let PhotometricInput { image, target, ignored } = contiguous(input);
        let shape: [usize; 3] = image.shape().dims();
        let [channels, height, width] = shape;
        let (client, total) = (image.client.clone(), channels * height * width);
        let (uniforms, count) = window(shape);
        let (sums, partials) = (empty_f32(&image, [count, SUMS]), empty_f32(&image, [3, channels, height, width]));
        compare_kernel::launch(
            &client,
            cubes(count),
            cube_dim(),
            buffer(&image),
            buffer(&target),
            buffer(&ignored),
            buffer(&sums),
            buffer(&partials),
            uniforms,
            total as u32,
            masked,
        );
        let [value, squared_error] = [(); 2].map(|()| empty_f32(&image, [1]));
        let mean = weights.pixels_per_counted / total as f64;
        value_kernel::launch(
            &client,
            cubes(1),
            cube_dim(),
            buffer(&sums),
            buffer(&value),
            buffer(&squared_error),
            SharesLaunch::new(
                (weights.offset * weights.pixels_per_counted) as f32,
                (weights.l1 * mean) as f32,
                (weights.ssim * mean) as f32,
                mean as f32,
            ),
            count as u32,
        );
        PhotometricOutput { value, squared_error, partials }
    }
}

impl BackwardState<CubeBackend, 1> for PhotometricState<CubeBackend> {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 1] {
        let Self { input, partials, weights, masked } = self;
        let PhotometricInput { image, target, ignored } = contiguous(input);
        let (partials, grad) = (floats(partials), floats(grad));
        let shape: [usize; 3] = image.shape().dims();
        let out = empty_f32(&image, shape);
        let (uniforms, count) = window(shape);
        let total = shape.iter().product::<usize>();
        backward_kernel::launch(
            &image.client.clone(),
            cubes(count),
            cube_dim(),
            buffer(&image),
            buffer(&target),
            buffer(&ignored),
            buffer(&partials),
            buffer(&grad),
            buffer(&out),
            uniforms,
            SharesLaunch::new(
                0.0,
                (weights.l1 * weights.pixels_per_counted / total as f64) as f32,
                (weights.ssim * weights.pixels_per_counted) as f32,
                0.0,
            ),
            total as u32,
            masked,
        );
        [Some(out)]
    }
}

//! Gathering from primitives of very different sizes: the pixels of every rectangle in pieces of about the same size,
//! each for [`WORKERS`] units. Sums of pieces are added up for each primitive afterwards, in a fixed order.
//!
//! The size of a piece grows with the area of all rectangles, so that the number of pieces has a bound that does not
//! depend on them, and the host need not wait for it.

pub(crate) mod owner;

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use self::owner::own_owner;
use super::gather::zeros;
use super::launch::{UNITS, buffer, cube_dim, cubes, empty_f32, empty_u32, units};
use super::rect::Rect;
use super::reduce::{self, sum_parts, sum_units};
use super::scan;

/// Units that gather from a piece or add up the pieces of a rectangle, and how many pieces or rectangles a cube has.
pub const WORKERS: u32 = 8;
const PIECES: usize = (UNITS / WORKERS) as usize;
/// Pixels of the smallest piece.
const SMALLEST: f32 = 256.0;
/// Pieces beyond one for each primitive and one for every two.
const SPARE: usize = 16_384;
/// Numbers of a [`Piece`] in a buffer.
const PIECE: usize = 6;

/// Consecutive pixels of the rectangle of a primitive, line by line.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Piece {
    pub primitive: u32,
    /// Columns of the rectangle, half open, and its first row.
    x0: u32,
    x1: u32,
    y0: u32,
    /// Pixels, counted from the first of the rectangle, half open.
    from: u32,
    pub end: u32,
}

/// Columns and rows from a pixel of a unit to its next.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Stride {
    columns: u32,
    rows: u32,
}

/// Number of the piece, or of the rectangle, that this unit works for.
#[cube]
pub fn own_number() -> usize {
    CUBE_POS * PIECES + (UNIT_POS / WORKERS) as usize
}

/// Position of this unit among the [`WORKERS`].
#[cube]
pub fn worker() -> u32 {
    UNIT_POS % WORKERS
}

#[cube]
impl Piece {
    fn load(pieces: &[u32], at: usize) -> Piece {
        let o = at * PIECE;
        Piece {
            primitive: pieces[o],
            x0: pieces[o + 1],
            x1: pieces[o + 2],
            y0: pieces[o + 3],
            from: pieces[o + 4],
            end: pieces[o + 5],
        }
    }

    fn store(&self, pieces: &mut [u32], at: usize) {
        let o = at * PIECE;
        pieces[o] = self.primitive;
        pieces[o + 1] = self.x0;
        pieces[o + 2] = self.x1;
        pieces[o + 3] = self.y0;
        pieces[o + 4] = self.from;
        pieces[o + 5] = self.end;
    }

    /// The piece of this unit.
    pub fn own(pieces: &[u32]) -> Piece {
        Piece::load(pieces, own_number())
    }

    /// The first pixel of this unit, counted from the first of the rectangle.
    pub fn first(&self) -> u32 {
        self.from + worker()
    }

    /// Column and row of a pixel.
    pub fn pixel(&self, at: u32) -> (u32, u32) {
        // an empty piece has no columns to divide by
        let width = max(self.x1 - self.x0, 1u32);
        (self.x0 + at % width, self.y0 + at / width)
    }

    // one division for a piece in place of two for every pixel
    pub fn stride(&self) -> Stride {
        let width = max(self.x1 - self.x0, 1u32);
        Stride { columns: WORKERS % width, rows: WORKERS / width }
    }

    /// Column and row of the pixel [`WORKERS`] after another.
    pub fn next(&self, stride: Stride, column: u32, row: u32) -> (u32, u32) {
        let ahead = column + stride.columns;
        let wraps = ahead >= self.x1;
        (select(wraps, ahead - (self.x1 - self.x0), ahead), row + stride.rows + select(wraps, 1u32, 0u32))
    }
}

/// Whether the pieces of this cube exist; they come first. It is uniform over the cube.
#[cube]
pub fn cube_has_pieces(pieces: &[u32], most: u32) -> bool {
    // uniform for WGSL, which allows an exit before barriers only if all units of the cube take it
    let mut end = Shared::<[u32]>::new_slice(1usize);
    if UNIT_POS == 0u32 {
        end[0] = 0u32;
    }
    if UNIT_POS == 0u32 && CUBE_POS * PIECES < most as usize {
        end[0] = Piece::load(pieces, CUBE_POS * PIECES).end;
    }
    workgroup_uniform_load(&end[0]) > 0u32
}

/// Whether any of `count` rectangles is one of this cube. It is uniform over the cube.
#[cube]
pub fn cube_has_rectangles(count: u32) -> bool {
    CUBE_POS * PIECES < count as usize
}

/// Writes what the units of every piece or rectangle of this cube gathered, [`count`, `numbers`]: the sum of the numbers of
/// all its units or, if not `sum`, the largest. All units of the cube must call this together.
#[cube]
pub fn store_gathered(
    own: &Array<f32>,
    gathered: &mut [f32],
    count: u32,
    #[comptime] numbers: usize,
    #[comptime] sum: bool,
) {
    let mut partial = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * numbers));
    let unit = UNIT_POS as usize;
    #[unroll]
    for number in 0..numbers {
        partial[unit * numbers + number] = own[number];
    }
    sync_cube();
    let mut at = unit;
    while at < PIECES * numbers {
        let (piece, number) = (at / numbers, at % numbers);
        let mut value = 0.0f32;
        for worker in 0..WORKERS {
            let part = partial[(piece * WORKERS as usize + worker as usize) * numbers + number];
            if comptime!(sum) {
                value += part;
            } else {
                value = max(value, part);
            }
        }
        if CUBE_POS * PIECES + piece < count as usize {
            gathered[CUBE_POS * PIECES * numbers + at] = value;
        }
        at += UNITS as usize;
    }
}

/// Area of the rectangles, px, in as many parts as there are cubes.
#[cube(launch)]
fn areas_kernel(rects: &[u32], areas: &mut [f32], count: u32, parts: u32) {
    if CUBE_POS >= parts as usize {
        terminate!();
    }
    let mut own = zeros(1usize);
    let mut at = CUBE_POS as u32 * UNITS + UNIT_POS;
    while at < count {
        // in f32: many large rectangles have more than 2³² pixels, and the sum only decides about a size
        own[0] += f32::cast_from(Rect::load(rects, at as usize).area());
        at += parts * UNITS;
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    sum_units(&own, &mut memory, 1usize);
    if UNIT_POS == 0u32 {
        areas[CUBE_POS] = memory[0];
    }
}

/// Pixels of a piece, and the number of pieces of every rectangle.
#[cube(launch)]
fn counts_kernel(
    rects: &[u32],
    areas: &[f32],
    size: &mut [u32],
    counts: &mut [u32],
    count: u32,
    parts: u32,
    budget: f32,
) {
    if CUBE_POS * UNITS as usize >= count as usize {
        terminate!();
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    sum_parts(areas, parts, &mut memory, 1usize);
    let own_size = u32::cast_from(f32::ceil(max(memory[0] / budget, SMALLEST)));
    let i = ABSOLUTE_POS;
    if i == 0usize {
        size[0] = own_size;
    }
    if i < count as usize {
        counts[i] = Rect::load(rects, i).area().div_ceil(own_size);
    }
}

/// Every piece; empty ones behind them.
#[cube(launch)]
fn pieces_kernel(rects: &[u32], size: &[u32], starts: &[u32], pieces: &mut [u32], count: u32, most: u32) {
    let at = ABSOLUTE_POS;
    let total = starts[count as usize];
    let i = own_owner(starts, count, total);
    if (at as u32) < total {
        let rect = Rect::load(rects, i as usize);
        let from = (at as u32 - starts[i as usize]) * size[0];
        let end = min(rect.area(), from + size[0]);
        Piece { primitive: i, x0: rect.x0, x1: rect.x1, y0: rect.y0, from, end }.store(pieces, at);
    } else if (at as u32) < most {
        Piece { primitive: 0u32, x0: 0u32, x1: 0u32, y0: 0u32, from: 0u32, end: 0u32 }.store(pieces, at);
    }
}

/// Pieces of rectangles.
#[derive(Clone)]
pub struct WorkSplit {
    /// [most, 6] in the order of the rectangles, empty ones last
    pub pieces: CubeTensor,
    /// [N + 1] the first piece of each rectangle
    pub starts: CubeTensor,
    /// Bound of the number of pieces, a multiple of those of a cube.
    pub most: usize,
}

/// Adds what the pieces of every rectangle gathered: `taken` of the numbers, from the `first` on.
#[cube(launch)]
fn collect_kernel(
    gathered: &[f32],
    starts: &[u32],
    sums: &mut [f32],
    count: u32,
    #[comptime] first: usize,
    #[comptime] taken: usize,
    #[comptime] numbers: usize,
) {
    if !cube_has_rectangles(count) {
        terminate!();
    }
    let mut own = zeros(taken);
    let i = own_number();
    if i < count as usize {
        let end = starts[i + 1];
        let mut piece = starts[i] + worker();
        while piece < end {
            let at = piece as usize * numbers + first;
            #[unroll]
            for number in 0..taken {
                own[number] += gathered[at + number];
            }
            piece += WORKERS;
        }
    }
    store_gathered(&own, sums, count, taken, true);
}

/// A grid with [`WORKERS`] units for each of `count` rectangles.
pub fn collectors(count: usize) -> CubeCount {
    cubes(count.div_ceil(PIECES))
}

impl WorkSplit {
    /// A grid with [`WORKERS`] units for each piece.
    pub fn gatherers(&self) -> CubeCount {
        cubes(self.most / PIECES)
    }

    /// [N, `taken`] sums over the pieces of every rectangle of what they `gathered` [most, n], from number `first` on.
    pub fn collect(&self, gathered: &CubeTensor, first: usize, taken: usize) -> CubeTensor {
        let count = self.starts.shape()[0] - 1;
        let sums = empty_f32(gathered, [count, taken]);
        collect_kernel::launch(
            &gathered.client.clone(),
            collectors(count),
            cube_dim(),
            buffer(gathered),
            buffer(&self.starts),
            buffer(&sums),
            count as u32,
            first,
            taken,
            gathered.shape()[1],
        );
        sums
    }
}

/// The pixels of `rects` [N, 4] in pieces.
pub fn split_work(rects: &CubeTensor) -> WorkSplit {
    let (client, count) = (rects.client.clone(), rects.shape()[0]);
    let parts = reduce::parts(count);
    let budget = count / 2 + SPARE;
    let areas = empty_f32(rects, [parts]);
    areas_kernel::launch(&client, cubes(parts), cube_dim(), buffer(rects), buffer(&areas), count as u32, parts as u32);
    let (size, counts) = (empty_u32(rects, [1]), empty_u32(rects, [count]));
    counts_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(rects),
        buffer(&areas),
        buffer(&size),
        buffer(&counts),
        count as u32,
        parts as u32,
        // rounding may make the sum of the areas a little too small
        budget as f32 * 0.999,
    );
    let starts = scan::starts(&counts);
    // a rectangle has one piece more than its area over their size, at most, and these shares add up to the budget
    let most = (count + budget).next_multiple_of(PIECES);
    let pieces = empty_u32(rects, [most, PIECE]);
    pieces_kernel::launch(
        &client,
        units(most),
        cube_dim(),
        buffer(rects),
        buffer(&size),
        buffer(&starts),
        buffer(&pieces),
        count as u32,
        most as u32,
    );
    WorkSplit { pieces, starts, most }
}

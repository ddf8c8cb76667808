//! The walk through a tile in the order of each pixel's own ray (StopThePop).

use pulp::Scalar;

use super::walk::{Fragments, Thresholds, Tile};
use crate::backend::real::Real;
use crate::footprint::gaussian::cpu::along_ray::{AlongRay, unit_ray};
use crate::math::{CameraOf, V3};
use crate::ops::blend::QUEUES;
use crate::tiles::{TILE, TILE_PIXELS, pixel_offset};

/// Edges of a block and of a quad, px.
const BLOCK: usize = 4;
const QUAD: usize = 2;
/// Blocks and quads in a row of a tile.
const BLOCKS: usize = TILE / BLOCK;
const QUADS: usize = TILE / QUAD;

/// At most N values, by key.
#[derive(Clone, Copy)]
struct Queue<V, const N: usize> {
    /// Ascending.
    keys: [f64; N],
    values: [V; N],
    len: usize,
}

impl<V: Copy + Default, const N: usize> Queue<V, N> {
    fn new() -> Self {
        Self { keys: [0.0; N], values: [V::default(); N], len: 0 }
    }

    /// Takes the value with the smallest key.
    fn pop(&mut self) -> Option<V> {
        let first = (self.len > 0).then(|| self.values[0])?;
        self.keys.copy_within(1..self.len, 0);
        self.values.copy_within(1..self.len, 0);
        self.len -= 1;
        Some(first)
    }

    /// Takes the value with the smallest key if the queue is full, and adds another behind those of the same key.
    fn push(&mut self, key: f64, value: V) -> Option<V> {
        let first = if self.len == N { self.pop() } else { None };
        // `total_cmp` has a place for NaN as well, so that the queue stays sorted
        let at = self.keys[..self.len].partition_point(|other| other.total_cmp(&key).is_le());
        self.keys.copy_within(at..self.len, at + 1);
        self.values.copy_within(at..self.len, at + 1);
        (self.keys[at], self.values[at]) = (key, value);
        self.len += 1;
        first
    }
}

/// Unit vectors of the rays through the middles of the squares of `edge` px in a tile, row by row.
fn rays<T: Real>(camera: &CameraOf<T>, origin: (usize, usize), edge: usize) -> Vec<V3<T>> {
    let row = TILE / edge;
    let middle = |at: usize, origin: usize| T::of((origin + at * edge) as f64 + 0.5 * edge as f64);
    (0..row * row).map(|at| unit_ray(camera, [middle(at % row, origin.0), middle(at / row, origin.1)])).collect()
}

/// A pixel that waits for what comes.
#[derive(Clone, Copy)]
struct Pixel<T> {
    /// Position in the list of the tile, and α before it is capped.
    queue: Queue<(u32, T), { QUEUES[2] }>,
    /// T
    through: T,
    /// Until it has ended.
    open: bool,
}

/// The queues of a tile.
struct Walk<'a, T, V> {
    along: &'a [AlongRay<T>],
    list: &'a [u32],
    origin: (usize, usize),
    thresholds: &'a Thresholds<T>,
    rays: [Vec<V3<T>>; 3],
    blocks: Vec<Queue<u32, { QUEUES[0] }>>,
    quads: Vec<Queue<u32, { QUEUES[1] }>>,
    pixels: Vec<Pixel<T>>,
    /// Open pixels of each block.
    open: [usize; BLOCKS * BLOCKS],
    visit: V,
}

/// The four squares of half the edge in square `at` of `row` in a row.
fn quarters(at: usize, row: usize) -> [usize; 4] {
    let first = at / row * 4 * row + at % row * 2;
    [first, first + 1, first + 2 * row, first + 2 * row + 1]
}

impl<'a, T: Real, V: FnMut(usize, usize, &Fragments<T, Scalar>)> Walk<'a, T, V> {
    fn new<F>(tile: &Tile<'a, T, F>, visit: V) -> Self {
        let (grid, origin) = (tile.sorted.grid, tile.origin());
        let pixel = |at: usize| {
            let open = origin.0 + at % TILE < grid.width && origin.1 + at / TILE < grid.height;
            Pixel { queue: Queue::new(), through: T::one(), open }
        };
        let pixels: Vec<Pixel<T>> = (0..TILE_PIXELS).map(pixel).collect();
        let mut open = [0; BLOCKS * BLOCKS];
        for at in (0..TILE_PIXELS).filter(|&at| pixels[at].open) {
            open[block_of(at)] += 1;
        }
        Self {
            along: &tile.sorted.along,
            list: tile.list(),
            origin,
            thresholds: tile.thresholds,
            rays: [BLOCK, QUAD, 1].map(|edge| rays(tile.camera, origin, edge)),
            blocks: vec![Queue::new(); BLOCKS * BLOCKS],
            quads: vec![Queue::new(); QUADS * QUADS],
            pixels,
            open,
            visit,
        }
    }

    fn along(&self, position: u32) -> &'a AlongRay<T> {
        &self.along[self.list[position as usize] as usize]
    }

    /// Shows an entry of the list to every block.
    fn enter(&mut self, position: u32) {
        let along = self.along(position);
        for block in 0..BLOCKS * BLOCKS {
            let first = [self.origin.0 + block % BLOCKS * BLOCK, self.origin.1 + block / BLOCKS * BLOCK];
            // blocks whose pixels have all ended take nothing more
            if self.open[block] > 0 && along.splat.reaches(first, [BLOCK; 2]) {
                let key = along.depth(self.rays[0][block]).as_f64();
                if let Some(leaving) = self.blocks[block].push(key, position) {
                    self.leave_block(block, leaving);
                }
            }
        }
    }

    fn leave_block(&mut self, block: usize, position: u32) {
        let along = self.along(position);
        for quad in quarters(block, BLOCKS) {
            let key = along.depth(self.rays[1][quad]).as_f64();
            if let Some(leaving) = self.quads[quad].push(key, position) {
                self.leave_quad(quad, leaving);
            }
        }
    }

    fn leave_quad(&mut self, quad: usize, position: u32) {
        let along = self.along(position);
        for pixel in quarters(quad, QUADS) {
            if !self.pixels[pixel].open {
                continue;
            }
            let [dx, dy] = pixel_offset(along.splat.mean, self.origin, pixel);
            let [u, v] = along.splat.in_deviations(dx, dy);
            let weight = along.splat.weight(u, v);
            let depth = along.depth(self.rays[2][pixel]);
            // t* below 0 lies behind the camera
            if weight > T::zero()
                && depth >= T::zero()
                && let Some((position, weight)) = self.pixels[pixel].queue.push(depth.as_f64(), (position, weight))
            {
                self.blend(pixel, position, weight);
            }
        }
    }

    fn blend(&mut self, at: usize, position: u32, weight: T) {
        // maps have the depth of the centre in either order; t* only sorts
        let depth = self.along(position).splat.depth;
        let pixel = &mut self.pixels[at];
        let alpha = weight.min(self.thresholds.max_alpha);
        let behind = pixel.through * (T::one() - alpha);
        // before the fragment, so that T stays above the least (3DGS)
        if behind < self.thresholds.min_transmittance {
            pixel.open = false;
            self.open[block_of(at)] -= 1;
            return;
        }
        let fragments = Fragments::single(alpha * pixel.through, behind, depth);
        pixel.through = behind;
        (self.visit)(position as usize, at, &fragments);
    }

    /// Empties all queues.
    fn finish(&mut self) {
        // blocks first: what leaves them passes through the queues after them
        for block in 0..BLOCKS * BLOCKS {
            while let Some(leaving) = self.blocks[block].pop() {
                self.leave_block(block, leaving);
            }
        }
        for quad in 0..QUADS * QUADS {
            while let Some(leaving) = self.quads[quad].pop() {
                self.leave_quad(quad, leaving);
            }
        }
        for pixel in 0..TILE_PIXELS {
            while let Some((position, weight)) = self.pixels[pixel].queue.pop().filter(|_| self.pixels[pixel].open) {
                self.blend(pixel, position, weight);
            }
        }
    }
}

/// The block of a pixel of a tile.
fn block_of(pixel: usize) -> usize {
    pixel / TILE / BLOCK * BLOCKS + pixel % TILE / BLOCK
}

/// Positions in the list of a tile by t* where α is largest.
fn by_depth_in_tile<T: Real, F>(tile: &Tile<T, F>) -> Vec<u32> {
    let origin = tile.origin();
    let key = |id: u32| {
        let along = &tile.sorted.along[id as usize];
        let ([dx, dy], _) = along.splat.nearest([origin.0, origin.1], [TILE; 2]);
        along.depth(unit_ray(tile.camera, [along.splat.mean[0] + dx, along.splat.mean[1] + dy])).as_f64()
    };
    let mut keyed: Vec<(f64, u32)> = tile.list().iter().zip(0..).map(|(&id, position)| (key(id), position)).collect();
    // stable: ties stay in the order of the list
    keyed.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    keyed.into_iter().map(|(_, position)| position).collect()
}

/// Goes through a tile, each pixel in its own order. Calls `visit(position, pixel, fragment)` for every fragment that is
/// blended: with its position in the list, and the pixel in the tile. Returns T behind everything.
pub fn walk_rays<T: Real, F>(
    tile: &Tile<T, F>,
    visit: impl FnMut(usize, usize, &Fragments<T, Scalar>),
) -> [T; TILE_PIXELS] {
    let mut walk = Walk::new(tile, visit);
    for position in by_depth_in_tile(tile) {
        walk.enter(position);
    }
    walk.finish();
    std::array::from_fn(|pixel| walk.pixels[pixel].through)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_gives_the_smallest_and_ties_leave_as_they_came() {
        let mut queue = Queue::<char, 3>::new();
        for (key, value) in [(2.0, 'b'), (1.0, 'a'), (2.0, 'c')] {
            assert_eq!(queue.push(key, value), None);
        }
        // the smallest leaves before the new one is looked at
        assert_eq!(queue.push(-1.0, 'd'), Some('a'));
        assert_eq!(std::iter::from_fn(|| queue.pop()).collect::<String>(), "dbc");
    }

    #[test]
    fn squares_consist_of_their_quarters() {
        let pixels_of = |block: usize| quarters(block, BLOCKS).map(|quad| quarters(quad, QUADS)).concat();
        for block in 0..BLOCKS * BLOCKS {
            assert!(pixels_of(block).into_iter().all(|pixel| block_of(pixel) == block), "{block}");
        }
        let mut all: Vec<usize> = (0..BLOCKS * BLOCKS).flat_map(pixels_of).collect();
        all.sort_unstable();
        assert!(all.into_iter().eq(0..TILE_PIXELS));
    }
}

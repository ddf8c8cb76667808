//! Between planar images [P, H, W] and tile blocks [tile, P, `TILE_PIXELS`].

use rayon::prelude::*;

use super::{TILE, TILE_PIXELS, TileGrid};

/// Planar images from tile blocks; what lies outside the image is dropped.
pub fn to_planes<V: Copy + Default + Send + Sync>(blocks: &[V], planes: usize, grid: TileGrid) -> Vec<V> {
    let mut out = vec![V::default(); planes * grid.width * grid.height];
    out.par_chunks_mut(grid.width.max(1)).enumerate().for_each(|(line, out)| {
        let (plane, y) = (line / grid.height, line % grid.height);
        for (column, pixels) in out.chunks_mut(TILE).enumerate() {
            let tile = y / TILE * grid.columns + column;
            let start = (tile * planes + plane) * TILE_PIXELS + y % TILE * TILE;
            pixels.copy_from_slice(&blocks[start..start + pixels.len()]);
        }
    });
    out
}

/// Tile blocks from planar images; pixels outside the image become `outside`.
pub fn to_tiles<V: Copy + Send + Sync>(image: &[V], planes: usize, grid: TileGrid, outside: V) -> Vec<V> {
    let mut out = vec![outside; grid.len() * planes * TILE_PIXELS];
    out.par_chunks_mut(planes * TILE_PIXELS).enumerate().for_each(|(tile, block)| {
        let (x, y) = grid.origin(tile);
        let width = TILE.min(grid.width - x);
        for (plane, block) in block.chunks_mut(TILE_PIXELS).enumerate() {
            for (line, pixels) in block.chunks_mut(TILE).enumerate().take(grid.height - y) {
                let start = (plane * grid.height + y + line) * grid.width + x;
                pixels[..width].copy_from_slice(&image[start..start + width]);
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_and_planes_are_inverse_and_pad_outside() {
        let grid = TileGrid::new(37, 21);
        let image: Vec<u32> = (0..2 * 37 * 21).collect();
        let blocks = to_tiles(&image, 2, grid, u32::MAX);
        assert_eq!(blocks.iter().filter(|&&v| v == u32::MAX).count(), blocks.len() - image.len());
        assert_eq!(to_planes(&blocks, 2, grid), image);
    }
}

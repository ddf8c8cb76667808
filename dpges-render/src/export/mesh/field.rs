//! A truncated signed distance field in blocks of voxels, of which only those near a surface exist.

use std::collections::HashMap;

/// Voxels along each side of a block.
pub const BLOCK: i32 = 8;
/// Voxels of a block.
pub const BLOCK_LEN: usize = (BLOCK * BLOCK * BLOCK) as usize;

/// Place of a block: that of its first voxel divided by [`BLOCK`]. Voxel (i, j, k) lies at (i, j, k) × voxel.
pub type BlockKey = [i32; 3];

/// The state of a voxel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Voxel {
    /// Mean signed distance from the surface, in units of the truncation: positive where it was seen, at most 1.
    pub distance: f32,
    /// Number of views in the mean; 0 if the voxel is unknown.
    pub weight: f32,
    pub colour: [f32; 3],
}

impl Voxel {
    /// Takes one view into the means.
    pub fn add(&mut self, distance: f32, colour: [f32; 3]) {
        self.weight += 1.0;
        let share = 1.0 / self.weight;
        self.distance += share * (distance - self.distance);
        for (mean, new) in self.colour.iter_mut().zip(colour) {
            *mean += share * (new - *mean);
        }
    }
}

pub struct Block {
    pub key: BlockKey,
    /// x varies fastest.
    pub voxels: Box<[Voxel; BLOCK_LEN]>,
}

/// Blocks in the order in which they were made.
#[derive(Default)]
pub struct Field {
    pub blocks: Vec<Block>,
    pub places: HashMap<BlockKey, usize>,
}

impl Field {
    /// Makes a block of unknown voxels.
    pub fn insert(&mut self, key: BlockKey) {
        self.places.insert(key, self.blocks.len());
        self.blocks.push(Block { key, voxels: Box::new([Voxel::default(); BLOCK_LEN]) });
    }

    /// The voxel at a lattice point, unknown where there is no block.
    pub fn voxel(&self, point: [i32; 3]) -> Voxel {
        let key = point.map(|i| i.div_euclid(BLOCK));
        let [x, y, z] = point.map(|i| i.rem_euclid(BLOCK));
        let at = (x + BLOCK * (y + BLOCK * z)) as usize;
        self.places.get(&key).map_or_else(Voxel::default, |&block| self.blocks[block].voxels[at])
    }
}

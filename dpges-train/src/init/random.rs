//! Initialisation at random places (3DGS).

use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::placement::OrientedPoints;
use super::region::Region;

/// `count` grey points, drawn uniformly from the region.
pub fn points(region: Region, count: usize, rng: &mut ChaCha8Rng) -> OrientedPoints {
    let mut draw =
        || (region.low + region.size() * DVec3::from_array([0; 3].map(|_| rng.random()))).as_vec3().to_array();
    let positions: Vec<[f32; 3]> = (0..count).map(|_| draw()).collect();
    OrientedPoints { positions, colours: vec![[0.5; 3]; count], normals: vec![DVec3::Z; count] }
}

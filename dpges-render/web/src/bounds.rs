//! Where a scene is, for a first view of it.

use dpges_core::scene::SceneData;

/// Share of the primitives within the sphere: the rest are strays far outside.
const SHARE: f64 = 0.9;

/// Centre and radius, world units, of a sphere with most of the primitives. A scene without any is a unit sphere.
pub fn sphere(scene: &SceneData) -> ([f64; 3], f64) {
    let positions = || scene.surfels.positions.chunks_exact(3).chain(scene.gaussians.positions.chunks_exact(3));
    if positions().next().is_none() {
        return ([0.0; 3], 1.0);
    }
    let centre = [0, 1, 2].map(|axis| at_share(positions().map(|position| f64::from(position[axis])), 0.5));
    let squared = |position: &[f32]| (0..3).map(|axis| (f64::from(position[axis]) - centre[axis]).powi(2)).sum::<f64>();
    let radius = at_share(positions().map(squared), SHARE).sqrt();
    (centre, if radius > 0.0 { radius } else { 1.0 })
}

/// The value that `share` of the `values` do not exceed.
fn at_share(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let last = values.len() - 1;
    *values.select_nth_unstable_by((share * last as f64) as usize, f64::total_cmp).1
}

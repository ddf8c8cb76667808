//! Turns points on surfaces into surfels and Gaussians.

use dpges_core::scene::{ColourData, ColourModel, GaussianData, SH_C0, SurfelData};
use glam::{DQuat, DVec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::config::Config;
use crate::dataset::neighbours::spacing;
use crate::refine::add::faint_detail;

/// Scale of a primitive without neighbours, as a fraction of the extent.
const LONE_SCALE: f64 = 0.01;

/// Points on surfaces, with colours and outward normals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OrientedPoints {
    /// World units.
    pub positions: Vec<[f32; 3]>,
    /// Red, green, blue from 0 to 1.
    pub colours: Vec<[f32; 3]>,
    /// Unit vectors.
    pub normals: Vec<DVec3>,
}

/// At most `count` of `total` rows, drawn uniformly, ascending.
pub fn draw_rows(total: usize, count: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..total).collect();
    if count < total {
        for at in 0..count {
            rows.swap(at, rng.random_range(at..total));
        }
        rows.truncate(count);
        rows.sort_unstable();
    }
    rows
}

/// Largest scale at the start, extents.
const MAX_SCALE_EXTENT: f64 = 0.06;
/// Largest scale at the start, medians.
const MAX_SCALE_MEDIAN: f64 = 10.0;

/// How large and how opaque primitives start.
#[derive(Clone, Copy, Debug)]
pub struct PrimitiveStart {
    /// Scale of a surfel relative to the root mean square distance to the 3 nearest points.
    pub surfel_scale: f64,
    /// The same of a Gaussian.
    pub gaussian_scale: f64,
    pub gaussian_opacity: f64,
}

impl Default for PrimitiveStart {
    /// Those of the joint stage: together, surfels and Gaussians cover what either would cover alone.
    fn default() -> Self {
        Self { surfel_scale: 0.4, gaussian_scale: 0.5, gaussian_opacity: 0.1 }
    }
}

/// The settings of `[init]` that concern primitives, for a scene of a given extent.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    pub model: ColourModel,
    pub start: PrimitiveStart,
    /// World units.
    pub max_scale: f64,
    /// Multiple of the median scale.
    pub max_scale_median: f64,
    /// Largest scale before the factors above, world units.
    pub lone_scale: f64,
}

impl Placement {
    /// `extent` in world units. An extent of 0 limits no scale.
    pub fn new(config: &Config, extent: f64) -> Self {
        let (known, limited) = (extent > 0.0, config.init.limit_scales);
        Self {
            model: config.model.colour,
            start: PrimitiveStart::default(),
            max_scale: if known && limited { MAX_SCALE_EXTENT * extent } else { f64::MAX },
            max_scale_median: if limited { MAX_SCALE_MEDIAN } else { f64::INFINITY },
            lone_scale: LONE_SCALE * if known { extent } else { 1.0 },
        }
    }

    /// Logarithms of `factor` × the spacing of `positions`, within the limits.
    fn log_scales(&self, positions: &[[f32; 3]], factor: f64) -> Vec<f32> {
        let spacing = spacing(positions);
        let mut scales: Vec<f64> = spacing.iter().map(|s| factor * s.map_or(self.lone_scale, f64::from)).collect();
        let mut sorted = scales.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(1.0);
        let limit = self.max_scale.min(self.max_scale_median * median);
        scales.iter_mut().for_each(|scale| *scale = scale.min(limit));
        scales.into_iter().map(|scale| scale.ln() as f32).collect()
    }
}

/// One disc per point, perpendicular to its normal, as wide as the spacing of the points. Margins are zero.
pub fn surfels(points: &OrientedPoints, placement: &Placement, rng: &mut ChaCha8Rng) -> SurfelData {
    let log_scales = placement.log_scales(&points.positions, placement.start.surfel_scale);
    let mut surfels = SurfelData::neutral(placement.model, points.positions.len());
    surfels.positions = points.positions.as_flattened().to_vec();
    surfels.quaternions = points.normals.iter().flat_map(|&normal| facing(normal)).collect();
    surfels.log_scales = log_scales.into_iter().flat_map(|s| [s; 2]).collect();
    surfels.colour = colour(points, placement.model, rng);
    surfels
}

/// One isotropic Gaussian of low opacity per point.
pub fn gaussians(points: &OrientedPoints, placement: &Placement, rng: &mut ChaCha8Rng) -> GaussianData {
    let log_scales = placement.log_scales(&points.positions, placement.start.gaussian_scale);
    let mut gaussians = GaussianData::neutral(placement.model, points.positions.len());
    gaussians.positions = points.positions.as_flattened().to_vec();
    gaussians.quaternions = [1.0, 0.0, 0.0, 0.0].repeat(points.positions.len());
    gaussians.log_scales = log_scales.into_iter().flat_map(|s| [s; 3]).collect();
    gaussians.opacities.fill(placement.start.gaussian_opacity as f32);
    gaussians.colour = colour(points, placement.model, rng);
    gaussians
}

/// Quaternion (w, x, y, z) of a rotation whose third column is the unit vector `normal`.
pub fn facing(normal: DVec3) -> [f32; 4] {
    let q = DQuat::from_rotation_arc(DVec3::Z, normal);
    [q.w, q.x, q.y, q.z].map(|x| x as f32)
}

fn colour(points: &OrientedPoints, model: ColourModel, rng: &mut ChaCha8Rng) -> ColourData {
    let base = points.colours.as_flattened().iter().map(|&c| ((f64::from(c) - 0.5) / SH_C0) as f32).collect();
    ColourData::new(model, base, faint_detail(model, points.positions.len(), rng))
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{PI, TAU};

    use rand::SeedableRng;

    use super::*;

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(8)
    }

    fn points(positions: &[[f32; 3]]) -> OrientedPoints {
        let n = positions.len();
        OrientedPoints { positions: positions.to_vec(), colours: vec![[0.5, 1.0, 0.0]; n], normals: vec![DVec3::X; n] }
    }

    #[test]
    fn the_third_column_is_the_normal_in_every_direction() {
        let directions = [DVec3::X, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z, DVec3::new(0.1, -0.7, -0.9).normalize()];
        for normal in directions {
            let [w, x, y, z] = facing(normal).map(f64::from);
            let turned = DQuat::from_xyzw(x, y, z, w) * DVec3::Z;
            assert!((turned - normal).length() < 1e-6, "{normal}");
        }
    }

    #[test]
    fn outliers_are_capped_by_the_median_and_by_the_extent() {
        let mut positions: Vec<[f32; 3]> = (0..20).map(|i| [i as f32 * 0.1, 0.0, 0.0]).collect();
        positions.push([500.0, 0.0, 0.0]);
        let placement = Placement::new(&Config::default(), 1000.0);
        let scales = placement.log_scales(&positions, 1.0);
        let median = f64::from(spacing(&positions)[10].unwrap());
        assert!((f64::from(scales[20]).exp() / median - 10.0).abs() < 1e-3, "{}", scales[20].exp());
        let placement = Placement::new(&Config::default(), 1.0);
        assert!(placement.log_scales(&positions, 1.0).iter().all(|s| s.exp() <= 0.0601));
        let mut unlimited = Config::default();
        unlimited.init.limit_scales = false;
        let scales = Placement::new(&unlimited, 1.0).log_scales(&positions, 1.0);
        assert!((scales[20].exp() - spacing(&positions)[20].unwrap()).abs() < 1e-2, "{}", scales[20].exp());
    }

    #[test]
    fn primitives_have_the_colour_of_their_point_and_faint_lobes() {
        let cloud = points(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let placement = Placement::new(&Config::default(), 100.0);
        let surfels = surfels(&cloud, &placement, &mut rng());
        let gaussians = gaussians(&cloud, &placement, &mut rng());
        let rgb: Vec<f64> = surfels.colour.base[..3].iter().map(|&k| 0.5 + SH_C0 * f64::from(k)).collect();
        assert!(rgb.iter().zip([0.5, 1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!(surfels.colour.detail.len(), 3 * 12);
        for lobe in surfels.colour.detail.chunks(6) {
            assert_eq!((&lobe[..3], lobe[5]), (&[-0.3; 3][..], 0.0));
            assert!((0.0..PI).contains(&lobe[3]) && (0.0..TAU).contains(&lobe[4]), "{lobe:?}");
        }
        assert!((surfels.log_scales[0].exp() - 0.4).abs() < 1e-6);
        assert!((gaussians.log_scales[0].exp() - 0.5).abs() < 1e-6);
        assert_eq!((gaussians.len(), gaussians.opacities[0], gaussians.quaternions[0]), (3, 0.1, 1.0));
    }

    #[test]
    fn rows_are_drawn_without_replacement_and_in_their_order() {
        let drawn = draw_rows(50, 20, &mut rng());
        assert_eq!(drawn.len(), 20);
        assert!(drawn.windows(2).all(|pair| pair[0] < pair[1]) && drawn[19] < 50);
        assert_eq!(draw_rows(20, 100, &mut rng()), (0..20).collect::<Vec<_>>());
    }
}

//! Geometry with one thing wrong.

use std::f64::consts::TAU;
use std::fmt;

use dpges_core::scene::SurfelData;
use dpges_train::init::placement::draw_rows;
use glam::Vec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::surfaces::TrueSurfels;

/// An error in the true geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Degradation {
    Nothing,
    /// Every surfel is moved along the ray from the camera that saw its place: relative standard deviation of its depth.
    DepthNoise(f64),
    /// Share of the surfels that is missing, at random.
    Holes(f64),
    /// Factor on all scales.
    Sizes(f64),
    /// Surfels at silhouettes are missing.
    NoSilhouettes,
    /// Factor on the scales of surfels at silhouettes: they reach over the edge, or no longer do.
    SilhouetteSizes(f64),
}

impl Degradation {
    pub const ALL: [Self; 10] = [
        Self::Nothing,
        Self::DepthNoise(0.005),
        Self::DepthNoise(0.02),
        Self::Holes(0.1),
        Self::Holes(0.3),
        Self::Sizes(0.5),
        Self::Sizes(2.0),
        Self::NoSilhouettes,
        Self::SilhouetteSizes(0.5),
        Self::SilhouetteSizes(2.0),
    ];

    /// `known` surfels with this wrong.
    pub fn apply(self, known: &TrueSurfels, rng: &mut ChaCha8Rng) -> SurfelData {
        let count = known.surfels.len();
        let mut surfels = known.surfels.clone();
        match self {
            Self::Nothing => surfels,
            Self::DepthNoise(deviation) => {
                for (position, eye) in surfels.positions.as_chunks_mut::<3>().0.iter_mut().zip(&known.eyes) {
                    let ray = Vec3::from_array(*position).as_dvec3() - *eye;
                    *position = (*eye + ray * (1.0 + deviation * normal(rng))).as_vec3().to_array();
                }
                surfels
            }
            Self::Holes(share) => {
                let kept = ((1.0 - share) * count as f64).round() as usize;
                surfels.select(&draw_rows(count, kept, rng))
            }
            Self::Sizes(factor) => {
                scale(&mut surfels, factor, |_| true);
                surfels
            }
            Self::NoSilhouettes => {
                let kept: Vec<usize> = (0..count).filter(|&row| !known.at_silhouette[row]).collect();
                surfels.select(&kept)
            }
            Self::SilhouetteSizes(factor) => {
                scale(&mut surfels, factor, |row| known.at_silhouette[row]);
                surfels
            }
        }
    }
}

impl fmt::Display for Degradation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing => write!(f, "true geometry"),
            Self::DepthNoise(deviation) => write!(f, "depth ± {} %", 100.0 * deviation),
            Self::Holes(share) => write!(f, "holes, {} %", 100.0 * share),
            Self::Sizes(factor) => write!(f, "sizes × {factor}"),
            Self::NoSilhouettes => write!(f, "silhouettes removed"),
            Self::SilhouetteSizes(factor) => write!(f, "silhouettes × {factor}"),
        }
    }
}

/// Makes the surfels of `rows` larger by `factor`.
fn scale(surfels: &mut SurfelData, factor: f64, rows: impl Fn(usize) -> bool) {
    let change = factor.ln() as f32;
    for (row, log_scales) in surfels.log_scales.as_chunks_mut::<2>().0.iter_mut().enumerate() {
        if rows(row) {
            *log_scales = log_scales.map(|scale| scale + change);
        }
    }
}

/// A standard normal number (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (TAU * rng.random::<f64>()).cos()
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::ColourModel;
    use glam::DVec3;
    use rand::SeedableRng;

    use super::*;

    /// Surfels at distance 2 from an eye at (0, 0, 1), the first half at silhouettes.
    fn known(count: usize) -> TrueSurfels {
        let mut surfels = SurfelData::neutral(ColourModel::SphericalBeta { lobes: 1 }, count);
        surfels.positions = [2.0, 0.0, 1.0].repeat(count);
        surfels.log_scales = vec![0.5; 2 * count];
        let at_silhouette = (0..count).map(|row| row < count / 2).collect();
        TrueSurfels { surfels, eyes: vec![DVec3::Z; count], at_silhouette }
    }

    fn degraded(what: Degradation, count: usize) -> SurfelData {
        what.apply(&known(count), &mut ChaCha8Rng::seed_from_u64(3))
    }

    #[test]
    fn depths_scatter_along_rays_as_much_as_asked() {
        let found = degraded(Degradation::DepthNoise(0.02), 4000);
        let mut squares = 0.0;
        for position in found.positions.as_chunks::<3>().0 {
            assert_eq!(position[1..], [0.0, 1.0]);
            squares += (f64::from(position[0]) / 2.0 - 1.0).powi(2);
        }
        let deviation = (squares / 4000.0).sqrt();
        assert!((deviation / 0.02 - 1.0).abs() < 0.05, "{deviation}");
        let others = SurfelData { positions: known(4000).surfels.positions, ..found };
        assert_eq!(others, known(4000).surfels);
    }

    #[test]
    fn holes_and_silhouettes_lack_surfels() {
        assert_eq!(degraded(Degradation::Holes(0.3), 1000).len(), 700);
        assert_eq!(degraded(Degradation::NoSilhouettes, 1000).len(), 500);
        assert_eq!(degraded(Degradation::Nothing, 10), known(10).surfels);
    }

    #[test]
    fn sizes_change_for_all_or_at_silhouettes() {
        let ratios = |what: Degradation| -> Vec<f32> {
            degraded(what, 4).log_scales.iter().map(|scale| (scale - 0.5).exp()).collect()
        };
        let near = |found: Vec<f32>, expected: [f32; 8]| found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near(ratios(Degradation::Sizes(0.5)), [0.5; 8]));
        assert!(near(ratios(Degradation::SilhouetteSizes(2.0)), [2.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0]));
    }

    #[test]
    fn variants_have_different_names() {
        let mut names: Vec<String> = Degradation::ALL.iter().map(Degradation::to_string).collect();
        assert_eq!(names[1], "depth ± 0.5 %");
        names.sort();
        names.dedup();
        assert_eq!(names.len(), Degradation::ALL.len());
    }
}

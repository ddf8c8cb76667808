//! Turns trained discs into surfels and Gaussians (DP-GES, GES): opaque discs become surfels, the others Gaussians.

use dpges_core::scene::{GaussianData, SurfelData};

/// Thickness of a Gaussian that was a disc, relative to the mean of its two scales (GES).
const THICKNESS: f32 = 0.1;

/// Discs with an opacity above `min_opacity` (GES: 0.8) as surfels, with their scales multiplied by `scale_factor`, and
/// the others as Gaussians a tenth as thick as wide. Positions, rotations, colours and the order of rows are kept.
/// Margins are zero.
///
/// Opacities are effective, from 0 to 1. The third scale of a disc is ignored.
pub fn promote(discs: &GaussianData, min_opacity: f64, scale_factor: f64) -> (SurfelData, GaussianData) {
    let is_opaque = |row: &usize| f64::from(discs.opacities[*row]) > min_opacity;
    let (opaque, others): (Vec<usize>, Vec<usize>) = (0..discs.len()).partition(is_opaque);

    let opaque = discs.select(&opaque);
    let log_factor = scale_factor.ln() as f32;
    let widths = opaque.log_scales.as_chunks::<3>().0.iter().flat_map(|[x, y, _]| [x + log_factor, y + log_factor]);
    let mut surfels = SurfelData::neutral(opaque.colour.model, opaque.len());
    surfels.log_scales = widths.collect();
    surfels.positions = opaque.positions;
    surfels.quaternions = opaque.quaternions;
    surfels.colour = opaque.colour;

    let mut gaussians = discs.select(&others);
    for [x, y, z] in gaussians.log_scales.as_chunks_mut::<3>().0 {
        *z = (THICKNESS * 0.5 * (x.exp() + y.exp())).ln();
    }
    (surfels, gaussians)
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourData, ColourModel};

    use super::*;

    const MODEL: ColourModel = ColourModel::SphericalHarmonics { degree: 1 };

    /// Discs of scales 1 and 3 whose other numbers tell the rows apart.
    fn discs(opacities: &[f32]) -> GaussianData {
        let n = opacities.len();
        let numbered = |width: usize| (0..n * width).map(|i| i as f32).collect();
        GaussianData {
            positions: numbered(3),
            quaternions: numbered(4),
            log_scales: [0.0, 3f32.ln(), f32::NAN].repeat(n),
            opacities: opacities.to_vec(),
            colour: ColourData::new(MODEL, numbered(3), numbered(9)),
            ..GaussianData::default()
        }
    }

    #[test]
    fn the_opaque_become_surfels_and_the_others_thin_gaussians() {
        let old = discs(&[0.9, 0.5, 0.81, 0.79]);
        let (surfels, gaussians) = promote(&old, 0.8, 0.5);
        let have_scales = |logarithms: &[f32], expected: Vec<f32>| {
            assert_eq!(logarithms.len(), expected.len());
            assert!(logarithms.iter().zip(expected).all(|(log_scale, scale)| (log_scale.exp() - scale).abs() < 1e-6));
        };
        let expected = old.select(&[0, 2]);
        assert_eq!((surfels.positions, surfels.quaternions), (expected.positions, expected.quaternions));
        assert_eq!((surfels.colour, surfels.margins), (expected.colour, vec![0.0; 2]));
        have_scales(&surfels.log_scales, [0.5, 1.5].repeat(2));
        let expected = old.select(&[1, 3]);
        assert_eq!((gaussians.positions, gaussians.quaternions), (expected.positions, expected.quaternions));
        assert_eq!((gaussians.colour, gaussians.opacities), (expected.colour, vec![0.5, 0.79]));
        have_scales(&gaussians.log_scales, [1.0, 3.0, 0.2].repeat(2));
    }

    #[test]
    fn all_or_none() {
        for (opacity, counts) in [(0.9, (3, 0)), (0.5, (0, 3)), (0.75, (0, 3))] {
            let (surfels, gaussians) = promote(&discs(&[opacity; 3]), 0.75, 1.0);
            assert_eq!((surfels.len(), gaussians.len()), counts);
        }
        assert_eq!(promote(&discs(&[]), 0.8, 1.0), (SurfelData::neutral(MODEL, 0), GaussianData::neutral(MODEL, 0)));
    }
}

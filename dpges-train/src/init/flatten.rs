//! Turns opaque Gaussians into surfels in their planes.

use dpges_core::scene::{GaussianData, SurfelData};
use glam::{DMat3, DQuat, DVec3};

use crate::refine::children::{rotation, vector};

/// The `most` most opaque of `gaussians` as surfels, in the order of their rows: without their shortest axis, and with the other
/// scales multiplied by `scale_factor`. Margins are zero.
pub fn flatten(gaussians: &GaussianData, most: usize, scale_factor: f64) -> SurfelData {
    let mut rows: Vec<usize> = (0..gaussians.len()).collect();
    rows.sort_by(|&a, &b| gaussians.opacities[b].total_cmp(&gaussians.opacities[a]).then(a.cmp(&b)));
    rows.truncate(most);
    rows.sort_unstable();

    let chosen = gaussians.select(&rows);
    let mut surfels = SurfelData::neutral(chosen.colour.model, rows.len());
    for row in 0..rows.len() {
        let log_scales = vector(&chosen.log_scales, row);
        let shortest = (0..3).min_by(|&a, &b| log_scales[a].total_cmp(&log_scales[b])).expect("three axes");
        let [u, v] = [(shortest + 1) % 3, (shortest + 2) % 3];
        surfels.log_scales[2 * row..][..2]
            .copy_from_slice(&[u, v].map(|axis| (log_scales[axis] + scale_factor.ln()) as f32));
        // the axes u, v and the shortest are an even permutation, so a rotation
        let turned = DMat3::from_cols(DVec3::AXES[u], DVec3::AXES[v], DVec3::AXES[shortest]);
        let q = rotation(&chosen, row) * DQuat::from_mat3(&turned);
        surfels.quaternions[4 * row..][..4].copy_from_slice(&[q.w, q.x, q.y, q.z].map(|value| value as f32));
    }
    surfels.positions = chosen.positions;
    surfels.colour = chosen.colour;
    surfels
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourData, ColourModel};

    use super::*;

    #[test]
    fn the_most_opaque_lie_in_their_plane() {
        let gaussians = GaussianData {
            positions: (0..9).map(|i| i as f32).collect(),
            quaternions: [0.5, 0.5, -0.5, 0.5].repeat(3),
            log_scales: [0.0, 1.0, 2.0, 1.0, 0.0, 2.0, 2.0, 1.0, 0.0].to_vec(),
            opacities: vec![0.9, 0.2, 0.8],
            colour: ColourData::new(
                ColourModel::SphericalBeta { lobes: 0 },
                (0..9).map(|i| i as f32).collect(),
                vec![],
            ),
            ..GaussianData::default()
        };
        let surfels = flatten(&gaussians, 2, 1f64.exp());
        assert_eq!((&surfels.positions[3..], &surfels.colour.base[3..]), (&[6.0, 7.0, 8.0][..], &[6.0, 7.0, 8.0][..]));
        assert_eq!(surfels.log_scales, [2.0, 3.0, 3.0, 2.0]);
        for (row, shortest) in [(0, DVec3::X), (1, DVec3::Z)] {
            let [w, x, y, z] = [0, 1, 2, 3].map(|i| f64::from(surfels.quaternions[4 * row + i]));
            let normal = DQuat::from_xyzw(x, y, z, w) * DVec3::Z;
            let expected = rotation(&gaussians, 0) * shortest;
            assert!((normal.dot(expected).abs() - 1.0).abs() < 1e-6, "{normal} instead of {expected}");
        }
        assert_eq!(flatten(&gaussians, 9, 1.0).len(), 3);
    }
}

//! Exact relocation: without sorting, copies of a Gaussian that share its opacity draw the same picture as it did.
//!
//! Gaussians enter a pixel only through the sums of α c and of α. So n Gaussians of opacity o / n leave every sum as one of
//! opacity o made it, but for what is cut off below α = 1/255. Gaussians that draw nothing can be moved, and new ones added,
//! at no loss.

use dpges_core::scene::GaussianData;
use glam::{DVec3, Vec3};
use rand_chacha::ChaCha8Rng;

use super::add::draw_in_proportion;
use super::children::{rotation, vector};
use super::normal;
use super::prune::drawn;
use crate::dataset::block::Bounds;

/// Least opacity that is left to a copy: five times what is cut off, so that a copy is hardly narrower than its source.
const LEAST_OPACITY: f32 = 5.0 / 255.0;
/// Shift of a copy, relative to the standard deviations of its source.
const SHIFT: f64 = 0.5;
/// Draws for sources that are not too faint already.
const ROUNDS: usize = 4;

/// A set of Gaussians with copies in place of those that draw nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Renewal {
    pub rows: Vec<usize>,
    /// Opacities of the rows that stay, as they are rendered.
    pub opacities: Vec<f32>,
    pub copies: GaussianData,
}

/// As many copies as it takes to have `target` Gaussians, after those that draw nothing have left. If more than `target` draw,
/// those that answer for the least error leave too.
///
/// Sources lie within `bounds` and are drawn in proportion to `errors` `[M]`, what each answers for, or to o / (1 + o) if that is not known. A source
/// and its copies share its opacity, and copies are shifted by 0.5 R diag(s) N(0, I) (`shift` true).
pub fn renew(
    gaussians: &GaussianData,
    errors: &[f32],
    target: usize,
    bounds: Bounds,
    shift: bool,
    rng: &mut ChaCha8Rng,
) -> Renewal {
    let mut rows = drawn(&gaussians.opacities);
    if rows.len() > target {
        // ties by row, so that every rank finds the same ones
        rows.sort_by(|&a, &b| errors[b].total_cmp(&errors[a]).then(a.cmp(&b)));
        rows.truncate(target);
        rows.sort_unstable();
    }
    let kept: Vec<f32> = rows.iter().map(|&row| gaussians.opacities[row]).collect();
    let known = rows.iter().any(|&row| errors[row] > 0.0);
    let mut weights: Vec<f32> = match known {
        true => rows.iter().map(|&row| errors[row]).collect(),
        // before an opaque surfel, which weighs 1, this is the share of the pixel that a Gaussian has
        false => kept.iter().map(|opacity| opacity / (1.0 + opacity)).collect(),
    };
    let (positions, _) = gaussians.positions.as_chunks::<3>();
    let beyond = rows.iter().map(|&row| !bounds.contains(positions[row]));
    weights.iter_mut().zip(beyond).filter(|(_, beyond)| *beyond).for_each(|(weight, _)| *weight = 0.0);
    let most_members = |opacity: f32| ((opacity / LEAST_OPACITY) as usize).max(1);
    let mut members = vec![1; kept.len()];
    let mut sources = Vec::new();
    let missing = target.saturating_sub(kept.len());
    for _ in 0..ROUNDS {
        weights
            .iter_mut()
            .enumerate()
            .filter(|(at, _)| members[*at] >= most_members(kept[*at]))
            .for_each(|(_, w)| *w = 0.0);
        for at in draw_in_proportion(&weights, missing - sources.len(), rng) {
            // one draw may take a source several times, beyond what it can share
            if members[at] < most_members(kept[at]) {
                members[at] += 1;
                sources.push(at);
            }
        }
    }
    let opacities: Vec<f32> = kept.iter().zip(&members).map(|(opacity, &members)| opacity / members as f32).collect();
    let mut copies = gaussians.select(&sources.iter().map(|&at| rows[at]).collect::<Vec<_>>());
    copies.opacities = sources.iter().map(|&at| opacities[at]).collect();
    // copies in one place would have the same gradients, and never part
    if shift {
        shift_within(&mut copies, rng);
    }
    Renewal { rows, opacities, copies }
}

fn shift_within(gaussians: &mut GaussianData, rng: &mut ChaCha8Rng) {
    for row in 0..gaussians.len() {
        let draw = DVec3::new(normal(rng), normal(rng), normal(rng));
        let shift = rotation(gaussians, row) * (SHIFT * vector(&gaussians.log_scales, row).exp() * draw);
        let position = &mut gaussians.positions[row * 3..][..3];
        position.copy_from_slice(&(Vec3::from_slice(position) + shift.as_vec3()).to_array());
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::rng;
    use super::*;
    use crate::run::fixtures::{camera, device};
    use burn::tensor::{DType, Tensor};
    use dpges_core::camera::CameraFromWorld;
    use dpges_core::ops::splat::splat;
    use dpges_core::scene::{ColourData, ColourModel, Gaussians};

    /// Gaussians whose position, x, is their row.
    fn gaussians(opacities: &[f32]) -> GaussianData {
        let n = opacities.len();
        GaussianData {
            positions: (0..n).flat_map(|i| [i as f32, 0.0, 0.0]).collect(),
            quaternions: [1.0, 0.0, 0.0, 0.0].repeat(n),
            log_scales: [0.0, 1.0, -20.0].repeat(n),
            opacities: opacities.to_vec(),
            colour: ColourData::new(ColourModel::SphericalBeta { lobes: 0 }, vec![0.5; n * 3], vec![]),
            ..GaussianData::default()
        }
    }

    #[test]
    fn sources_share_their_opacity_and_errors_choose_them() {
        let old = gaussians(&[0.6, 0.001, 1.2, -0.3, 0.3]);
        let new = renew(&old, &[1.0, 9.0, 0.0, 9.0, 0.0], 5, Bounds::ALL, false, &mut rng(8));
        assert_eq!((&new.rows[..], new.copies.len()), (&[0, 2, 4][..], 2));
        assert!((new.opacities[0] - 0.2).abs() < 1e-6 && new.opacities[1..] == [1.2, 0.3], "{:?}", new.opacities);
        assert_eq!(new.copies.positions, [0.0; 6]);
        assert_eq!(new.copies.opacities, [new.opacities[0]; 2]);
    }

    #[test]
    fn sums_of_opacities_stay_as_they_were() {
        let old = gaussians(&(0..200).map(|i| 0.004 + 0.01 * i as f32).collect::<Vec<_>>());
        let errors: Vec<f32> = (0..200).map(|i| (i % 7) as f32).collect();
        let new = renew(&old, &errors, 900, Bounds::ALL, true, &mut rng(8));
        let after = new.opacities.iter().chain(&new.copies.opacities).sum::<f32>();
        assert!((after - old.opacities.iter().sum::<f32>()).abs() < 1e-3);
        assert_eq!(new.rows.len() + new.copies.len(), 900);
        assert!(new.copies.opacities.iter().all(|&opacity| opacity >= 0.99 * LEAST_OPACITY));
    }

    /// Sums of pixels of Gaussians around the camera, which are cut off nowhere in the picture.
    fn sums(gaussians: &GaussianData, dtype: DType) -> Vec<f64> {
        let camera_from_world = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -40.0), DVec3::ZERO, -DVec3::Y);
        let camera = camera(camera_from_world, 30.0, [24, 16]);
        let limits = Tensor::full([2, 16, 24], 1e9, (&device(), dtype));
        let gaussians = Gaussians::from_data(gaussians, &device(), dtype);
        let white = Tensor::ones([gaussians.positions.dims()[0], 3], (&device(), dtype));
        splat(&gaussians, &white, &limits, &camera).unwrap().into_data().iter::<f64>().collect()
    }

    #[test]
    fn pictures_stay_as_they_were() {
        let mut old = gaussians(&[0.75, 2.0]);
        old.log_scales = vec![3.0; 6];
        let new = renew(&old, &[1.0, 0.0], 4, Bounds::ALL, false, &mut rng(8));
        let mut after = GaussianData { opacities: new.opacities, ..old.select(&new.rows) };
        after.append(new.copies);
        assert_eq!(after.opacities, [0.25, 2.0, 0.25, 0.25]);
        for (dtype, most) in [(DType::F64, 1e-12), (DType::F32, 1e-5)] {
            let (before, after) = (sums(&old, dtype), sums(&after, dtype));
            let apart = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < most && before.iter().all(|sum| *sum > 0.1), "{dtype:?}: {apart}");
        }
    }

    #[test]
    fn faint_gaussians_have_no_copies() {
        let new = renew(&gaussians(&[0.021, 0.0393]), &[1.0; 2], 50, Bounds::ALL, true, &mut rng(8));
        assert_eq!((new.rows.len(), new.copies.len()), (2, 1));
        let none = renew(&gaussians(&[]), &[], 50, Bounds::ALL, true, &mut rng(8));
        assert_eq!((none.rows.len(), none.copies.len()), (0, 0));
    }

    #[test]
    fn without_errors_the_opaque_have_more_copies() {
        let new = renew(&gaussians(&[9.0, 1.0]), &[0.0; 2], 142, Bounds::ALL, false, &mut rng(8));
        let of_first = new.copies.positions.chunks(3).filter(|position| position[0] == 0.0).count();
        assert!((75..=105).contains(&of_first), "{of_first}");
    }

    #[test]
    fn beyond_the_target_those_that_answer_for_least_leave() {
        let new = renew(&gaussians(&[0.5, 0.5, 0.0, 0.5]), &[0.2, 0.1, 5.0, 0.3], 2, Bounds::ALL, true, &mut rng(8));
        assert_eq!((&new.rows[..], new.copies.len()), (&[0, 3][..], 0));
    }

    #[test]
    fn copies_lie_within_their_source() {
        let new = renew(&gaussians(&[1e3]), &[1.0], 20_001, Bounds::ALL, true, &mut rng(8));
        let spread = |axis: usize| {
            let squares = new.copies.positions.chunks(3).map(|position| f64::from(position[axis]).powi(2));
            (squares.sum::<f64>() / new.copies.len() as f64).sqrt()
        };
        assert!((spread(0) - 0.5).abs() < 0.02 && (spread(1) - 0.5 * 1f64.exp()).abs() < 0.05 && spread(2) < 1e-6);
    }
}

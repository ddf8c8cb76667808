//! The loss that holds surfels to measured points.

use burn::tensor::Tensor;

use crate::error::Result;
use crate::ops::composite::normals;
use crate::scene::Surfels;
use crate::scene::tensors::check_shape;

/// Mean of |(x − p) · n| over the surfels with a target, world units: how far their planes, through x with the normal n, are from their
/// points p. 0 if none has one. `targets` [N, 4] are p, world units, and 1; 0 for surfels without.
/// Gradients reach positions and quaternions.
///
/// # Errors
/// [`crate::Error::Shape`] if there is not a target for each surfel.
pub fn point_distance(surfels: &Surfels, targets: Tensor<2>) -> Result<Tensor<1>> {
    let count = surfels.len();
    check_shape("targets", &targets, [count, 4])?;
    if surfels.is_empty() {
        return Ok(Tensor::zeros([1], (&targets.device(), targets.dtype())));
    }
    let [points, has_one] = [0..3, 3..4].map(|columns| targets.clone().slice([0..count, columns]));
    let distances = ((surfels.positions.clone() - points) * normals(&surfels.quaternions)).sum_dim(1).abs();
    Ok((distances * has_one.clone()).sum() / has_one.sum().clamp_min(1.0))
}

#[cfg(test)]
mod tests {
    use burn::tensor::DType;

    use super::*;
    use crate::ops::fixtures::{SURFEL_NAMES, SURFEL_WIDTHS, check_rows, constant, surfel_rows};
    use crate::scene::ColourModel;
    use crate::testing::device;
    use crate::testing::golden::values;
    use crate::testing::random::Random;
    use crate::testing::scenes::{self, Recipe};

    #[test]
    fn distances_are_along_normals_of_the_surfels_that_have_a_target() {
        let scene = scenes::random(3, &Recipe { surfels: 3, gaussians: 0, ..Recipe::default() });
        let (surfels, _) = scene.tensors(&device(), DType::F64);
        // the last looks along x
        let positions = constant(&[0.0, 0.0, 1.0, 5.0, 5.0, 5.0, 1.0, 2.0, 3.0], [3, 3]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let quaternions = constant(&[2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, half, 0.0, half, 0.0], [3, 4]);
        let surfels = Surfels { positions, quaternions, ..surfels };
        let loss = |targets: &[f64]| values(&point_distance(&surfels, constant(targets, [3, 4])).unwrap())[0];
        let targets = [9.0, 9.0, 1.25, 1.0, 0.0, 0.0, 0.0, 0.0, 1.5, 9.0, 9.0, 1.0];
        assert!((loss(&targets) - (0.25 + 0.5) / 2.0).abs() < 1e-12);
        assert_eq!(loss(&[0.0; 12]), 0.0);
        let (none, _) = scenes::random(3, &Recipe { surfels: 0, ..Recipe::default() }).tensors(&device(), DType::F64);
        assert_eq!(values(&point_distance(&none, constant(&[], [0, 4])).unwrap()), [0.0]);
        let error = point_distance(&surfels, constant(&[0.0; 8], [2, 4])).unwrap_err();
        assert!(error.to_string().contains("targets"), "{error}");
    }

    #[test]
    fn gradients_are_central_differences() {
        let model = ColourModel::SphericalBeta { lobes: 0 };
        let scene = scenes::random(7, &Recipe { surfels: 5, gaussians: 0, model, ..Recipe::default() });
        let mut targets = Random::new(8).numbers(20, -1.0, 1.0);
        targets.iter_mut().skip(3).step_by(4).enumerate().for_each(|(row, flag)| *flag = f64::from(u8::from(row != 1)));
        let loss = |[positions, quaternions, log_scales]: &[Tensor<2>; 3]| {
            let [positions, quaternions, log_scales] = [positions, quaternions, log_scales].map(Tensor::clone);
            let (others, _) = scene.tensors(&device(), DType::F64);
            let surfels = Surfels { positions, quaternions, log_scales, ..others };
            point_distance(&surfels, constant(&targets, [5, 4])).unwrap()
        };
        let rows = surfel_rows(&scene.surfels);
        let [positions, quaternions, _] = check_rows("the distance", SURFEL_NAMES, &rows, SURFEL_WIDTHS, 1e-6, loss);
        assert!(positions[3..6].iter().chain(&quaternions[4..8]).all(|gradient| *gradient == 0.0));
        assert!(positions[..3].iter().chain(&quaternions[..4]).any(|gradient| gradient.abs() > 1e-3));
    }
}

//! Losses that hold rendered depths to depth maps: those of a sensor, of stereo, or of a network that sees one picture.
//!
//! A map has disparities, one over depth ([`crate::camera`]) in world units, [1, H, W]; 0 where nothing is known. Depths are
//! [1, H, W] in world units, 0 where nothing is rendered.

use burn::tensor::Tensor;

use super::geometry::expected_depth;
use crate::error::Result;
use crate::ops::composite::layer_depth;
use crate::render::Render;
use crate::scene::tensors::check_shape;

/// Keeps sums over no pixel from being divided by 0.
const TINY: f64 = 1e-12;
/// Variance up to which relative disparities, which reach 1, are all the same.
const FLAT: f64 = 1e-8;

/// Expected depth of the surfels `Σ w D / Σ w` and their coverage `Σ w` with the weights w of the layers, both 0 where there are none.
/// Gradients reach positions, quaternions and log-scales of surfels.
pub fn surfel_depth(render: &Render) -> [Tensor<3>; 2] {
    let weights = &render.seen.weights;
    let coverage = weights.clone().sum_dim(0);
    [expected_depth(layer_depth(&render.layers, weights), coverage.clone()), coverage]
}

/// Mean of `a |D d − 1| / (D d + 1)` over the pixels with a disparity d, of the `depth` D and the `coverage` a, which
/// carries no gradient. 0 if no disparity is known.
///
/// With Z = 1 / d this is |D − Z| / (D + Z): the same for a scene of any size, for depths that are too large and too small
/// by the same factor, and at most 1, so that a wrong pixel of a map does not outweigh the others.
///
/// # Errors
/// [`crate::Error::Shape`] if the tensors differ in shape.
pub fn depth_map(depth: Tensor<3>, coverage: Tensor<3>, disparity: Tensor<3>) -> Result<Tensor<1>> {
    check_shape("disparity", &disparity, depth.dims())?;
    check_shape("coverage", &coverage, depth.dims())?;
    let unknown = disparity.clone().lower_equal_elem(0.0);
    let known = disparity.ones_like().mask_fill(unknown, 0.0);
    let count = known.clone().sum().clamp_min(1.0);
    let ratio = depth * disparity;
    let error = (ratio.clone() - 1.0).abs() / (ratio + 1.0);
    Ok((error * coverage.detach() * known).sum() / count)
}

/// The disparities `scale · r + shift` of the `relative` ones r, from 0 where unknown to 1, by the scale and shift that fit the
/// rendered `depth` best: by least squares of disparities, weighted by `coverage`. 0 everywhere if they do not rise
/// together, and where the result is not positive. Carries no gradient.
///
/// # Errors
/// [`crate::Error::Shape`] if the tensors differ in shape.
pub fn fitted_disparity(relative: Tensor<3>, depth: Tensor<3>, coverage: Tensor<3>) -> Result<Tensor<3>> {
    check_shape("relative disparity", &relative, depth.dims())?;
    check_shape("coverage", &coverage, depth.dims())?;
    let (depth, coverage) = (depth.detach(), coverage.detach());
    let unknown = relative.clone().lower_equal_elem(0.0);
    let nothing = depth.clone().lower_equal_elem(0.0);
    let weight = coverage.mask_fill(unknown.clone().bool_or(nothing.clone()), 0.0);
    let rendered = depth.mask_fill(nothing, 1.0).recip();
    let scalar = |sum: Tensor<1>| sum.reshape([1, 1, 1]);
    let total = scalar(weight.clone().sum()).clamp_min(TINY);
    let mean = |values: &Tensor<3>| scalar((weight.clone() * values.clone()).sum()) / total.clone();
    let (mean_relative, mean_rendered) = (mean(&relative), mean(&rendered));
    let centred = relative - mean_relative;
    let covariance = scalar((weight.clone() * centred.clone() * (rendered - mean_rendered.clone())).sum());
    let variance = scalar((weight * centred.clone() * centred.clone()).sum());
    let rises = covariance.clone().greater_elem(0.0).bool_and((variance.clone() / total).greater_elem(FLAT));
    let rises = covariance.zeros_like().mask_fill(rises, 1.0);
    let fitted = centred * (covariance / variance.clamp_min(TINY)) + mean_rendered;
    Ok((fitted.clamp_min(0.0) * rises).mask_fill(unknown, 0.0))
}

#[cfg(test)]
mod tests {
    use std::cell::OnceCell;

    use burn::tensor::DType;

    use super::*;
    use crate::ops::fixtures::{SURFEL_NAMES, SURFEL_WIDTHS, check_rows, constant, surfel_rows};
    use crate::ops::peel::PeelOptions;
    use crate::render::{RenderOptions, render};
    use crate::scene::{ColourModel, Footprint, Peeling, Surfels};
    use crate::testing::device;
    use crate::testing::golden::values;
    use crate::testing::random::Random;
    use crate::testing::scenes::{self, Recipe};

    fn row(values: &[f64]) -> Tensor<3> {
        constant(values, [1, 1, values.len()])
    }

    fn assert_close(found: &Tensor<3>, expected: &[f64], tolerance: f64) {
        let found = values(found);
        assert_eq!(found.len(), expected.len());
        found.iter().zip(expected).for_each(|(a, b)| assert!((a - b).abs() < tolerance, "{found:?}, not {expected:?}"));
    }

    #[test]
    fn errors_are_relative_weighted_by_coverage_and_only_where_maps_know_something() {
        // half, twice and 1.5 times as far as the map says; right; nothing rendered; nothing known
        let (depth, disparity) = ([1.0, 4.0, 3.0, 2.0, 0.0, 7.0], [0.5, 0.5, 0.5, 0.5, 0.5, 0.0]);
        let coverage = [1.0, 1.0, 0.5, 1.0, 0.0, 1.0];
        let loss = depth_map(row(&depth), row(&coverage), row(&disparity)).unwrap();
        let expected = (1.0 / 3.0 + 1.0 / 3.0 + 0.5 * 0.2) / 5.0;
        assert!((values(&loss)[0] - expected).abs() < 1e-14);
        let nothing = depth_map(row(&depth), row(&coverage), row(&[0.0; 6])).unwrap();
        assert_eq!(values(&nothing), [0.0]);
        let error = depth_map(row(&depth), row(&coverage), row(&[0.5; 5])).unwrap_err();
        assert!(error.to_string().contains("disparity"), "{error}");
    }

    #[test]
    fn scale_and_shift_of_relative_disparities_are_found() {
        let relative = [0.1, 0.9, 0.4, 0.0, 0.7, 0.2];
        let truth = relative.map(|r| 0.6 * r + 0.05);
        // nothing is known of the fourth pixel, nothing rendered at the last: they say nothing
        let mut depth = truth.map(f64::recip);
        (depth[3], depth[5]) = (9.0, 0.0);
        let coverage = [1.0, 0.5, 0.25, 1.0, 1.0, 0.0];
        let fitted = fitted_disparity(row(&relative), row(&depth), row(&coverage)).unwrap();
        assert_close(&fitted, &[truth[0], truth[1], truth[2], 0.0, truth[4], truth[5]], 1e-12);
        // what does not rise with the render, is of one value, or has nothing to be compared with
        let falling = fitted_disparity(row(&relative), row(&truth), row(&coverage)).unwrap();
        let flat = fitted_disparity(row(&[0.5; 6]), row(&depth), row(&coverage)).unwrap();
        let lone = fitted_disparity(row(&relative), row(&depth), row(&[0.0; 6])).unwrap();
        for nothing in [falling, flat, lone] {
            assert_eq!(values(&nothing), [0.0; 6]);
        }
        // 1.1, 0.6, 0.1 rendered: the line through them falls below 0 before 0.1
        let beyond =
            fitted_disparity(row(&[0.9, 0.6, 0.3, 0.1]), row(&[1.0 / 1.1, 1.0 / 0.6, 10.0, 0.0]), row(&[1.0; 4]));
        assert_close(&beyond.unwrap(), &[1.1, 0.6, 0.1, 0.0], 1e-12);
    }

    #[test]
    fn the_gradient_with_respect_to_surfels_is_central_differences() {
        let model = ColourModel::SphericalBeta { lobes: 0 };
        let recipe = Recipe { surfels: 7, gaussians: 2, model, width: 21, height: 18, ..Recipe::default() };
        let scene = scenes::random(7, &recipe);
        let camera = &scene.camera;
        let shape = [1, camera.height, camera.width];
        let mut disparities = Random::new(8).numbers(camera.width * camera.height, 0.2, 1.0);
        disparities.iter_mut().step_by(5).for_each(|disparity| *disparity = 0.0);
        let disparity = constant(&disparities, shape);
        let peel =
            PeelOptions { layer_count: 3, modulation: 1.5, footprint: Footprint::Opacity, peeling: Peeling::Nearest };
        let options = RenderOptions { peel, ..RenderOptions::default() };
        let fixed = OnceCell::new();
        let loss = |[positions, quaternions, log_scales]: &[Tensor<2>; 3]| {
            let (others, gaussians) = scene.tensors(&device(), DType::F64);
            let [positions, quaternions, log_scales] = [positions, quaternions, log_scales].map(Tensor::clone);
            let surfels = Surfels { positions, quaternions, log_scales, ..others };
            let [depth, coverage] = surfel_depth(&render(&surfels, &gaussians, camera, &options).unwrap());
            // coverage carries no gradient: it stays what it is at first
            let coverage = match fixed.set(coverage.clone().detach()) {
                Ok(()) => coverage,
                Err(_) => fixed.get().cloned().unwrap(),
            };
            depth_map(depth, coverage, disparity.clone()).unwrap()
        };
        let rows = surfel_rows(&scene.surfels);
        let gradients = check_rows("the depth map", SURFEL_NAMES, &rows, SURFEL_WIDTHS, 1e-6, loss);
        assert!(gradients.iter().all(|of| of.iter().any(|g| g.abs() > 1e-4)), "no surfel is seen");
    }
}

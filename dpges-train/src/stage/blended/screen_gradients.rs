//! How much the pictures want each Gaussian to move on the screen: what densification decides by.

use std::ops::Range;

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::camera::{Camera, Lens};
use dpges_core::ranks::Ranks;
use dpges_core::scene::Gaussians;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};

use crate::refine::densify::GradientSums;

/// Gradients of the loss with respect to the projected centres, summed over views, on the device. NDC units.
#[derive(Clone, Debug)]
pub struct ScreenGradients {
    /// [M] sum of their norms.
    signed: Tensor<1>,
    /// [M] sum of the norms of their absolute values, summed over pixels.
    absolute: Tensor<1>,
    /// [M] number of views that had the Gaussian in their picture, hidden or not.
    views: Tensor<1>,
}

impl ScreenGradients {
    /// Names of its columns in a checkpoint.
    pub const NAMES: [&'static str; 3] =
        ["screen_gradients.signed", "screen_gradients.absolute", "screen_gradients.views"];

    /// No view has been seen yet of `count` Gaussians.
    pub fn new(count: usize, device: &Device) -> Self {
        Self::from_columns([&vec![0.0; count], &vec![0.0; count], &vec![0.0; count]], device)
    }

    /// From what [`columns`](Self::columns) returned.
    pub fn from_columns(columns: [&Vec<f32>; 3], device: &Device) -> Self {
        let [signed, absolute, views] = columns
            .map(|column| Tensor::from_data(TensorData::new(column.clone(), [column.len()]), (device, DType::F32)));
        Self { signed, absolute, views }
    }

    /// In the order of [`NAMES`](Self::NAMES).
    pub fn columns(&self) -> [Vec<f32>; 3] {
        [&self.signed, &self.absolute, &self.views].map(tensor_to_rows)
    }

    /// Counts a view for the Gaussians of which something may be in its picture. `axes` of their scales count: 2 of discs,
    /// 3 of ellipsoids.
    pub fn see(&mut self, gaussians: &Gaussians, axes: usize, camera: &Camera) {
        if !gaussians.is_empty() {
            self.views = self.views.clone() + in_picture(gaussians, axes, camera);
        }
    }

    /// Adds the gradient [M, 4] of the probe of one view of each of `ranks`, whose first `signed` columns are a gradient, and the
    /// others that of absolute values.
    pub fn add(&mut self, probe: Tensor<2>, signed: usize, ranks: &dyn Ranks) {
        let [count, width] = probe.dims();
        let squares = probe.clone() * probe.clone();
        let norm =
            |columns: Range<usize>| squares.clone().slice([0..count, columns]).sum_dim(1).sqrt().reshape([count]);
        let (signed, absolute) = (ranks.joined(norm(0..signed)), ranks.joined(norm(signed..width)));
        self.signed = self.signed.clone() + signed;
        self.absolute = self.absolute.clone() + absolute;
    }

    /// On the host, for densification.
    pub fn sums(&self) -> GradientSums {
        let [signed, absolute, views] = self.columns();
        GradientSums { signed, absolute, views: views.into_iter().map(|views| views as u32).collect() }
    }
}

/// `[M]` 1 for each Gaussian in front of the near plane whose sphere of 3 of its largest σ reaches the picture, else 0
/// (3DGS takes the box of its ellipse).
fn in_picture(gaussians: &Gaussians, axes: usize, camera: &Camera) -> Tensor<1> {
    const SIGMAS: f64 = 3.0;
    let (positions, count) = (&gaussians.positions, gaussians.len());
    let pose = &camera.camera_from_world;
    let rotation: Vec<f32> = (0..3).flat_map(|i| pose.rotation.row(i).to_array()).map(|value| value as f32).collect();
    let rotation = rows_to_tensor(&rotation, 3, &positions.device(), DType::F32);
    let in_camera = positions.clone().matmul(rotation.transpose());
    let column = |i: usize| in_camera.clone().slice([0..count, i..i + 1]).reshape([count]) + pose.translation[i];
    let (x, y, z) = (column(0), column(1), column(2));
    let largest = gaussians.log_scales.clone().slice([0..count, 0..axes]).max_dim(1).reshape([count]).exp();
    if let Some(lens) = &camera.lens {
        return in_picture_of_lens(lens, [x, y, z], largest * SIGMAS, camera);
    }
    let ahead = z.clone().greater_elem(camera.near);
    let z = z.clamp_min(camera.near);
    let reach = |along: Tensor<1>, focal: f64, centre: f64, size: usize| {
        let half = size as f64 / 2.0;
        let from_middle = (along * focal / z.clone() + (centre - half)).abs();
        from_middle.lower(largest.clone() * (SIGMAS * focal) / z.clone() + half)
    };
    let beside = reach(x, camera.fx, camera.cx, camera.width);
    let above = reach(y, camera.fy, camera.cy, camera.height);
    ahead.bool_and(beside).bool_and(above).float()
}

/// The same through a lens: `radius` is that of the spheres, `[M]`. Positions are bent along their radius alone.
fn in_picture_of_lens(lens: &Lens, [x, y, z]: [Tensor<1>; 3], radius: Tensor<1>, camera: &Camera) -> Tensor<1> {
    let square = |t: &Tensor<1>| t.clone() * t.clone();
    let across = (square(&x) + square(&y)).sqrt().clamp_min(1e-12);
    let depth = if lens.is_wide() { (square(&across) + square(&z)).sqrt() } else { z.clone() };
    let mut ahead = depth.clone().greater_elem(camera.near);
    let depth = depth.clamp_min(camera.near);
    let undistorted = match lens.arc() {
        Some([kappa, omega]) => (across.clone() * kappa).atan2(z) / omega,
        None => across.clone() / depth.clone(),
    };
    ahead = ahead.bool_and(undistorted.clone().lower_equal_elem(lens.limit()));
    let squared = square(&undistorted.clamp_max(lens.limit()));
    let sum = |coefficients: &[f64]| {
        let zero = squared.zeros_like();
        coefficients.iter().rev().fold(zero, |sum, c| (sum + *c) * squared.clone()) + 1.0
    };
    let distortion = lens.distortion();
    let position = squared.clone().sqrt() * sum(&distortion.numerator) / sum(&distortion.denominator) / across;
    let reach = |along: Tensor<1>, focal: f64, centre: f64, size: usize| {
        let half = size as f64 / 2.0;
        let from_middle = (along * position.clone() * focal + (centre - half)).abs();
        from_middle.lower(radius.clone() * focal / depth.clone() + half)
    };
    let beside = reach(x, camera.fx, camera.cx, camera.width);
    let above = reach(y, camera.fy, camera.cy, camera.height);
    ahead.bool_and(beside).bool_and(above).float()
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::{CameraFromWorld, Distortion, Projection};
    use dpges_core::ranks::Alone;
    use dpges_core::scene::{ColourModel, GaussianData};
    use dpges_core::testing::random::Random;
    use glam::DVec3;

    use super::*;
    use crate::run::fixtures::camera;

    #[test]
    fn views_count_for_what_is_in_their_picture_hidden_or_not() {
        let camera_from_world = CameraFromWorld::look_at(DVec3::ZERO, DVec3::Z, -DVec3::Y);
        let camera = Camera { cx: 10.0, near: 0.5, ..camera(camera_from_world, 50.0, [40, 20]) };
        // seen, behind, too near, beyond the left border (10 px left of the axis), reaching over it, below the picture
        let positions =
            [[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [0.0, 0.0, 0.4], [-0.5, 0.0, 2.0], [-0.5, 0.0, 2.0], [0.0, 0.5, 2.0]];
        let mut data = GaussianData::neutral(ColourModel::SphericalBeta { lobes: 0 }, 6);
        data.positions = positions.as_flattened().to_vec();
        let scales = |scale: f32| [scale.ln(), scale.ln(), 2.0];
        data.log_scales = [0.01, 0.01, 0.01, 0.01, 0.05, 0.01].into_iter().flat_map(scales).collect();
        let device = Device::flex();
        let gaussians = Gaussians::from_data(&data, &device, DType::F32);
        let mut sums = ScreenGradients::new(6, &device);
        sums.see(&gaussians, 2, &camera);
        sums.see(&gaussians, 2, &camera);
        assert_eq!(sums.sums().views, [2, 0, 0, 0, 2, 0]);
        sums.see(&gaussians, 3, &camera);
        assert_eq!(sums.sums().views, [3, 0, 0, 1, 3, 1]);
    }

    #[test]
    fn through_a_lens_views_count_for_what_appears_in_their_picture() {
        let numerator = [0.05, -0.02, 0.0, 0.0, 0.0, 0.0];
        for projection in [Projection::Perspective, Projection::Equidistant, Projection::FieldOfView(1.2)] {
            let lens = Lens::new(Distortion { numerator, ..Distortion::new(projection) });
            let camera_from_world = CameraFromWorld::look_at(DVec3::ZERO, DVec3::new(0.2, 0.1, 1.0), -DVec3::Y);
            let (fx, fy) = if lens.is_wide() { (14.0, 15.0) } else { (30.0, 31.0) };
            let pinhole = camera(camera_from_world, fx, [40, 20]);
            let camera = Camera { fy, cx: 18.0, cy: 11.0, near: 0.05, lens: Some(lens), ..pinhole };
            let mut random = Random::new(3);
            let count = 400;
            let positions: Vec<f32> = (0..3 * count).map(|_| random.normal() as f32).collect();
            let mut data = GaussianData::neutral(ColourModel::SphericalBeta { lobes: 0 }, count);
            data.log_scales = vec![-20.0; 3 * count];
            data.positions = positions.clone();
            let device = Device::flex();
            let mut sums = ScreenGradients::new(count, &device);
            sums.see(&Gaussians::from_data(&data, &device, DType::F32), 3, &camera);
            let expected: Vec<u32> = positions
                .as_chunks::<3>()
                .0
                .iter()
                .map(|&position| u32::from(camera.pixel(DVec3::from(position.map(f64::from))).is_some()))
                .collect();
            assert_eq!(sums.sums().views, expected, "{projection:?}");
            assert!((6..count as u32 - 20).contains(&expected.iter().sum()), "{projection:?}");
        }
    }

    #[test]
    fn screen_gradients_are_summed_by_norm() {
        let device = Device::flex();
        let mut sums = ScreenGradients::new(2, &device);
        let probe = |rows: [f32; 8]| Tensor::from_data(TensorData::new(rows.to_vec(), [2, 4]), (&device, DType::F32));
        sums.add(probe([3.0, -4.0, 6.0, 8.0, 0.0, 0.0, 0.0, 0.0]), 2, &Alone);
        sums.add(probe([0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 1.0, 0.0]), 2, &Alone);
        let GradientSums { signed, absolute, views } = sums.sums();
        assert_eq!((signed, absolute, views), (vec![6.0, 0.0], vec![12.0, 1.0], vec![0, 0]));
        let mut sums = ScreenGradients::new(2, &device);
        sums.add(probe([2.0, -1.0, 2.0, 5.0, 0.0, 0.0, 0.0, 0.25]), 3, &Alone);
        let GradientSums { signed, absolute, .. } = sums.sums();
        assert_eq!((signed, absolute), (vec![3.0, 0.0], vec![5.0, 0.25]));
    }
}

//! The filter that keeps primitives from being finer than what the training views resolve (Mip-Splatting).

use burn::tensor::{DType, Device, Tensor};
use dpges_core::camera::Camera;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};
use dpges_core::scene::{GaussianData, Gaussians, SurfelData, Surfels};

use super::Context;
use crate::refine::sampling::finest_pixels;

/// Standard deviations of a filter in the world, one for each primitive. A Gaussian is drawn as itself convolved with its
/// filter: scales √(s² + f²), and an opacity that keeps its weight. A surfel gets the same scales, which widen its rim; it
/// stays opaque.
pub struct SamplingLimit {
    /// Width of the filter at the primitive, px.
    smoothing_px: f64,
    /// [N, 1] world units.
    deviations: Tensor<2>,
}

impl SamplingLimit {
    /// The filter of primitives at `positions` [N, 3], `smoothing_px` wide in the training view that resolves each best.
    pub fn new(positions: &Tensor<2>, smoothing_px: f64, context: &Context) -> Self {
        let cameras: Vec<&Camera> = context.dataset.train.iter().map(|view| &view.camera).collect();
        let coarsest = |own: f64| context.ranks.gather_numbers(&[own]).concat().into_iter().fold(0.0, f64::max);
        let mut deviations = finest_pixels(&tensor_to_rows(positions), &cameras, coarsest);
        deviations.iter_mut().for_each(|pixel| *pixel *= smoothing_px as f32);
        Self::from_column(&deviations, smoothing_px, &context.device)
    }

    /// From what [`column`](Self::column) returned.
    pub fn from_column(column: &[f32], smoothing_px: f64, device: &Device) -> Self {
        Self { smoothing_px, deviations: rows_to_tensor(column, 1, device, DType::F32) }
    }

    pub fn column(&self) -> Vec<f32> {
        tensor_to_rows(&self.deviations)
    }

    /// Measures anew, after Gaussians moved, came or went.
    pub fn measure(&mut self, positions: &Tensor<2>, context: &Context) {
        *self = Self::new(positions, self.smoothing_px, context);
    }

    /// `gaussians` as they are drawn. Gradients pass through to scales and opacities, none to the filter.
    pub fn smoothed(&self, gaussians: &Gaussians) -> Gaussians {
        let log_scales = self.widened(&gaussians.log_scales);
        let dimming = (gaussians.log_scales.clone() - log_scales.clone()).sum_dim(1).exp();
        Gaussians { opacities: gaussians.opacities.clone() * dimming, log_scales, ..gaussians.clone() }
    }

    /// `surfels` as they are drawn, with gradients as in [`smoothed`](Self::smoothed).
    pub fn smoothed_surfels(&self, surfels: &Surfels) -> Surfels {
        Surfels { log_scales: self.widened(&surfels.log_scales), ..surfels.clone() }
    }

    /// [`smoothed`](Self::smoothed) on the host.
    pub fn bake(&self, gaussians: &mut GaussianData) {
        let (deviations, scales) = (self.column(), gaussians.log_scales.as_chunks_mut::<3>().0);
        for ((scales, deviation), opacity) in scales.iter_mut().zip(deviations).zip(&mut gaussians.opacities) {
            let before: f64 = scales.iter().map(|&scale| f64::from(scale)).sum();
            widen(scales, deviation);
            *opacity *= (before - scales.iter().map(|&scale| f64::from(scale)).sum::<f64>()).exp() as f32;
        }
    }

    /// [`smoothed_surfels`](Self::smoothed_surfels) on the host.
    pub fn bake_surfels(&self, surfels: &mut SurfelData) {
        let scales = surfels.log_scales.as_chunks_mut::<2>().0;
        scales.iter_mut().zip(self.column()).for_each(|(scales, deviation)| widen(scales, deviation));
    }

    /// [N, A] logarithms of √(s² + f²), relative to the larger of the two so that neither overflows.
    fn widened(&self, log_scales: &Tensor<2>) -> Tensor<2> {
        let [count, axes] = log_scales.dims();
        if count == 0 {
            return log_scales.clone();
        }
        let filters = self.deviations.clone().clamp_min(f32::MIN_POSITIVE).log().expand([count, axes]);
        let filters = if log_scales.is_autodiff() { filters.autodiff() } else { filters };
        let largest = log_scales.clone().detach().max_pair(filters.clone());
        let squares = ((log_scales.clone() - largest.clone()) * 2.0).exp() + ((filters - largest.clone()) * 2.0).exp();
        largest + squares.log() * 0.5
    }
}

/// The same for the scales of one primitive.
fn widen(log_scales: &mut [f32], deviation: f32) {
    for scale in log_scales {
        *scale = (0.5 * ((2.0 * f64::from(*scale)).exp() + f64::from(deviation).powi(2)).ln()) as f32;
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::ColourData;
    use dpges_core::testing::gradients::central_differences;

    use super::*;
    use crate::run::fixtures::device;

    /// Standard deviations of two filters, world units: wider and narrower than what they filter.
    const DEVIATIONS: [f32; 2] = [0.3, 0.01];

    fn limit() -> SamplingLimit {
        SamplingLimit::from_column(&DEVIATIONS, 0.5, &device())
    }

    fn gaussians() -> GaussianData {
        GaussianData {
            positions: vec![0.0; 6],
            quaternions: [1.0, 0.0, 0.0, 0.0].repeat(2),
            log_scales: [0.1f32, 0.2, 0.4, 0.05, 0.1, 0.02].map(f32::ln).to_vec(),
            opacities: vec![0.5, 0.8],
            colour: ColourData { base: vec![0.0; 6], ..ColourData::default() },
            ..GaussianData::default()
        }
    }

    /// A sum over all that is drawn of one Gaussian, in f64: weights of logarithms of scales, and 1 of the opacity.
    fn drawn(log_scales: &[f64], opacity: f64, deviation: f64, weights: [f64; 3]) -> f64 {
        let widened: Vec<f64> =
            log_scales.iter().map(|s| 0.5 * ((2.0 * s).exp() + deviation * deviation).ln()).collect();
        let dimming: f64 = log_scales.iter().zip(&widened).map(|(before, after)| before - after).sum();
        widened.iter().zip(weights).map(|(scale, weight)| scale * weight).sum::<f64>() + opacity * dimming.exp()
    }

    #[test]
    fn gradients_are_central_differences() {
        let weights = [0.7f64, -0.4, 1.3];
        let tape = device().autodiff();
        let mut leaves = Gaussians::from_data(&gaussians(), &tape, DType::F32);
        leaves.log_scales = leaves.log_scales.require_grad();
        leaves.opacities = leaves.opacities.require_grad();
        let smoothed = limit().smoothed(&leaves);
        let row: Vec<f32> = weights.iter().map(|&weight| weight as f32).collect();
        let loss = (smoothed.log_scales * rows_to_tensor(&row, 3, &tape, DType::F32)).sum() + smoothed.opacities.sum();
        let gradients = loss.backward();
        let of = |tensor: &Tensor<2>| tensor_to_rows(&tensor.grad(&gradients).expect("on the tape"));
        let (scales, opacities) = (of(&leaves.log_scales), of(&leaves.opacities));
        for (row, deviation) in DEVIATIONS.into_iter().enumerate() {
            let numbers = |scales: &[f32], opacities: &[f32]| -> Vec<f64> {
                scales[3 * row..][..3].iter().chain(&opacities[row..=row]).map(|&number| number.into()).collect()
            };
            let at = numbers(&gaussians().log_scales, &gaussians().opacities);
            let loss = |at: &[f64]| drawn(&at[..3], at[3], deviation.into(), weights);
            let expected = central_differences(&at, &[0, 1, 2, 3], 1e-5, loss);
            for (found, expected) in numbers(&scales, &opacities).into_iter().zip(expected) {
                assert!((found - expected.unwrap()).abs() < 1e-5, "of {row}: {found}, expected {expected:?}");
            }
        }
    }

    #[test]
    fn what_is_baked_is_what_a_step_draws() {
        let limit = limit();
        let mut baked = gaussians();
        limit.bake(&mut baked);
        let smoothed = limit.smoothed(&Gaussians::from_data(&gaussians(), &device(), DType::F32));
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6) && a.len() == b.len();
        assert!(near(&baked.log_scales, &tensor_to_rows(&smoothed.log_scales)));
        assert!(near(&baked.opacities, &tensor_to_rows(&smoothed.opacities)));
        // a Gaussian keeps its weight, opacity times volume
        let volume = |data: &GaussianData| data.opacities[0] * data.log_scales[..3].iter().sum::<f32>().exp();
        assert!((volume(&baked) / volume(&gaussians()) - 1.0).abs() < 1e-5);
        assert!((baked.log_scales[0].exp() - 0.1f32.hypot(0.3)).abs() < 1e-6);

        let surfels = SurfelData {
            positions: vec![0.0; 6],
            quaternions: [1.0, 0.0, 0.0, 0.0].repeat(2),
            log_scales: [0.1f32, 0.2, 0.05, 0.1].map(f32::ln).to_vec(),
            colour: ColourData { base: vec![0.0; 6], ..ColourData::default() },
            margins: vec![0.1; 2],
        };
        let mut baked = surfels.clone();
        limit.bake_surfels(&mut baked);
        let smoothed = limit.smoothed_surfels(&Surfels::from_data(&surfels, &device(), DType::F32));
        assert!(near(&baked.log_scales, &tensor_to_rows(&smoothed.log_scales)));
        assert!((baked.log_scales[1].exp() - 0.2f32.hypot(0.3)).abs() < 1e-6);
    }

    #[test]
    fn extreme_scales_stay_finite() {
        let data = GaussianData { log_scales: vec![80.0, -80.0, 0.0, 60.0, -100.0, -60.0], ..gaussians() };
        let mut leaves = Gaussians::from_data(&data, &device().autodiff(), DType::F32);
        leaves.log_scales = leaves.log_scales.require_grad();
        let limit = SamplingLimit::from_column(&[0.3, 0.0], 0.5, &device());
        let smoothed = limit.smoothed(&leaves);
        let gradients = smoothed.log_scales.clone().sum().backward();
        let found = tensor_to_rows(&smoothed.log_scales);
        let gradient = tensor_to_rows(&leaves.log_scales.grad(&gradients).unwrap());
        for (at, (expected, slope)) in
            [(80.0, 1.0), (0.3f32.ln(), 0.0), (0.5 * 1.09f32.ln(), 1.0 / 1.09), (60.0, 1.0)].into_iter().enumerate()
        {
            assert!(
                (found[at] - expected).abs() < 1e-5 && (gradient[at] - slope).abs() < 1e-5,
                "{found:?} {gradient:?}"
            );
        }
        assert!(found.iter().chain(&gradient).all(|value| value.is_finite()), "{found:?} {gradient:?}");
    }

    #[test]
    fn no_primitives_are_drawn_as_none() {
        let none = SamplingLimit::from_column(&[], 0.5, &device());
        let empty = GaussianData::neutral(dpges_core::scene::ColourModel::SphericalBeta { lobes: 0 }, 0);
        assert_eq!(none.smoothed(&Gaussians::from_data(&empty, &device(), DType::F32)).opacities.dims(), [0, 1]);
    }
}

//! Colour corrections of the training views in training: whether a run has them, their steps.

use std::collections::HashMap;

use burn::tensor::{Device, Tensor};
use dpges_core::ops::adam::AdamStep;
use dpges_core::scene::schema::{Activation, Attribute, RateGroup, Width};

use crate::optimizer::{NamedGradient, Parameter, ParameterRows};
use crate::views::exposure::Correction;

/// [views, 6]: of each training view three logarithms of gains, three offsets.
static EXPOSURE: Attribute = Attribute {
    name: "exposure",
    raw_name: "exposure",
    width: Width::Fixed(6),
    activation: Activation::Identity,
    rate: RateGroup::Exposure,
    neutral: &[0.0],
};
/// Spread of brightness above which a run with `train.exposure = "auto"` corrects exposures, stops.
pub const LARGE_SPREAD: f64 = 0.1;

/// The corrections of a run, [views, 6]; `None` in runs without any. Their means over the views are 0, so that the scene cannot
/// change its own exposure through them.
pub type ExposureState = Option<Parameter>;

/// Corrections of `views` views that change nothing yet.
pub fn fresh(views: usize, device: &Device) -> ExposureState {
    Some(Parameter::fresh(&EXPOSURE, &vec![0.0; 6 * views], [views, 6], device))
}

/// Takes the corrections of `views` views out of `rows`, if there are any.
///
/// # Errors
/// A message if they are those of other views, or have no moments.
pub fn from_rows(
    rows: &mut HashMap<String, ParameterRows>,
    views: usize,
    device: &Device,
) -> Result<ExposureState, String> {
    Parameter::take(&EXPOSURE, rows, 6, |count| count == views, views, device)
}

/// The corrections of all training views, by their indices; none if photographs are taken as they are.
pub fn corrections(state: &ExposureState) -> Vec<Correction> {
    let rows = state.as_ref().map(Parameter::raw_rows).unwrap_or_default();
    rows.as_chunks().0.iter().map(Correction::of_row).collect()
}

/// Takes a step and takes the means over the views away. Nothing changes where `gate` `[1]` is not 1.
pub fn step(
    state: &mut ExposureState,
    gradient: Option<NamedGradient>,
    gate: &Tensor<1>,
    step: AdamStep,
) -> dpges_core::Result<()> {
    let Some(parameter) = state else { return Ok(()) };
    parameter.step(gradient.and_then(|(_, gradient)| gradient), gate, step)?;
    let raw = parameter.raw();
    let mean = raw.clone().mean_dim(0) * gate.clone().reshape([1, 1]);
    parameter.set_tensor(raw - mean);
    Ok(())
}

/// `image` [3, H, W] of the scene as a photograph with `correction` [1, 6], a row of the leaf of its [state](ExposureState),
/// shows it. Gradients reach both.
pub fn photographed(image: Tensor<3>, correction: &Tensor<2>) -> Tensor<3> {
    let part = |from: usize| correction.clone().slice([0..1, from..from + 3]).reshape([3, 1, 1]);
    image * part(0).exp() + part(3)
}

#[cfg(test)]
mod tests {
    use burn::tensor::{DType, TensorData};
    use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};
    use dpges_core::testing::golden::values;
    use dpges_core::testing::gradients::{check, leaf};

    use super::*;

    const STEP: AdamStep = AdamStep { learning_rate: 0.1, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 1 };

    /// A state of three views, of which these were stepped.
    fn stepped(views: &[usize]) -> ExposureState {
        let mut state = fresh(3, &Device::flex());
        views.iter().for_each(|&view| take_step(&mut state, view, 1.0));
        state
    }

    fn take_step(state: &mut ExposureState, view: usize, open: f32) {
        let mut gradient = vec![0.0; 18];
        gradient[6 * view..][..6].copy_from_slice(&[1.0, -1.0, 2.0, -0.5, 0.25, -3.0]);
        let gradient = rows_to_tensor(&gradient, 6, &Device::flex(), DType::F32);
        let gate = Tensor::full([1], open, (&Device::flex(), DType::F32));
        step(state, Some((&EXPOSURE, Some(gradient))), &gate, STEP).unwrap();
    }

    fn raw(state: &ExposureState) -> Vec<f32> {
        state.as_ref().unwrap().raw_rows()
    }

    #[test]
    fn means_over_the_views_stay_zero_and_a_closed_gate_changes_nothing() {
        let mut state = stepped(&[]);
        for view in [0, 1, 0, 2, 0] {
            take_step(&mut state, view, 1.0);
            let raw = raw(&state);
            for column in 0..6 {
                let sum: f32 = raw.iter().skip(column).step_by(6).sum();
                assert!(sum.abs() < 1e-6, "column {column} sums to {sum}");
            }
        }
        let before = raw(&state);
        assert!(before.iter().all(|value| *value != 0.0), "{before:?}");
        take_step(&mut state, 1, 0.0);
        assert_eq!(raw(&state), before);
    }

    #[test]
    fn a_first_step_moves_the_view_away_from_the_others() {
        let state = stepped(&[1]);
        let raw = raw(&state);
        // −0.1 for the view, then the mean of −0.1/3 taken away
        for (row, expected) in [(0, 0.1 / 3.0), (1, -0.2 / 3.0), (2, 0.1 / 3.0)] {
            assert!((raw[6 * row] - expected).abs() < 1e-6 && (raw[6 * row + 1] + expected).abs() < 1e-6, "{raw:?}");
        }
        let corrections = corrections(&state);
        assert_eq!(corrections.len(), 3);
        assert!((corrections[1].gain[0] - (-0.2f64 / 3.0).exp()).abs() < 1e-6);
        assert!((corrections[1].offset[0] - f64::from(raw[9])).abs() < 1e-9);
    }

    #[test]
    fn rows_come_back_and_those_of_other_views_do_not() {
        let device = Device::flex();
        let (name, rows) = stepped(&[2]).unwrap().named_rows();
        let saved = || HashMap::from([(name.to_owned(), rows.clone())]);
        let back = from_rows(&mut saved(), 3, &device).unwrap().unwrap();
        assert_eq!(back.rows(), rows);
        let refused = from_rows(&mut saved(), 4, &device).unwrap_err();
        assert!(refused.contains("3 × 6, expected 4 × 6"), "{refused}");
        assert!(from_rows(&mut HashMap::new(), 3, &device).unwrap().is_none());
        assert!(corrections(&None).is_empty());
    }

    #[test]
    fn a_corrected_image_is_what_the_correction_says() {
        let device = Device::flex();
        let row = [0.25, -0.5, 0.0, 0.125, 0.0, -0.25];
        let image: Vec<f32> = (0..3 * 2 * 2).map(|i| i as f32 / 12.0).collect();
        let image = Tensor::from_data(TensorData::new(image, [3, 2, 2]), (&device, DType::F32));
        let found = tensor_to_rows(&photographed(image.clone(), &rows_to_tensor(&row, 6, &device, DType::F32)));
        let expected = tensor_to_rows(&Correction::of_row(&row).applied(image));
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} {expected:?}");
    }

    #[test]
    fn the_gradient_of_the_correction_is_central_differences() {
        let device = dpges_core::testing::device();
        let image: Vec<f64> = (0..12).map(|i| f64::from(i * 5 % 12) / 12.0).collect();
        let weights: Vec<f64> = (0..12).map(|i| f64::from(i * 7 % 11) - 4.5).collect();
        let weights = leaf(&weights, [3, 2, 2], &device).detach();
        let row = [0.3, -0.4, 0.1, 0.05, -0.1, 0.2];
        let loss = |image: &Tensor<3>, row: &Tensor<2>| {
            (photographed(image.clone(), row).powi_scalar(2) * weights.clone()).sum()
        };
        let image_of = |numbers: &[f64]| leaf(numbers, [3, 2, 2], &device);
        let row_of = |numbers: &[f64]| leaf(numbers, [1, 6], &device);
        let (image_leaf, row_leaf) = (image_of(&image), row_of(&row));
        let gradients = loss(&image_leaf, &row_leaf).backward();
        let by_image = values(&image_leaf.grad(&gradients).unwrap());
        let by_row = values(&row_leaf.grad(&gradients).unwrap());
        check("image", &image, &by_image, 1e-5, |moved| values(&loss(&image_of(moved), &row_leaf))[0]);
        check("exposure", &row, &by_row, 1e-5, |moved| values(&loss(&image_leaf, &row_of(moved)))[0]);
    }
}

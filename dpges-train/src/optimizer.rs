//! Adam over the attributes of a scene, and the edits of rows that keep its moments. All of it stays on the device.

use burn::tensor::{Bool, DType, Device, Gradients, Int, Tensor, TensorData};
use dpges_core::ops::adam::{AdamParameter, AdamState, AdamStep, adam_step};
use dpges_core::scene::schema::Attribute;
use dpges_core::scene::tensors::{row_indices, tensor_to_rows};

/// One attribute of all primitives of a kind: its raw numbers and, if it learns, its two Adam moments.
#[derive(Clone, Debug)]
pub struct Parameter {
    attribute: &'static Attribute,
    /// [rows, width]
    raw: Tensor<2>,
    /// [2, rows, width] first and second.
    moments: Option<Tensor<3>>,
}

/// A [`Parameter`] in host memory.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterRows {
    pub count: usize,
    pub width: usize,
    pub raw: Vec<f32>,
    pub moments: Option<[Vec<f32>; 2]>,
}

impl Parameter {
    /// Raw numbers [`count`, `width`] that have not been stepped yet.
    pub fn fresh(attribute: &'static Attribute, raw: &[f32], [count, width]: [usize; 2], device: &Device) -> Self {
        let raw = tensor(raw, [count, width], device);
        let moments = attribute.learns().then(|| zeros([2, count, width], device));
        Self { attribute, raw, moments }
    }

    pub fn from_rows(attribute: &'static Attribute, rows: &ParameterRows, device: &Device) -> Self {
        let shape = [rows.count, rows.width];
        let moments = rows.moments.as_ref();
        let moments = moments.map(|moments| tensor(&moments.concat(), [2, rows.count, rows.width], device));
        Self { attribute, raw: tensor(&rows.raw, shape, device), moments }
    }

    pub fn rows(&self) -> ParameterRows {
        let [count, width] = self.raw.dims();
        let moments = self.moments.as_ref().map(|moments| {
            let mut first = tensor_to_rows(moments);
            let second = first.split_off(count * width);
            [first, second]
        });
        ParameterRows { count, width, raw: tensor_to_rows(&self.raw), moments }
    }

    /// [rows, width] the raw numbers, not on a tape.
    pub fn raw(&self) -> Tensor<2> {
        self.raw.clone()
    }

    /// [rows, width] the raw numbers on a new tape; a leaf of it if the attribute learns.
    pub fn leaf(&self) -> Tensor<2> {
        let raw = self.raw.clone().autodiff();
        if self.attribute.learns() { raw.require_grad() } else { raw }
    }

    /// The gradient that a backward pass left for a [`leaf`](Self::leaf); `None` if nothing reached it.
    pub fn gradient(&self, leaf: &Tensor<2>, gradients: &mut Gradients) -> Option<Tensor<2>> {
        if self.attribute.learns() { leaf.grad_remove(gradients) } else { None }
    }

    /// Replaces all raw numbers; the moments stay.
    ///
    /// # Panics
    /// If `raw` has another length.
    pub fn set(&mut self, raw: &[f32]) {
        self.raw = tensor(raw, self.raw.dims(), &self.raw.device());
    }

    /// Replaces all raw numbers by those of a tensor [rows, width] on the same device; the moments stay.
    pub fn set_tensor(&mut self, raw: Tensor<2>) {
        self.raw = raw;
    }

    /// Replaces all raw numbers; the moments start again.
    ///
    /// # Panics
    /// If `raw` has another length.
    pub fn restart(&mut self, raw: &[f32]) {
        *self = Self::fresh(self.attribute, raw, self.raw.dims(), &self.raw.device());
    }

    /// Keeps the `kept` rows and appends `added_count` rows with the raw numbers `added`, whose moments are zero (3DGS).
    ///
    /// # Panics
    /// If `added` has another length.
    pub fn edit(&mut self, kept: &Rows, added: &[f32], added_count: usize) {
        let [_, width] = self.raw.dims();
        let device = self.raw.device();
        self.raw = joined(kept.of(&self.raw, 0), || tensor(added, [added_count, width], &device), added_count, 0);
        if let Some(moments) = &mut self.moments {
            *moments = joined(kept.of(moments, 1), || zeros([2, added_count, width], &device), added_count, 1);
        }
    }

    /// Row i becomes a copy of row i of `copied`. Moments stay with their place; they are zero in places that are new,
    /// and where `fresh` [rows of the new set, 1] is true (3DGS-MCMC).
    pub fn copy_rows(&mut self, copied: &Rows, fresh: &Tensor<2, Bool>) {
        let [count, width] = self.raw.dims();
        let added = copied.len() - count;
        self.raw = copied.of(&self.raw, 0);
        if let Some(moments) = &mut self.moments {
            let device = moments.device();
            let extended = joined(moments.clone(), || zeros([2, added, width], &device), added, 1);
            *moments = if extended.shape().num_elements() == 0 {
                extended
            } else {
                let fresh = fresh.clone().reshape([1, copied.len(), 1]).expand([2, -1, width as i64]);
                extended.mask_fill(fresh, 0.0)
            };
        }
    }
}

/// A step of several parameters, which costs a GPU one launch for every two.
#[derive(Default)]
pub struct OptimizerStep<'a> {
    parameters: Vec<&'a mut Parameter>,
    /// What they hold until the step is taken.
    inputs: Vec<AdamParameter<'static>>,
}

impl<'a> OptimizerStep<'a> {
    /// Adds a parameter, if it learns and has any numbers. Without `gradient`, [rows, width], its moments fade.
    pub fn add(&mut self, parameter: &'a mut Parameter, gradient: Option<Tensor<2>>, learning_rate: f64) {
        if parameter.raw.shape().num_elements() == 0 {
            return;
        }
        let Some(moments) = parameter.moments.take() else { return };
        let name = parameter.attribute.raw_name;
        let gradient = gradient.unwrap_or_else(|| parameter.raw.zeros_like());
        // Moved out, so that the step can work in place; the gradient holds the place.
        let value = std::mem::replace(&mut parameter.raw, gradient.clone());
        self.inputs.push(AdamParameter { name, state: AdamState { value, moments }, gradient, learning_rate });
        self.parameters.push(parameter);
    }

    /// Takes the step. Nothing changes where `gate` `[1]` is not 1.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if a gradient belongs to another set of rows.
    pub fn take(self, gate: &Tensor<1>, step: &AdamStep) -> dpges_core::Result<()> {
        let stepped = adam_step(self.inputs, gate, step)?;
        for (parameter, AdamState { value, moments }) in self.parameters.into_iter().zip(stepped) {
            (parameter.raw, parameter.moments) = (value, Some(moments));
        }
        Ok(())
    }
}

/// Rows of a set, in a new order or fewer of them, on the device of the set.
pub struct Rows {
    /// `None` where all rows stay in place.
    indices: Option<Tensor<1, Int>>,
    count: usize,
}

impl Rows {
    /// `rows` of a set that has `of` of them.
    pub fn new(rows: &[usize], of: usize, device: &Device) -> Self {
        let all = rows.len() == of && rows.iter().enumerate().all(|(at, &row)| at == row);
        Self { indices: (!all).then(|| row_indices(rows, device)), count: rows.len() }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// `values` of these rows alone, which are its dimension `rows`.
    fn of<const D: usize>(&self, values: &Tensor<D>, rows: usize) -> Tensor<D> {
        let mut shape = values.dims();
        shape[rows] = self.count;
        match &self.indices {
            None => values.clone(),
            Some(_) if shape.contains(&0) => zeros(shape, &values.device()),
            Some(indices) => values.clone().select(rows, indices.clone()),
        }
    }
}

/// `kept`, followed along the dimension `rows` by `added`, which has `count` of them.
fn joined<const D: usize>(kept: Tensor<D>, added: impl FnOnce() -> Tensor<D>, count: usize, rows: usize) -> Tensor<D> {
    match (kept.dims()[rows], count) {
        (_, 0) => kept,
        (0, _) => added(),
        _ => Tensor::cat(vec![kept, added()], rows),
    }
}

fn tensor<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), (device, DType::F32))
}

/// Not by a kernel, which some devices refuse to launch over nothing.
fn zeros<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    if shape.contains(&0) { tensor(&[], shape, device) } else { Tensor::zeros(shape, (device, DType::F32)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dpges_core::scene::schema::{Columns, SurfelColumns};
    use dpges_core::scene::tensors::rows_to_tensor;

    const STEP: AdamStep = AdamStep { beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 1 };
    /// Two numbers wide.
    const LOG_SCALES: &Attribute = &SurfelColumns::<()>::ATTRIBUTES[2];
    /// Does not learn.
    const MARGINS: &Attribute = &SurfelColumns::<()>::ATTRIBUTES[3];

    fn open(device: &Device) -> Tensor<1> {
        Tensor::ones([1], (device, DType::F32))
    }

    fn fresh_rows(rows: &[bool], device: &Device) -> Tensor<2, Bool> {
        Tensor::<1, Bool>::from_data(TensorData::new(rows.to_vec(), [rows.len()]), device).reshape([rows.len(), 1])
    }

    /// One step of `parameter` alone.
    fn step(parameter: &mut Parameter, gradient: Option<&[f32]>) {
        let [_, width] = parameter.raw().dims();
        let device = parameter.raw().device();
        let gradient = gradient.map(|rows| rows_to_tensor(rows, width, &device, DType::F32));
        let mut step = OptimizerStep::default();
        step.add(parameter, gradient, 0.1);
        step.take(&open(&device), &STEP).unwrap();
    }

    fn moments(parameter: &Parameter) -> [Vec<f32>; 2] {
        parameter.rows().moments.unwrap()
    }

    #[test]
    fn edits_keep_the_moments_of_kept_rows_and_zero_those_of_new_ones() {
        let device = Device::flex();
        let mut parameter = Parameter::fresh(LOG_SCALES, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [3, 2], &device);
        step(&mut parameter, Some(&[1.0, -1.0, 0.0, 2.0, -3.0, 4.0]));
        let before = parameter.rows();
        parameter.edit(&Rows::new(&[0, 2], 3, &device), &[7.0, 8.0], 1);
        let after = parameter.rows();
        assert_eq!(after.raw[..2], before.raw[..2]);
        assert_eq!(after.raw[2..], [before.raw[4], before.raw[5], 7.0, 8.0]);
        for (after, before) in after.moments.unwrap().iter().zip(&before.moments.unwrap()) {
            assert_eq!(after[..4], [before[0], before[1], before[4], before[5]]);
            assert_eq!(after[4..], [0.0, 0.0]);
        }
    }

    #[test]
    fn the_first_step_is_the_learning_rate_towards_less_loss_and_none_is_taken_without_gradient() {
        let device = Device::flex();
        let mut parameter = Parameter::fresh(LOG_SCALES, &[1.0, 1.0], [1, 2], &device);
        step(&mut parameter, Some(&[5.0, -0.001]));
        let stepped = parameter.rows().raw;
        assert!((stepped[0] - 0.9).abs() < 1e-5 && (stepped[1] - 1.1).abs() < 1e-5, "{stepped:?}");
        let mut untouched = Parameter::fresh(LOG_SCALES, &[1.0, 2.0], [1, 2], &device);
        step(&mut untouched, None);
        assert_eq!(untouched.rows().raw, [1.0, 2.0]);
    }

    #[test]
    fn parameters_that_are_stepped_together_keep_their_gradients_and_rates() {
        let device = Device::flex();
        let starts: [&[f32]; 4] = [&[1.0, 2.0], &[], &[3.0, 4.0, 5.0, 6.0], &[7.0, 8.0]];
        let fresh = || starts.map(|raw| Parameter::fresh(LOG_SCALES, raw, [raw.len() / 2, 2], &device));
        let (mut together, mut alone) = (fresh(), fresh());
        let gradients = starts.map(|raw| raw.iter().map(|value| 4.5 - value).collect::<Vec<_>>());
        let mut all = OptimizerStep::default();
        for (at, (parameter, gradient)) in together.iter_mut().zip(&gradients).enumerate() {
            let gradient = rows_to_tensor(gradient, 2, &device, DType::F32);
            // the last has none
            all.add(parameter, (at < 3).then_some(gradient), [0.1, 0.1, 0.01, 0.1][at]);
        }
        all.take(&open(&device), &STEP).unwrap();
        for at in [0, 1, 3] {
            step(&mut alone[at], (at < 3).then_some(&gradients[at][..]));
            assert_eq!(together[at].rows(), alone[at].rows());
        }
        let [.., slow, _] = together;
        let moved: Vec<f32> = slow.rows().raw.iter().zip(starts[2]).map(|(after, before)| after - before).collect();
        assert!(
            moved.iter().zip(&gradients[2]).all(|(moved, g)| (moved + 0.01 * g.signum()).abs() < 1e-6),
            "{moved:?}"
        );
    }

    #[test]
    fn a_gradient_of_other_rows_is_refused_by_the_name_of_its_attribute() {
        let device = Device::flex();
        let mut parameter = Parameter::fresh(LOG_SCALES, &[1.0, 2.0], [1, 2], &device);
        let mut step = OptimizerStep::default();
        step.add(&mut parameter, Some(rows_to_tensor(&[1.0; 4], 2, &device, DType::F32)), 0.1);
        let error = step.take(&open(&device), &STEP).unwrap_err().to_string();
        assert!(error.contains("gradient of surfels.log_scales"), "{error}");
    }

    #[test]
    fn what_does_not_learn_has_no_moments_and_is_edited_all_the_same() {
        let device = Device::flex();
        let mut margins = Parameter::fresh(MARGINS, &[0.1, 0.2, 0.3], [3, 1], &device);
        step(&mut margins, Some(&[1.0; 3]));
        margins.edit(&Rows::new(&[2, 0], 3, &device), &[0.4], 1);
        let rows = margins.rows();
        assert_eq!((rows.raw, rows.moments), (vec![0.3, 0.1, 0.4], None));
    }

    #[test]
    fn copied_rows_leave_their_moments_in_place() {
        let device = Device::flex();
        let moments_before = [vec![0.1, 0.1, 0.2, 0.2, 0.3, 0.3], vec![0.4, 0.4, 0.5, 0.5, 0.6, 0.6]];
        let raw = vec![1.0, 1.5, 2.0, 2.5, 3.0, 3.5];
        let rows = ParameterRows { count: 3, width: 2, raw, moments: Some(moments_before) };
        let mut parameter = Parameter::from_rows(LOG_SCALES, &rows, &device);
        let copied = Rows::new(&[0, 2, 2, 0], 3, &device);
        parameter.copy_rows(&copied, &fresh_rows(&[false, false, true, true], &device));
        assert_eq!(parameter.rows().raw, [1.0, 1.5, 3.0, 3.5, 3.0, 3.5, 1.0, 1.5]);
        let [first, second] = moments(&parameter);
        assert_eq!(first, [0.1, 0.1, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(second, [0.4, 0.4, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0]);
        parameter.set(&[5.0; 8]);
        assert_eq!((parameter.rows().raw, moments(&parameter)[0][2]), (vec![5.0; 8], 0.2));
        parameter.restart(&[6.0; 8]);
        assert_eq!((parameter.rows().raw, moments(&parameter)), (vec![6.0; 8], [vec![0.0; 8], vec![0.0; 8]]));
    }

    #[test]
    fn all_rows_may_go_and_come_back() {
        let device = Device::flex();
        let mut parameter = Parameter::fresh(LOG_SCALES, &[1.0, 2.0], [1, 2], &device);
        parameter.edit(&Rows::new(&[], 1, &device), &[], 0);
        assert_eq!(parameter.raw().dims(), [0, 2]);
        step(&mut parameter, None);
        parameter.edit(&Rows::new(&[], 0, &device), &[3.0, 4.0], 1);
        assert_eq!(parameter.rows().raw, [3.0, 4.0]);
    }
}

//! Adam over the attributes of a scene, and the row surgery that keeps its moments.

use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use dpges_core::ops::adam::{AdamStep, adam_step};
use dpges_core::scene::data::select_rows;
use dpges_core::scene::tensors::tensor_to_rows;

use crate::refine::RowEdit;

/// One attribute of all primitives of a kind: its raw values and its two Adam moments, each [rows, width].
#[derive(Clone, Debug)]
pub struct Attribute {
    name: &'static str,
    value: Tensor<2>,
    moments: [Tensor<2>; 2],
}

/// Values and moments of an attribute in host memory.
#[derive(Clone, Debug, PartialEq)]
pub struct AttributeRows {
    pub count: usize,
    pub width: usize,
    pub value: Vec<f32>,
    pub moments: [Vec<f32>; 2],
}

impl AttributeRows {
    /// Values that have not been stepped yet.
    pub fn fresh(value: Vec<f32>, [count, width]: [usize; 2]) -> Self {
        let moments = [vec![0.0; value.len()], vec![0.0; value.len()]];
        Self { count, width, value, moments }
    }

    /// The kept rows, followed by `added` (`added_count` rows) with zero moments.
    fn edit(&self, edit: &RowEdit, added: &[f32], added_count: usize) -> Self {
        let edited = |rows: &[f32], appended: &[f32]| {
            let mut rows = select_rows(rows, self.width, &edit.keep);
            rows.extend(appended);
            rows
        };
        let zeros = vec![0.0; added.len()];
        Self {
            count: edit.keep.len() + added_count,
            width: self.width,
            value: edited(&self.value, added),
            moments: [edited(&self.moments[0], &zeros), edited(&self.moments[1], &zeros)],
        }
    }
}

impl Attribute {
    /// `name` is how errors speak of it, as in `gaussians.positions`.
    pub fn new(name: &'static str, rows: &AttributeRows, device: &Device) -> Self {
        let shape = [rows.count, rows.width];
        let tensor = |values: &[f32]| Tensor::from_data(TensorData::new(values.to_vec(), shape), (device, DType::F32));
        Self { name, value: tensor(&rows.value), moments: [tensor(&rows.moments[0]), tensor(&rows.moments[1])] }
    }

    pub fn rows(&self) -> AttributeRows {
        let [count, width] = self.value.dims();
        AttributeRows {
            count,
            width,
            value: tensor_to_rows(&self.value),
            moments: [tensor_to_rows(&self.moments[0]), tensor_to_rows(&self.moments[1])],
        }
    }

    pub fn name(&self) -> &'static str {
        self.name
    }

    /// [rows, width], not on a tape.
    pub fn value(&self) -> Tensor<2> {
        self.value.clone()
    }

    /// [rows, width], a leaf of a new tape.
    pub fn leaf(&self) -> Tensor<2> {
        self.value.clone().autodiff().require_grad()
    }

    /// The gradient that a backward pass left for a [`leaf`](Self::leaf); `None` if nothing reached it.
    pub fn gradient(&self, leaf: &Tensor<2>, gradients: &mut Gradients) -> Option<Tensor<2>> {
        leaf.grad_remove(gradients)
    }

    /// Nothing changes where `gate` `[1]` is not 1.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if the gradient belongs to another set of rows.
    pub fn step(&mut self, gradient: Option<Tensor<2>>, gate: &Tensor<1>, step: AdamStep) -> dpges_core::Result<()> {
        let gradient = gradient.unwrap_or_else(|| self.value.zeros_like());
        // moved out, so that the step can work in place
        let empty = || Tensor::empty([0, 0], &self.value.device());
        let (no_value, no_moments) = (empty(), [empty(), empty()]);
        let value = std::mem::replace(&mut self.value, no_value);
        let moments = std::mem::replace(&mut self.moments, no_moments);
        (self.value, self.moments) = adam_step(value, moments, gradient, gate.clone(), step)?;
        Ok(())
    }

    /// Row i becomes a copy of row `rows[i]`, or of row i of `values` where they are given. Moments stay with their
    /// place, and are zero in places that are new or `fresh` (3DGS-MCMC).
    pub fn copy_rows(&mut self, rows: &[usize], values: Option<&[f32]>, fresh: &[bool]) {
        let old = self.rows();
        let width = old.width;
        let value = values.map_or_else(|| select_rows(&old.value, width, rows), <[f32]>::to_vec);
        let moments = old.moments.map(|mut moments| {
            moments.resize(rows.len() * width, 0.0);
            for (row, _) in fresh.iter().enumerate().filter(|(_, fresh)| **fresh) {
                moments[row * width..(row + 1) * width].fill(0.0);
            }
            moments
        });
        let rows = AttributeRows { count: rows.len(), width, value, moments };
        *self = Self::new(self.name, &rows, &self.value.device());
    }

    /// Replaces all values; the moments stay.
    pub fn set_value(&mut self, values: &[f32]) {
        let data = TensorData::new(values.to_vec(), self.value.dims());
        self.value = Tensor::from_data(data, (&self.value.device(), DType::F32));
    }

    /// Keeps and appends rows; appended rows start with zero moments (3DGS).
    pub fn edit(&mut self, edit: &RowEdit, added: &[f32], added_count: usize) {
        *self = Self::new(self.name, &self.rows().edit(edit, added, added_count), &self.value.device());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dpges_core::scene::tensors::rows_to_tensor;

    const STEP: AdamStep = AdamStep { learning_rate: 0.1, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 1 };

    fn open(device: &Device) -> Tensor<1> {
        Tensor::ones([1], (device, DType::F32))
    }

    #[test]
    fn surgery_keeps_the_moments_of_kept_rows_and_zeroes_those_of_new_ones() {
        let device = Device::flex();
        let rows = AttributeRows::fresh(vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [3, 2]);
        let mut attribute = Attribute::new("surfels.log_scales", &rows, &device);
        let gradient = rows_to_tensor(&[1.0, -1.0, 0.0, 2.0, -3.0, 4.0], 2, &device, DType::F32);
        attribute.step(Some(gradient), &open(&device), STEP).unwrap();
        let before = attribute.rows();
        attribute.edit(&RowEdit { keep: vec![0, 2] }, &[7.0, 8.0], 1);
        let after = attribute.rows();
        assert_eq!(after.value[..2], before.value[..2]);
        assert_eq!(after.value[2..], [before.value[4], before.value[5], 7.0, 8.0]);
        for (after, before) in after.moments.iter().zip(&before.moments) {
            assert_eq!(after[..4], [before[0], before[1], before[4], before[5]]);
            assert_eq!(after[4..], [0.0, 0.0]);
        }
    }

    #[test]
    fn the_first_step_is_the_learning_rate_towards_less_loss_and_none_is_taken_without_gradient() {
        let device = Device::flex();
        let mut attribute = Attribute::new("x", &AttributeRows::fresh(vec![1.0, 1.0], [2, 1]), &device);
        let gradient = rows_to_tensor(&[5.0, -0.001], 1, &device, DType::F32);
        attribute.step(Some(gradient), &open(&device), STEP).unwrap();
        let stepped = attribute.rows().value;
        assert!((stepped[0] - 0.9).abs() < 1e-5 && (stepped[1] - 1.1).abs() < 1e-5, "{stepped:?}");
        let mut untouched = Attribute::new("x", &AttributeRows::fresh(vec![1.0], [1, 1]), &device);
        untouched.step(None, &open(&device), STEP).unwrap();
        assert_eq!(untouched.rows().value, [1.0]);
    }

    #[test]
    fn copied_rows_leave_their_moments_in_place() {
        let device = Device::flex();
        let rows = AttributeRows {
            count: 3,
            width: 1,
            value: vec![1.0, 2.0, 3.0],
            moments: [vec![0.1, 0.2, 0.3], vec![0.4, 0.5, 0.6]],
        };
        let mut attribute = Attribute::new("x", &rows, &device);
        attribute.copy_rows(&[0, 2, 2, 0], None, &[false, false, true, true]);
        let found = attribute.rows();
        assert_eq!(found.value, [1.0, 3.0, 3.0, 1.0]);
        assert_eq!(found.moments, [vec![0.1, 0.2, 0.0, 0.0], vec![0.4, 0.5, 0.0, 0.0]]);
        attribute.copy_rows(&[0, 1], Some(&[7.0, 8.0]), &[false, true]);
        let found = attribute.rows();
        assert_eq!((found.value, found.moments[0].clone()), (vec![7.0, 8.0], vec![0.1, 0.0]));
        attribute.set_value(&[5.0, 6.0]);
        assert_eq!((attribute.rows().value, attribute.rows().moments[0][0]), (vec![5.0, 6.0], 0.1));
    }

    #[test]
    fn all_rows_may_go_and_come_back() {
        let device = Device::flex();
        let mut attribute = Attribute::new("x", &AttributeRows::fresh(vec![1.0, 2.0], [1, 2]), &device);
        attribute.edit(&RowEdit::default(), &[], 0);
        assert_eq!(attribute.value().dims(), [0, 2]);
        attribute.step(None, &open(&device), STEP).unwrap();
        attribute.edit(&RowEdit::default(), &[3.0, 4.0], 1);
        assert_eq!(attribute.rows().value, [3.0, 4.0]);
    }
}

//! Adam over the attributes of a scene, and the edits of rows that keep its moments. All of it stays on the device.

pub mod pose_step;
pub mod rates;
pub mod scene_state;

use std::collections::HashMap;
use std::fmt::Display;

use burn::tensor::{Bool, DType, Device, Gradients, Int, Tensor, TensorData};
use dpges_core::ops::adam::{AdamStep, adam_step};
use dpges_core::scene::schema::Attribute;
use dpges_core::scene::split;
use dpges_core::scene::tensors::{row_indices, tensor_to_rows};

/// Learning rate of the logits of opacities, of Gaussians and discs that are blended (3DGS).
pub const LOGIT_RATE: f64 = 0.05;

/// Extent of the scenes for which methods publish constants in world units: COLMAP makes reconstructions about ten units wide.
const USUAL_EXTENT: f64 = 5.0;

/// World units, in a scene of `extent` (world units), of one world unit of a scene of the usual extent; 1 if it is 0.
pub fn unit_of(extent: f64) -> f64 {
    if extent > 0.0 { extent / USUAL_EXTENT } else { 1.0 }
}

/// One attribute of all primitives of a kind: its raw numbers and, if it learns, its two Adam moments.
#[derive(Clone, Debug)]
pub struct Parameter {
    attribute: &'static Attribute,
    /// One after the other, all columns: one block, unless no buffer of the device holds them ([`split`]).
    blocks: Vec<Block>,
}

#[derive(Clone, Debug)]
struct Block {
    /// [rows, columns]
    raw: Tensor<2>,
    /// Each [rows, columns].
    moments: Option<[Tensor<2>; 2]>,
}

/// A [`Parameter`] in host memory.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterRows {
    pub count: usize,
    pub width: usize,
    pub raw: Vec<f32>,
    pub moments: Option<[Vec<f32>; 2]>,
}

/// An attribute with the gradient that a backward pass left for it; `None` if nothing reached it.
pub type NamedGradient = (&'static Attribute, Option<Tensor<2>>);

impl Parameter {
    /// Raw numbers [`count`, `width`] that have not been stepped yet.
    pub fn fresh(attribute: &'static Attribute, raw: &[f32], shape: [usize; 2], device: &Device) -> Self {
        let block = |columns: Tensor<2>| {
            let shape = columns.dims();
            let moments = attribute.learns().then(|| [(); 2].map(|()| zeros(shape, device)));
            Block { raw: columns, moments }
        };
        let columns = columns(raw, shape, &split::widths(attribute, shape, device), device);
        Self { attribute, blocks: columns.into_iter().map(block).collect() }
    }

    pub fn from_rows(attribute: &'static Attribute, rows: &ParameterRows, device: &Device) -> Self {
        let shape = [rows.count, rows.width];
        Self::in_blocks(attribute, rows, &split::widths(attribute, shape, device), device)
    }

    fn in_blocks(attribute: &'static Attribute, rows: &ParameterRows, widths: &[usize], device: &Device) -> Self {
        let of = |values: &Vec<f32>| columns(values, [rows.count, rows.width], widths, device);
        let mut moments = rows.moments.as_ref().map(|moments| moments.each_ref().map(|rows| of(rows).into_iter()));
        let block = |raw| Block {
            raw,
            moments: moments
                .as_mut()
                .map(|both| both.each_mut().map(|columns| columns.next().expect("as many blocks"))),
        };
        Self { attribute, blocks: of(&rows.raw).into_iter().map(block).collect() }
    }

    /// Takes the parameter of an attribute that only some runs have out of `rows`; `None` if it is not there.
    ///
    /// # Errors
    /// A message if the number of its rows does not fit, which should be `expected`, or if it has another width or no moments.
    pub fn take(
        attribute: &'static Attribute,
        rows: &mut HashMap<String, ParameterRows>,
        width: usize,
        fits: impl Fn(usize) -> bool,
        expected: impl Display,
        device: &Device,
    ) -> Result<Option<Self>, String> {
        let name = attribute.raw_name;
        let Some(found) = rows.remove(name) else { return Ok(None) };
        if found.width != width || !fits(found.count) || found.moments.is_none() {
            let shape = format!("{} × {}", found.count, found.width);
            return Err(format!("`{name}` is {shape}, expected {expected} × {width} with moments"));
        }
        Ok(Some(Self::from_rows(attribute, &found, device)))
    }

    /// [`rows`](Self::rows) with the name that they have in a checkpoint.
    pub fn named_rows(&self) -> (&'static str, ParameterRows) {
        (self.attribute.raw_name, self.rows())
    }

    pub fn rows(&self) -> ParameterRows {
        let moment = |which: usize| self.join(|block| &block.moments.as_ref().expect("every block has moments")[which]);
        let moments = self.blocks[0].moments.is_some().then(|| [moment(0), moment(1)]);
        let [count, width] = self.dims();
        ParameterRows { count, width, raw: self.raw_rows(), moments }
    }

    /// [`ParameterRows::raw`] alone.
    pub fn raw_rows(&self) -> Vec<f32> {
        self.join(|block| &block.raw)
    }

    fn join<'a>(&'a self, column: impl Fn(&'a Block) -> &'a Tensor<2>) -> Vec<f32> {
        split::join(self.blocks.iter().map(|block| (tensor_to_rows(column(block)), block.raw.dims()[1])).collect())
    }

    /// [rows, width]
    fn dims(&self) -> [usize; 2] {
        [self.blocks[0].raw.dims()[0], self.widths().into_iter().sum()]
    }

    fn widths(&self) -> Vec<usize> {
        self.blocks.iter().map(|block| block.raw.dims()[1]).collect()
    }

    fn device(&self) -> Device {
        self.blocks[0].raw.device()
    }

    /// [rows, width] the raw numbers, not on a tape; of a detail those of the first block.
    pub fn raw(&self) -> Tensor<2> {
        self.blocks[0].raw.clone()
    }

    /// The raw numbers of all blocks but the first.
    pub fn rest(&self) -> Vec<Tensor<2>> {
        self.blocks[1..].iter().map(|block| block.raw.clone()).collect()
    }

    /// The two Adam moments, each [rows, width], of a detail those of the first block; `None` if the attribute does not learn.
    pub fn moments(&self) -> Option<&[Tensor<2>; 2]> {
        self.blocks[0].moments.as_ref()
    }

    /// [`raw`](Self::raw) on a new tape; a leaf of it if the attribute learns.
    pub fn leaf(&self) -> Tensor<2> {
        self.on_tape(self.raw())
    }

    /// [`rest`](Self::rest), likewise.
    pub fn rest_of_leaves(&self) -> Vec<Tensor<2>> {
        self.rest().into_iter().map(|raw| self.on_tape(raw)).collect()
    }

    fn on_tape(&self, raw: Tensor<2>) -> Tensor<2> {
        let raw = raw.autodiff();
        if self.attribute.learns() { raw.require_grad() } else { raw }
    }

    /// The gradient that a backward pass left for a [`leaf`](Self::leaf).
    pub fn gradient(&self, leaf: &Tensor<2>, gradients: &mut Gradients) -> NamedGradient {
        (self.attribute, if self.attribute.learns() { leaf.grad_remove(gradients) } else { None })
    }

    /// Steps the first block. Nothing changes where `gate` `[1]` is not 1, or if the attribute does not learn.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if the gradient belongs to another set of rows.
    pub fn step(&mut self, gradient: Option<Tensor<2>>, gate: &Tensor<1>, step: AdamStep) -> dpges_core::Result<()> {
        self.blocks[0].step(gradient, gate, step)
    }

    /// Steps the [rest](Self::rest), each block by the gradient in its place.
    pub fn step_rest(
        &mut self,
        gradients: impl Iterator<Item = Option<Tensor<2>>>,
        gate: &Tensor<1>,
        step: AdamStep,
    ) -> dpges_core::Result<()> {
        self.blocks[1..].iter_mut().zip(gradients).try_for_each(|(block, gradient)| block.step(gradient, gate, step))
    }

    /// Replaces all raw numbers; the moments stay.
    ///
    /// # Panics
    /// If `raw` has another length.
    pub fn set(&mut self, raw: &[f32]) {
        let columns = columns(raw, self.dims(), &self.widths(), &self.device());
        self.blocks.iter_mut().zip(columns).for_each(|(block, raw)| block.raw = raw);
    }

    /// Replaces all raw numbers by those of a tensor [rows, width] on the same device; the moments stay. Not of a detail.
    pub fn set_tensor(&mut self, raw: Tensor<2>) {
        self.blocks[0].raw = raw;
    }

    /// Replaces all raw numbers; the moments start again.
    ///
    /// # Panics
    /// If `raw` has another length.
    pub fn restart(&mut self, raw: &[f32]) {
        *self = Self::fresh(self.attribute, raw, self.dims(), &self.device());
    }

    /// Keeps the `kept` rows and appends `added_count` rows with the raw numbers `added`, whose moments are zero (3DGS).
    ///
    /// # Panics
    /// If `added` has another length.
    pub fn edit(&mut self, kept: &Rows, added: &[f32], added_count: usize) {
        self.split_for(kept.count + added_count);
        let (device, [_, width]) = (self.device(), self.dims());
        let added = columns(added, [added_count, width], &self.widths(), &device);
        for (block, added) in self.blocks.iter_mut().zip(added) {
            let shape = added.dims();
            block.raw = joined(kept.of(&block.raw), || added, added_count);
            for moment in block.moments.iter_mut().flatten() {
                *moment = joined(kept.of(moment), || zeros(shape, &device), added_count);
            }
        }
    }

    /// More blocks, if `count` rows need more.
    fn split_for(&mut self, count: usize) {
        let widths = split::widths(self.attribute, [count, self.dims()[1]], &self.device());
        if widths.len() > self.blocks.len() {
            *self = Self::in_blocks(self.attribute, &self.rows(), &widths, &self.device());
        }
    }

    /// Row i becomes a copy of row i of `copied`. Moments stay with their place; they are zero in places that are new,
    /// and where `fresh` [rows of the new set, 1] is true (3DGS-MCMC).
    pub fn copy_rows(&mut self, copied: &Rows, fresh: &Tensor<2, Bool>) {
        self.split_for(copied.count);
        for Block { raw, moments } in &mut self.blocks {
            let [count, width] = raw.dims();
            let added = copied.count - count;
            *raw = copied.of(raw);
            for moment in moments.iter_mut().flatten() {
                let extended = joined(moment.clone(), || zeros([added, width], &moment.device()), added);
                *moment = if width == 0 {
                    extended
                } else {
                    extended.mask_fill(fresh.clone().expand([-1, width as i64]), 0.0)
                };
            }
        }
    }
}

impl Block {
    fn step(&mut self, gradient: Option<Tensor<2>>, gate: &Tensor<1>, step: AdamStep) -> dpges_core::Result<()> {
        let Some(moments) = self.moments.take_if(|_| self.raw.dims()[1] > 0) else { return Ok(()) };
        let gradient = gradient.unwrap_or_else(|| self.raw.zeros_like());
        // Moved out, so that the step can work in place.
        let raw = std::mem::replace(&mut self.raw, zeros([0, 0], &gate.device()));
        let (raw, moments) = adam_step(raw, moments, &gradient, gate, &step)?;
        (self.raw, self.moments) = (raw, Some(moments));
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

    /// [count, width] these rows of `values`.
    fn of(&self, values: &Tensor<2>) -> Tensor<2> {
        let [_, width] = values.dims();
        match &self.indices {
            None => values.clone(),
            Some(_) if self.count == 0 || width == 0 => zeros([self.count, width], &values.device()),
            Some(indices) => values.clone().select(0, indices.clone()),
        }
    }
}

/// `kept`, followed by `added`, which has `count` rows.
fn joined(kept: Tensor<2>, added: impl FnOnce() -> Tensor<2>, count: usize) -> Tensor<2> {
    match (kept.dims()[0], count) {
        (_, 0) => kept,
        (0, _) => added(),
        _ => Tensor::cat(vec![kept, added()], 0),
    }
}

/// `values` [`count`, all columns] in tensors of so many columns each.
fn columns(values: &[f32], [count, _]: [usize; 2], widths: &[usize], device: &Device) -> Vec<Tensor<2>> {
    if let &[width] = widths {
        return vec![tensor(values, [count, width], device)];
    }
    let parts = split::split(values, widths).into_iter().zip(widths);
    parts.map(|(values, &width)| tensor(&values, [count, width], device)).collect()
}

fn tensor(values: &[f32], shape: [usize; 2], device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), (device, DType::F32))
}

/// Not by a kernel, which some devices refuse to launch over nothing.
fn zeros([count, width]: [usize; 2], device: &Device) -> Tensor<2> {
    if count * width == 0 {
        tensor(&[], [count, width], device)
    } else {
        Tensor::zeros([count, width], (device, DType::F32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dpges_core::scene::schema::{Columns, SurfelColumns};
    use dpges_core::scene::tensors::rows_to_tensor;

    const STEP: AdamStep = AdamStep { learning_rate: 0.1, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 1 };
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

    /// What happens to an attribute in a run, one thing after the other.
    fn in_a_run(mut parameter: Parameter, device: &Device) -> Vec<ParameterRows> {
        let gradient: Vec<f32> = (0..24).map(|at| (at as f32).sin()).collect();
        let gradients = columns(&gradient, [2, 12], &parameter.widths(), device);
        let mut gradients = gradients.into_iter().map(Some);
        parameter.step(gradients.next().flatten(), &open(device), STEP).unwrap();
        parameter.step_rest(gradients, &open(device), STEP).unwrap();
        let mut all = vec![parameter.rows()];
        let added: Vec<f32> = (0..12).map(|at| at as f32).collect();
        parameter.edit(&Rows::new(&[1], 2, device), &added, 1);
        all.push(parameter.rows());
        parameter.copy_rows(&Rows::new(&[1, 1, 0], 2, device), &fresh_rows(&[false, true, false], device));
        all.push(parameter.rows());
        parameter.set(&[0.25; 36]);
        all.push(parameter.rows());
        all
    }

    #[test]
    fn a_detail_in_several_blocks_fares_like_one_in_one() {
        let (device, detail) = (Device::flex(), SurfelColumns::<()>::detail());
        let raw: Vec<f32> = (0..24).map(|at| at as f32 / 7.0).collect();
        let whole = Parameter::fresh(detail, &raw, [2, 12], &device);
        let split = Parameter::in_blocks(detail, &whole.rows(), &[6, 6], &device);
        assert_eq!((whole.widths(), split.widths()), (vec![12], vec![6, 6]));
        assert_eq!((split.raw().dims(), split.rest_of_leaves().len()), ([2, 6], 1));
        assert_eq!(in_a_run(split, &device), in_a_run(whole, &device));
    }

    #[test]
    fn edits_keep_the_moments_of_kept_rows_and_zero_those_of_new_ones() {
        let device = Device::flex();
        let mut parameter = Parameter::fresh(LOG_SCALES, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [3, 2], &device);
        let gradient = rows_to_tensor(&[1.0, -1.0, 0.0, 2.0, -3.0, 4.0], 2, &device, DType::F32);
        parameter.step(Some(gradient), &open(&device), STEP).unwrap();
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
        let gradient = rows_to_tensor(&[5.0, -0.001], 2, &device, DType::F32);
        parameter.step(Some(gradient), &open(&device), STEP).unwrap();
        let stepped = parameter.rows().raw;
        assert!((stepped[0] - 0.9).abs() < 1e-5 && (stepped[1] - 1.1).abs() < 1e-5, "{stepped:?}");
        let mut untouched = Parameter::fresh(LOG_SCALES, &[1.0, 2.0], [1, 2], &device);
        untouched.step(None, &open(&device), STEP).unwrap();
        assert_eq!(untouched.rows().raw, [1.0, 2.0]);
    }

    #[test]
    fn what_does_not_learn_has_no_moments_and_is_edited_all_the_same() {
        let device = Device::flex();
        let mut margins = Parameter::fresh(MARGINS, &[0.1, 0.2, 0.3], [3, 1], &device);
        let gradient = rows_to_tensor(&[1.0; 3], 1, &device, DType::F32);
        margins.step(Some(gradient), &open(&device), STEP).unwrap();
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
        let [first, second] = parameter.rows().moments.unwrap();
        assert_eq!(first, [0.1, 0.1, 0.2, 0.2, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(second, [0.4, 0.4, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0]);
        parameter.set(&[5.0; 8]);
        assert_eq!((parameter.rows().raw, parameter.rows().moments.unwrap()[0][2]), (vec![5.0; 8], 0.2));
        parameter.restart(&[6.0; 8]);
        let rows = parameter.rows();
        assert_eq!((rows.raw, rows.moments), (vec![6.0; 8], Some([vec![0.0; 8], vec![0.0; 8]])));
    }

    #[test]
    fn all_rows_may_go_and_come_back() {
        let device = Device::flex();
        let mut parameter = Parameter::fresh(LOG_SCALES, &[1.0, 2.0], [1, 2], &device);
        parameter.edit(&Rows::new(&[], 1, &device), &[], 0);
        assert_eq!(parameter.raw().dims(), [0, 2]);
        parameter.step(None, &open(&device), STEP).unwrap();
        parameter.edit(&Rows::new(&[], 0, &device), &[3.0, 4.0], 1);
        assert_eq!(parameter.rows().raw, [3.0, 4.0]);
    }
}

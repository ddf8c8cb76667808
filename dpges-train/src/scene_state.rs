//! The trainable scene: attributes of surfels and Gaussians with their optimiser state, and the
//! edits that keep rows of all attributes together.

use std::collections::BTreeMap;

use burn::tensor::activation::sigmoid;
use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use dpges_core::ops::adam::AdamStep;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{Colour, ColourData, ColourModel, GaussianData, Gaussians, SurfelData, Surfels};

use crate::config::Opacity;
use crate::optimizer::{Attribute, AttributeRows};
use crate::refine::relocate::Relocated;
use crate::refine::{GaussianEdit, RowEdit};

/// Opacities this near to 0 or 1 are what a logit can still hold and leave.
const OPACITY_LIMIT: f64 = 1.2e-7;

/// Learning rates of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// World units.
    pub surfel_positions: f64,
    /// World units.
    pub gaussian_positions: f64,
    pub quaternions: f64,
    pub log_scales: f64,
    pub opacities: f64,
    pub base: f64,
    pub detail: f64,
}

impl Rates {
    /// The same for surfels of which only the colours learn.
    pub fn of_frozen_surfels(self) -> Self {
        Self { surfel_positions: 0.0, quaternions: 0.0, log_scales: 0.0, ..self }
    }
}

/// Attributes of surfels; the order of `all` is the order of everything that goes over them.
#[derive(Clone, Debug)]
pub struct SurfelState {
    model: ColourModel,
    positions: Attribute,
    quaternions: Attribute,
    log_scales: Attribute,
    base: Attribute,
    detail: Attribute,
    margins: Tensor<1>,
}

/// Attributes of Gaussians; opacities are [M, 1] here, and what [`Opacity`] says of them.
#[derive(Clone, Debug)]
pub struct GaussianState {
    model: ColourModel,
    opacity: Opacity,
    positions: Attribute,
    quaternions: Attribute,
    log_scales: Attribute,
    opacities: Attribute,
    base: Attribute,
    detail: Attribute,
}

/// Values and moments of attributes by name, as a checkpoint holds them.
pub type NamedRows = BTreeMap<&'static str, AttributeRows>;

/// Gradients in the order of the attributes.
pub type GradientList = Vec<Option<Tensor<2>>>;

fn gradients_of<const N: usize>(
    attributes: [&Attribute; N],
    leaves: [&Tensor<2>; N],
    gradients: &mut Gradients,
) -> GradientList {
    let gradient = |(attribute, leaf): (&&Attribute, &Tensor<2>)| attribute.gradient(leaf, gradients);
    attributes.iter().zip(leaves).map(gradient).collect()
}

impl SurfelState {
    pub const NAMES: [&'static str; 5] = [
        "surfels.positions",
        "surfels.quaternions",
        "surfels.log_scales",
        "surfels.colour.base",
        "surfels.colour.detail",
    ];

    pub fn new(data: &SurfelData, model: ColourModel, device: &Device) -> Self {
        let count = data.len();
        let fresh = |values: &[f32], width| AttributeRows::fresh(values.to_vec(), [count, width]);
        let rows = [
            fresh(&data.positions, 3),
            fresh(&data.quaternions, 4),
            fresh(&data.log_scales, 2),
            fresh(&data.colour.base, 3),
            fresh(&data.colour.detail, model.detail_len()),
        ];
        Self::from_rows(rows, &data.margins, model, device)
    }

    /// `rows` in the order of [`NAMES`](Self::NAMES).
    pub fn from_rows(rows: [AttributeRows; 5], margins: &[f32], model: ColourModel, device: &Device) -> Self {
        let mut at = 0;
        let [positions, quaternions, log_scales, base, detail] = rows.map(|rows| {
            at += 1;
            Attribute::new(Self::NAMES[at - 1], &rows, device)
        });
        Self { model, positions, quaternions, log_scales, base, detail, margins: margin_tensor(margins, device) }
    }

    fn all(&self) -> [&Attribute; 5] {
        [&self.positions, &self.quaternions, &self.log_scales, &self.base, &self.detail]
    }

    fn all_mut(&mut self) -> [&mut Attribute; 5] {
        [&mut self.positions, &mut self.quaternions, &mut self.log_scales, &mut self.base, &mut self.detail]
    }

    pub fn len(&self) -> usize {
        self.margins.dims()[0]
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn rows(&self) -> NamedRows {
        self.all().into_iter().map(|attribute| (attribute.name(), attribute.rows())).collect()
    }

    pub fn to_data(&self) -> SurfelData {
        let [positions, quaternions, log_scales, base, detail] = self.all().map(|a| tensor_to_rows(&a.value()));
        let margins = tensor_to_rows(&self.margins);
        SurfelData { positions, quaternions, log_scales, colour: ColourData { base, detail }, margins }
    }

    fn assemble(&self, [positions, quaternions, log_scales, base, detail]: [Tensor<2>; 5]) -> Surfels {
        let colour = Colour { model: self.model, base, detail };
        Surfels { positions, quaternions, log_scales, colour, margins: self.margins.clone() }
    }

    /// For rendering without a tape.
    pub fn values(&self) -> Surfels {
        self.assemble(self.all().map(Attribute::value))
    }

    /// For one step: every attribute is a leaf.
    pub fn leaves(&self) -> Surfels {
        let surfels = self.assemble(self.all().map(Attribute::leaf));
        Surfels { margins: surfels.margins.autodiff(), ..surfels }
    }

    pub fn gradients(&self, leaves: &Surfels, gradients: &mut Gradients) -> GradientList {
        let colour = &leaves.colour;
        let tensors = [&leaves.positions, &leaves.quaternions, &leaves.log_scales, &colour.base, &colour.detail];
        gradients_of(self.all(), tensors, gradients)
    }

    /// Nothing changes where `gate` `[1]` is not 1.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if the gradients belong to other rows.
    pub fn step(
        &mut self,
        gradients: GradientList,
        gate: &Tensor<1>,
        rates: &Rates,
        adam: AdamStep,
    ) -> dpges_core::Result<()> {
        let rates = [rates.surfel_positions, rates.quaternions, rates.log_scales, rates.base, rates.detail];
        for ((attribute, gradient), learning_rate) in self.all_mut().into_iter().zip(gradients).zip(rates) {
            attribute.step(gradient, gate, AdamStep { learning_rate, ..adam })?;
        }
        Ok(())
    }

    pub fn edit(&mut self, edit: &RowEdit) {
        self.all_mut().into_iter().for_each(|attribute| attribute.edit(edit, &[], 0));
        let margins = tensor_to_rows(&self.margins);
        let kept: Vec<f32> = edit.keep.iter().map(|&row| margins[row]).collect();
        self.set_margins(&kept);
    }

    /// [N × detail] lobes or higher harmonics.
    pub fn set_detail(&mut self, detail: &[f32]) {
        self.detail.set_value(detail);
    }

    /// [N × 3]
    pub fn set_base(&mut self, base: &[f32]) {
        self.base.set_value(base);
    }

    /// `[N]` world units.
    pub fn set_margins(&mut self, margins: &[f32]) {
        self.margins = margin_tensor(margins, &self.margins.device());
    }
}

fn margin_tensor(margins: &[f32], device: &Device) -> Tensor<1> {
    Tensor::from_data(TensorData::new(margins.to_vec(), [margins.len()]), (device, DType::F32))
}

impl GaussianState {
    pub const NAMES: [&'static str; 6] = [
        "gaussians.positions",
        "gaussians.quaternions",
        "gaussians.log_scales",
        "gaussians.opacities",
        "gaussians.colour.base",
        "gaussians.colour.detail",
    ];

    pub fn new(data: &GaussianData, model: ColourModel, opacity: Opacity, device: &Device) -> Self {
        let count = data.len();
        let fresh = |values: &[f32], width| AttributeRows::fresh(values.to_vec(), [count, width]);
        let rows = [
            fresh(&data.positions, 3),
            fresh(&data.quaternions, 4),
            fresh(&data.log_scales, 3),
            fresh(&raw_opacities(&data.opacities, opacity), 1),
            fresh(&data.colour.base, 3),
            fresh(&data.colour.detail, model.detail_len()),
        ];
        Self::from_rows(rows, model, opacity, device)
    }

    /// `rows` in the order of [`NAMES`](Self::NAMES).
    pub fn from_rows(rows: [AttributeRows; 6], model: ColourModel, opacity: Opacity, device: &Device) -> Self {
        let mut at = 0;
        let [positions, quaternions, log_scales, opacities, base, detail] = rows.map(|rows| {
            at += 1;
            Attribute::new(Self::NAMES[at - 1], &rows, device)
        });
        Self { model, opacity, positions, quaternions, log_scales, opacities, base, detail }
    }

    fn all(&self) -> [&Attribute; 6] {
        [&self.positions, &self.quaternions, &self.log_scales, &self.opacities, &self.base, &self.detail]
    }

    fn all_mut(&mut self) -> [&mut Attribute; 6] {
        [
            &mut self.positions,
            &mut self.quaternions,
            &mut self.log_scales,
            &mut self.opacities,
            &mut self.base,
            &mut self.detail,
        ]
    }

    pub fn len(&self) -> usize {
        self.positions.value().dims()[0]
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn rows(&self) -> NamedRows {
        self.all().into_iter().map(|attribute| (attribute.name(), attribute.rows())).collect()
    }

    /// The opacities as they are rendered.
    pub fn to_data(&self) -> GaussianData {
        let [positions, quaternions, log_scales, raw, base, detail] = self.all().map(|a| tensor_to_rows(&a.value()));
        let opacities = match self.opacity {
            Opacity::Linear => raw,
            Opacity::Sigmoid => raw.into_iter().map(|x| (1.0 / (1.0 + f64::from(-x).exp())) as f32).collect(),
        };
        GaussianData { positions, quaternions, log_scales, opacities, colour: ColourData { base, detail } }
    }

    fn assemble(
        &self,
        [positions, quaternions, log_scales, opacities, base, detail]: [Tensor<2>; 6],
    ) -> (Gaussians, Tensor<2>) {
        let colour = Colour { model: self.model, base, detail };
        let flat = opacities.clone().reshape([opacities.dims()[0]]);
        let flat = if self.opacity == Opacity::Sigmoid { sigmoid(flat) } else { flat };
        (Gaussians { positions, quaternions, log_scales, opacities: flat, colour }, opacities)
    }

    /// For rendering without a tape.
    pub fn values(&self) -> Gaussians {
        self.assemble(self.all().map(Attribute::value)).0
    }

    /// For one step: every attribute is a leaf. Returns the leaf of the opacities beside them, of
    /// which the Gaussians hold a function.
    pub fn leaves(&self) -> (Gaussians, Tensor<2>) {
        self.assemble(self.all().map(Attribute::leaf))
    }

    pub fn gradients(&self, (leaves, opacities): (&Gaussians, &Tensor<2>), gradients: &mut Gradients) -> GradientList {
        let colour = &leaves.colour;
        let tensors =
            [&leaves.positions, &leaves.quaternions, &leaves.log_scales, opacities, &colour.base, &colour.detail];
        gradients_of(self.all(), tensors, gradients)
    }

    /// Nothing changes where `gate` `[1]` is not 1.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if the gradients belong to other rows.
    pub fn step(
        &mut self,
        gradients: GradientList,
        gate: &Tensor<1>,
        rates: &Rates,
        adam: AdamStep,
    ) -> dpges_core::Result<()> {
        let rates =
            [rates.gaussian_positions, rates.quaternions, rates.log_scales, rates.opacities, rates.base, rates.detail];
        for ((attribute, gradient), learning_rate) in self.all_mut().into_iter().zip(gradients).zip(rates) {
            attribute.step(gradient, gate, AdamStep { learning_rate, ..adam })?;
        }
        Ok(())
    }

    pub fn edit(&mut self, edit: &GaussianEdit) {
        let added = &edit.added;
        let opacities = raw_opacities(&added.opacities, self.opacity);
        let parts = [
            &added.positions,
            &added.quaternions,
            &added.log_scales,
            &opacities,
            &added.colour.base,
            &added.colour.detail,
        ];
        for (attribute, part) in self.all_mut().into_iter().zip(parts) {
            attribute.edit(&edit.rows, part, added.len());
        }
    }

    /// Rows become copies of others.
    pub fn relocate(&mut self, relocated: &Relocated) {
        let opacities = raw_opacities(&relocated.opacities, self.opacity);
        let Relocated { rows, log_scales, fresh_moments, .. } = relocated;
        let values = [None, None, Some(log_scales), Some(&opacities), None, None];
        for (attribute, values) in self.all_mut().into_iter().zip(values) {
            attribute.copy_rows(rows, values.map(Vec::as_slice), fresh_moments);
        }
    }

    /// [M × 3] world units.
    pub fn set_positions(&mut self, positions: &[f32]) {
        self.positions.set_value(positions);
    }

    /// `[M]` as they are rendered; their moments start again.
    pub fn reset_opacities(&mut self, opacities: &[f32]) {
        let raw = raw_opacities(opacities, self.opacity);
        let rows: Vec<usize> = (0..raw.len()).collect();
        self.opacities.copy_rows(&rows, Some(&raw), &vec![true; raw.len()]);
    }

    /// [M × detail] lobes or higher harmonics.
    pub fn set_detail(&mut self, detail: &[f32]) {
        self.detail.set_value(detail);
    }

    /// [M × 3]
    pub fn set_base(&mut self, base: &[f32]) {
        self.base.set_value(base);
    }
}

/// The numbers that are trained for `opacities`.
fn raw_opacities(opacities: &[f32], opacity: Opacity) -> Vec<f32> {
    let logit = |o: f64| (o / (1.0 - o)).ln() as f32;
    match opacity {
        Opacity::Linear => opacities.to_vec(),
        Opacity::Sigmoid => {
            opacities.iter().map(|&o| logit(f64::from(o).clamp(OPACITY_LIMIT, 1.0 - OPACITY_LIMIT))).collect()
        }
    }
}

//! The scene in training: the parameters of surfels and of Gaussians, and the edits that keep the rows of all
//! attributes together.

use std::collections::{BTreeMap, HashMap};

use burn::tensor::{Bool, Device, Gradients, Tensor, TensorData};
use dpges_core::ops::adam::AdamStep;
use dpges_core::scene::schema::{
    Activation, Attribute, Columns, DEGREES_OF_FREEDOM, GaussianColumns, OpacityActivation, RateGroup, SurfelColumns,
};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{ColourData, ColourModel};

use crate::optimizer::{NamedGradient, Parameter, ParameterRows, Rows};
use crate::refine::GaussianEdit;
use crate::refine::mcmc_relocation::Relocated;

/// Learning rates of one step and one kind of primitive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    /// World units.
    pub positions: f64,
    pub quaternions: f64,
    pub log_scales: f64,
    pub opacities: f64,
    pub degrees_of_freedom: f64,
    /// Rate of the factors of opacities that depend on the direction; 0 where there are none.
    pub opacity_base: f64,
    /// Likewise.
    pub opacity_detail: f64,
    pub base: f64,
    pub detail: f64,
}

impl Rates {
    /// The same for primitives of which only the colours learn.
    pub fn of_colours(self) -> Self {
        Self { positions: 0.0, quaternions: 0.0, log_scales: 0.0, ..self }
    }

    fn of(&self, group: RateGroup) -> f64 {
        match group {
            RateGroup::Fixed | RateGroup::WeightedSum | RateGroup::Environment | RateGroup::Exposure => 0.0,
            RateGroup::Positions => self.positions,
            RateGroup::Quaternions => self.quaternions,
            RateGroup::LogScales => self.log_scales,
            RateGroup::Opacities => self.opacities,
            RateGroup::DegreesOfFreedom => self.degrees_of_freedom,
            RateGroup::OpacityBase => self.opacity_base,
            RateGroup::OpacityDetail => self.opacity_detail,
            RateGroup::Base => self.base,
            RateGroup::Detail => self.detail,
        }
    }
}

/// All primitives of a kind in training.
#[derive(Clone, Debug)]
pub struct State<C> {
    pub columns: C,
    opacity: OpacityActivation,
}

pub type SurfelState = State<SurfelColumns<Parameter>>;
pub type GaussianState = State<GaussianColumns<Parameter>>;

/// The attributes of one step, on a tape.
pub struct Leaves<T> {
    /// The values that are rendered.
    pub values: T,
    /// The numbers that are trained: the leaves of the values.
    pub raw: T,
}

/// Parameters by their raw names, as a checkpoint holds them.
pub type NamedRows = BTreeMap<&'static str, ParameterRows>;

/// Gradients of the attributes that learn.
pub type GradientList = Vec<NamedGradient>;

impl<C: Columns<Value = Parameter, With<Parameter> = C>> State<C> {
    /// Primitives that have not been stepped yet; opacities in `data` are as they are rendered.
    pub fn new(data: &C::With<Vec<f32>>, opacity: OpacityActivation, device: &Device) -> Self {
        let (model, columns) = (data.model(), data.list());
        let first = &C::ATTRIBUTES[0];
        let count = columns[0].len() / first.width.under(model);
        let parameter = |(attribute, values): (&'static Attribute, &Vec<f32>)| {
            Parameter::fresh(attribute, &raw(attribute, values, opacity), attribute.shape(count, model), device)
        };
        Self { columns: C::generate(model, C::all_attributes().zip(columns).map(parameter)), opacity }
    }

    /// Takes the parameters of this kind out of `rows`.
    ///
    /// # Errors
    /// A message naming the attribute that is missing or does not fit the others.
    pub fn from_rows(
        rows: &mut HashMap<String, ParameterRows>,
        model: ColourModel,
        opacity: OpacityActivation,
        device: &Device,
    ) -> Result<Self, String> {
        let count = rows.get(C::ATTRIBUTES[0].raw_name).map_or(0, |rows| rows.count);
        let stored = C::OPTIONAL.iter().take_while(|attribute| rows.contains_key(attribute.raw_name)).count();
        let parameter = |attribute: &'static Attribute| {
            let name = attribute.raw_name;
            if attribute.is_left_out(model) {
                return Ok(Parameter::fresh(attribute, &[], attribute.shape(count, model), device));
            }
            let found = rows.remove(name).ok_or_else(|| format!("attribute `{name}` is missing"))?;
            let [expected, width] = attribute.shape(count, model);
            if (found.count, found.width) != (expected, width) {
                return Err(format!("`{name}` is {} × {}, expected {expected} × {width}", found.count, found.width));
            }
            if found.moments.is_some() != attribute.learns() {
                return Err(format!("the moments of `{name}` are missing, or it has some and does not learn"));
            }
            Ok(Parameter::from_rows(attribute, &found, device))
        };
        let list =
            C::all_attributes().take(C::ATTRIBUTES.len() + stored).map(parameter).collect::<Result<_, String>>()?;
        Ok(Self { columns: C::from_list(model, list), opacity })
    }

    pub fn rows(&self) -> NamedRows {
        let model = self.columns.model();
        let kept = self.columns.iter().filter(|(attribute, _)| !attribute.is_left_out(model));
        kept.map(|(_, parameter)| parameter.named_rows()).collect()
    }

    pub fn len(&self) -> usize {
        self.columns.list()[0].raw().dims()[0]
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn device(&self) -> Device {
        self.columns.list()[0].raw().device()
    }

    /// The attributes as they are rendered, in host memory.
    pub fn to_data(&self) -> C::With<Vec<f32>> {
        self.columns.map_ref(|attribute, parameter| {
            let raw = parameter.raw_rows();
            match attribute.activation {
                Activation::Identity => raw,
                Activation::Opacity => raw.into_iter().map(|raw| self.opacity.value(raw)).collect(),
                Activation::DegreesOfFreedom => raw
                    .into_iter()
                    .map(|raw| raw.clamp(*DEGREES_OF_FREEDOM.start(), *DEGREES_OF_FREEDOM.end()))
                    .collect(),
            }
        })
    }

    fn activated(&self, attribute: &Attribute, raw: Tensor<2>) -> Tensor<2> {
        match attribute.activation {
            Activation::Identity => raw,
            Activation::Opacity => self.opacity.activate(raw),
            Activation::DegreesOfFreedom => raw.clamp(*DEGREES_OF_FREEDOM.start(), *DEGREES_OF_FREEDOM.end()),
        }
    }

    /// The attributes as they are rendered, without a tape.
    pub fn values(&self) -> C::With<Tensor<2>> {
        let mut values = self.columns.map_ref(|attribute, parameter| self.activated(attribute, parameter.raw()));
        values.colour_mut().rest = self.columns.colour().detail.rest();
        values
    }

    /// The attributes on a new tape, for one step.
    pub fn leaves(&self) -> Leaves<C::With<Tensor<2>>> {
        let mut raw = self.columns.map_ref(|_, parameter| parameter.leaf());
        raw.colour_mut().rest = self.columns.colour().detail.rest_of_leaves();
        let activated = C::all_attributes().zip(raw.list()).map(|(a, leaf)| self.activated(a, leaf.clone()));
        let mut values = C::generate(self.columns.model(), activated);
        values.colour_mut().rest.clone_from(&raw.colour().rest);
        Leaves { values, raw }
    }

    /// The gradients that a backward pass left for the raw [`leaves`](Self::leaves); those of further blocks of the detail
    /// are the last.
    pub fn gradients(&self, raw: &C::With<Tensor<2>>, gradients: &mut Gradients) -> GradientList {
        let detail = &self.columns.colour().detail;
        let rest = raw.colour().rest.iter().map(|leaf| (detail, leaf));
        let all = self.columns.list().into_iter().zip(raw.list()).chain(rest);
        let learning = all.filter(|(parameter, _)| parameter.attribute.learns());
        learning.map(|(parameter, leaf)| parameter.gradient(leaf, gradients)).collect()
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
        let learning = C::all_attributes().zip(self.columns.list_mut()).filter(|(attribute, _)| attribute.learns());
        let mut gradients = gradients.into_iter().map(|(_, gradient)| gradient);
        let at = |attribute: &Attribute| AdamStep { learning_rate: rates.of(attribute.rate), ..adam };
        for (attribute, parameter) in learning {
            parameter.step(gradients.next().flatten(), gate, at(attribute))?;
        }
        self.columns.colour_mut().detail.step_rest(gradients, gate, at(C::detail()))
    }

    /// Rows that stay.
    pub fn keep(&mut self, rows: &[usize]) {
        let kept = Rows::new(rows, self.len(), &self.device());
        self.columns.list_mut().into_iter().for_each(|parameter| parameter.edit(&kept, &[], 0));
    }

    /// The colours in host memory.
    pub fn colour(&self) -> ColourData {
        let colour = self.columns.colour();
        let [base, detail] = [&colour.base, &colour.detail].map(Parameter::raw_rows);
        ColourData::new(colour.model, base, detail)
    }

    /// Replaces all colours; their moments stay.
    pub fn set_colour(&mut self, colour: &ColourData) {
        let columns = self.columns.colour_mut();
        columns.base.set(&colour.base);
        columns.detail.set(&colour.detail);
    }
}

impl GaussianState {
    /// `[M]` opacities as they are rendered, in host memory.
    pub fn opacities(&self) -> Vec<f32> {
        let raw = tensor_to_rows(&self.columns.opacities.raw());
        raw.into_iter().map(|raw| self.opacity.value(raw)).collect()
    }

    pub fn edit(&mut self, edit: &GaussianEdit) {
        let kept = Rows::new(&edit.keep, self.len(), &self.device());
        let parameters = self.columns.list_mut().into_iter();
        for ((attribute, added), parameter) in edit.added.iter().zip(parameters) {
            parameter.edit(&kept, &raw(attribute, added, self.opacity), edit.added.len());
        }
    }

    /// Rows become copies of others.
    pub fn relocate(&mut self, relocated: &Relocated) {
        let Relocated { rows, opacities, log_scales, fresh_moments, .. } = relocated;
        let device = self.device();
        let copied = Rows::new(rows, self.len(), &device);
        let fresh = TensorData::new(fresh_moments.clone(), [rows.len(), 1]);
        let fresh = Tensor::<2, Bool>::from_data(fresh, &device);
        self.columns.list_mut().into_iter().for_each(|parameter| parameter.copy_rows(&copied, &fresh));
        self.columns.log_scales.set(log_scales);
        self.columns.opacities.set(&raw_opacities(opacities, self.opacity));
    }

    /// `[M]` as they are rendered; their moments stay.
    pub fn set_opacities(&mut self, opacities: &[f32]) {
        self.columns.opacities.set(&raw_opacities(opacities, self.opacity));
    }

    /// `[M]` as they are rendered; their moments start again.
    pub fn reset_opacities(&mut self, opacities: &[f32]) {
        self.columns.opacities.restart(&raw_opacities(opacities, self.opacity));
    }
}

/// The numbers that are trained for `values`.
fn raw(attribute: &Attribute, values: &[f32], opacity: OpacityActivation) -> Vec<f32> {
    match attribute.activation {
        Activation::Identity | Activation::DegreesOfFreedom => values.to_vec(),
        Activation::Opacity => raw_opacities(values, opacity),
    }
}

fn raw_opacities(opacities: &[f32], activation: OpacityActivation) -> Vec<f32> {
    opacities.iter().map(|&opacity| activation.raw(opacity)).collect()
}

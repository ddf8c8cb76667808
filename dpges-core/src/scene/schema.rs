//! Every attribute of surfels and Gaussians, declared once: its name, its width, its activation, its learning rate.
//!
//! [`SurfelColumns`] and [`GaussianColumns`] have one field per attribute, the same wherever a scene goes. The content of
//! a field depends on the place: rows of `f32` in host memory and in files, a tensor on a device, a parameter with
//! its moments in an optimiser, a gradient, a learning rate. Code that treats all attributes alike goes over
//! [`Columns`]; only an operation that gives an attribute its meaning names it.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::colour_model::{ColourModel, SH_C0};

/// Numbers per primitive of an attribute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// One. Files store such an attribute as `[N]`, tensors in memory are [N, 1].
    Scalar,
    Fixed(usize),
    /// The number that the colour model needs: [`ColourModel::detail_len`].
    Detail,
    /// One if opacities depend on the direction ([`ColourModel::opacity_len`]), else none.
    OpacityBase,
    /// The rest of the coefficients of these opacities.
    OpacityDetail,
}

impl Width {
    /// Numbers per primitive under `model`.
    pub const fn under(self, model: ColourModel) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Fixed(width) => width,
            Self::Detail => model.detail_len(),
            Self::OpacityBase => (model.opacity_len() > 0) as usize,
            Self::OpacityDetail => model.opacity_len().saturating_sub(1),
        }
    }
}

/// The function from the raw numbers that are trained to the values that are rendered and stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// None: the raw numbers are the values.
    Identity,
    /// An [`OpacityActivation`], which the run chooses.
    Opacity,
    /// Clamped to [`DEGREES_OF_FREEDOM`] (SSS).
    DegreesOfFreedom,
}

/// Range of the degrees of freedom of Student's t kernels (SSS).
pub const DEGREES_OF_FREEDOM: RangeInclusive<f32> = 1.0..=1e4;

/// Attributes that share a learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RateGroup {
    /// Does not learn.
    Fixed,
    Positions,
    Quaternions,
    LogScales,
    Opacities,
    DegreesOfFreedom,
    OpacityBase,
    OpacityDetail,
    Base,
    Detail,
    /// Numbers that all Gaussians of a weighted sum share; no primitive has such an attribute.
    WeightedSum,
    /// Coefficients of an environment; no primitive has such an attribute.
    Environment,
    /// Colour corrections of photographs; no primitive has such an attribute.
    Exposure,
}

/// One attribute of a kind of primitive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attribute {
    /// Name of its values in errors and scene files, as in `gaussians.opacities`.
    pub name: &'static str,
    /// Name of the raw numbers in errors and checkpoints, as in `gaussians.raw_opacities`.
    pub raw_name: &'static str,
    pub width: Width,
    pub activation: Activation,
    pub rate: RateGroup,
    /// Values of a primitive of which nothing is known, repeated as often as it has room for them.
    pub neutral: &'static [f32],
}

impl Attribute {
    /// [rows, width] of `count` primitives in memory.
    pub fn shape(&self, count: usize, model: ColourModel) -> [usize; 2] {
        [count, self.width.under(model)]
    }

    /// Shape of `count` primitives in a scene file.
    pub fn stored_shape(&self, count: usize, model: ColourModel) -> Vec<usize> {
        match self.width {
            Width::Scalar => vec![count],
            width => vec![count, width.under(model)],
        }
    }

    pub fn learns(&self) -> bool {
        self.rate != RateGroup::Fixed
    }

    /// Whether files have no such attribute of primitives under `model`, as none of their opacities depends on the direction.
    pub fn is_left_out(&self, model: ColourModel) -> bool {
        matches!(self.width, Width::OpacityBase | Width::OpacityDetail) && model.opacity_len() == 0
    }
}

/// The coefficients of an environment: [(degree + 1)², 3], in memory as in scene files.
pub const ENVIRONMENT: Attribute = Attribute {
    name: "environment",
    raw_name: "environment",
    width: Width::Fixed(3),
    activation: Activation::Identity,
    rate: RateGroup::Environment,
    neutral: &[0.0],
};

/// View-dependent colour of N primitives.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Colour<T> {
    pub model: ColourModel,
    /// [N, 3] zeroth-order coefficient k0; contributes `0.5 + C0 · k0`.
    pub base: T,
    /// [N, [`ColourModel::detail_len`]] raw lobes or higher spherical-harmonic coefficients.
    pub detail: T,
    /// Further columns of the detail, in tensors on devices whose largest buffer does not hold all of it; else none.
    pub rest: Vec<T>,
}

impl<T> Colour<T> {
    pub const fn new(model: ColourModel, base: T, detail: T) -> Self {
        Self { model, base, detail, rest: Vec::new() }
    }

    /// The detail and its rest.
    pub fn details(&self) -> impl Iterator<Item = &T> {
        std::iter::once(&self.detail).chain(&self.rest)
    }

    pub fn details_mut(&mut self) -> impl Iterator<Item = &mut T> {
        std::iter::once(&mut self.detail).chain(&mut self.rest)
    }
}

/// One value of type [`Value`](Self::Value) per attribute of a kind of primitive, in the order of
/// [`ATTRIBUTES`](Self::ATTRIBUTES), and after them of those of [`OPTIONAL`](Self::OPTIONAL) that there are.
pub trait Columns: Sized {
    type Value;
    /// The same attributes with other values.
    type With<U>: Columns<Value = U>;

    const ATTRIBUTES: &'static [Attribute];
    /// Attributes of some scenes only. A scene has the first of them before it has the next.
    const OPTIONAL: &'static [Attribute];

    fn colour(&self) -> &Colour<Self::Value>;
    fn colour_mut(&mut self) -> &mut Colour<Self::Value>;
    fn list(&self) -> Vec<&Self::Value>;
    fn list_mut(&mut self) -> Vec<&mut Self::Value>;
    fn into_list(self) -> Vec<Self::Value>;

    /// # Panics
    /// If `list` does not have one value per attribute of [`ATTRIBUTES`](Self::ATTRIBUTES), or more than all attributes.
    fn from_list<U>(model: ColourModel, list: Vec<U>) -> Self::With<U>;

    fn model(&self) -> ColourModel {
        self.colour().model
    }

    /// Every attribute that can be: as many as a list has are there.
    fn all_attributes() -> impl Iterator<Item = &'static Attribute> {
        Self::ATTRIBUTES.iter().chain(Self::OPTIONAL)
    }

    fn iter<'a>(&'a self) -> impl Iterator<Item = (&'static Attribute, &'a Self::Value)>
    where
        Self::Value: 'a,
    {
        Self::all_attributes().zip(self.list())
    }

    fn map<U>(mut self, mut with: impl FnMut(&'static Attribute, Self::Value) -> U) -> Self::With<U> {
        let (model, rest) = (self.model(), std::mem::take(&mut self.colour_mut().rest));
        let values = Self::all_attributes().zip(self.into_list());
        let mut mapped = Self::generate(model, values.map(|(attribute, value)| with(attribute, value)));
        mapped.colour_mut().rest = rest.into_iter().map(|value| with(Self::detail(), value)).collect();
        mapped
    }

    fn map_ref<U>(&self, mut with: impl FnMut(&'static Attribute, &Self::Value) -> U) -> Self::With<U> {
        let mut mapped = Self::generate(self.model(), self.iter().map(|(attribute, value)| with(attribute, value)));
        mapped.colour_mut().rest = self.colour().rest.iter().map(|value| with(Self::detail(), value)).collect();
        mapped
    }

    /// The attribute of [`Colour::detail`].
    fn detail() -> &'static Attribute {
        &Self::ATTRIBUTES[Self::ATTRIBUTES.len() - 1]
    }

    fn generate<U>(model: ColourModel, values: impl Iterator<Item = U>) -> Self::With<U> {
        Self::from_list(model, values.collect())
    }

    /// Without optional attributes.
    fn try_generate<U, E>(
        model: ColourModel,
        make: impl FnMut(&'static Attribute) -> Result<U, E>,
    ) -> Result<Self::With<U>, E> {
        Ok(Self::from_list(model, Self::ATTRIBUTES.iter().map(make).collect::<Result<_, E>>()?))
    }
}

macro_rules! attribute {
    ($kind:literal, [$($field:tt)+], $width:expr, $activation:ident, $rate:ident, $neutral:expr) => {
        Attribute {
            name: concat!($kind, ".", $($field)+),
            raw_name: match Activation::$activation {
                Activation::Identity => concat!($kind, ".", $($field)+),
                Activation::Opacity | Activation::DegreesOfFreedom => concat!($kind, ".raw_", $($field)+),
            },
            width: $width,
            activation: Activation::$activation,
            rate: RateGroup::$rate,
            neutral: &$neutral,
        }
    };
}

/// Declares the columns of a kind of primitive. Every kind has the two attributes of [`Colour`] after its own, and then
/// those that only some scenes have.
macro_rules! columns {
    ($(#[$doc:meta])* $columns:ident, $kind:literal, {
        $($(#[$field_doc:meta])* $field:ident: $width:expr, $activation:ident, $rate:ident, neutral $neutral:expr;)*
    }, optional {
        $($(#[$extra_doc:meta])*
        $extra:ident: $extra_width:expr, $extra_activation:ident, $extra_rate:ident, neutral $extra_neutral:expr;)*
    }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct $columns<T> {
            $($(#[$field_doc])* pub $field: T,)*
            pub colour: Colour<T>,
            $($(#[$extra_doc])* pub $extra: Option<T>,)*
        }

        impl<T> Columns for $columns<T> {
            type Value = T;
            type With<U> = $columns<U>;

            const ATTRIBUTES: &'static [Attribute] = &[
                $(attribute!($kind, [stringify!($field)], $width, $activation, $rate, $neutral),)*
                attribute!($kind, ["colour.base"], Width::Fixed(3), Identity, Base, [0.0]),
                attribute!($kind, ["colour.detail"], Width::Detail, Identity, Detail, [0.0]),
            ];

            const OPTIONAL: &'static [Attribute] =
                &[$(attribute!($kind, [stringify!($extra)], $extra_width, $extra_activation, $extra_rate, $extra_neutral),)*];

            fn colour(&self) -> &Colour<T> {
                &self.colour
            }

            fn colour_mut(&mut self) -> &mut Colour<T> {
                &mut self.colour
            }

            fn list(&self) -> Vec<&T> {
                let all = [$(&self.$field,)* &self.colour.base, &self.colour.detail];
                all.into_iter()$(.chain(&self.$extra))*.collect()
            }

            fn list_mut(&mut self) -> Vec<&mut T> {
                let all = [$(&mut self.$field,)* &mut self.colour.base, &mut self.colour.detail];
                all.into_iter()$(.chain(&mut self.$extra))*.collect()
            }

            fn into_list(self) -> Vec<T> {
                let all = [$(self.$field,)* self.colour.base, self.colour.detail];
                all.into_iter()$(.chain(self.$extra))*.collect()
            }

            fn from_list<U>(model: ColourModel, list: Vec<U>) -> $columns<U> {
                let (least, extra) = (Self::ATTRIBUTES.len(), Self::OPTIONAL.len());
                assert!((least..=least + extra).contains(&list.len()), "one value per attribute");
                let mut values = list.into_iter();
                let mut next = || values.next().expect("counted above");
                $columns {
                    $($field: next(),)*
                    colour: Colour::new(model, next(), next()),
                    $($extra: values.next(),)*
                }
            }
        }
    };
}

columns! {
    /// N surfels: opaque discs with semi-transparent rims.
    SurfelColumns, "surfels", {
        /// [N, 3] world units.
        positions: Width::Fixed(3), Identity, Positions, neutral [0.0];
        /// [N, 4] (w, x, y, z), not necessarily of unit length; the third column of the rotation is the normal.
        quaternions: Width::Fixed(4), Identity, Quaternions, neutral [1.0, 0.0, 0.0, 0.0];
        /// [N, 2] natural logarithm of the scales along the first two columns, world units.
        log_scales: Width::Fixed(2), Identity, LogScales, neutral [0.0];
        /// [N, 1] depth margin ε, world units; carries no gradient.
        margins: Width::Scalar, Identity, Fixed, neutral [0.0];
    }, optional {}
}

columns! {
    /// M Gaussians.
    GaussianColumns, "gaussians", {
        /// [M, 3] world units.
        positions: Width::Fixed(3), Identity, Positions, neutral [0.0];
        /// [M, 4] (w, x, y, z), not necessarily of unit length.
        quaternions: Width::Fixed(4), Identity, Quaternions, neutral [1.0, 0.0, 0.0, 0.0];
        /// [M, 3] natural logarithm of the scales, world units.
        log_scales: Width::Fixed(3), Identity, LogScales, neutral [0.0];
        /// [M, 1] linear opacity, used as max(0, opacity); may exceed 1. Where there are degrees of freedom it is from −1
        /// to 1, and those below 0 take colour away.
        opacities: Width::Scalar, Opacity, Opacities, neutral [1.0];
        /// [M, 1] zeroth-order coefficient k0 of a factor of the opacity; contributes `C0 · k0`. [M, 0] without such factors.
        opacity_base: Width::OpacityBase, Identity, OpacityBase, neutral [(1.0 / SH_C0) as f32];
        /// [M, [`ColourModel::opacity_len`] − 1] its higher spherical-harmonic coefficients, or [M, 0].
        opacity_detail: Width::OpacityDetail, Identity, OpacityDetail, neutral [0.0];
    }, optional {
        /// [M, 1] ν of Student's t kernels, in [`DEGREES_OF_FREEDOM`]; where there are none, kernels are Gaussian, which is
        /// the limit of large ν (SSS).
        degrees_of_freedom: Width::Scalar, DegreesOfFreedom, DegreesOfFreedom, neutral [100.0];
    }
}

/// How the opacity of a Gaussian is made from the raw number that is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OpacityActivation {
    /// It is that number (DP-GES).
    #[default]
    Linear,
    /// 1 / (1 + e^−x) (3DGS).
    Sigmoid,
    /// tanh x, from −1 to 1 (SSS). Not for peeled scenes, which draw nothing below 0, so no configuration has it.
    #[serde(skip)]
    Tanh,
}

impl OpacityActivation {
    /// Opacities this near to 0, 1 or −1 are what a raw number can still hold and leave.
    const LIMIT: f64 = 1.2e-7;

    /// The opacity that is rendered.
    pub fn value(self, raw: f32) -> f32 {
        match self {
            Self::Linear => raw,
            Self::Sigmoid => (1.0 / (1.0 + f64::from(-raw).exp())) as f32,
            Self::Tanh => f64::from(raw).tanh() as f32,
        }
    }

    /// The number that is trained; undoes [`value`](Self::value).
    pub fn raw(self, value: f32) -> f32 {
        match self {
            Self::Linear => value,
            Self::Sigmoid => {
                let opacity = f64::from(value).clamp(Self::LIMIT, 1.0 - Self::LIMIT);
                (opacity / (1.0 - opacity)).ln() as f32
            }
            Self::Tanh => f64::from(value).clamp(Self::LIMIT - 1.0, 1.0 - Self::LIMIT).atanh() as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_and_fields_agree() {
        let names = |attributes: &[Attribute]| attributes.iter().map(|attribute| attribute.name).collect::<Vec<_>>();
        let surfels = names(SurfelColumns::<()>::ATTRIBUTES);
        let columns = SurfelColumns::<()>::from_list(ColourModel::default(), surfels.clone());
        assert_eq!((columns.positions, columns.log_scales), ("surfels.positions", "surfels.log_scales"));
        assert_eq!((columns.margins, columns.colour.detail), ("surfels.margins", "surfels.colour.detail"));
        assert_eq!(columns.list().into_iter().copied().collect::<Vec<_>>(), surfels);
        assert_eq!(columns.into_list(), surfels);
        let mut gaussians = GaussianColumns::<()>::from_list(ColourModel::default(), vec![0; 8]);
        gaussians.list_mut().into_iter().enumerate().for_each(|(at, value)| *value = at);
        assert_eq!((gaussians.positions, gaussians.opacities, gaussians.opacity_detail), (0, 3, 5));
        assert_eq!((gaussians.colour.base, gaussians.colour.detail), (6, 7));
        assert_eq!((gaussians.degrees_of_freedom, gaussians.iter().count()), (None, 8));
    }

    #[test]
    fn an_optional_attribute_is_the_last_where_there_is_one() {
        let names: Vec<&str> = GaussianColumns::<()>::all_attributes().map(|attribute| attribute.name).collect();
        let mut students = GaussianColumns::<()>::from_list(ColourModel::default(), names.clone());
        assert_eq!(students.degrees_of_freedom, Some("gaussians.degrees_of_freedom"));
        assert!(students.iter().all(|(attribute, value)| attribute.name == *value));
        assert_eq!((students.list_mut().len(), students.clone().into_list()), (9, names));
        let upper = students.map(|attribute, _| attribute.rate);
        assert_eq!(upper.degrees_of_freedom, Some(RateGroup::DegreesOfFreedom));
        assert_eq!(SurfelColumns::<()>::OPTIONAL, []);
    }

    #[test]
    fn only_models_that_ask_for_them_have_factors_of_opacities() {
        let widths = |model: &str| {
            let model = model.parse().unwrap();
            let gaussians =
                GaussianColumns::<()>::ATTRIBUTES.iter().map(|a| (a.width.under(model), a.is_left_out(model)));
            gaussians.collect::<Vec<_>>()
        };
        assert_eq!(widths("sh1+opacity")[3..], [(1, false), (1, false), (3, false), (3, false), (9, false)]);
        assert_eq!(widths("sh1")[3..], [(1, false), (0, true), (0, true), (3, false), (9, false)]);
        assert_eq!(widths("sb0")[3..], [(1, false), (0, true), (0, true), (3, false), (0, false)]);
        let sum: f32 = crate::scene::GaussianData::neutral("sh1+opacity".parse().unwrap(), 1).opacity_base.iter().sum();
        assert!((f64::from(sum) * SH_C0 - 1.0).abs() < 1e-6, "a factor of 1");
    }

    #[test]
    fn only_what_has_an_activation_has_another_raw_name() {
        let mut all = SurfelColumns::<()>::all_attributes().chain(GaussianColumns::<()>::all_attributes());
        assert!(all.all(|a| (a.name == a.raw_name) == (a.activation == Activation::Identity)));
        assert_eq!(GaussianColumns::<()>::ATTRIBUTES[3].raw_name, "gaussians.raw_opacities");
    }

    #[test]
    fn raw_opacities_come_back() {
        for opacity in [0.0f32, 1e-6, 0.1, 0.5, 0.99, 1.0] {
            assert_eq!(OpacityActivation::Linear.value(OpacityActivation::Linear.raw(opacity)), opacity);
            let sigmoid = OpacityActivation::Sigmoid;
            assert!((sigmoid.value(sigmoid.raw(opacity)) - opacity).abs() < 2e-7, "{opacity}");
            assert!(sigmoid.raw(opacity).is_finite());
            for signed in [opacity, -opacity] {
                let tanh = OpacityActivation::Tanh;
                assert!((tanh.value(tanh.raw(signed)) - signed).abs() < 2e-7, "{signed}");
                assert!(tanh.raw(signed).is_finite());
            }
        }
    }
}

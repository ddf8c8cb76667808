//! Every attribute of surfels and Gaussians, declared once: its name, its width, its activation, its learning rate.
//!
//! [`SurfelColumns`] and [`GaussianColumns`] have one field per attribute, the same wherever a scene goes. The content of
//! a field depends on the place: rows of `f32` in host memory and in files, a tensor on a device, a parameter with
//! its moments in an optimiser, a gradient, a learning rate. Code that treats all attributes alike goes over
//! [`Columns`]; only an operation that gives an attribute its meaning names it.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::colour_model::ColourModel;

/// Numbers per primitive of an attribute.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// One. Files store such an attribute as `[N]`, tensors in memory are [N, 1].
    Scalar,
    /// As many.
    Fixed(usize),
    /// The number that the colour model needs: [`ColourModel::detail_len`].
    Detail,
}

impl Width {
    /// Numbers per primitive under `model`.
    pub const fn under(self, model: ColourModel) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Fixed(width) => width,
            Self::Detail => model.detail_len(),
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
}

/// Attributes that share a learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RateGroup {
    /// Does not learn.
    Fixed,
    Positions,
    Quaternions,
    LogScales,
    Opacities,
    Base,
    Detail,
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
}

/// One value of type [`Value`](Self::Value) per attribute of a kind of primitive, in the order of
/// [`ATTRIBUTES`](Self::ATTRIBUTES).
pub trait Columns: Sized {
    type Value;
    /// The same attributes with other values.
    type With<U>: Columns<Value = U>;

    const ATTRIBUTES: &'static [Attribute];

    fn colour(&self) -> &Colour<Self::Value>;
    fn colour_mut(&mut self) -> &mut Colour<Self::Value>;
    fn list(&self) -> Vec<&Self::Value>;
    fn list_mut(&mut self) -> Vec<&mut Self::Value>;
    fn into_list(self) -> Vec<Self::Value>;

    /// # Panics
    /// If `list` does not have one value per attribute.
    fn from_list<U>(model: ColourModel, list: Vec<U>) -> Self::With<U>;

    fn model(&self) -> ColourModel {
        self.colour().model
    }

    fn iter<'a>(&'a self) -> impl Iterator<Item = (&'static Attribute, &'a Self::Value)>
    where
        Self::Value: 'a,
    {
        Self::ATTRIBUTES.iter().zip(self.list())
    }

    fn map<U>(self, mut with: impl FnMut(&'static Attribute, Self::Value) -> U) -> Self::With<U> {
        let model = self.model();
        Self::generate(model, Self::ATTRIBUTES.iter().zip(self.into_list()).map(|(a, value)| with(a, value)))
    }

    fn map_ref<U>(&self, mut with: impl FnMut(&'static Attribute, &Self::Value) -> U) -> Self::With<U> {
        Self::generate(self.model(), self.iter().map(|(attribute, value)| with(attribute, value)))
    }

    fn generate<U>(model: ColourModel, values: impl Iterator<Item = U>) -> Self::With<U> {
        Self::from_list(model, values.collect())
    }

    /// # Errors
    /// The first error of `make`.
    fn try_generate<U, E>(
        model: ColourModel,
        make: impl FnMut(&'static Attribute) -> Result<U, E>,
    ) -> Result<Self::With<U>, E> {
        Ok(Self::from_list(model, Self::ATTRIBUTES.iter().map(make).collect::<Result<_, E>>()?))
    }
}

/// Declares the columns of a kind of primitive. Every kind ends with the two attributes of [`Colour`].
macro_rules! columns {
    ($(#[$doc:meta])* $columns:ident, $kind:literal, {
        $($(#[$field_doc:meta])* $field:ident: $width:expr, $activation:ident, $rate:ident, neutral $neutral:expr;)*
    }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct $columns<T> {
            $($(#[$field_doc])* pub $field: T,)*
            pub colour: Colour<T>,
        }

        impl<T> Columns for $columns<T> {
            type Value = T;
            type With<U> = $columns<U>;

            const ATTRIBUTES: &'static [Attribute] = &[
                $(Attribute {
                    name: concat!($kind, ".", stringify!($field)),
                    raw_name: match Activation::$activation {
                        Activation::Identity => concat!($kind, ".", stringify!($field)),
                        Activation::Opacity => concat!($kind, ".raw_", stringify!($field)),
                    },
                    width: $width,
                    activation: Activation::$activation,
                    rate: RateGroup::$rate,
                    neutral: &$neutral,
                },)*
                Attribute {
                    name: concat!($kind, ".colour.base"),
                    raw_name: concat!($kind, ".colour.base"),
                    width: Width::Fixed(3),
                    activation: Activation::Identity,
                    rate: RateGroup::Base,
                    neutral: &[0.0],
                },
                Attribute {
                    name: concat!($kind, ".colour.detail"),
                    raw_name: concat!($kind, ".colour.detail"),
                    width: Width::Detail,
                    activation: Activation::Identity,
                    rate: RateGroup::Detail,
                    neutral: &[0.0],
                },
            ];

            fn colour(&self) -> &Colour<T> {
                &self.colour
            }

            fn colour_mut(&mut self) -> &mut Colour<T> {
                &mut self.colour
            }

            fn list(&self) -> Vec<&T> {
                vec![$(&self.$field,)* &self.colour.base, &self.colour.detail]
            }

            fn list_mut(&mut self) -> Vec<&mut T> {
                vec![$(&mut self.$field,)* &mut self.colour.base, &mut self.colour.detail]
            }

            fn into_list(self) -> Vec<T> {
                vec![$(self.$field,)* self.colour.base, self.colour.detail]
            }

            fn from_list<U>(model: ColourModel, list: Vec<U>) -> $columns<U> {
                assert_eq!(list.len(), Self::ATTRIBUTES.len(), "one value per attribute");
                let mut values = list.into_iter();
                let mut next = || values.next().expect("counted above");
                $columns { $($field: next(),)* colour: Colour { model, base: next(), detail: next() } }
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
    }
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
        /// [M, 1] linear opacity, used as max(0, opacity); may exceed 1.
        opacities: Width::Scalar, Opacity, Opacities, neutral [1.0];
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
}

impl OpacityActivation {
    /// Opacities this near to 0 or 1 are what a logit can still hold and leave.
    const LIMIT: f64 = 1.2e-7;

    /// The opacity that is rendered.
    pub fn value(self, raw: f32) -> f32 {
        match self {
            Self::Linear => raw,
            Self::Sigmoid => (1.0 / (1.0 + f64::from(-raw).exp())) as f32,
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
        }
    }
}

impl fmt::Display for OpacityActivation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Linear => "linear",
            Self::Sigmoid => "sigmoid",
        })
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
        let mut gaussians = GaussianColumns::<()>::from_list(ColourModel::default(), vec![0; 6]);
        gaussians.list_mut().into_iter().enumerate().for_each(|(at, value)| *value = at);
        assert_eq!((gaussians.positions, gaussians.opacities, gaussians.colour.detail), (0, 3, 5));
    }

    #[test]
    fn only_what_has_an_activation_has_another_raw_name() {
        let mut all = SurfelColumns::<()>::ATTRIBUTES.iter().chain(GaussianColumns::<()>::ATTRIBUTES);
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
        }
    }
}

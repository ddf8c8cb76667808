//! How keys are declared. One declaration gives the field of a section with its documentation, its default, its range
//! check, its ablations, and its entry in [`SECTIONS`](super::SECTIONS), which help texts and documents are made from.

use dpges_core::scene::{ColourModel, DepthWeight, Footprint, OpacityActivation, Peeling, Transparency};

/// A section of the configuration, such as `[train]`.
#[derive(Debug)]
pub struct Section {
    pub name: &'static str,
    pub(super) about: &'static [&'static str],
    pub keys: &'static [Key],
}

/// A key of the configuration.
#[derive(Debug)]
pub struct Key {
    /// With its section: `train.steps`.
    pub name: &'static str,
    pub(super) about: &'static [&'static str],
    /// Empty for numbers without a unit and for what is no number.
    pub unit: &'static str,
    /// Allowed values, for numbers that are not all allowed.
    pub range: Option<fn() -> String>,
    /// The strings that are allowed, for keys that do not take any string.
    pub choices: &'static [Choice],
    /// The kind of value, such as "a whole number".
    pub(super) kind: &'static str,
    pub(super) takes: fn(&toml::Value) -> bool,
    pub ablations: &'static [Ablation],
}

/// One of the strings that a key allows. `N` stands for a number.
#[derive(Debug)]
pub struct Choice {
    pub name: &'static str,
    pub(super) about: &'static [&'static str],
}

/// A value that takes one part of the method away or replaces it.
#[derive(Debug)]
pub struct Ablation {
    pub name: &'static str,
    /// As `--set KEY=VALUE` takes it.
    pub value: &'static str,
    /// The change, in words.
    pub effect: &'static str,
}

/// The lines of a doc comment as one line.
fn joined(lines: &[&str]) -> String {
    lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ")
}

impl Section {
    /// Subject of its keys.
    pub fn about(&self) -> String {
        joined(self.about)
    }
}

impl Key {
    /// Its meaning.
    pub fn about(&self) -> String {
        joined(self.about)
    }

    /// Its range, its choices, or the kind of its values.
    pub fn allowed(&self) -> String {
        match self.range {
            Some(range) => range(),
            None if self.choices.is_empty() => self.kind.to_owned(),
            None => self.choices.iter().map(|choice| choice.name).collect::<Vec<_>>().join(", "),
        }
    }

    /// For an option that sets the key: what it means, its unit and what is allowed.
    pub fn help(&self) -> String {
        let about = self.about();
        let mut notes = vec![format!("key: {}", self.name)];
        if !self.unit.is_empty() {
            notes.push(format!("unit: {}", self.unit));
        }
        if self.range.is_some() || !self.choices.is_empty() {
            notes.push(format!("allowed: {}", self.allowed()));
        }
        format!("{} [{}]", about.trim_end_matches('.'), notes.join("; "))
    }
}

impl Choice {
    /// Its meaning; empty if the name says it.
    pub fn about(&self) -> String {
        joined(self.about)
    }

    /// As in TOML, and what it means if the name does not say it.
    pub(super) fn documented(&self, quote: &str) -> String {
        let written = if self.name == "N" { self.name.to_owned() } else { format!("{:?}", self.name) };
        let about = self.about();
        format!("{quote}{written}{quote}{}{about}", if about.is_empty() { "" } else { ": " })
    }
}

/// A type of values that keys have.
pub trait Value {
    const KIND: &'static str;
    /// Whether TOML has a value of the right kind, which may still be out of range.
    const TAKES: fn(&toml::Value) -> bool;
    const CHOICES: &'static [Choice] = &[];
}

macro_rules! value {
    ($Type:ty, $kind:literal, $takes:expr $(, $name:literal => $about:literal)*) => {
        impl $crate::config::declare::Value for $Type {
            const KIND: &'static str = $kind;
            const TAKES: fn(&toml::Value) -> bool = $takes;
            const CHOICES: &'static [$crate::config::declare::Choice] =
                &[$($crate::config::declare::Choice { name: $name, about: &[$about] }),*];
        }
    };
}

/// A type that is written as a string: `FromStr` and `Display` make it one for serde.
macro_rules! text {
    ($Type:ty) => {
        impl TryFrom<String> for $Type {
            type Error = String;

            fn try_from(text: String) -> Result<Self, String> {
                text.parse()
            }
        }

        impl From<$Type> for String {
            fn from(value: $Type) -> Self {
                value.to_string()
            }
        }
    };
}

value!(bool, "true or false", toml::Value::is_bool);
value!(u32, "a whole number", toml::Value::is_integer);
value!(u64, "a whole number", toml::Value::is_integer);
value!(usize, "a whole number", toml::Value::is_integer);
value!(crate::dataset::MaxResolution, "a whole number", toml::Value::is_integer);
value!(f64, "a number", |value| value.is_float() || value.is_integer());
value!(String, "a string", toml::Value::is_str);
value!(Vec<usize>, "a list", toml::Value::is_array);
value!(
    ColourModel, "a string", toml::Value::is_str,
    "sbN" => "A base colour and N spherical Beta lobes (DBS, DP-GES).",
    "shN" => "Spherical harmonics of degree N, 0 to 3 (3DGS)."
);
value!(
    Footprint, "a string", toml::Value::is_str,
    "kernel" => "Where its kernel G falls below 1/255.",
    "opacity" => "Where its opacity min(1, w G) falls below 1/255."
);
value!(
    OpacityActivation, "a string", toml::Value::is_str,
    "linear" => "It is that number: at least 0, and above 1 where needed (GES, DP-GES).",
    "sigmoid" => "It is the logistic function of that number: below 1 (3DGS)."
);
value!(
    Peeling, "a string", toml::Value::is_str,
    "continuous" => "The nearest opaque surfel and the `layers` − 1 nearest others. Nothing jumps when the camera moves.",
    "nearest" => "The `layers` nearest surfels, opaque or not, in strict order (DP-GES).",
    "literal" => "The same; Gaussians are compared with bare depths, without margins, as the paper's formula reads."
);

value!(
    DepthWeight, "a string", toml::Value::is_str,
    "dir" => "1 at every depth (DIR-WSR).",
    "exp" => "exp(−σ d^β), with σ and β learnt (EXP-WSR).",
    "lc" => "max(0, 1 − d / σ), with σ learnt (LC-WSR)."
);

value!(
    Transparency, "a string", toml::Value::is_str,
    "hybrid" => "The 16 nearest of those with α of at least 0.05; the others are mixed behind them (HTGS).",
    "nearest" => "The same 16, and no others.",
    "sorted" => "All of them, in one order for all pixels, by the depths of their centres.",
    "tail" => "None: all are mixed."
);

/// Enums whose variants are the strings that a key allows.
macro_rules! choices {
    ($(
        $(#[doc = $about:literal])+
        $Name:ident { $($(#[doc = $doc:literal])+ $name:literal => $Variant:ident,)+ }
    )+) => {$(
        $(#[doc = $about])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub enum $Name {
            $($(#[doc = $doc])+ #[serde(rename = $name)] $Variant,)+
        }

        impl $crate::config::declare::Value for $Name {
            const KIND: &'static str = "a string";
            const TAKES: fn(&toml::Value) -> bool = toml::Value::is_str;
            const CHOICES: &'static [$crate::config::declare::Choice] =
                &[$($crate::config::declare::Choice { name: $name, about: &[$($doc),+] }),+];
        }
    )+};
}

/// `None`, or `Some` of what there is.
macro_rules! optional {
    () => {
        None
    };
    ($value:expr) => {
        Some($value)
    };
}

/// The sections of the configuration with their keys:
///
/// ```text
/// /// Subject of the section.
/// [section] Struct {
///     /// Meaning of the key.
///     key: Type = default, unit: "px", range: 1.., ablation: "name" = "value" ("What changes");
/// }
/// ```
///
/// All after the default may be absent; there may be several ablations.
macro_rules! configuration {
    ($(
        $(#[doc = $about:literal])+
        [$section:ident] $Section:ident {$(
            $(#[doc = $doc:literal])+
            $key:ident: $Type:ty = $default:expr
            $(, unit: $unit:literal)?
            $(, range: $range:expr)?
            $(, ablation: $ablation:literal = $value:literal ($effect:literal))*;
        )+}
    )+) => {
        /// The configuration of a run: a field per section of its TOML.
        #[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(default, deny_unknown_fields)]
        pub struct Config {
            $($(#[doc = $about])+ pub $section: $Section,)+
        }

        $(
            $(#[doc = $about])+
            #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
            #[serde(default, deny_unknown_fields)]
            pub struct $Section {
                $($(#[doc = $doc])+ $(#[doc = concat!("\n\nUnit: ", $unit, ".")])? pub $key: $Type,)+
            }

            impl Default for $Section {
                fn default() -> Self {
                    Self { $($key: $default,)+ }
                }
            }
        )+

        /// All sections and keys, in the order in which they are documented.
        pub static SECTIONS: &[Section] = &[$(Section {
            name: stringify!($section),
            about: &[$($about),+],
            keys: &[$(Key {
                name: concat!(stringify!($section), ".", stringify!($key)),
                about: &[$($doc),+],
                unit: concat!($($unit)?),
                range: optional!($(|| range::phrase::<$Type>(&$range))?),
                choices: <$Type as Value>::CHOICES,
                kind: <$Type as Value>::KIND,
                takes: <$Type as Value>::TAKES,
                ablations: &[$(Ablation { name: $ablation, value: $value, effect: $effect }),*],
            }),+],
        }),+];

        impl Config {
            /// Whether each number is in its range.
            pub(super) fn check_ranges(&self) -> Result<(), ConfigError> {
                $($($(
                    range::check(concat!(stringify!($section), ".", stringify!($key)), self.$section.$key, &$range)?;
                )?)+)+
                Ok(())
            }
        }
    };
}

pub(super) use {choices, configuration, optional, text, value};

//! Names of the graphics adapters of a machine.

use std::fmt;

use serde::Serialize;

/// Kinds of adapters, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A GPU with memory of its own.
    Discrete,
    /// A GPU that shares the CPU's memory.
    Integrated,
    /// A share of a GPU.
    Virtual,
    /// A GPU whose driver does not report its kind.
    Other,
    /// A driver that emulates a GPU on the CPU.
    Software,
}

/// Graphics APIs that wgpu speaks, in the order in which they are preferred.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Api {
    Metal,
    Vulkan,
    Dx12,
    Gl,
}

/// An adapter by name:
///
/// | name | adapter |
/// |---|---|
/// | `wgpu`, `gpu` | the best suitable one: by kind, then by API |
/// | `wgpu:N` | number N of all, from 0, as `dpges devices` lists them |
/// | `discrete`, `integrated`, `virtual`, `other`, `software` | the best suitable one of the kind |
/// | `discrete:N` and so on | number N of the kind, from 0, in the same order |
/// | `metal`, `vulkan`, `dx12`, `gl` | the best suitable one of the API |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterName {
    Best,
    Number(usize),
    OfKind(Kind),
    NumberOfKind(Kind, usize),
    OfApi(Api),
}

impl Kind {
    pub const ALL: [Self; 5] = [Self::Discrete, Self::Integrated, Self::Virtual, Self::Other, Self::Software];
}

impl Api {
    pub const ALL: [Self; 4] = [Self::Metal, Self::Vulkan, Self::Dx12, Self::Gl];
}

impl AdapterName {
    /// `None` if the text names no adapter.
    pub fn parse(text: &str) -> Option<Self> {
        let (word, number) = match text.split_once(':') {
            Some((word, number)) => (word, Some(number.parse::<usize>().ok()?)),
            None => (text, None),
        };
        let kind = Kind::ALL.into_iter().find(|kind| kind.to_string() == word);
        let api = Api::ALL.into_iter().find(|api| api.to_string() == word);
        match (word, kind, api, number) {
            ("wgpu" | "gpu", _, _, None) => Some(Self::Best),
            ("wgpu" | "gpu", _, _, Some(number)) => Some(Self::Number(number)),
            (_, Some(kind), _, None) => Some(Self::OfKind(kind)),
            (_, Some(kind), _, Some(number)) => Some(Self::NumberOfKind(kind, number)),
            (_, _, Some(api), None) => Some(Self::OfApi(api)),
            _ => None,
        }
    }
}

/// In lower case, as in JSON.
impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&format!("{self:?}").to_lowercase())
    }
}

/// In lower case, as in JSON.
impl fmt::Display for Api {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&format!("{self:?}").to_lowercase())
    }
}

/// Text that [`AdapterName::parse`] reads back.
impl fmt::Display for AdapterName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Best => f.write_str("wgpu"),
            Self::Number(number) => write!(f, "wgpu:{number}"),
            Self::OfKind(kind) => kind.fmt(f),
            Self::NumberOfKind(kind, number) => write!(f, "{kind}:{number}"),
            Self::OfApi(api) => api.fmt(f),
        }
    }
}

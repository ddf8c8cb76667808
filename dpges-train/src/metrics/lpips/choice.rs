//! Which networks LPIPS is measured with.

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use burn::tensor::Device;

use super::installed::{installed, path};
use super::{Lpips, LpipsError, Network, Weights};

/// Why networks cannot be loaded.
#[derive(Debug, thiserror::Error)]
pub enum ChoiceError {
    #[error("--lpips: `none` does not go with networks")]
    NoneAndOthers,
    #[error("--lpips: {first} and {second} both hold network `{network}`")]
    Twice { first: Choice, second: Choice, network: Network },
    #[error("--lpips: {place}; tools/lpips_weights.py {network} makes it, see docs/guide/measure.md; or name a file")]
    NotInstalled { network: Network, place: String },
    #[error(transparent)]
    Network(#[from] LpipsError),
}

impl ChoiceError {
    /// Whether it was asked for wrongly, and nothing failed.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::NoneAndOthers | Self::Twice { .. })
    }
}

/// `none`, `vgg` and `alex` for those that are installed, or a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Choice {
    None,
    Installed(Network),
    File(PathBuf),
}

impl FromStr for Choice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        let network = Network::ALL.into_iter().find(|network| network.name() == text);
        Ok(match network {
            _ if text == "none" => Self::None,
            Some(network) => Self::Installed(network),
            None => Self::File(text.into()),
        })
    }
}

impl fmt::Display for Choice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::Installed(network) => network.fmt(f),
            Self::File(path) => path.display().fmt(f),
        }
    }
}

/// Whether LPIPS with VGG16 is among `choices`, as far as their files need not be read to know; without choices, whether it is
/// installed.
pub fn has_vgg(choices: &[Choice]) -> bool {
    let may_be_vgg = |choice: &Choice| matches!(choice, Choice::Installed(Network::Vgg) | Choice::File(_));
    if choices.is_empty() { installed(Network::Vgg).is_some() } else { choices.iter().any(may_be_vgg) }
}

/// The networks of `choices` on `device`; without choices VGG16 if it is installed.
///
/// # Errors
/// [`ChoiceError`].
pub fn load(choices: &[Choice], device: &Device) -> Result<Vec<Lpips>, ChoiceError> {
    match choices {
        [] => {
            let vgg = installed(Network::Vgg).map(|path| Weights::load(&path)).transpose()?;
            return Ok(vgg.map(|weights| Lpips::new(&weights, device)).into_iter().collect());
        }
        [Choice::None] => return Ok(Vec::new()),
        several if several.contains(&Choice::None) => return Err(ChoiceError::NoneAndOthers),
        _ => {}
    }
    let mut networks: Vec<Lpips> = Vec::new();
    for choice in choices {
        let weights = Weights::load(&choice.file()?)?;
        if let Some(first) = networks.iter().position(|loaded| loaded.network == weights.network) {
            let (first, second) = (choices[first].clone(), choice.clone());
            return Err(ChoiceError::Twice { first, second, network: weights.network });
        }
        networks.push(Lpips::new(&weights, device));
    }
    Ok(networks)
}

impl Choice {
    fn file(&self) -> Result<PathBuf, ChoiceError> {
        match self {
            Self::File(file) => Ok(file.clone()),
            Self::None => Err(ChoiceError::NoneAndOthers),
            Self::Installed(network) => installed(*network).ok_or_else(|| {
                let place = path(*network).map(|path| format!("there is no {}", path.display()));
                let place = place.unwrap_or_else(|| "there is no home folder".to_owned());
                ChoiceError::NotInstalled { network: *network, place }
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_installed_networks_and_anything_else_is_a_file() {
        let choice = |text: &str| text.parse::<Choice>().unwrap();
        assert_eq!(choice("none"), Choice::None);
        assert_eq!(choice("vgg"), Choice::Installed(Network::Vgg));
        assert_eq!(choice("alex"), Choice::Installed(Network::Alex));
        for file in ["./vgg", "vgg.safetensors", "VGG"] {
            assert_eq!(choice(file), Choice::File(file.into()));
            assert_eq!(choice(file).to_string(), file);
        }
    }
}

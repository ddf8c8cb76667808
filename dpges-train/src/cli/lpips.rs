//! `--lpips`: the networks that LPIPS is measured with; and `dpges lpips`, which gets them.

pub mod install;

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use burn::tensor::Device;
use clap::Args;
use dpges_train::metrics::lpips::installed::{installed, path};
use dpges_train::metrics::lpips::{Lpips, Network, Weights};

use super::{Failure, Result};

#[derive(Debug, Args)]
pub struct LpipsArgs {
    /// Measure LPIPS with the network in this file, AlexNet or VGG16; once for each of them. `vgg` and `alex` are those
    /// that `dpges lpips install` has put into the user's data folder; `none` measures no LPIPS [default: vgg, if it is
    /// there]
    #[arg(long = "lpips", value_name = "FILE")]
    chosen: Vec<Choice>,
}

/// What `--lpips` takes.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Choice {
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

impl LpipsArgs {
    /// Whether nothing was said about networks.
    pub fn is_empty(&self) -> bool {
        self.chosen.is_empty()
    }

    /// The networks on `device`: those that were chosen, or else VGG16 if it is installed.
    ///
    /// # Errors
    /// If a file cannot be used, or two hold the same network.
    pub fn load(&self, device: &Device) -> Result<Vec<Lpips>> {
        if self.is_empty() {
            return match installed(Network::Vgg) {
                Some(path) => Ok(vec![Lpips::new(&Weights::load(&path)?, device)]),
                None => Ok(Vec::new()),
            };
        }
        if self.chosen.contains(&Choice::None) {
            return match &self.chosen[..] {
                [_] => Ok(Vec::new()),
                _ => Err(Failure::Usage("--lpips: `none` does not go with networks".to_owned())),
            };
        }
        let mut networks: Vec<Lpips> = Vec::new();
        for choice in &self.chosen {
            let weights = choice.weights()?;
            if let Some(first) = networks.iter().position(|loaded| loaded.network == weights.network) {
                let message = format!("{} and {choice} both hold network `{}`", self.chosen[first], weights.network);
                return Err(Failure::Usage(format!("--lpips: {message}")));
            }
            networks.push(Lpips::new(&weights, device));
        }
        Ok(networks)
    }
}

impl Choice {
    fn weights(&self) -> Result<Weights> {
        let file = match self {
            Self::File(file) => file.clone(),
            Self::Installed(network) => installed(*network).ok_or_else(|| not_installed(*network))?,
            Self::None => unreachable!("no networks are loaded"),
        };
        Ok(Weights::load(&file)?)
    }
}

fn not_installed(network: Network) -> Failure {
    let place = path(network)
        .map_or_else(|| "there is no home folder".to_owned(), |path| format!("there is no {}", path.display()));
    let message = format!("--lpips: network `{network}` is not installed: {place}");
    Failure::with_help(message, format!("`dpges lpips install {network}` puts it there; or name a file"))
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

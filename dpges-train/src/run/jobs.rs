//! Runs that several processes share, side by side or as jobs of Slurm: who works on a run, how far it has come, and the files
//! that submit the jobs.

use std::fmt::Write as _;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use dpges_core::Error;
use dpges_core::scene::atomic::{self, make_folder, write_atomically};

use super::folder::RunFolder;
use super::shell::quoted;
use crate::config::{Config, differences};
use crate::device::DeviceRequest;

/// How far a run has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    New,
    /// There is a checkpoint.
    Begun,
    Finished,
}

/// A folder holds something else than what is to be trained there.
#[derive(Debug, thiserror::Error)]
#[error("{} holds another run: {reason}; choose another --out, or remove that folder", .path.display())]
pub struct OtherRun {
    pub path: PathBuf,
    pub reason: String,
}

impl OtherRun {
    /// Checks that the run in `folder` was begun with `config`.
    ///
    /// # Errors
    /// If it was not.
    pub fn check(folder: &RunFolder, config: &Config) -> Result<(), Self> {
        let other = |reason: String| Self { path: folder.path().to_owned(), reason };
        let found = Config::resolve(None, Some(&folder.config()), &[]).map_err(|error| other(error.to_string()))?;
        let differences = differences(&found, config);
        if differences.is_empty() { Ok(()) } else { Err(other(differences.join(", "))) }
    }
}

/// Makes `folder`, waits until no other process works in it, and keeps others from it until the result is dropped. Messages call
/// the work `name`.
///
/// # Errors
/// [`Error::Io`] if the folder cannot be written.
pub fn lock(folder: &Path, name: &str) -> Result<File, Error> {
    make_folder(folder)?;
    atomic::lock(&folder.join("lock"), || tracing::info!("{name} waits for another process that works on it"))
}

/// A job of Slurm, or an array of jobs.
pub struct Job {
    /// Name of its files.
    pub name: &'static str,
    /// Number of jobs of an array, numbered from 0 by `$SLURM_ARRAY_TASK_ID`; `None` for one job.
    pub count: Option<usize>,
    pub needs_gpu: bool,
    /// When it begins after the one before: `afterok` or `afterany`.
    pub after: &'static str,
    /// Lines of a shell.
    pub script: String,
}

/// Whether jobs on `device` need a GPU.
pub fn needs_gpu(device: DeviceRequest) -> bool {
    !matches!(device, DeviceRequest::Named(name) if name.is_cpu())
}

/// Writes into `folder` a file `NAME.sbatch` for each of `jobs`, and `submit.sh`, which submits each to follow the one before. A job
/// that is requeued starts again. Returns the paths, one a line.
///
/// # Errors
/// [`Error::Io`].
pub fn write_slurm(folder: &Path, jobs: &[Job]) -> Result<String, Error> {
    make_folder(folder)?;
    let io = |action, path: &Path| {
        let path = path.to_owned();
        move |source| Error::Io { action, path, source }
    };
    let folder = std::path::absolute(folder).map_err(io("cannot find", folder))?;
    let here = std::env::current_dir().map_err(io("cannot find", Path::new(".")))?;
    let place = |path: &Path| quoted(&path.to_string_lossy());
    let mut submit = format!("#!/bin/bash\nset -euo pipefail\ncd {}\n", place(&folder));
    let mut paths = String::new();
    let mut before = None;
    for Job { name, count, needs_gpu, after, script } in jobs {
        let array = count.map_or(String::new(), |count| format!("#SBATCH --array=0-{}\n", count - 1));
        let gpu = if *needs_gpu { "#SBATCH --gres=gpu:1\n" } else { "" };
        let number = if count.is_some() { "-%a" } else { "" };
        let text = format!(
            "#!/bin/bash\n#SBATCH --job-name=dpges-{name}\n{array}{gpu}#SBATCH --requeue\n\
             #SBATCH --output={name}{number}.log\n#SBATCH --open-mode=append\nset -euo pipefail\ncd {}\n{script}",
            place(&here)
        );
        let path = folder.join(format!("{name}.sbatch"));
        write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
        _ = writeln!(paths, "{}", path.display());
        let follows = before.map_or(String::new(), |before| format!("--dependency=\"{after}:${before}\" "));
        _ = writeln!(submit, "{name}=$(sbatch --parsable {follows}\"$@\" {name}.sbatch)\necho {name} ${name}");
        before = Some(name);
    }
    let path = folder.join("submit.sh");
    write_atomically(&path, |file| file.write_all(submit.as_bytes()))?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let set = std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755));
        set.map_err(io("cannot make executable", &path))?;
    }
    _ = writeln!(paths, "{}", path.display());
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_job_follows_the_one_before() {
        let at = tempfile::tempdir().unwrap();
        let folder = at.path().join("my jobs");
        let job = |name, count, after| Job { name, count, needs_gpu: count.is_some(), after, script: "train\n".into() };
        let jobs = [job("cells", Some(3), "afterok"), job("tables", None, "afterany")];
        assert_eq!(write_slurm(&folder, &jobs).unwrap().lines().count(), 3);
        let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
        for part in ["--job-name=dpges-cells\n#SBATCH --array=0-2\n#SBATCH --gres=gpu:1\n", "--output=cells-%a.log\n"] {
            assert!(read("cells.sbatch").contains(part), "{part}");
        }
        let tables = read("tables.sbatch");
        assert!(!tables.contains("--array") && !tables.contains("--gres") && tables.ends_with("train\n"), "{tables}");
        let submit = read("submit.sh");
        let second = "tables=$(sbatch --parsable --dependency=\"afterany:$cells\" \"$@\" tables.sbatch)";
        for part in ["my jobs'\n", "cells=$(sbatch --parsable \"$@\" cells.sbatch)\n", second] {
            assert!(submit.contains(part), "{part}: {submit}");
        }
    }
}

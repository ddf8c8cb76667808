//! The steps of a plan as jobs of Slurm.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;

use dpges_core::Error;
use dpges_core::scene::atomic::write_atomically;

use super::Result;
use super::steps::{Capture, Step};
use crate::device::DeviceRequest;
use crate::run::shell::quoted;

impl Capture {
    /// Writes into the folder of the plan: `coarse.sbatch`; `blocks.sbatch`, an array with a job for each block; `merge.sbatch`;
    /// and `submit.sh`, which submits each to follow the one before. A job asks for a GPU unless `device` is a CPU, and goes on
    /// where it was if it is requeued. Returns the paths, one a line.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write_slurm(&self, device: DeviceRequest) -> Result<String> {
        let program = std::env::current_exe().map_err(|source| Error::Io {
            action: "cannot find",
            path: PathBuf::from("dpges"),
            source,
        })?;
        let (program, folder) = (quoted(&program.to_string_lossy()), quoted(&self.folder().to_string_lossy()));
        let gpu = match device {
            DeviceRequest::Named(name) if name.is_cpu() => "",
            _ => "#SBATCH --gres=gpu:1\n",
        };
        let job = |name: &str, options: &str, log: &str, step: &str| {
            format!(
                "#!/bin/bash\n#SBATCH --job-name=dpges-{name}\n{options}{gpu}#SBATCH --requeue\n\
                 #SBATCH --output={log}.log\n#SBATCH --open-mode=append\nset -euo pipefail\n\
                 exec {program} blocks {step} --device={device}\n"
            )
        };
        let array = format!("#SBATCH --array=0-{}\n", self.plan.blocks.len() - 1);
        let of_block = format!("train {folder} --block=\"$SLURM_ARRAY_TASK_ID\"");
        let submit = format!(
            "#!/bin/bash\nset -euo pipefail\ncd {folder}\n\
             coarse=$(sbatch --parsable \"$@\" coarse.sbatch)\n\
             blocks=$(sbatch --parsable --dependency=\"afterok:$coarse\" \"$@\" blocks.sbatch)\n\
             sbatch --dependency=\"afterok:$blocks\" \"$@\" merge.sbatch\n"
        );
        let files = [
            ("coarse.sbatch", job("coarse", "", "coarse", &format!("coarse {folder}"))),
            ("blocks.sbatch", job("block", &array, "block-%a", &of_block)),
            ("merge.sbatch", job("merge", "", "merge", &format!("merge {folder}"))),
            ("submit.sh", submit),
        ];
        let mut paths = String::new();
        for (name, text) in files {
            let path = self.folder().join(name);
            write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
            #[cfg(unix)]
            if name.ends_with(".sh") {
                use std::os::unix::fs::PermissionsExt as _;
                let set = std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755));
                set.map_err(|source| Error::Io { action: "cannot make executable", path: path.clone(), source })?;
            }
            _ = writeln!(paths, "{}", path.display());
        }
        Ok(paths)
    }

    /// The remaining work, a line for each step.
    pub fn progress(&self) -> String {
        let all = std::iter::once(Step::Coarse).chain(self.blocks()).chain([Step::Merge]);
        let line = |step: Step| {
            let state = if self.is_done(step) { "done".to_owned() } else { format!("`{}`", self.command(step)) };
            format!("{step}: {state}\n")
        };
        all.map(line).collect()
    }
}

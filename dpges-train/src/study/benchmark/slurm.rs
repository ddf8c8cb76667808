//! The cells of a benchmark as jobs of Slurm.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::Path;

use super::super::Result;
use super::super::store::write_texts;
use super::{Benchmark, Planned};
use crate::device::DeviceRequest;
use crate::run::shell::quoted;

impl Benchmark {
    /// Writes into `folder`: `cells.txt`, the cells that are not done; `cells.sbatch`, an array of jobs, one for each, with the
    /// command that this program runs for a cell on `device`; `tables.sbatch`, which writes the tables; and `submit.sh`, which
    /// submits the second to follow the first. Returns the paths, one a line.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write_slurm(&self, folder: &Path, device: DeviceRequest) -> Result<String> {
        std::fs::create_dir_all(folder)?;
        let folder = std::path::absolute(folder)?;
        let program = std::env::current_exe()?;
        let here = std::env::current_dir()?;
        let cells = self.open();
        let common = |last: &str| -> String {
            let arguments = self.common_arguments();
            let words = std::iter::once(program.clone().into()).chain(arguments);
            words.map(|word: OsString| quoted(&word.to_string_lossy())).collect::<Vec<_>>().join(" ") + " " + last
        };
        let place = quoted(&folder.to_string_lossy());
        let enter = format!("set -euo pipefail\ncd {}\n", quoted(&here.to_string_lossy()));
        let last = cells.len().saturating_sub(1);
        let mut array = format!(
            "#!/bin/bash\n#SBATCH --job-name=dpges-cells\n#SBATCH --array=0-{last}\n#SBATCH --gres=gpu:1\n#SBATCH --requeue\n\
             #SBATCH --output=cells-%a.log\n#SBATCH --open-mode=append\n"
        );
        array += &enter;
        _ = writeln!(array, "cell=$(sed -n \"$((SLURM_ARRAY_TASK_ID + 1))p\" {place}/cells.txt)");
        array += &common(&format!("--devices={} --cell=\"$cell\"\n", device));
        let head = "#!/bin/bash\n#SBATCH --job-name=dpges-tables\n#SBATCH --output=tables.log\n";
        let (methods, scenes) = (self.names(|planned| planned.way.name), self.names(|planned| planned.scene.name));
        let chosen = format!("--methods={methods} --scenes={scenes} --tables\n");
        let tables = format!("{head}{enter}{}", common(&chosen));
        let jobs = match cells.len() {
            0 => "sbatch tables.sbatch\n",
            _ => "cells=$(sbatch --parsable cells.sbatch)\nsbatch --dependency=\"afterany:$cells\" tables.sbatch\n",
        };
        let submit = format!("#!/bin/bash\nset -euo pipefail\ncd {place}\n{jobs}");
        let list: String = cells.iter().map(|cell| cell.name() + "\n").collect();
        let files = [("cells.txt", list), ("cells.sbatch", array), ("tables.sbatch", tables), ("submit.sh", submit)];
        write_texts(&folder, files)
    }

    /// Names of what is planned, without repetitions, with commas in between.
    fn names(&self, of: fn(&Planned) -> &'static str) -> String {
        let mut names = Vec::new();
        for name in self.planned.iter().map(of) {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names.join(",")
    }
}

#[cfg(test)]
mod tests {
    use super::super::Request;
    use super::super::protocol::Protocol;
    use super::super::tests::{made, request};
    use super::*;
    use crate::metrics::lpips::choice::Choice;

    #[test]
    fn jobs_are_an_array_of_cells_and_the_tables_after_it() {
        let data = made(&["my data/tandt/truck/sparse", "my data/tandt/truck/images"]);
        let root = data.path().join("my data");
        let protocol = Protocol { steps_scale: 0.5, ..Protocol::default() };
        let request = request(&root, &["mcmc", "dpges"], protocol);
        let lpips = vec![Choice::File("vgg net".into())];
        let all = Benchmark::find(Request { out: "out".into(), lpips, ..request }).unwrap();
        let jobs = data.path().join("jobs");
        let paths = all.write_slurm(&jobs, DeviceRequest::Auto).unwrap();
        assert_eq!(paths.lines().count(), 4);
        let read = |name: &str| std::fs::read_to_string(jobs.join(name)).unwrap();
        let expected = "tanks-and-temples/truck/mcmc/seed_0\ntanks-and-temples/truck/dpges/seed_0\n";
        assert_eq!(read("cells.txt"), expected);
        let cells = read("cells.sbatch");
        for part in [
            "#SBATCH --array=0-1\n",
            &format!("benchmark --data '{}' --out", root.display()),
            "--steps-scale=0.5 --seeds=1 '--lpips=vgg net' --devices=auto --cell=\"$cell\"\n",
        ] {
            assert!(cells.contains(part), "{part}: {cells}");
        }
        assert!(read("tables.sbatch").ends_with("'--lpips=vgg net' --methods=mcmc,dpges --scenes=truck --tables\n"));
        let submit = read("submit.sh");
        assert!(submit.contains("afterany:$cells") && submit.contains("cells=$(sbatch --parsable cells.sbatch)"));
    }
}

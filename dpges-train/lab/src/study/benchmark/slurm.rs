//! The cells of a benchmark as jobs of Slurm.

use std::path::Path;

use dpges_train::device::DeviceRequest;
use dpges_train::run::jobs::{Job, needs_gpu, write_slurm};
use dpges_train::run::shell::quoted;

use super::super::Result;
use super::super::store::write_texts;
use super::{Benchmark, Planned};

impl Benchmark {
    /// Writes into `folder` `cells.txt`, the cells that are not done, and [jobs](write_slurm): an array with the command that this
    /// program runs for a cell on `device`, and the tables. Returns the paths, one a line.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write_slurm(&self, folder: &Path, device: DeviceRequest) -> Result<String> {
        std::fs::create_dir_all(folder)?;
        let folder = std::path::absolute(folder)?;
        let words = std::iter::once(std::env::current_exe()?.into()).chain(self.common_arguments());
        let command = words.map(|word| quoted(&word.to_string_lossy())).collect::<Vec<_>>().join(" ");
        let cells = self.open();
        let list = quoted(&folder.join("cells.txt").to_string_lossy());
        let array = format!(
            "cell=$(sed -n \"$((SLURM_ARRAY_TASK_ID + 1))p\" {list})\n{command} --devices={device} --cell=\"$cell\"\n"
        );
        let (methods, scenes) = (self.names(|planned| planned.way.name), self.names(|planned| planned.scene.name));
        let tables = format!("{command} --methods={methods} --scenes={scenes} --tables\n");
        let job = |name, count, needs_gpu, script| Job { name, count, needs_gpu, after: "afterany", script };
        let of_cells = (!cells.is_empty()).then(|| job("cells", Some(cells.len()), needs_gpu(device), array));
        let jobs: Vec<Job> = of_cells.into_iter().chain([job("tables", None, false, tables)]).collect();
        let cells = cells.iter().map(|cell| cell.name() + "\n").collect();
        Ok(write_texts(&folder, [("cells.txt", cells)])? + &write_slurm(&folder, &jobs)?)
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
    use dpges_train::metrics::lpips::choice::Choice;

    use super::super::Request;
    use super::super::protocol::Protocol;
    use super::super::tests::{made, request};
    use super::*;

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
        assert!(
            submit.contains("afterany:$cells") && submit.contains("cells=$(sbatch --parsable \"$@\" cells.sbatch)")
        );
    }
}

//! Published datasets, methods and tables: each method is trained on each scene with its published settings, and measured as
//! the DP-GES paper measures.
//!
//! A cell is a method, a scene and a seed. Each is trained and measured by a process of its own, several [side by
//! side](side_by_side) on several devices, or as [jobs of Slurm](slurm). It leaves a row in its folder; the rows of all are
//! collected in `benchmark.json`, and [`tables`] of them written as Markdown, CSV and LaTeX.

pub mod layout;
mod measure;
pub mod protocol;
pub mod published;
pub mod side_by_side;
pub mod slurm;
pub mod tables;
mod written;

use std::fs::File;
use std::path::PathBuf;

use clap::Args;
use clap::builder::PossibleValuesParser;
use dpges_train::config::Config;
use dpges_train::dataset::source::Source;
use dpges_train::metrics::lpips::choice::{Choice, has_vgg};
use dpges_train::run::jobs::lock;

use super::cell::{Cell, Plan};
use super::row::Row;
use super::store::{Shape, Study};
use super::variant::Variant;
use super::{Result, StudyError};
use layout::{Asked, Scene};
use protocol::Protocol;
use published::{WAYS, Way};
use tables::Tables;

pub static SHAPE: Shape = Shape { name: "benchmark", title: "Benchmark", line: "method", frontier_alone: false };

/// Folder of the runs in that of the study.
const RUNS: &str = "runs";
/// File of a finished and measured cell, in the folder of its run.
const ROW: &str = "row.json";
/// Messages of the process that works on a cell, in the folder of its run.
const LOG: &str = "log.txt";

/// The request of a user.
#[derive(Args, Clone, Debug, Default)]
pub struct Request {
    /// Folder of the datasets
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Folder for runs and tables
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub scenes: Asked,
    /// Methods and ablations, separated by commas [default: all methods]
    #[arg(long, value_name = "METHOD", value_delimiter = ',', value_parser = PossibleValuesParser::new(WAYS.iter().map(|way| way.name)))]
    pub methods: Vec<String>,
    #[command(flatten)]
    pub protocol: Protocol,
    /// Networks that LPIPS is measured with; of these VGG16 counts.
    #[arg(skip)]
    pub lpips: Vec<Choice>,
}

/// The cells that are to be trained and measured.
#[derive(Debug)]
pub struct Benchmark {
    request: Request,
    planned: Vec<Planned>,
}

/// A cell by its names.
#[derive(Clone, Debug)]
pub struct Planned {
    pub scene: Scene,
    pub way: &'static Way,
    pub seed: u64,
}

impl Planned {
    /// As `--cell` takes it; also its folder in that of the runs.
    pub fn name(&self) -> String {
        let Self { scene, way, seed } = self;
        format!("{}/{}/{}/seed_{seed}", scene.dataset.name, scene.name, way.name)
    }
}

impl Benchmark {
    /// The cells of all scenes and methods with the first seed, then with the second, and so on.
    ///
    /// # Errors
    /// [`layout::LayoutError`].
    pub fn find(request: Request) -> Result<Self> {
        let is_named = |way: &Way| match &request.methods[..] {
            [] => !way.is_ablation,
            named => named.iter().any(|name| name == way.name),
        };
        let scenes = layout::find(&request.data, &request.scenes)?;
        let mut planned = Vec::new();
        for seed in 0..request.protocol.seeds {
            for scene in &scenes {
                let ways = WAYS.iter().filter(|way| is_named(way) && way.is_of(scene.dataset));
                planned.extend(ways.map(|way| Planned { scene: scene.clone(), way, seed }));
            }
        }
        Ok(Self { request, planned })
    }

    /// The cell that is called `name` alone.
    ///
    /// # Errors
    /// [`StudyError::NoCell`]; [`layout::LayoutError`] if its scene is not there.
    pub fn one(name: &str, request: Request) -> Result<Self> {
        let unknown = || StudyError::NoCell { name: name.to_owned() };
        let parts: Vec<&str> = name.split('/').collect();
        let [dataset, scene, method, seed] = parts[..] else { return Err(unknown()) };
        let seed: u64 = seed.strip_prefix("seed_").and_then(|seed| seed.parse().ok()).ok_or_else(unknown)?;
        let scenes = Asked { datasets: vec![dataset.to_owned()], scenes: vec![scene.to_owned()] };
        let mut benchmark = Self::find(Request { scenes, methods: vec![method.to_owned()], ..request })?;
        benchmark.planned.truncate(1);
        benchmark.planned.first_mut().ok_or_else(unknown)?.seed = seed;
        Ok(benchmark)
    }

    pub fn planned(&self) -> &[Planned] {
        &self.planned
    }

    /// Folder of the run of a cell.
    fn folder(&self, planned: &Planned) -> PathBuf {
        self.request.out.join(RUNS).join(planned.name())
    }

    /// The run of a cell, as far as it has come.
    ///
    /// # Errors
    /// [`StudyError::OtherRun`] if its folder holds anything else; [`StudyError::Config`].
    pub fn cell(&self, planned: &Planned) -> Result<Cell> {
        let Planned { scene, way, seed } = planned;
        let mut settings = way.settings(scene.dataset, scene.name, self.request.protocol.own_caps);
        settings.extend(self.request.protocol.settings(*seed));
        let mut config = Config::resolve(way.preset(scene.dataset), None, &settings)?;
        self.request.protocol.scale(&mut config)?;
        let variant = Variant::new(way.name, "", settings);
        let folder = self.request.out.join(RUNS).join(&scene.dataset.name).join(scene.name);
        let source = Source::named(Some(&scene.path)).to_string();
        let plan = Plan { variants: &[], seeds: 1, folder: &folder, dataset: &source };
        let name = format!("{} on {}, seed {seed}", way.name, scene.name);
        Ok(Cell { name, relative: format!("{RUNS}/{}", planned.name()), ..plan.cell(&variant, config)? })
    }

    /// Waits until no other process works on a cell, and keeps others from it until the result is dropped.
    ///
    /// # Errors
    /// If its folder cannot be written.
    pub fn lock(&self, planned: &Planned) -> Result<File> {
        Ok(lock(&self.folder(planned), &planned.name())?)
    }

    /// The row of a cell that is finished and measured; `None` of others.
    fn row(&self, planned: &Planned) -> Option<Row> {
        let folder = self.folder(planned);
        let is_finished = folder.join("eval.json").is_file();
        let text = std::fs::read_to_string(folder.join(ROW)).ok().filter(|_| is_finished)?;
        serde_json::from_str(&text).ok()
    }

    /// The cells for which something is left to do.
    fn open(&self) -> Vec<&Planned> {
        let with_lpips = has_vgg(&self.request.lpips);
        let is_done = |row: Row| !with_lpips || row.get(measure::LPIPS).is_some();
        self.planned.iter().filter(|planned| !self.row(planned).is_some_and(is_done)).collect()
    }

    /// The rows that are in `out` so far, of this benchmark and of others with the same protocol.
    ///
    /// # Errors
    /// [`StudyError::OtherRows`] if they are of another protocol.
    pub fn study(&self) -> Result<Study> {
        std::fs::create_dir_all(&self.request.out)?;
        let mut study = Study::open(&SHAPE, &self.request.out, self.request.protocol.subject())?;
        for planned in &self.planned {
            match self.row(planned) {
                Some(row) => study.replace(row),
                None => study.content.not_run.push(planned.name()),
            }
        }
        Ok(study)
    }

    /// Collects all rows and writes the tables. Returns them in Markdown, and the paths of the files, one a line.
    ///
    /// # Errors
    /// Those of [`study`](Self::study); if a file cannot be written.
    pub fn report(&self) -> Result<String> {
        let study = self.study()?;
        study.save()?;
        let tables = Tables::of(&study.content.rows, &self.request.protocol);
        let (text, files) = written::write(&tables, &study, &self.request.protocol)?;
        Ok(format!("{text}\n{}\n{files}", study.path().display()))
    }
}

#[cfg(test)]
pub mod tests {
    use std::path::Path;

    use dpges_train::dataset::MaxResolution;
    use dpges_train::run::jobs::State;
    use tempfile::TempDir;

    use super::*;

    /// Folders and files, which end without and with a point; `sparse` makes a COLMAP scene.
    pub fn made(paths: &[&str]) -> TempDir {
        let data = tempfile::tempdir().unwrap();
        for path in paths {
            let path = data.path().join(path);
            if path.extension().is_some() {
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, "{}").unwrap();
            } else {
                std::fs::create_dir_all(path).unwrap();
            }
        }
        data
    }

    /// Garden and truck.
    pub fn data() -> TempDir {
        made(&["360_v2/garden/sparse/0", "360_v2/garden/images_4", "tandt/truck/sparse", "tandt/truck/images"])
    }

    pub fn request(data: &Path, methods: &[&str], protocol: Protocol) -> Request {
        let methods = methods.iter().map(|&name| name.to_owned()).collect();
        let (data, out) = (data.to_owned(), data.join("out"));
        Request { data, out, methods, protocol, lpips: vec![Choice::None], ..Request::default() }
    }

    pub fn benchmark(data: &Path, methods: &[&str], protocol: Protocol) -> Benchmark {
        Benchmark::find(request(data, methods, protocol)).unwrap()
    }

    fn names(benchmark: &Benchmark) -> Vec<String> {
        benchmark.planned().iter().map(Planned::name).collect()
    }

    #[test]
    fn cells_are_methods_and_scenes_and_seeds_and_ablations_are_of_one_dataset() {
        let data = data();
        let two = Protocol { seeds: 2, ..Protocol::default() };
        let all = benchmark(data.path(), &["layers-2", "dpges"], two.clone());
        let expected = [
            "mipnerf360/garden/dpges/seed_0",
            "mipnerf360/garden/layers-2/seed_0",
            "tanks-and-temples/truck/dpges/seed_0",
            "mipnerf360/garden/dpges/seed_1",
            "mipnerf360/garden/layers-2/seed_1",
            "tanks-and-temples/truck/dpges/seed_1",
        ];
        assert_eq!(names(&all), expected);
        let one = |name: &str| Benchmark::one(name, request(data.path(), &[], two.clone()));
        assert_eq!(names(&one(expected[4]).unwrap()), [expected[4]]);
        for name in ["garden/dpges", "mipnerf360/garden/4dgs/seed_0", "mipnerf360/garden/dpges/0"] {
            let message = one(name).unwrap_err().to_string();
            assert!(message.contains(name) && message.contains("DATASET/SCENE/METHOD/seed_N"), "{message}");
        }
    }

    #[test]
    fn a_cell_has_the_settings_of_its_scene_and_of_the_protocol() {
        let data = data();
        let protocol =
            Protocol { steps_scale: 0.01, max_resolution: Some(MaxResolution(64)), seeds: 2, ..Protocol::default() };
        let all = benchmark(data.path(), &["mcmc"], protocol);
        let cell = all.cell(&all.planned()[2]).unwrap();
        let Config { data: read, train, model, .. } = &cell.config;
        assert_eq!((train.steps, train.seed, train.checkpoint_every, train.evaluate_every), (300, 1, 15, 0));
        assert_eq!((read.image_scale, read.max_resolution), (4, MaxResolution(64)));
        assert_eq!(model.colour.to_string(), "sh3");
        assert_eq!((cell.state, &cell.relative[..]), (State::New, "runs/mipnerf360/garden/mcmc/seed_1"));
        assert_eq!(cell.folder.path(), all.request.out.join(&cell.relative));
    }

    #[test]
    fn a_cell_is_done_when_it_is_finished_and_measured() {
        let data = data();
        let all = benchmark(data.path(), &["mcmc"], Protocol::default());
        let planned = &all.planned()[0];
        let folder = all.folder(planned);
        std::fs::create_dir_all(&folder).unwrap();
        let mut row = Row::new("mcmc", Some(0));
        row.scene = Some("mipnerf360/garden".to_owned());
        row.set("psnr", Some(20.0));
        std::fs::write(folder.join(ROW), serde_json::to_string(&row).unwrap()).unwrap();
        assert_eq!(all.open().len(), 2, "it is trained anew");
        std::fs::write(folder.join("eval.json"), "{}").unwrap();
        assert_eq!(all.open().len(), 1);
        let lpips = vec![Choice::File("vgg".into())];
        let with_lpips =
            Benchmark::find(Request { lpips, ..request(data.path(), &["mcmc"], Protocol::default()) }).unwrap();
        assert_eq!(with_lpips.open().len(), 2, "LPIPS is measured later");
        let study = all.study().unwrap();
        assert_eq!(study.content.rows, [row]);
        assert_eq!(study.content.not_run, ["tanks-and-temples/truck/mcmc/seed_0"]);
        study.save().unwrap();
        let other = Protocol { steps_scale: 0.5, ..Protocol::default() };
        let message = benchmark(data.path(), &["mcmc"], other).study().unwrap_err().to_string();
        assert!(message.contains("`steps_scale` is 1.0, not 0.5"), "{message}");
    }
}

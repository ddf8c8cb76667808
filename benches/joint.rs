//! `cargo bench -p dpges-benches --bench joint -- [ROW …]`: the joint stage alone, from the same trained Gaussians with
//! several seeds, and where its errors are. About five minutes on two cores; all rows, or those whose names contain one of
//! the texts.
//!
//! On the built-in scene its own geometry as surfels is measured, too, and what each kind of error in it costs.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use burn::tensor::Device;
use clap::Parser;
use dpges_benches::joint::degrade::Degradation;
use dpges_benches::joint::errors::Errors;
use dpges_benches::joint::pixels::{PixelKind, kinds};
use dpges_benches::joint::surfaces::{KnownView, TrueSurfels};
use dpges_benches::machine;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Rendering, SceneData, SceneInfo, SurfelData};
use dpges_lab::study::spread::Spread;
use dpges_train::config::Config;
use dpges_train::dataset::{BuiltinOptions, Dataset, View, builtin, load, pictures};
use dpges_train::device::DeviceName;
use dpges_train::eval::rendered::{TrainingRenderer, to_picture};
use dpges_train::run::Trainer;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Primitives per pixel of a training view by default: what captured scenes have in the paper.
const DENSITY: f64 = 0.15;
/// Scenes of Gaussians in the folder of a run.
const STAGE_FILES: [&str; 2] = ["stage_mcmc.safetensors", "stage_dbs.safetensors"];

#[derive(Parser)]
struct Arguments {
    /// Texts, one of which is part of the name of each wanted row; all are wanted without any
    rows: Vec<String>,
    /// Folder of the dataset; the built-in scene without
    #[arg(long)]
    data: Option<PathBuf>,
    /// Longest side of a picture, px
    #[arg(long, default_value_t = 128)]
    size: usize,
    /// Scene of trained Gaussians, or folder of a run that has some; if there is none, they are trained and kept in this file,
    /// by default one in the target directory
    #[arg(long)]
    gaussians: Option<PathBuf>,
    /// Scene of trained surfels or discs; the depths that the Gaussians agree about without
    #[arg(long)]
    surfels: Option<PathBuf>,
    /// Primitives; by default 0.15 per pixel of a picture, or what the given Gaussians are a share of
    #[arg(long)]
    budget: Option<usize>,
    /// Length of the stage of Gaussians, if it is trained
    #[arg(long, default_value_t = 1200)]
    first_steps: usize,
    /// Length of the joint stage
    #[arg(long, default_value_t = 400)]
    steps: usize,
    /// Joint stages per row, with seeds 0, 1, …
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// As of `dpges train`
    #[arg(long, default_value = "cpu")]
    device: DeviceName,
    /// KEY=VALUE of the configuration, for the joint stage; may be repeated
    #[arg(long)]
    set: Vec<String>,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

impl Arguments {
    fn wants(&self, row: &str) -> bool {
        self.rows.is_empty() || self.rows.iter().any(|text| row.contains(text.as_str()))
    }

    fn dataset(&self) -> Result<Dataset> {
        let dataset = match &self.data {
            Some(folder) => {
                let config = self.config(&self.set, &[format!("data.max_resolution={}", self.size)])?;
                load(folder, &config.data.load_options())?
            }
            None => builtin(&BuiltinOptions { width: self.size, height: self.size, ..BuiltinOptions::default() }),
        };
        if dataset.test.is_empty() { Err("the dataset has no held-out views".into()) } else { Ok(dataset) }
    }

    /// The defaults with `of_user` and then `of_bench` on top.
    fn config(&self, of_user: &[String], of_bench: &[String]) -> Result<Config> {
        Ok(Config::resolve(None, None, &[of_user, of_bench].concat())?)
    }

    /// The file of the Gaussians for a `budget` of primitives. It may not exist yet.
    fn gaussians_file(&self, budget: usize) -> PathBuf {
        match &self.gaussians {
            Some(folder) if folder.is_dir() => {
                let files = STAGE_FILES.map(|name| folder.join(name));
                files.iter().find(|file| file.is_file()).unwrap_or(&files[0]).clone()
            }
            Some(file) => file.clone(),
            None => {
                let data = self.data.as_deref().and_then(Path::file_name);
                let data = data.map_or("builtin".into(), |name| name.to_string_lossy());
                let name = format!("joint-{data}-{}px-{budget}-{}steps.safetensors", self.size, self.first_steps);
                Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
            }
        }
    }
}

/// Data that all rows share.
struct Bench {
    arguments: Arguments,
    dataset: Arc<Dataset>,
    device: Device,
    budget: usize,
    /// Trained and blended.
    gaussians: SceneData,
    gaussians_file: PathBuf,
    held_out: Blended,
    training: Blended,
}

/// Views and what the Gaussians before the joint stage show there.
struct Blended {
    pictures: Vec<Vec<u8>>,
    errors: Errors,
}

/// Errors of some views after the joint stage, and those of the Gaussians before it at pixels of the same kinds.
struct Compared {
    after: Errors,
    before: Errors,
}

/// The result of one joint stage.
struct Outcome {
    /// Held-out views before the first step.
    at_start: Compared,
    held_out: Compared,
    training: Compared,
    /// Before the first step and after the last.
    surfels: [usize; 2],
    gaussians: usize,
    /// Refinement included.
    steps_per_second: f64,
}

/// Where the surfels of a row come from.
enum Start<'a> {
    /// As a run finds them.
    Run,
    File(&'a Path),
    Known(&'a TrueSurfels, Degradation),
}

/// Trains the stage of Gaussians.
fn trained_gaussians(
    arguments: &Arguments,
    budget: usize,
    dataset: &Arc<Dataset>,
    device: &Device,
) -> Result<SceneData> {
    let all = arguments.first_steps + arguments.steps;
    let config = arguments.config(
        &[],
        &[
            format!("train.steps={all}"),
            format!("refine.budget={budget}"),
            "stages.surfels=0".to_owned(),
            "stages.gaussians_by=mcmc".to_owned(),
            format!("stages.gaussians={}", arguments.first_steps as f64 / all as f64),
        ],
    )?;
    let mut trainer = Trainer::new(config, Arc::clone(dataset), device.clone())?;
    while !trainer.stage_is_over() {
        trainer.step()?;
    }
    trainer.settle()?;
    Ok(trainer.scene())
}

/// The pictures of `views` of a scene, and the kinds of their pixels.
fn drawn(scene: &SceneData, views: &[View], device: &Device) -> Result<Vec<(Vec<u8>, Vec<PixelKind>)>> {
    let renderer = TrainingRenderer::new(scene, device);
    let of_view = |view: &View| {
        let rendered = renderer.render(&view.camera)?;
        let (width, height) = (view.camera.width, view.camera.height);
        let kinds = match rendered.peeled() {
            Some(render) => {
                let layers = &render.layers;
                kinds(&tensor_to_rows(&layers.alpha), &tensor_to_rows(&layers.depth), width, height)
            }
            None => vec![PixelKind::Uncovered; width * height],
        };
        Ok((to_picture(rendered.image()).bytes, kinds))
    };
    views.iter().map(of_view).collect()
}

impl Blended {
    fn new(scene: &SceneData, views: &[View], device: &Device) -> Result<Self> {
        let mut blended = Self { pictures: Vec::new(), errors: Errors::default() };
        for ((bytes, kinds), (_, photograph)) in drawn(scene, views, device)?.into_iter().zip(pictures(views)) {
            let photograph = photograph?;
            blended.errors.add(&bytes, &photograph.bytes, photograph.counted.as_deref(), &kinds);
            blended.pictures.push(bytes);
        }
        Ok(blended)
    }

    /// Compares `views` of the `scene` after the joint stage.
    fn compared(&self, scene: &SceneData, views: &[View], device: &Device) -> Result<Compared> {
        let mut compared = Compared { after: Errors::default(), before: Errors::default() };
        let drawn = drawn(scene, views, device)?;
        for (((bytes, kinds), before), (_, photograph)) in drawn.iter().zip(&self.pictures).zip(pictures(views)) {
            let photograph = photograph?;
            let counted = photograph.counted.as_deref();
            compared.after.add(bytes, &photograph.bytes, counted, kinds);
            compared.before.add(before, &photograph.bytes, counted, kinds);
        }
        Ok(compared)
    }
}

impl Bench {
    fn new(arguments: Arguments) -> Result<Self> {
        let dataset = Arc::new(arguments.dataset()?);
        let device = arguments.device.open()?;
        let share = arguments.config(&arguments.set, &[])?.stages.gaussian_budget;
        let pixels: usize = dataset.train.iter().map(|view| view.camera.width * view.camera.height).sum();
        let budget = arguments.budget.unwrap_or((DENSITY * pixels as f64 / dataset.train.len() as f64) as usize);
        let gaussians_file = arguments.gaussians_file(budget);
        let gaussians = if gaussians_file.is_file() {
            eprintln!("Gaussians of {}", gaussians_file.display());
            SceneData::load(&gaussians_file)?
        } else {
            eprintln!("training Gaussians, to be kept in {}", gaussians_file.display());
            let scene = trained_gaussians(&arguments, budget, &dataset, &device)?;
            scene.save(&gaussians_file)?;
            scene
        };
        let of_given = || (gaussians.gaussians.len() as f64 / share).ceil() as usize;
        let budget = if arguments.gaussians.is_some() { arguments.budget.unwrap_or_else(of_given) } else { budget };
        Ok(Self {
            held_out: Blended::new(&gaussians, &dataset.test, &device)?,
            training: Blended::new(&gaussians, &dataset.train, &device)?,
            arguments,
            dataset,
            device,
            budget,
            gaussians,
            gaussians_file,
        })
    }

    /// The configuration of a joint stage with surfels of a file, or as a run finds them.
    fn config(&self, seed: u64, surfels: Option<&Path>) -> Result<Config> {
        let mut of_bench = vec![
            format!("train.steps={}", self.arguments.steps),
            format!("train.seed={seed}"),
            format!("refine.budget={}", self.budget),
            "stages.surfels=0".to_owned(),
            "stages.gaussians=0".to_owned(),
            format!("stages.gaussians_from={}", self.gaussians_file.display()),
        ];
        of_bench.extend(surfels.map(|file| format!("stages.surfels_from={}", file.display())));
        self.arguments.config(&self.arguments.set, &of_bench)
    }

    /// The built-in scene's own surfels, as many as a run may place.
    fn true_surfels(&self) -> Result<TrueSurfels> {
        let views: dpges_core::Result<Vec<_>> = self.dataset.train.iter().map(KnownView::of_builtin).collect();
        let config = self.config(0, None)?;
        let most = (config.stages.depth_surfels * self.budget as f64) as usize;
        Ok(TrueSurfels::place(&views?, most, &self.dataset, &config, &mut ChaCha8Rng::seed_from_u64(0)))
    }

    /// Writes a scene of `surfels` alone.
    fn save(&self, surfels: SurfelData, file: &Path) -> Result<()> {
        let info = SceneInfo { rendering: Rendering::Peeled, ..self.gaussians.info.clone() };
        let gaussians = GaussianData::neutral(info.colour_model, 0);
        Ok(SceneData { info, surfels, gaussians, environment: None }.save(file)?)
    }

    fn outcome(&self, seed: u64, start: &Start<'_>) -> Result<Outcome> {
        let folder = tempfile::tempdir()?;
        let surfels = match start {
            Start::Run => None,
            Start::File(file) => Some((*file).to_owned()),
            Start::Known(known, degradation) => {
                let file = folder.path().join("surfels.safetensors");
                self.save(degradation.apply(known, &mut ChaCha8Rng::seed_from_u64(seed)), &file)?;
                Some(file)
            }
        };
        let config = self.config(seed, surfels.as_deref())?;
        let mut trainer = Trainer::new(config, Arc::clone(&self.dataset), self.device.clone())?;
        let first = trainer.scene();
        let at_start = self.held_out.compared(&first, &self.dataset.test, &self.device)?;
        let begin = Instant::now();
        while !trainer.is_finished() {
            trainer.step()?;
        }
        trainer.settle()?;
        let steps_per_second = self.arguments.steps as f64 / begin.elapsed().as_secs_f64();
        let scene = trainer.scene();
        Ok(Outcome {
            at_start,
            held_out: self.held_out.compared(&scene, &self.dataset.test, &self.device)?,
            training: self.training.compared(&scene, &self.dataset.train, &self.device)?,
            surfels: [first.surfels.len(), scene.surfels.len()],
            gaussians: scene.gaussians.len(),
            steps_per_second,
        })
    }
}

/// The row of what the Gaussians show before the joint stage.
fn row_before(bench: &Bench) -> Vec<String> {
    let psnr = |blended: &Blended| format!("{:.2}", blended.errors.psnr());
    let count = bench.gaussians.gaussians.len();
    let filled = format!("{:.0}", 100.0 * count as f64 / bench.budget as f64);
    let (count, held_out, training) = (count.to_string(), psnr(&bench.held_out), psnr(&bench.training));
    ["Gaussians, blended", "–", &held_out, &training, "–", "0", &count, &filled, "–"].map(str::to_owned).into()
}

/// Means over seeds.
fn row(name: &str, outcomes: &[Outcome], budget: usize) -> Vec<String> {
    let figures = |of: &dyn Fn(&Outcome) -> f64| -> Vec<f64> { outcomes.iter().map(of).collect() };
    let round = |of: &dyn Fn(&Outcome) -> f64| format!("{:.0}", Spread::of(&figures(of)).mean);
    let spread = |of: &dyn Fn(&Outcome) -> f64| Spread::of(&figures(of)).to_string();
    let drawn = |outcome: &Outcome| (outcome.surfels[1] + outcome.gaussians) as f64;
    vec![
        name.to_owned(),
        spread(&|outcome| outcome.at_start.after.psnr()),
        spread(&|outcome| outcome.held_out.after.psnr()),
        spread(&|outcome| outcome.training.after.psnr()),
        round(&|outcome| outcome.surfels[0] as f64),
        round(&|outcome| outcome.surfels[1] as f64),
        round(&|outcome| outcome.gaussians as f64),
        round(&|outcome| 100.0 * drawn(outcome) / budget as f64),
        round(&|outcome| outcome.steps_per_second),
    ]
}

/// Share of pixels, PSNR and its gain over the Gaussians before, of each kind of pixel: means over seeds.
fn row_of_kinds(name: &str, compared: &[&Compared]) -> Vec<String> {
    let cell = |kind: PixelKind| {
        let mean = |of: &dyn Fn(&Compared) -> Option<f64>| {
            let figures: Vec<f64> = compared.iter().filter_map(|compared| of(compared)).collect();
            (!figures.is_empty()).then(|| Spread::of(&figures).mean)
        };
        let share = mean(&|of| Some(of.after.share(kind)));
        match (share, mean(&|of| of.after.of(kind).psnr()), mean(&|of| of.before.of(kind).psnr())) {
            (Some(share), Some(psnr), Some(before)) => format!("{share:.1} · {psnr:.2} · {:+.2}", psnr - before),
            _ => "0".to_owned(),
        }
    };
    std::iter::once(name.to_owned()).chain(PixelKind::ALL.map(cell)).collect()
}

/// A table of `rows` below `columns`. The first column is text, the others numbers.
fn markdown(columns: &[&str], rows: &[Vec<String>]) -> String {
    let rule = format!("|---|{}\n", "---:|".repeat(columns.len() - 1));
    let body = rows.iter().map(|row| format!("| {} |\n", row.join(" | ")));
    format!("| {} |\n{rule}{}", columns.join(" | "), body.collect::<String>())
}

/// Selects the part of an outcome that a table shows.
type Split = fn(&Outcome) -> &Compared;

fn report(bench: &Bench, rows: &[(String, Vec<Outcome>)]) {
    let columns = [
        "geometry",
        "at step 0, dB",
        "held out, dB",
        "training, dB",
        "surfels at first",
        "in the end",
        "Gaussians",
        "% of budget",
        "steps/s",
    ];
    let before = std::iter::once(row_before(bench));
    let all: Vec<Vec<String>> =
        before.chain(rows.iter().map(|(name, outcomes)| row(name, outcomes, bench.budget))).collect();
    println!("{}", markdown(&columns, &all));
    let kinds = PixelKind::ALL.map(PixelKind::name);
    let splits: [(&str, Split); 3] = [
        ("held out, at step 0", |outcome| &outcome.at_start),
        ("held out", |outcome| &outcome.held_out),
        ("training", |outcome| &outcome.training),
    ];
    for (split, of) in splits {
        let columns: Vec<&str> = std::iter::once(split).chain(kinds).collect();
        let row = |(name, outcomes): &(String, Vec<Outcome>)| {
            row_of_kinds(name, &outcomes.iter().map(of).collect::<Vec<_>>())
        };
        println!("{}", markdown(&columns, &rows.iter().map(row).collect::<Vec<_>>()));
    }
    println!("By kind of pixel: % of pixels · PSNR, dB · gain over the blended Gaussians at the same pixels, dB.");
}

fn main() -> Result<()> {
    let began = Instant::now();
    let bench = Bench::new(Arguments::parse())?;
    let Bench { arguments, dataset, budget, .. } = &bench;
    let known = if arguments.data.is_none() { Some(bench.true_surfels()?) } else { None };
    let mut starts = vec![("as in a run".to_owned(), Start::Run)];
    starts.extend(arguments.surfels.as_deref().map(|file| ("of the file".to_owned(), Start::File(file))));
    let variants =
        known.iter().flat_map(|known| Degradation::ALL.map(|what| (what.to_string(), Start::Known(known, what))));
    starts.extend(variants);
    let mut rows = Vec::new();
    for (name, start) in starts.into_iter().filter(|(name, _)| arguments.wants(name)) {
        let outcomes: Result<Vec<Outcome>> = (0..arguments.seeds).map(|seed| bench.outcome(seed, &start)).collect();
        let outcomes = outcomes?;
        let psnr: Vec<f64> = outcomes.iter().map(|outcome| outcome.held_out.after.psnr()).collect();
        eprintln!("{name}: {} dB held out", Spread::of(&psnr));
        rows.push((name, outcomes));
    }
    println!(
        "{}, device {}; {} training and {} held-out views of up to {} px, {budget} primitives; {} joint steps, {} seeds; \
         {:.0} s\n",
        machine(),
        arguments.device,
        dataset.train.len(),
        dataset.test.len(),
        arguments.size,
        arguments.steps,
        arguments.seeds,
        began.elapsed().as_secs_f64()
    );
    report(&bench, &rows);
    Ok(())
}

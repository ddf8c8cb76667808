//! `dpges benchmark`: methods on published datasets, and the tables of the paper.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, value_parser};
use dpges_lab::study::benchmark::layout::Asked;
use dpges_lab::study::benchmark::protocol::Protocol;
use dpges_lab::study::benchmark::published::{PUBLISHED, WAYS};
use dpges_lab::study::benchmark::{Benchmark, Request};
use dpges_train::dataset::source::Source;
use dpges_train::device::DeviceRequest;
use dpges_train::run::child::end_with_the_other;
use dpges_train::run::interrupts;

use super::Training;
use crate::device_choice::watched;
use crate::logging::LogStyle;
use crate::lpips::LpipsArgs;
use crate::train::options::factor;
use crate::{Result, device_choice, print};

/// Train methods on published datasets with their published settings, and write the tables of the paper
///
/// Finds Mip-NeRF360 (360_v2), Tanks & Temples (tandt), Deep Blending (db) and NeRF-Synthetic (nerf_synthetic) below --data.
/// Each cell (a method on a scene with a seed) is a process of its own, with a folder below --out/runs. The same command
/// again skips finished cells and resumes others. Image quality, costs and ablations are printed and written to tables.md,
/// tables.csv and tables.tex, each number beside the published one, with marks where they cannot be compared; all rows are in
/// benchmark.json.
#[derive(Debug, Args)]
pub struct BenchmarkArgs {
    /// Folder of the datasets
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// Folder for runs and tables
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Datasets, separated by commas [default: those that are there]
    #[arg(long, value_name = "DATASET", value_delimiter = ',', value_parser = PossibleValuesParser::new(PUBLISHED.names()))]
    datasets: Vec<String>,
    /// Scenes, separated by commas [default: those that are there]
    #[arg(long, value_name = "SCENE", value_delimiter = ',')]
    scenes: Vec<String>,
    /// Methods and ablations, separated by commas [default: all methods]
    #[arg(long, value_name = "METHOD", value_delimiter = ',', value_parser = PossibleValuesParser::new(WAYS.iter().map(|way| way.name)))]
    methods: Vec<String>,
    /// Factor on the published steps of every method
    #[arg(long, value_name = "F", default_value_t = 1.0, value_parser = factor)]
    steps_scale: f64,
    /// Longest side of photographs, px [default: as published]
    #[arg(long, value_name = "N", value_parser = value_parser!(u32).range(1..))]
    max_resolution: Option<u32>,
    /// Give 3DGS-MCMC, DBS and SSS the numbers of primitives of their own publications, not that of DP-GES
    #[arg(long)]
    own_caps: bool,
    /// Keep every eighth training view, and end a run that no longer improves it
    #[arg(long)]
    flexible_stopping: bool,
    /// Number of seeds, from 0
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Devices, separated by commas, each of which works on one cell at a time
    #[arg(long, value_name = "NAME", value_delimiter = ',', default_value = "auto")]
    devices: Vec<DeviceRequest>,
    #[command(flatten)]
    lpips: LpipsArgs,
    /// Train nothing, and write the cells as jobs of Slurm into this folder
    #[arg(long, value_name = "DIR")]
    slurm: Option<PathBuf>,
    /// Train and measure this cell alone, DATASET/SCENE/METHOD/seed_N, and write no tables
    #[arg(long, value_name = "CELL", conflicts_with_all = ["slurm", "tables"])]
    cell: Option<String>,
    /// Train nothing, and write the tables of what is finished
    #[arg(long, conflicts_with = "slurm")]
    tables: bool,
}

pub fn run(args: BenchmarkArgs, style: LogStyle) -> Result<()> {
    let BenchmarkArgs { data, out, datasets, scenes, methods, steps_scale, own_caps, flexible_stopping, seeds, .. } =
        args;
    let max_resolution = args.max_resolution.map(|px| px as usize);
    let protocol = Protocol { steps_scale, max_resolution, own_caps, flexible_stopping, seeds };
    let (scenes, lpips) = (Asked { datasets, scenes }, args.lpips.chosen().to_vec());
    let request = Request { data, out, scenes, methods, protocol, lpips };
    if let Some(name) = &args.cell {
        return work(&Benchmark::one(name, request)?, args.devices[0], style);
    }
    let benchmark = Benchmark::find(request)?;
    if let Some(folder) = &args.slurm {
        return print(&benchmark.write_slurm(folder, args.devices[0])?);
    }
    benchmark.study()?;
    let trained = if args.tables { Ok(()) } else { benchmark.run(&args.devices, &*interrupts::watch()?) };
    let report = benchmark.report()?;
    style.print(&report)?;
    Ok(trained?)
}

/// Trains and measures the only cell of `benchmark`.
fn work(benchmark: &Benchmark, device: DeviceRequest, style: LogStyle) -> Result<()> {
    end_with_the_other();
    let planned = &benchmark.planned()[0];
    let _held = benchmark.lock(planned)?;
    let cell = benchmark.cell(planned)?;
    let name = device_choice::select(device)?;
    let source = Source::named(Some(&planned.scene.path));
    let mut training = Training::new(source, &cell.config, name, name.open()?, style, interrupts::watch()?)?;
    training.train(&cell, &mut ())?;
    watched(name, || Ok(benchmark.measure(planned, &cell, &training.dataset, (name, &training.device))?))
}

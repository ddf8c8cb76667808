//! `dpges benchmark`: methods on published datasets, and the tables of the paper.

use std::path::PathBuf;

use clap::Args;
use dpges_lab::study::benchmark::{Benchmark, Request};
use dpges_train::dataset::source::Source;
use dpges_train::device::DeviceRequest;
use dpges_train::run::child::end_with_the_other;
use dpges_train::run::interrupts;

use super::Training;
use crate::device_choice::watched;
use crate::logging::LogStyle;
use crate::lpips::LpipsArgs;
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
    #[command(flatten)]
    request: Request,
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
    let request = Request { lpips: args.lpips.chosen, ..args.request };
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
    watched(name, || Ok(benchmark.measure(planned, &cell, &training.dataset, name, &training.device)?))
}

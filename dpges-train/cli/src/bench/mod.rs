//! `dpges bench`: how fast things are on this machine.

mod render;
mod step;

use clap::{Args, Subcommand};

use super::Result;

/// Measure speed on this machine
#[derive(Debug, Args)]
pub struct BenchArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Render(render::BenchRenderArgs),
    Step(step::BenchStepArgs),
}

pub fn run(args: &BenchArgs) -> Result<()> {
    match &args.what {
        What::Render(args) => render::run(args),
        What::Step(args) => step::run(args),
    }
}

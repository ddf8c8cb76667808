//! `dpges bench`: how fast things are on this machine.

mod render;
mod step;

use clap::Subcommand;

use super::Result;

#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    Render(render::BenchRenderArgs),
    Step(step::BenchStepArgs),
}

pub fn run(command: &BenchCommand) -> Result<()> {
    match command {
        BenchCommand::Render(args) => render::run(args),
        BenchCommand::Step(args) => step::run(args),
    }
}

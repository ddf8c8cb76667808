//! The `dpges` binary. Exit codes: 0, 1 for failure, 2 for wrong usage.

mod cli;
mod logging;
mod progress;

fn main() -> std::process::ExitCode {
    cli::run()
}

//! Opens the window with a scene file: `cargo run -p dpges-render --features viewer --example view -- SCENE`.

use std::process::ExitCode;

use dpges_render::viewer::{Start, ViewerOptions, run};

fn main() -> ExitCode {
    let start = std::env::args_os().nth(1).map_or(Start::Page, |path| Start::Open(path.into()));
    match run(ViewerOptions { start, ..ViewerOptions::default() }) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

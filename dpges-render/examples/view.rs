//! Opens the window with a scene file: `cargo run -p dpges-render --features viewer --example view -- SCENE`.

use dpges_render::viewer::{Start, ViewerError, ViewerOptions, run};

fn main() -> Result<(), ViewerError> {
    let start = std::env::args_os().nth(1).map_or(Start::Page, |path| Start::Open(path.into()));
    run(ViewerOptions { start, ..ViewerOptions::default() })
}

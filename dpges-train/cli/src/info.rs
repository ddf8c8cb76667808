//! `dpges info`: the content of a scene file.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use dpges_lab::lod::describe as lod;
use dpges_train::run::description::{describe, rows};

use super::data::Scene;
use super::{Result, print_either, table};

/// Describe a scene: counts, size, colour model, rendering, extent, percentiles; or the levels of one in levels of detail
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Scene file, splats (PLY, SPZ, SOG, glTF), folder of a run, or folder of levels of detail
    scene: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &InfoArgs) -> Result<()> {
    if lod::is_lod(&args.scene) {
        let description = lod::describe(&args.scene)?;
        return print_either(args.json, &description, &table(&description.rows()));
    }
    let entries = describe(&Scene::load(&args.scene)?);
    let text = table(&rows(&entries));
    print_either(args.json, &entries.into_iter().collect::<BTreeMap<_, _>>(), &text)
}

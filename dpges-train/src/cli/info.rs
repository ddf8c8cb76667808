//! `dpges info`: the content of a scene file.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use dpges_train::lod::describe as lod;
use dpges_train::run::description::describe;
use serde_json::Value;

use super::data::Scene;
use super::{Result, print, print_json, table};

/// Describe a scene: counts, size, colour model, rendering, extent, percentiles; or the levels of one in levels of detail
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Scene file, folder of a run, or folder of levels of detail
    scene: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &InfoArgs) -> Result<()> {
    if lod::is_lod(&args.scene) {
        let description = lod::describe(&args.scene)?;
        return if args.json { print_json(&description) } else { print(&table(&description.rows())) };
    }
    let entries = describe(&Scene::load(&args.scene)?);
    if args.json {
        return print_json(&entries.into_iter().collect::<BTreeMap<_, _>>());
    }
    let rows: Vec<(&str, String)> = entries.iter().map(|(name, value)| (*name, text(value))).collect();
    print(&table(&rows))
}

fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "none".to_owned(),
        Value::Array(values) => values.iter().map(text).collect::<Vec<_>>().join("  "),
        Value::Number(number) if number.is_f64() => match number.as_f64().unwrap_or(f64::NAN) {
            small if small != 0.0 && small.abs() < 0.01 => format!("{small:.3e}"),
            other => format!("{other:.4}"),
        },
        other => other.to_string(),
    }
}

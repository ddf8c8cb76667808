//! `dpges config`: the keys of the configuration.

use clap::Args;
use dpges_train::config::Config;
use dpges_train::config::document::markdown;

use super::{Result, print};

/// Print every key of the configuration with its default, meaning, unit and range
///
/// The output is TOML for `dpges train --config`. A file may leave out the keys that it does not change.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    /// Print the values of a configuration that comes with the program, such as cpu, instead of the defaults
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Print tables of presets and keys in Markdown instead
    #[arg(long, conflicts_with = "preset")]
    markdown: bool,
}

pub fn run(args: &ConfigArgs) -> Result<()> {
    if args.markdown {
        return print(&markdown());
    }
    let config = Config::resolve(args.preset.as_deref(), None, &[])?;
    print(&config.to_documented_toml())
}

//! The reference section of `docs/commands.md`: what `--help` prints.

use clap::{Command, CommandFactory};

use super::Cli;

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/commands.md");
const MARKER: &str = "<!-- generated from here on -->\n";
const WRITE: &str = "DPGES_WRITE_DOCS";

/// The long help of every subcommand, as Markdown.
fn reference() -> String {
    let mut cli = Cli::command().term_width(110);
    cli.build();
    let section = |command: &Command| {
        // Without the line of spaces that separates long descriptions of options.
        let help = command.clone().render_long_help().to_string();
        let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
        format!("\n### dpges {}\n\n```text\n{}\n```\n", command.get_name(), lines.join("\n").trim_end())
    };
    cli.get_subcommands().filter(|command| command.get_name() != "help").map(section).collect()
}

#[test]
fn the_reference_is_what_help_prints() {
    let text = std::fs::read_to_string(FILE).unwrap();
    let (guide, written) = text.split_once(MARKER).expect("the marker is there");
    let reference = reference();
    if std::env::var_os(WRITE).is_some() {
        std::fs::write(FILE, format!("{guide}{MARKER}{reference}")).unwrap();
        return;
    }
    let differing = reference.lines().zip(written.lines()).find(|(new, old)| new != old);
    assert!(
        written == reference,
        "{FILE} is out of date: `{WRITE}=1 cargo test --release -p dpges-train --bin dpges reference` writes it again. \
         First difference: {differing:?}"
    );
}

//! The reference section of `docs/reference/commands.md`: what `--help` prints.

use clap::{Command, CommandFactory};

use super::Cli;

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/reference/commands.md");
const MARKER: &str = "<!-- generated from here on -->\n";
const WRITE: &str = "DPGES_WRITE_DOCS";

/// The output of `--help` for every subcommand, and those below it, as Markdown.
fn reference() -> String {
    Cli::command().get_subcommands().map(|command| section(&[], command)).collect()
}

fn section(above: &[&str], command: &Command) -> String {
    let names = [above, &[command.get_name()]].concat();
    let words = [&["dpges"], &names[..], &["--help"]].concat();
    let help = Cli::command().try_get_matches_from(words).unwrap_err().to_string();
    let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
    let own = format!("\n### dpges {}\n\n```text\n{}\n```\n", names.join(" "), lines.join("\n").trim_end());
    let below = command.get_subcommands().filter(|below| below.get_name() != "help");
    own + &below.map(|below| section(&names, below)).collect::<String>()
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
        "{FILE} is out of date: `{WRITE}=1 cargo test --release -p dpges reference` writes it again. \
         First difference: {differing:?}"
    );
}

//! The tables as Markdown, CSV and LaTeX.

use std::fmt::Write as _;

use super::super::Result;
use super::super::store::{Study, write_texts};
use super::super::table::aligned;
use super::protocol::Protocol;
use super::published::DPGES;
use super::tables::{Column, Entry, Line, Mark, Order, Table, Tables};

/// Writes `tables.md`, `tables.csv` and `tables.tex` into the folder of `study`. Returns the tables in Markdown, and the paths,
/// one a line.
///
/// # Errors
/// If a file cannot be written.
pub fn write(tables: &Tables, study: &Study, protocol: &Protocol) -> Result<(String, String)> {
    let sentences = sentences(tables, study, protocol);
    let markdown = markdown(tables, &sentences);
    let files =
        [("tables.md", markdown.clone()), ("tables.csv", csv(tables)), ("tables.tex", latex(tables, &sentences))];
    Ok((markdown, write_texts(&study.folder, files)?))
}

/// Sentences that hold for all tables.
fn sentences(tables: &Tables, study: &Study, protocol: &Protocol) -> Vec<String> {
    let mut sentences = vec![
        "Each number is followed by the published one in parentheses.".to_owned(),
        format!("Means over scenes; of each scene over seeds {}.", study.content.seeds().join(", ")),
    ];
    if protocol.steps_scale != 1.0 {
        sentences.push(format!("Every method has {} of its published steps.", protocol.steps_scale));
    }
    sentences.extend(
        protocol.max_resolution.map(|most| format!("The longer side of photographs is at most {} px.", most.0)),
    );
    sentences.extend(protocol.sentences().map(str::to_owned));
    let mut scenes: Vec<&str> = tables.scenes.iter().map(|line| &line.scene[..]).collect();
    scenes.dedup();
    sentences.push(format!("Scenes: {}.", scenes.join(", ")));
    sentences.extend(tables.marks().iter().map(|mark| format!("{}: {}.", mark.letter(), mark.meaning())));
    if !study.content.not_run.is_empty() {
        sentences.push(format!("Not finished: {}.", study.content.not_run.join(", ")));
    }
    sentences
}

/// The name of a column in a table of several datasets.
fn name(table: &Table, column: &Column) -> String {
    let is_one = table.columns.iter().all(|other| other.dataset.name == column.dataset.name);
    if is_one { column.title.to_owned() } else { format!("{} {}", column.dataset.title, column.title) }
}

/// `found`, marks, and `published` in parentheses; `raised` sets the marks.
fn text(entry: &Entry, column: &Column, none: &str, raised: impl Fn(&str) -> String) -> String {
    let Column { digits, published_digits, .. } = *column;
    let marks: String = entry.marks.iter().map(|mark| mark.letter()).collect();
    let found = entry.found.map_or_else(|| none.to_owned(), |value| format!("{value:.digits$}"));
    let marks = if marks.is_empty() { marks } else { raised(&marks) };
    let published = entry.published.map(|value| format!(" ({value:.published_digits$})")).unwrap_or_default();
    format!("{found}{marks}{published}")
}

fn markdown(tables: &Tables, sentences: &[String]) -> String {
    let mut text = "# Benchmark\n\n".to_owned();
    sentences.iter().for_each(|sentence| _ = writeln!(text, "- {sentence}"));
    for table in &tables.tables {
        _ = writeln!(text, "\n## Table {}: {}\n", table.number, table.title);
        let title =
            |line: &Line| if line.name == DPGES { format!("**{}**", line.title) } else { line.title.to_owned() };
        let lines = cells(table, "method", title, "–", |marks| format!("<sup>{marks}</sup>"));
        text += &aligned(&lines, false);
        let orders = orders(table);
        if !orders.is_empty() {
            text += "\nOrder, the best first:\n\n";
            orders.iter().for_each(|order| _ = writeln!(text, "- {order}"));
        }
    }
    text
}

/// The cells of `table` under a head that begins with `first`. `title` is that of a line, `none` what stands for no number, and
/// `raised` sets marks.
fn cells(
    table: &Table,
    first: &str,
    title: impl Fn(&Line) -> String,
    none: &str,
    raised: impl Fn(&str) -> String,
) -> Vec<Vec<String>> {
    let names = table.columns.iter().map(|column| name(table, column));
    let head: Vec<String> = std::iter::once(first.to_owned()).chain(names).collect();
    let line = |line: &Line| -> Vec<String> {
        let entries = line.entries.iter().zip(&table.columns);
        let entries = entries.map(|(entry, column)| text(entry, column, none, &raised));
        std::iter::once(title(line)).chain(entries).collect()
    };
    std::iter::once(head).chain(table.lines.iter().map(line)).collect()
}

/// The orders of all columns in words.
fn orders(table: &Table) -> Vec<String> {
    let order = |(index, column): (usize, &Column)| {
        let Order { published, found, pairs, agreeing } = table.order(index)?;
        let (published, found) = (published.join(", "), found.join(", "));
        let name = name(table, column);
        Some(format!("{name}: paper {published}; found {found}; {agreeing} of {pairs} pairs in the same order"))
    };
    table.columns.iter().enumerate().filter_map(order).collect()
}

/// A line per number (RFC 4180): first those of the tables, then those of single scenes. What is not known is empty.
fn csv(tables: &Tables) -> String {
    let mut text = "table,method,dataset,scene,measure,found,published,marks,scenes\n".to_owned();
    for table in &tables.tables {
        for line in &table.lines {
            for (entry, column) in line.entries.iter().zip(&table.columns) {
                let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
                let marks: String = entry.marks.iter().map(|mark: &Mark| mark.letter()).collect();
                let (found, published) = (number(entry.found), number(entry.published));
                let (number, dataset, measure) = (table.number, &column.dataset.name, column.title);
                _ = writeln!(
                    text,
                    "{number},{},{dataset},,{measure},{found},{published},{marks},{}",
                    line.name, entry.scenes
                );
            }
        }
    }
    for line in &tables.scenes {
        let (dataset, scene) = line.scene.split_once('/').unwrap_or(("", &line.scene));
        for (measure, value) in &line.values {
            _ = writeln!(text, ",{},{dataset},{scene},{measure},{value},,,1", line.method);
        }
    }
    text
}

/// Without packages.
fn latex(tables: &Tables, sentences: &[String]) -> String {
    let mut text = String::new();
    sentences.iter().for_each(|sentence| _ = writeln!(text, "% {sentence}"));
    for table in &tables.tables {
        _ = writeln!(text, "\n\\begin{{table}}\n\\caption{{{}}}", escaped(table.title));
        _ = writeln!(text, "\\begin{{tabular}}{{l{}}}\n\\hline", "r".repeat(table.columns.len()));
        let raised = |marks: &str| format!("\\textsuperscript{{{marks}}}");
        let mut lines = cells(table, "Method", |line| escaped(line.title), "--", raised);
        lines[0].iter_mut().for_each(|name| *name = escaped(name));
        for (index, line) in lines.iter().enumerate() {
            let rule = if index == 0 { "\\hline\n" } else { "" };
            _ = write!(text, "{} \\\\\n{rule}", line.join(" & "));
        }
        text += "\\hline\n\\end{tabular}\n";
        let marks = tables.marks();
        let notes = marks.iter().map(|mark| format!("{}: {}.", mark.letter(), mark.meaning()));
        let notes: Vec<String> = notes.chain(orders(table)).map(|note| escaped(&note)).collect();
        notes.iter().for_each(|note| _ = writeln!(text, "\\par {note}"));
        text += "\\end{table}\n";
    }
    text
}

/// `text` as LaTeX prints it.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        if matches!(character, '&' | '%' | '_' | '#' | '$' | '{' | '}') {
            escaped.push('\\');
        }
        escaped.push(character);
    }
    escaped
}

#[cfg(test)]
mod tests {
    use dpges_train::dataset::MaxResolution;

    use super::super::SHAPE;
    use super::super::tables::tests::row;
    use super::*;

    #[test]
    fn tables_are_written_with_marks_published_numbers_and_orders() {
        let folder = tempfile::tempdir().unwrap();
        let protocol = Protocol { steps_scale: 0.5, max_resolution: Some(MaxResolution(64)), ..Protocol::default() };
        let mut study = Study::new(&SHAPE, folder.path(), protocol.subject());
        study.content.rows = vec![
            row("mcmc", "tanks-and-temples/truck", 0, 21.234),
            row("dpges", "tanks-and-temples/truck", 0, 22.0),
            row("dpges", "mipnerf360/garden", 0, 25.0),
        ];
        study.content.not_run.push("mipnerf360/garden/mcmc/seed_0".to_owned());
        let tables = Tables::of(&study.content.rows, &protocol);
        let (printed, paths) = write(&tables, &study, &protocol).unwrap();
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
        let (markdown, csv, latex) = (read("tables.md"), read("tables.csv"), read("tables.tex"));
        assert!(printed == markdown && paths.lines().count() == 3);
        for part in [
            "21.23<sup>ac</sup> (24.33)",
            "| **DP-GES** ",
            "– (27.43)",
            "2.5<sup>ac</sup> (156)",
            "## Table 3: Ablations",
            "Tanks & Temples PSNR: paper DP-GES, 3DGS-MCMC; found DP-GES, 3DGS-MCMC; 1 of 1 pairs in the same order",
            "- c: another number of steps.",
            "at most 64 px",
            "Scenes: mipnerf360/garden, tanks-and-temples/truck.",
            "Not finished: mipnerf360/garden/mcmc/seed_0.",
        ] {
            assert!(markdown.contains(part), "{part}: {markdown}");
        }
        let rows: Vec<&str> = markdown.lines().filter(|line| line.starts_with('|')).collect();
        assert!(rows.iter().take(13).all(|row| row.chars().count() == rows[0].chars().count()), "{markdown}");
        for part in [
            "1,mcmc,tanks-and-temples,,PSNR,21.234,24.33,ac,1",
            "1,3dgs,mipnerf360,,PSNR,,27.43,,0",
            "2,dpges,mipnerf360,,FPS,100,472,ac,1",
            ",dpges,mipnerf360,garden,MB,2.5,,,1",
        ] {
            assert!(csv.lines().any(|line| line == part), "{part}: {csv}");
        }
        assert!(csv.lines().all(|line| line.split(',').count() == 9), "{csv}");
        for part in [
            "Tanks \\& Temples PSNR",
            "21.23\\textsuperscript{ac} (24.33)",
            "\\par c: another number of steps.",
            "\\begin{tabular}{lrrrrrrrrrrrr}",
            "FLIP\\_1",
        ] {
            assert!(latex.contains(part), "{part}: {latex}");
        }
        let count = |part: &str| latex.matches(part).count();
        assert_eq!((count("\\begin{table}"), count("\\end{table}"), count("\\end{tabular}")), (3, 3, 3));
    }
}

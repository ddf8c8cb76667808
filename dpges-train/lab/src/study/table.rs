//! The rows of a study as a table: for people in Markdown and HTML, and unrounded as CSV.

use std::fmt::Write as _;

use super::measure::{MEASURES, Measure};
use super::row::{Group, groups};
use super::store::Study;

/// Measures whose differences to the first line are in the CSV.
const WITH_DIFFERENCE: [&str; 2] = ["psnr", "ssim"];

/// Text for people: a line for each label, whose differences are to the first label.
#[derive(Debug)]
pub struct Table {
    /// Cells of the head, then those of each line.
    lines: Vec<Vec<String>>,
    /// Whether a line is on a frontier, but for the head.
    is_best: Vec<bool>,
}

impl Table {
    /// All of it.
    pub fn whole(study: &Study) -> Self {
        let groups = groups(&study.content.rows);
        let columns: Vec<&Measure> = known(&groups).collect();
        Self::new(study, &groups, groups.first(), &columns)
    }

    /// The printed table: fewer columns, and where the study says so only the first line and frontiers, by ascending cost.
    pub fn printed(study: &Study) -> Self {
        let all = groups(&study.content.rows);
        let mut shown = all.clone();
        if study.shape.frontier_alone {
            shown.retain(|group| study.is_best(group.label) || group.label == all[0].label);
            let cost = |group: &Group| group.spread("frame_ms").map_or(f64::MAX, |spread| spread.mean);
            shown.sort_by(|a, b| cost(a).total_cmp(&cost(b)));
        }
        let columns: Vec<&Measure> = known(&shown).filter(|measure| measure.is_printed).collect();
        Self::new(study, &shown, all.first(), &columns)
    }

    fn new(study: &Study, groups: &[Group], base: Option<&Group>, columns: &[&Measure]) -> Self {
        let base = base.filter(|_| groups.len() > 1);
        let mut head = vec![study.shape.line.to_owned()];
        for measure in columns {
            head.push(measure.title.to_owned());
            head.extend(base.filter(|_| measure.key == "psnr").map(|base| format!("to {}", base.label)));
        }
        let line = |group: &Group| {
            let mut cells = vec![group.label.to_owned()];
            for measure in columns {
                let spread = group.spread(measure.key);
                cells.push(spread.map(|spread| measure.text(spread)).unwrap_or_default());
                if let Some(base) = base.filter(|_| measure.key == "psnr") {
                    let other = (group.label != base.label).then(|| group.difference(base, "psnr")).flatten();
                    cells.push(other.map(|spread| format!("{spread:+.2}")).unwrap_or_default());
                }
            }
            cells
        };
        let is_best = groups.iter().map(|group| study.is_best(group.label)).collect();
        Self { lines: std::iter::once(head).chain(groups.iter().map(line)).collect(), is_best }
    }

    /// Numbers stand right.
    pub fn markdown(&self) -> String {
        aligned(&self.lines, true)
    }

    /// Lines of frontiers have the class `best`.
    pub fn html(&self) -> String {
        let cells = |tag: &str, cells: &[String]| -> String {
            cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect()
        };
        let mut html = format!("<table>\n<tr>{}</tr>\n", cells("th", &self.lines[0]));
        for (line, is_best) in self.lines[1..].iter().zip(&self.is_best) {
            let class = if *is_best { " class=\"best\"" } else { "" };
            _ = writeln!(html, "<tr{class}>{}</tr>", cells("td", line));
        }
        html + "</table>\n"
    }
}

/// `lines`, of which the first is the head, in Markdown and aligned as text too; cells behind the first of a line stand right
/// where `numbers_right`.
pub fn aligned(lines: &[Vec<String>], numbers_right: bool) -> String {
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0).max(3);
    let widths: Vec<usize> = (0..lines[0].len()).map(width).collect();
    let stands_right = |column: usize| numbers_right && column > 0;
    let written = |line: &Vec<String>| {
        let cells = line.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
            if stands_right(column) { format!("| {cell:>width$} ") } else { format!("| {cell:width$} ") }
        });
        cells.collect::<String>() + "|\n"
    };
    let rules = widths.iter().enumerate().map(|(column, width)| {
        let end = if stands_right(column) { ":" } else { "-" };
        format!("|{}{end}", "-".repeat(width + 1))
    });
    written(&lines[0]) + &rules.collect::<String>() + "|\n" + &lines[1..].iter().map(written).collect::<String>()
}

/// A line per label under a line of names: means, with several seeds sample standard deviations, and differences to the first
/// label. What is not known is empty (RFC 4180).
pub fn csv(study: &Study) -> String {
    let groups = groups(&study.content.rows);
    let has_seeds = groups.iter().any(|group| group.rows.len() > 1);
    let columns: Vec<&Measure> = known(&groups).collect();
    let differs = |measure: &Measure| groups.len() > 1 && WITH_DIFFERENCE.contains(&measure.key);
    let mut text = format!("{},seeds,settings", study.shape.line);
    for measure in &columns {
        for suffix in ["", "_difference"].iter().take(if differs(measure) { 2 } else { 1 }) {
            _ = write!(text, ",{}{suffix}", measure.key);
            if has_seeds {
                _ = write!(text, ",{}{suffix}_deviation", measure.key);
            }
        }
    }
    text += "\n";
    for group in &groups {
        let settings = quoted(&group.rows[0].settings.join(" "));
        _ = write!(text, "{},{},{settings}", quoted(group.label), group.rows.len());
        for measure in &columns {
            let difference = differs(measure).then(|| group.difference(&groups[0], measure.key));
            for spread in std::iter::once(group.spread(measure.key)).chain(difference) {
                let deviation = has_seeds.then(|| spread.and_then(|spread| spread.deviation));
                for value in std::iter::once(spread.map(|spread| spread.mean)).chain(deviation) {
                    text += ",";
                    text += &value.map(|value| measure.exact(value)).unwrap_or_default();
                }
            }
        }
        text += "\n";
    }
    text
}

/// Measures that some group has of all its rows.
fn known(groups: &[Group]) -> impl Iterator<Item = &'static Measure> {
    MEASURES.iter().filter(|measure| groups.iter().any(|group| group.spread(measure.key).is_some()))
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

/// `text` within HTML.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::row::Row;
    use super::super::row::tests::{drawn, seeded};
    use super::super::store::tests::subject;
    use super::super::{compare, trade};
    use super::*;

    fn comparison(rows: Vec<Row>) -> Study {
        let mut study = Study::new(&compare::SHAPE, Path::new("."), subject());
        study.content.rows = rows;
        study
    }

    fn two() -> Vec<Row> {
        [seeded("dpges", &[10.0, 20.0, 30.0]), seeded("mcmc", &[11.0, 22.0, 33.0])].concat()
    }

    #[test]
    fn the_table_has_means_spreads_and_paired_differences() {
        let expected = "\
            | method |      PSNR, dB |     to dpges |            SSIM | surfels | Gaussians |   MB | training, s |\n\
            |--------|--------------:|-------------:|----------------:|--------:|----------:|-----:|------------:|\n\
            | dpges  | 20.00 ± 10.00 |              | 0.7500 ± 0.0000 |      12 |       347 | 6.70 |          89 |\n\
            | mcmc   | 22.00 ± 11.00 | +2.00 ± 1.00 | 0.7500 ± 0.0000 |      12 |       347 | 6.70 |          89 |\n";
        assert_eq!(Table::printed(&comparison(two())).markdown(), expected);
    }

    #[test]
    fn one_seed_has_no_spread_and_one_label_no_difference() {
        let study = comparison(seeded("dpges", &[28.0]));
        let table = Table::printed(&study).markdown();
        assert!(table.contains(" 28.00 |") && !table.contains('±') && !table.contains("to dpges"), "{table}");
        let expected = "method,seeds,settings,psnr,ssim,surfels,gaussians,primitives,bytes,training_seconds\n\
                        dpges,1,,28.0000,0.750000,12,345,357,6700000,89.0\n";
        assert_eq!(csv(&study), expected);
    }

    #[test]
    fn the_csv_has_a_line_per_label_with_deviations_and_differences() {
        let text = csv(&comparison(two()));
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        assert!(lines.len() == 3 && lines.iter().all(|line| line.len() == lines[0].len()), "{text}");
        let value = |line: usize, name: &str| lines[line][lines[0].iter().position(|other| *other == name).unwrap()];
        for (name, expected) in [
            ("method", "mcmc"),
            ("seeds", "3"),
            ("psnr", "22.0000"),
            ("psnr_deviation", "11.0000"),
            ("psnr_difference", "2.0000"),
            ("psnr_difference_deviation", "1.0000"),
            ("ssim_difference", "0.000000"),
            ("bytes", "6700000"),
        ] {
            assert_eq!(value(2, name), expected, "{name}: {text}");
        }
        assert_eq!(quoted("a \"b\", c"), "\"a \"\"b\"\", c\"");
    }

    #[test]
    fn a_measure_has_a_column_if_some_label_has_it_of_every_seed() {
        let mut rows = two();
        rows[0].set("lpips_vgg", Some(0.5));
        assert!(!Table::printed(&comparison(rows.clone())).markdown().contains("LPIPS"), "of one seed of three");
        rows[1..3].iter_mut().for_each(|row| row.set("lpips_vgg", Some(0.25)));
        rows.iter_mut().for_each(|row| row.set("validation_psnr", Some(15.0)));
        let table = Table::printed(&comparison(rows.clone())).markdown();
        for part in [" LPIPS (VGG) |", "| 0.3333 ± 0.1443 |", " validation PSNR |", "15.00 ± 0.00"] {
            assert!(table.contains(part), "{part}: {table}");
        }
        let text = csv(&comparison(rows));
        assert!(text.lines().last().unwrap().contains(",,,15.0000,0.0000,"), "unknown of mcmc: {text}");
    }

    #[test]
    fn the_printed_table_of_a_trade_has_the_frontier_by_cost_and_the_page_has_all() {
        let mut study = Study::new(&trade::SHAPE, Path::new("."), subject());
        study.content.rows = vec![
            drawn("as trained", 30.0, 5.0, 100),
            drawn("<b>", 29.0, 3.0, 100),
            drawn("modulation=4w", 20.0, 6.0, 100),
        ];
        study.content.frontiers.insert("frame_ms".to_owned(), vec!["<b>".to_owned(), "as trained".to_owned()]);
        let text = Table::printed(&study).markdown();
        let rows: Vec<&str> = text.lines().collect();
        assert!(rows.len() == 4 && rows[2].starts_with("| <b>        |    29.00 |         -1.00 |"), "{text}");
        let html = Table::whole(&study).html();
        assert!(
            html.contains("<tr class=\"best\"><td>&lt;b&gt;</td>") && html.contains("<tr><td>modulation=4w"),
            "{html}"
        );
    }
}

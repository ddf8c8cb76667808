//! The comparison of methods: a table in Markdown, `comparison.csv`, `comparison.json`, `comparison.svg`.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use dpges_core::scene::atomic::write_atomically;
use dpges_train::eval::floaters::Floaters;
use dpges_train::eval::popping::Popping;
use dpges_train::metrics::{Metric, Scores, further_metrics};
use dpges_train::run::folder::write_json;
use serde::Serialize;

use super::super::series::Member;
use super::super::series::chart::psnr_chart;
use super::super::series::row::{Measured, Row};
use super::super::series::statistics::Spread;
use super::sheets::Pictures;
use crate::cli::Result;
use crate::cli::data::Source;

const COLUMNS: &str = "method,seeds,psnr,psnr_deviation,ssim,ssim_deviation,flip,flip_deviation,\
                       ms_ssim,ms_ssim_deviation,ssimulacra2,ssimulacra2_deviation,lpips_alex,lpips_alex_deviation,\
                       lpips_vgg,lpips_vgg_deviation,psnr_difference,psnr_difference_deviation,\
                       ssim_difference,ssim_difference_deviation,validation_psnr,validation_psnr_deviation,\
                       validation_ssim,validation_ssim_deviation,surfels,gaussians,floaters,bytes,seconds,\
                       flip_1,flip_1_deviation,flip_7,flip_7_deviation";

/// Everything that is known of a comparison: the content of `comparison.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Folder of the dataset, or `builtin`.
    dataset: String,
    /// `train.steps` of every run.
    steps: usize,
    /// Largest number of surfels and Gaussians together, of every run.
    budget: usize,
    seeds: Vec<u64>,
    /// In the order in which they were asked for.
    methods: Vec<Entry>,
    pictures: Pictures,
    #[serde(skip)]
    rows: Vec<Row>,
}

/// A method: means and spreads over its seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Entry {
    method: &'static str,
    /// `key=value` of what makes a configuration this method.
    settings: Vec<String>,
    /// Of the held-out views, dB.
    psnr: Spread,
    /// Of the held-out views.
    ssim: Spread,
    /// Of the held-out views, an error.
    flip: Spread,
    /// Of the held-out views, and the same of the three that follow; `None` if a run does not have it.
    ms_ssim: Option<Spread>,
    ssimulacra2: Option<Spread>,
    /// An error.
    lpips_alex: Option<Spread>,
    /// An error.
    lpips_vgg: Option<Spread>,
    /// Popping, an error, and the same of the next; `None` if a run does not have it.
    flip_1: Option<Spread>,
    flip_7: Option<Spread>,
    /// To the first method, seed by seed, dB.
    psnr_difference: Spread,
    /// To the first method, seed by seed.
    ssim_difference: Spread,
    /// Of the validation views, dB; `None` if there are none.
    validation_psnr: Option<Spread>,
    validation_ssim: Option<Spread>,
    surfels: Spread,
    gaussians: Spread,
    /// Primitives in the way of points that training views saw; `None` if the dataset does not say which view saw what.
    floaters: Option<Spread>,
    /// Size of the scene file.
    bytes: Spread,
    /// Wall-clock time up to the last step.
    seconds: Spread,
    runs: Vec<RunEntry>,
}

/// A run of a method.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct RunEntry {
    seed: u64,
    /// Relative to the folder of the comparison.
    folder: String,
    test: Scores,
    validation: Option<Scores>,
    surfels: usize,
    gaussians: usize,
    floaters: Option<Floaters>,
    popping: Option<Popping>,
    bytes: u64,
    seconds: f64,
}

impl Comparison {
    /// `rows` are those of `members`, in their order.
    pub fn new(
        source: &Source,
        steps: usize,
        budget: usize,
        members: &[Member],
        rows: Vec<Row>,
        pictures: Pictures,
    ) -> Self {
        let entry = |(member, row): (&Member, &Row)| Entry::new(member, row, &rows[0]);
        Self {
            dataset: source.to_string(),
            steps,
            budget,
            seeds: rows.first().map_or_else(Vec::new, |row| row.runs.iter().map(|run| run.seed).collect()),
            methods: members.iter().zip(&rows).map(entry).collect(),
            pictures,
            rows,
        }
    }

    /// Writes all files but the pictures into `folder`; returns the paths of all, one a line.
    pub fn write(&self, folder: &Path) -> Result<String> {
        let mut paths = String::new();
        for (name, text) in [("comparison.csv", self.csv()), ("comparison.svg", psnr_chart(&self.rows))] {
            let path = folder.join(name);
            write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
            _ = writeln!(paths, "{}", path.display());
        }
        let path = folder.join("comparison.json");
        write_json(&path, self)?;
        _ = writeln!(paths, "{}", path.display());
        for sheet in &self.pictures.sheets {
            _ = writeln!(paths, "{}", folder.join(&sheet.file).display());
        }
        Ok(paths)
    }

    /// The comparison in Markdown, and what it is of.
    pub fn table(&self) -> String {
        let validates = self.methods.iter().any(|entry| entry.validation_psnr.is_some());
        let has_others = self.methods.len() > 1;
        let first = self.methods.first().map_or("", |entry| entry.method);
        let mut lines = vec![vec!["method".to_owned(), "PSNR, dB".to_owned()]];
        lines[0].extend(has_others.then(|| format!("to {first}")));
        lines[0].extend(["SSIM", "FLIP"].map(str::to_owned));
        let further = self.further_metrics();
        lines[0].extend(further.iter().map(|metric| metric.title.to_owned()));
        let pops = self.methods.iter().all(|entry| entry.flip_1.is_some());
        if pops {
            lines[0].extend(["FLIP_1", "FLIP_7"].map(str::to_owned));
        }
        if validates {
            lines[0].extend(["validation PSNR", "validation SSIM"].map(str::to_owned));
        }
        let floats = self.methods.iter().any(|entry| entry.floaters.is_some());
        lines[0].push("surfels + Gaussians".to_owned());
        lines[0].extend(floats.then(|| "floaters".to_owned()));
        lines[0].extend(["MB", "seconds"].map(str::to_owned));
        for (index, (entry, row)) in self.methods.iter().zip(&self.rows).enumerate() {
            let mut line = vec![entry.method.to_owned(), format!("{:.2}", entry.psnr)];
            line.extend(has_others.then(|| match index {
                0 => String::new(),
                _ => format!("{:+.2}", entry.psnr_difference),
            }));
            line.extend([entry.ssim, entry.flip].map(|spread| format!("{spread:.4}")));
            let of = |metric: &Metric| row.spread_if_known(|run| metric.of(&run.test));
            line.extend(further.iter().filter_map(|metric| Some(format!("{:.*}", metric.digits, of(metric)?))));
            if pops {
                line.extend([entry.flip_1, entry.flip_7].into_iter().flatten().map(|spread| format!("{spread:.4}")));
            }
            if validates {
                line.push(entry.validation_psnr.map(|spread| format!("{spread:.2}")).unwrap_or_default());
                line.push(entry.validation_ssim.map(|spread| format!("{spread:.4}")).unwrap_or_default());
            }
            line.push(format!("{:.0} + {:.0}", entry.surfels.mean, entry.gaussians.mean));
            if floats {
                line.push(entry.floaters.map(|spread| format!("{:.0}", spread.mean)).unwrap_or_default());
            }
            line.extend([format!("{:.2}", entry.bytes.mean / 1e6), format!("{:.0}", entry.seconds.mean)]);
            lines.push(line);
        }
        markdown(&lines) + "\n" + &self.conditions()
    }

    /// Of the metrics that only some runs have those that every run here has.
    fn further_metrics(&self) -> Vec<&'static Metric> {
        let is_known =
            |metric: &&Metric| self.rows.iter().flat_map(|row| &row.runs).all(|run| metric.of(&run.test).is_some());
        further_metrics().iter().filter(is_known).collect()
    }

    /// What the table is of, in sentences.
    fn conditions(&self) -> String {
        let Self { dataset, steps, budget, seeds, .. } = self;
        let mut text = format!("{dataset}: held-out views, {steps} steps, at most {budget} primitives, ");
        text += match seeds.len() {
            1 => "seed ",
            _ => "mean ± sample standard deviation over seeds ",
        };
        text += &seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
        if seeds.len() > 1 && self.methods.len() > 1 {
            text += "; differences are taken seed by seed";
        }
        text += ".\n";
        if !self.pictures.sheets.is_empty() {
            let columns = self.pictures.columns.join(" · ");
            _ = writeln!(text, "Pictures: {columns}; below each its error. Seed {}.", self.pictures.seed);
        }
        text
    }

    /// A line per method under a line of [`COLUMNS`]. What is not known is empty.
    fn csv(&self) -> String {
        let mut text = format!("{COLUMNS}\n");
        for entry in &self.methods {
            _ = write!(text, "{},{}", entry.method, entry.runs.len());
            text += &with_deviations(&[
                (Some(entry.psnr), 4),
                (Some(entry.ssim), 6),
                (Some(entry.flip), 6),
                (entry.ms_ssim, 6),
                (entry.ssimulacra2, 4),
                (entry.lpips_alex, 6),
                (entry.lpips_vgg, 6),
                (Some(entry.psnr_difference), 4),
                (Some(entry.ssim_difference), 6),
                (entry.validation_psnr, 4),
                (entry.validation_ssim, 6),
            ]);
            let Entry { surfels, gaussians, bytes, seconds, .. } = entry;
            let (surfels, gaussians, bytes, seconds) = (surfels.mean, gaussians.mean, bytes.mean, seconds.mean);
            let floaters = entry.floaters.map(|spread| format!("{:.0}", spread.mean)).unwrap_or_default();
            _ = write!(text, ",{surfels:.0},{gaussians:.0},{floaters},{bytes:.0},{seconds:.1}");
            text += &with_deviations(&[(entry.flip_1, 6), (entry.flip_7, 6)]);
            text += "\n";
        }
        text
    }
}

/// A mean and a deviation for each, with so many digits; empty where nothing is known.
fn with_deviations(spreads: &[(Option<Spread>, usize)]) -> String {
    let cell = |(value, digits): (Option<f64>, usize)| match value {
        Some(value) => format!(",{value:.digits$}"),
        None => ",".to_owned(),
    };
    let cells = |&(spread, digits): &(Option<Spread>, usize)| {
        let values = [spread.map(|spread| spread.mean), spread.and_then(|spread| spread.deviation)];
        values.map(|value| cell((value, digits))).concat()
    };
    spreads.iter().map(cells).collect()
}

impl Entry {
    fn new(member: &Member, row: &Row, base: &Row) -> Self {
        let psnr: fn(&Measured) -> f64 = |run| run.test.psnr;
        let ssim: fn(&Measured) -> f64 = |run| run.test.ssim;
        Self {
            method: member.label,
            settings: member.settings.clone(),
            psnr: row.spread(psnr),
            ssim: row.spread(ssim),
            flip: row.spread(|run| run.test.flip),
            ms_ssim: row.spread_if_known(|run| run.test.perceptual.ms_ssim),
            ssimulacra2: row.spread_if_known(|run| run.test.perceptual.ssimulacra2),
            lpips_alex: row.spread_if_known(|run| run.test.perceptual.lpips_alex),
            lpips_vgg: row.spread_if_known(|run| run.test.perceptual.lpips_vgg),
            flip_1: row.spread_if_known(|run| run.popping.map(|popping| popping.flip_1)),
            flip_7: row.spread_if_known(|run| run.popping.map(|popping| popping.flip_7)),
            psnr_difference: row.difference(base, psnr),
            ssim_difference: row.difference(base, ssim),
            validation_psnr: row.validation(|scores| scores.psnr),
            validation_ssim: row.validation(|scores| scores.ssim),
            surfels: row.spread(|run| run.surfels as f64),
            gaussians: row.spread(|run| run.gaussians as f64),
            floaters: row.spread_if_known(|run| run.floaters.map(|found| (found.surfels + found.gaussians) as f64)),
            bytes: row.spread(|run| run.bytes as f64),
            seconds: row.spread(|run| run.seconds),
            runs: row.runs.iter().map(RunEntry::new).collect(),
        }
    }
}

impl RunEntry {
    fn new(run: &Measured) -> Self {
        let Measured { seed, test, validation, surfels, gaussians, floaters, popping, bytes, seconds, .. } = *run;
        let folder = run.folder.clone();
        Self { seed, folder, test, validation, surfels, gaussians, floaters, popping, bytes, seconds }
    }
}

/// A table in Markdown whose columns are aligned as text too; the first line is its head, numbers stand right.
fn markdown(lines: &[Vec<String>]) -> String {
    let columns = lines.iter().map(Vec::len).max().unwrap_or(0);
    let length = |line: &Vec<String>, column: usize| line.get(column).map_or(0, |cell| cell.chars().count());
    let widths: Vec<usize> =
        (0..columns).map(|column| lines.iter().map(|line| length(line, column)).max().unwrap_or(0).max(3)).collect();
    let written = |line: &Vec<String>| {
        let cells = line.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| match column {
            0 => format!(" {cell:width$} |"),
            _ => format!(" {cell:>width$} |"),
        });
        format!("|{}\n", cells.collect::<String>())
    };
    let rules = widths.iter().enumerate().map(|(column, &width)| match column {
        0 => format!("{}|", "-".repeat(width + 2)),
        _ => format!("{}:|", "-".repeat(width + 1)),
    });
    let mut text = lines.first().map(&written).unwrap_or_default();
    text += &format!("|{}\n", rules.collect::<String>());
    text + &lines.iter().skip(1).map(written).collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::super::super::series::row::tests::{row, scores};
    use super::super::sheets::Sheet;
    use super::*;

    fn comparison(rows: Vec<Row>) -> Comparison {
        let sheet = Sheet {
            file: "pictures/a.png".to_owned(),
            view: "a.jpg".to_owned(),
            chosen: "worst",
            psnr: vec![Some(9.0)],
        };
        let pictures = Pictures {
            seed: 0,
            columns: std::iter::once("photograph").chain(rows.iter().map(|row| row.label)).collect(),
            rows: ["picture", "error"],
            largest_error: 0.25,
            sheets: vec![sheet],
        };
        let member = |row: &Row| Member { label: row.label, settings: vec![format!("train.method={}", row.label)] };
        let members: Vec<Member> = rows.iter().map(member).collect();
        Comparison::new(&Source::Builtin, 30, 900, &members, rows, pictures)
    }

    fn two() -> Vec<Row> {
        vec![row("dpges", &[10.0, 20.0, 30.0]), row("mcmc", &[11.0, 22.0, 33.0])]
    }

    #[test]
    fn the_table_has_means_spreads_and_paired_differences() {
        let expected = "\
            | method |      PSNR, dB |     to dpges |            SSIM |            FLIP | surfels + Gaussians |   MB | \
            seconds |\n\
            |--------|--------------:|-------------:|----------------:|----------------:|--------------------:|-----:|\
            --------:|\n\
            | dpges  | 20.00 ± 10.00 |              | 0.7500 ± 0.0000 | 0.1250 ± 0.0000 |            12 + 347 | 6.70 |      \
            89 |\n\
            | mcmc   | 22.00 ± 11.00 | +2.00 ± 1.00 | 0.7500 ± 0.0000 | 0.1250 ± 0.0000 |            12 + 347 | 6.70 |      \
            89 |\n\
            \n\
            builtin: held-out views, 30 steps, at most 900 primitives, mean ± sample standard deviation over seeds 0, 1, \
            2; differences are taken seed by seed.\n\
            Pictures: photograph · dpges · mcmc; below each its error. Seed 0.\n";
        assert_eq!(comparison(two()).table(), expected);
    }

    #[test]
    fn one_seed_has_no_spread_and_one_method_no_difference() {
        let table = comparison(vec![row("dpges", &[28.0])]).table();
        assert!(table.contains("28.00 |") && table.contains("seed 0.\n"), "{table}");
        assert!(!table.contains('±') && !table.contains("to dpges"), "{table}");
    }

    #[test]
    fn validation_views_have_columns_if_there_are_any() {
        let mut rows = two();
        for (row, psnr) in rows.iter_mut().zip([15.0, 17.5]) {
            row.runs.iter_mut().for_each(|run| run.validation = Some(scores(psnr, 0.5, 0.25)));
        }
        let with = comparison(rows);
        for part in ["| validation PSNR |", "15.00 ± 0.00", "17.50 ± 0.00", "0.5000 ± 0.0000"] {
            assert!(with.table().contains(part), "{part}: {}", with.table());
        }
        assert!(with.csv().contains(",15.0000,0.0000,0.500000,0.000000,12,"), "{}", with.csv());
        assert!(!comparison(two()).table().contains("validation"));
    }

    #[test]
    fn floaters_have_a_column_if_they_are_known() {
        let mut rows = two();
        for (row, gaussians) in rows.iter_mut().zip([5, 9]) {
            row.runs.iter_mut().for_each(|run| run.floaters = Some(Floaters { surfels: 1, gaussians }));
        }
        let with = comparison(rows);
        assert!(
            with.table().contains("| floaters |") && with.table().contains("|       10 | 6.70 |"),
            "{}",
            with.table()
        );
        assert!(
            with.csv().contains(",12,347,6,6700000,") && with.csv().contains(",12,347,10,6700000,"),
            "{}",
            with.csv()
        );
        assert!(!comparison(two()).table().contains("floaters"));
    }

    #[test]
    fn perceptual_metrics_have_columns_if_every_run_has_them() {
        let mut rows = two();
        for run in rows.iter_mut().flat_map(|row| &mut row.runs) {
            run.test.perceptual.lpips_alex = Some(0.25);
            run.test.perceptual.ssimulacra2 = Some(if run.seed == 2 { 50.0 } else { 20.0 });
        }
        rows[1].runs[0].test.perceptual.lpips_vgg = Some(0.5);
        let mut with = comparison(rows);
        let table = with.table();
        assert!(table.contains(" SSIMULACRA2 |") && table.contains("| 30.00 ± 17.32 |"), "{table}");
        assert!(table.contains("LPIPS (Alex) |") && table.contains("| 0.2500 ± 0.0000 |"), "{table}");
        assert!(!table.contains("VGG") && !table.contains("MS-SSIM"), "{table}");
        let part = ",,,30.0000,17.3205,0.250000,0.000000,,,";
        assert!(with.csv().lines().skip(1).all(|line| line.contains(part)), "{}", with.csv());
        with.rows[1].runs[0].test.perceptual.lpips_alex = None;
        assert!(!with.table().contains("LPIPS"), "{}", with.table());
    }

    #[test]
    fn popping_has_columns_if_every_run_has_it() {
        let mut rows = two();
        for (row, flip_7) in rows.iter_mut().zip([0.25, 0.5]) {
            let popping = Popping { flip_1: 0.125, flip_7, frames: 60, pixels_compared: [0.9, 0.8] };
            row.runs.iter_mut().for_each(|run| run.popping = Some(popping));
        }
        let with = comparison(rows.clone());
        let table = with.table();
        assert!(table.contains(" FLIP_1 |") && table.contains("| 0.5000 ± 0.0000 |"), "{table}");
        let csv = with.csv();
        assert!(csv.ends_with(",89.0,0.125000,0.000000,0.500000,0.000000\n"), "{csv}");
        assert!(csv.lines().all(|line| line.split(',').count() == 33), "{csv}");
        rows[0].runs[1].popping = None;
        let without = comparison(rows);
        assert!(!without.table().contains("FLIP_1"), "{}", without.table());
        assert!(without.csv().lines().nth(1).unwrap().ends_with(",89.0,,,,"), "{}", without.csv());
    }

    #[test]
    fn the_csv_has_a_line_per_method_and_leaves_out_what_is_unknown() {
        let csv = comparison(two()).csv();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines[0], COLUMNS);
        assert_eq!(
            lines[2],
            "mcmc,3,22.0000,11.0000,0.750000,0.000000,0.125000,0.000000,,,,,,,,,2.0000,1.0000,0.000000,0.000000,,,,,12,347,,6700000,89.0,,,,"
        );
        assert!(lines.iter().all(|line| line.split(',').count() == 33), "{csv}");
        let once = comparison(vec![row("dpges", &[28.0])]).csv();
        assert!(
            once.ends_with(
                "dpges,1,28.0000,,0.750000,,0.125000,,,,,,,,,,0.0000,,0.000000,,,,,,12,345,,6700000,89.0,,,,\n"
            ),
            "{once}"
        );
    }

    #[test]
    fn the_json_has_the_documented_keys() {
        let json = serde_json::to_value(comparison(two())).unwrap();
        let keys = |value: &serde_json::Value| {
            let mut keys: Vec<String> = value.as_object().unwrap().keys().cloned().collect();
            keys.sort();
            keys.join(" ")
        };
        assert_eq!(keys(&json), "budget dataset methods pictures seeds steps");
        let second = &json["methods"][1];
        assert_eq!(
            keys(second),
            "bytes flip flip_1 flip_7 floaters gaussians lpips_alex lpips_vgg method ms_ssim psnr psnr_difference runs seconds settings ssim \
             ssim_difference ssimulacra2 surfels validation_psnr validation_ssim"
        );
        assert_eq!(second["psnr_difference"], serde_json::json!({ "mean": 2.0, "deviation": 1.0 }));
        assert_eq!(
            keys(&second["runs"][0]),
            "bytes floaters folder gaussians popping seconds seed surfels test validation"
        );
        assert_eq!(second["runs"][2]["test"]["psnr"], 33.0);
        assert_eq!(keys(&json["pictures"]), "columns largest_error rows seed sheets");
        assert_eq!(keys(&json["pictures"]["sheets"][0]), "chosen file psnr view");
    }

    #[test]
    fn all_files_are_written_and_named() {
        let folder = tempfile::tempdir().unwrap();
        let paths = comparison(two()).write(folder.path()).unwrap();
        let names: Vec<&str> = paths.lines().map(|path| path.rsplit('/').next().unwrap()).collect();
        assert_eq!(names, ["comparison.csv", "comparison.svg", "comparison.json", "a.png"]);
        assert!(paths.lines().take(3).all(|path| Path::new(path).is_file()));
    }
}

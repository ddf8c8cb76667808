//! The comparison of variants: a table, `ablation.csv`, `ablation.svg`.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use dpges_core::scene::atomic::write_atomically;

use super::super::series::chart::psnr_chart;
use super::super::series::row::{Measured, Row};
use super::super::series::statistics::Spread;
use super::variant::METHOD;
use crate::cli::progress::Seconds;
use crate::cli::{Result, table as names_and_values};

const COLUMNS: &str = "variant,psnr,ssim,surfels,gaussians,bytes,seconds";
/// Further columns with several seeds. Differences are to the row of [`METHOD`].
const OF_SEEDS: &str = ",seeds,psnr_deviation,ssim_deviation,psnr_difference,psnr_difference_deviation,\
                        ssim_difference,ssim_difference_deviation";

/// Writes `ablation.csv` and `ablation.svg` into `folder`; returns their paths, one a line.
pub fn write(folder: &Path, rows: &[Row]) -> Result<String> {
    let mut paths = String::new();
    for (name, text) in [("ablation.csv", csv(rows)), ("ablation.svg", psnr_chart(rows))] {
        let path = folder.join(name);
        write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
        _ = writeln!(paths, "{}", path.display());
    }
    Ok(paths)
}

/// The comparison for the terminal, a line per variant: means over the seeds, with several seeds also sample standard
/// deviations, and differences to the method in parentheses.
pub fn table(rows: &[Row]) -> String {
    let base = base(rows);
    let values = rows.iter().map(|row| {
        let mean = |of: fn(&Measured) -> f64| row.spread(of).mean;
        let mut psnr = row.spread(psnr).to_string();
        let mut ssim = format!("{:.4}", row.spread(ssim));
        if let Some(base) = base {
            _ = write!(psnr, " ({:+.2})", row.difference(base, self::psnr));
            _ = write!(ssim, " ({:+.4})", row.difference(base, self::ssim));
        }
        let (surfels, gaussians) = (mean(|run| run.surfels as f64), mean(|run| run.gaussians as f64));
        let (megabytes, seconds) = (mean(|run| run.bytes as f64) / 1e6, Seconds(mean(|run| run.seconds)));
        format!(
            "{psnr:>6} dB  {ssim}  {surfels:>7.0} surfels  {gaussians:>8.0} Gaussians  {megabytes:>6.1} MB  {seconds}"
        )
    });
    let lines = names_and_values(&rows.iter().map(|row| row.label).zip(values).collect::<Vec<_>>());
    match (rows.first().map_or(1, |row| row.runs.len()), base) {
        (0 | 1, _) => lines,
        (seeds, None) => format!("{lines}mean ± sample standard deviation over {seeds} seeds\n"),
        (seeds, Some(_)) => format!(
            "{lines}mean ± sample standard deviation over {seeds} seeds; in parentheses the difference to {METHOD}, seed \
             by seed\n"
        ),
    }
}

/// A line per variant under a line of names.
fn csv(rows: &[Row]) -> String {
    let has_seeds = rows.iter().any(|row| row.runs.len() > 1);
    let mut text = format!("{COLUMNS}{}\n", if has_seeds { OF_SEEDS } else { "" });
    for row in rows {
        let [psnr_spread, ssim_spread] = [row.spread(psnr), row.spread(ssim)];
        let counts: [fn(&Measured) -> f64; 3] =
            [|run| run.surfels as f64, |run| run.gaussians as f64, |run| run.bytes as f64];
        let [surfels, gaussians, bytes] = counts.map(|of| row.spread(of).mean);
        _ = write!(text, "{},{:.4},{:.6}", row.label, psnr_spread.mean, ssim_spread.mean);
        _ = write!(text, ",{surfels:.0},{gaussians:.0},{bytes:.0},{:.1}", row.spread(|run| run.seconds).mean);
        if has_seeds {
            let difference = |of| base(rows).map(|base| row.difference(base, of));
            let [by_psnr, by_ssim] = [difference(psnr as fn(&Measured) -> f64), difference(ssim)];
            let deviation = |spread: Option<Spread>| spread.and_then(|spread| spread.deviation);
            let mean = |spread: Option<Spread>| spread.map(|spread| spread.mean);
            _ = write!(text, ",{}", row.runs.len());
            for (value, digits) in [
                (psnr_spread.deviation, 4),
                (ssim_spread.deviation, 6),
                (mean(by_psnr), 4),
                (deviation(by_psnr), 4),
                (mean(by_ssim), 6),
                (deviation(by_ssim), 6),
            ] {
                text += ",";
                text += &value.map(|value| format!("{value:.digits$}")).unwrap_or_default();
            }
        }
        text += "\n";
    }
    text
}

fn psnr(run: &Measured) -> f64 {
    run.test.psnr
}

fn ssim(run: &Measured) -> f64 {
    run.test.ssim
}

/// What others are compared with if there are several seeds and several rows: the row of the method, if it is there.
fn base(rows: &[Row]) -> Option<&Row> {
    rows.iter().find(|row| row.label == METHOD && row.runs.len() > 1 && rows.len() > 1)
}

#[cfg(test)]
mod tests {
    use super::super::super::series::row::tests::row;
    use super::*;

    fn rows() -> Vec<Row> {
        vec![row("full", &[28.0]), row("ges", &[14.0]), row("sh", &[-3.0])]
    }

    #[test]
    fn the_csv_has_a_line_per_variant() {
        let expected = "variant,psnr,ssim,surfels,gaussians,bytes,seconds\n\
                        full,28.0000,0.750000,12,345,6700000,89.0\n\
                        ges,14.0000,0.750000,12,345,6700000,89.0\n\
                        sh,-3.0000,0.750000,12,345,6700000,89.0\n";
        assert_eq!(csv(&rows()), expected);
        assert_eq!(csv(&[]).lines().count(), 1);
    }

    #[test]
    fn with_several_seeds_the_csv_has_spreads_and_paired_differences() {
        let expected = "variant,psnr,ssim,surfels,gaussians,bytes,seconds,seeds,psnr_deviation,ssim_deviation,\
                        psnr_difference,psnr_difference_deviation,ssim_difference,ssim_difference_deviation\n\
                        full,20.0000,0.750000,12,347,6700000,89.0,3,10.0000,0.000000,0.0000,0.0000,0.000000,0.000000\n\
                        sh,22.0000,0.750000,12,347,6700000,89.0,3,11.0000,0.000000,2.0000,1.0000,0.000000,0.000000\n";
        assert_eq!(csv(&[row("full", &[10.0, 20.0, 30.0]), row("sh", &[11.0, 22.0, 33.0])]), expected);
        let without = csv(&[row("ges", &[1.0, 2.0, 3.0]), row("sh", &[11.0, 22.0, 33.0])]);
        assert!(without.ends_with("sh,22.0000,0.750000,12,347,6700000,89.0,3,11.0000,0.000000,,,,\n"), "{without}");
    }

    #[test]
    fn the_table_names_what_it_shows() {
        let table = table(&rows());
        assert_eq!(table.lines().count(), 3);
        let first = table.lines().next().unwrap();
        let expected = "full   28.00 dB  0.7500       12 surfels       345 Gaussians     6.7 MB  1 min 29 s";
        assert_eq!(first, expected);
    }

    #[test]
    fn with_several_seeds_the_table_has_spreads_and_paired_differences() {
        let shown = table(&[row("full", &[10.0, 20.0, 30.0]), row("sh", &[11.0, 22.0, 33.0])]);
        for part in ["full  20.00 ± 10.00 (+0.00 ± 0.00) dB", "sh    22.00 ± 11.00 (+2.00 ± 1.00) dB", "347 Gaussians"]
        {
            assert!(shown.contains(part), "{part}: {shown}");
        }
        assert!(shown.ends_with("over 3 seeds; in parentheses the difference to full, seed by seed\n"), "{shown}");
        let without = table(&[row("ges", &[1.0, 2.0, 3.0]), row("sh", &[11.0, 22.0, 33.0])]);
        assert!(without.contains("22.00 ± 11.00 dB") && without.ends_with("over 3 seeds\n"), "{without}");
        let alone = table(&[row("full", &[11.0, 22.0, 33.0])]);
        assert!(alone.contains("full  22.00 ± 11.00 dB") && alone.ends_with("over 3 seeds\n"), "{alone}");
    }

    #[test]
    fn both_files_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let paths = write(folder.path(), &rows()).unwrap();
        assert_eq!(paths.lines().count(), 2);
        assert!(paths.lines().all(|path| Path::new(path).is_file()));
    }
}

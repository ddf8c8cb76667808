//! The comparison of variants: a table, `ablation.csv`, `ablation.svg`.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use dpges_core::atomic::write_atomically;

use super::super::{Result, table as names_and_values};
use super::variant::Variant;
use crate::progress::Seconds;

const COLUMNS: &str = "variant,psnr,ssim,surfels,gaussians,bytes,seconds";

/// Sizes in the chart, px: width of names, of the longest bar and of numbers; height of a row and of its bar; margin.
const NAMES: usize = 210;
const LONGEST: usize = 400;
const NUMBERS: usize = 90;
const ROW: usize = 28;
const BAR: usize = 18;
const MARGIN: usize = 16;

/// For light and dark backgrounds.
const STYLE: &str = "<style>
text { fill: #24292f; font: 13px sans-serif; }
rect { fill: #4a8fd0; }
@media (prefers-color-scheme: dark) { text { fill: #e6edf3; } }
</style>
";

/// The result of one variant.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub variant: Variant,
    /// Mean over the held-out views, dB.
    pub psnr: f64,
    /// Mean over the held-out views.
    pub ssim: f64,
    pub surfels: usize,
    pub gaussians: usize,
    /// Size of the scene file.
    pub bytes: u64,
    /// Wall-clock time up to the last step, including evaluations.
    pub seconds: f64,
}

/// Writes `ablation.csv` and `ablation.svg` into `folder`; returns their paths, one a line.
pub fn write(folder: &Path, rows: &[Row]) -> Result<String> {
    let mut paths = String::new();
    for (name, text) in [("ablation.csv", csv(rows)), ("ablation.svg", chart(rows))] {
        let path = folder.join(name);
        write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
        _ = writeln!(paths, "{}", path.display());
    }
    Ok(paths)
}

/// The comparison for the terminal, a line per variant.
pub fn table(rows: &[Row]) -> String {
    let names: Vec<String> = rows.iter().map(|row| row.variant.to_string()).collect();
    let values = rows.iter().map(|row| {
        let Row { psnr, ssim, surfels, gaussians, bytes, seconds, .. } = row;
        let megabytes = *bytes as f64 / 1e6;
        format!(
            "{psnr:6.2} dB  {ssim:.4}  {surfels:>7} surfels  {gaussians:>8} Gaussians  {megabytes:>6.1} MB  {}",
            Seconds(*seconds)
        )
    });
    names_and_values(&names.iter().map(String::as_str).zip(values).collect::<Vec<_>>())
}

/// A line per variant under a line of [`COLUMNS`].
fn csv(rows: &[Row]) -> String {
    let mut text = format!("{COLUMNS}\n");
    for Row { variant, psnr, ssim, surfels, gaussians, bytes, seconds } in rows {
        _ = writeln!(text, "{variant},{psnr:.4},{ssim:.6},{surfels},{gaussians},{bytes},{seconds:.1}");
    }
    text
}

/// A bar per variant, from 0 dB, as long as its PSNR.
fn chart(rows: &[Row]) -> String {
    let largest = rows.iter().map(|row| row.psnr).fold(1.0, f64::max);
    let (width, height) = (NAMES + LONGEST + NUMBERS, ROW * (rows.len() + 1) + MARGIN);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} \
         {height}\" role=\"img\">\n<title>PSNR of the held-out views, dB</title>\n{STYLE}"
    );
    let middle = |row: usize| MARGIN / 2 + ROW * row + ROW / 2;
    let label = |x: f64, y: usize, anchor: &str, text: &str| {
        format!("<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"{anchor}\" dominant-baseline=\"central\">{text}</text>\n")
    };
    svg += &label(NAMES as f64, middle(0), "start", "PSNR of the held-out views, dB");
    for (row, Row { variant, psnr, .. }) in rows.iter().enumerate() {
        let y = middle(row + 1);
        let length = LONGEST as f64 * psnr.max(0.0) / largest;
        svg += &label((NAMES - 10) as f64, y, "end", variant.name);
        let top = y - BAR / 2;
        _ = writeln!(svg, "<rect x=\"{NAMES}\" y=\"{top}\" width=\"{length:.1}\" height=\"{BAR}\"/>");
        svg += &label(NAMES as f64 + length + 8.0, y, "start", &format!("{psnr:.2}"));
    }
    svg + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::super::variant::tests::variant;
    use super::*;

    fn rows() -> Vec<Row> {
        let row = |variant, psnr| Row {
            variant,
            psnr,
            ssim: 0.75,
            surfels: 12,
            gaussians: 345,
            bytes: 6_700_000,
            seconds: 89.04,
        };
        vec![row(variant("full"), 28.0), row(variant("ges"), 14.0), row(variant("sh"), -3.0)]
    }

    /// Names of all elements, each of which must end where it should.
    fn elements(xml: &str) -> Vec<String> {
        let (mut open, mut all) = (Vec::new(), Vec::new());
        for tag in xml.split('<').skip(1) {
            let (tag, text) = tag.split_once('>').expect("a tag ends");
            assert!(!text.contains('>') && !text.contains('&'), "{text}");
            assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
            let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap().to_owned();
            if tag.starts_with('/') {
                assert_eq!(open.pop(), Some(name));
                continue;
            }
            assert!(!open.is_empty() || all.is_empty(), "one root");
            all.push(name.clone());
            if !tag.ends_with('/') {
                open.push(name);
            }
        }
        assert!(open.is_empty(), "{open:?}");
        all
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
    fn the_chart_is_well_formed_and_its_bars_are_as_long_as_the_psnr() {
        let svg = chart(&rows());
        let count = |name: &str| elements(&svg).iter().filter(|element| *element == name).count();
        assert_eq!((count("svg"), count("style"), count("rect"), count("text")), (1, 1, 3, 1 + 2 * 3));
        assert!(svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\""));
        for part in ["width=\"400.0\"", "width=\"200.0\"", "width=\"0.0\"", ">full<", ">28.00<", ">-3.00<", "dark"] {
            assert!(svg.contains(part), "{part}: {svg}");
        }
        assert_eq!(elements(&chart(&[])), ["svg", "title", "style", "text"]);
    }

    #[test]
    fn the_table_names_what_it_shows() {
        let table = table(&rows());
        assert_eq!(table.lines().count(), 3);
        let first = table.lines().next().unwrap();
        for part in ["full", "28.00 dB", "0.7500", "12 surfels", "345 Gaussians", "6.7 MB", "1 min 29 s"] {
            assert!(first.contains(part), "{part}: {first}");
        }
    }

    #[test]
    fn both_files_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let paths = write(folder.path(), &rows()).unwrap();
        assert_eq!(paths.lines().count(), 2);
        assert!(paths.lines().all(|path| Path::new(path).is_file()));
    }
}

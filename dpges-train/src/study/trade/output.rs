//! What a measurement leaves in its folder, and what it prints.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::time::SystemTime;

use dpges_core::scene::atomic::write_atomically;
use dpges_train::eval::pictures::save_png;

use super::plot::{AXES, Plot};
use super::point::{Point, csv, further};
use super::report::{About, page};
use super::store::Trade;
use crate::cli::{Failure, Result};

/// Writes the table, the plots and the page; returns the paths of all files, one a line.
pub fn write(out: &Path, trade: &Trade, photograph: &str) -> Result<String> {
    let mut paths = String::new();
    let mut note = |name: &str| {
        let path = out.join(name);
        _ = writeln!(paths, "{}", path.display());
        path
    };
    let csv = csv(&trade.points);
    write_atomically(&note("trade.csv"), |file| file.write_all(csv.as_bytes()))?;
    note("trade.json");
    let drawn = |text: String| Failure::with_help(text, "this is a fault of the program");
    let mut plots = Vec::new();
    for axis in &AXES {
        let Some(plot) = Plot::new(&trade.points, axis) else { continue };
        let svg = plot.svg().map_err(drawn)?;
        write_atomically(&note(&format!("trade_{}.svg", axis.name)), |file| file.write_all(svg.as_bytes()))?;
        save_png(&plot.picture().map_err(drawn)?, &note(&format!("trade_{}.png", axis.name)))?;
        plots.push(svg);
    }
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let date = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    let page = page(out, trade, &plots, photograph, &About { command: &command, date: &date })?;
    write_atomically(&note("report.html"), |file| file.write_all(page.as_bytes()))?;
    Ok(paths)
}

/// The points on frontiers in Markdown, by ascending frame time, and what was left out.
pub fn table(trade: &Trade) -> String {
    let frontiers = &trade.frontiers;
    let on_one = |label: &String| frontiers.frame_ms.contains(label) || frontiers.bytes.contains(label);
    let mut points: Vec<&Point> =
        trade.points.iter().filter(|point| on_one(&point.label) || point.knobs.is_empty()).collect();
    points.sort_by(|a, b| a.frame_ms.total_cmp(&b.frame_ms));
    let mut text = format!("{} points on {}; those that no other beats:\n\n", trade.points.len(), trade.subject.device);
    let further = further(&trade.points);
    let titles: String = further.iter().map(|metric| format!(" {} |", metric.title)).collect();
    let rules = "---|".repeat(further.len());
    _ = writeln!(text, "| point | PSNR, dB | SSIM | FLIP |{titles} frame, ms | MB | primitives |");
    _ = writeln!(text, "|---|---|---|---|{rules}---|---|---|");
    for point in points {
        let seed = point.seed.map(|seed| format!(", seed {seed}")).unwrap_or_default();
        let Point { label, psnr, ssim, flip, frame_ms, bytes, .. } = point;
        let (megabytes, primitives) = (*bytes as f64 / 1e6, point.primitives());
        let more: String = further.iter().map(|metric| format!(" {} |", point.text(metric))).collect();
        _ = write!(text, "| {label}{seed} | {psnr:.2} | {ssim:.4} | {flip:.4} |{more}");
        _ = writeln!(text, " {frame_ms:.2} | {megabytes:.2} | {primitives} |");
    }
    if !trade.not_run.is_empty() {
        _ = writeln!(text, "\nnot measured, the same command goes on: {}", trade.not_run.join("; "));
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use super::super::point::tests::point;
    use super::super::store::Frontiers;
    use super::super::store::tests::subject;
    use super::*;

    #[test]
    fn the_table_shows_frontiers_and_what_is_left() {
        let points = vec![
            point("as trained", 30.0, 5.0, 100),
            point("layers=1", 29.0, 3.0, 100),
            point("modulation=4w", 20.0, 5.0, 100),
        ];
        let frontiers = Frontiers { frame_ms: vec!["layers=1".into(), "as trained".into()], ..Frontiers::default() };
        let trade = Trade { subject: subject(), points, not_run: vec!["steps-half, seed 1".to_owned()], frontiers };
        let text = table(&trade);
        let rows: Vec<&str> = text.lines().filter(|line| line.starts_with("| ")).collect();
        assert_eq!(rows.len(), 3, "{text}");
        assert!(rows[1].starts_with("| layers=1 | 29.00 | 0.7500 | 0.1250 | 3.00 |"), "{text}");
        assert!(text.contains("3 points on") && text.contains("goes on: steps-half, seed 1"), "{text}");
        assert!(!text.contains("LPIPS"), "{text}");

        let mut with = trade;
        with.points[1].perceptual.lpips_vgg = Some(0.25);
        let text = table(&with);
        assert!(
            text.contains("| FLIP | LPIPS (VGG) | frame, ms |") && text.contains("| 0.1250 | 0.2500 | 3.00 |"),
            "{text}"
        );
        assert!(text.contains("| 0.1250 |  | 5.00 |"), "of a point that was measured without it: {text}");
    }
}

//! `dpges data`: what a dataset is, and whether it will do.

mod map;
mod sheet;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use dpges_core::scene::atomic::write_atomically;
use dpges_train::config::Config;
use dpges_train::dataset::check::map::Map;
use dpges_train::dataset::check::{Effort, Report, Role, ViewFacts};
use dpges_train::dataset::{Dataset, capture};
use dpges_train::eval::pictures::save_png;
use dpges_train::run::folder::write_json;

use super::data::{DataArgs, Source};
use super::{Failure, Result, print, sfm, table};
use crate::cli::logging::LogStyle;

/// Check a dataset: what it consists of, and which photographs will harm the result
///
/// Names photographs that are blurred, brighter or darker than the rest, or there twice, and cameras that are far from all
/// others or see no points. Photographs are judged in the size in which they are trained on. `dpges train` prints what is
/// found too.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Folder of a COLMAP, Blender or nerfstudio dataset, or `builtin`; or photographs or a video, see `dpges sfm`
    dataset: PathBuf,
    /// Write all numbers to a JSON file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write a contact sheet, with what was found and what is masked marked, and a map of cameras and points to a folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    options: DataArgs,
}

pub fn run(args: &InspectArgs, style: LogStyle) -> Result<()> {
    let config = Config::resolve_data(None, &args.options.assignments()).map_err(Failure::from_config)?;
    let options = capture::Options { invert_masks: config.invert_masks, ..capture::Options::default() };
    sfm::prepare(Some(&args.dataset), &options, style)?;
    let source = Source::named(Some(&args.dataset));
    let dataset = source.load(&config)?;
    let report = Report::of(&dataset, Effort::Full)?;
    print(&summary(&source, &dataset, &report))?;
    if let Some(path) = &args.json {
        write_json(path, &report)?;
    }
    if let Some(out) = &args.out {
        print(&write(out, &dataset, &report)?)?;
    }
    Ok(())
}

/// Warns of what can be found in seconds.
pub fn warn(dataset: &Dataset) -> Result<()> {
    for finding in Report::of(dataset, Effort::Quick)?.findings {
        tracing::warn!("{finding}");
    }
    Ok(())
}

/// Writes the pictures; returns their paths, one a line.
fn write(out: &Path, dataset: &Dataset, report: &Report) -> Result<String> {
    std::fs::create_dir_all(out).map_err(|error| {
        Failure::with_help(format!("cannot make folder {}: {error}", out.display()), "name another one with --out")
    })?;
    let (sheet, map) = (out.join("contact_sheet.png"), out.join("cameras.svg"));
    save_png(&sheet::contact_sheet(dataset, report)?, &sheet)?;
    let svg = map::svg(&Map::of(dataset, report)).map_err(fault)?;
    write_atomically(&map, |file| file.write_all(svg.as_bytes()))?;
    Ok(format!("\n{}\n{}\n", sheet.display(), map.display()))
}

/// Of what could not be drawn.
fn fault(text: String) -> Failure {
    Failure::with_help(text, "this is a fault of the program")
}

fn summary(source: &Source, dataset: &Dataset, report: &Report) -> String {
    let count = |role: Role| report.views.iter().filter(|view| view.role == role).count();
    let mut rows = vec![
        ("dataset", format!("{source}: {}", dataset.format)),
        ("views", format!("{} for training, {} held out", count(Role::Train), count(Role::Test))),
        ("pictures", counted(&report.views, |view| format!("{} x {} px", view.camera.width, view.camera.height))),
        ("cameras", counted(&report.views, lens)),
        ("extent", format!("{:.3} world units", dataset.extent)),
        ("points", points(report)),
    ];
    let masked = dataset.masked();
    if masked.masked_views > 0 {
        rows.push(("masks", masked.to_string()));
    }
    let percent = |of: &dyn Fn(&ViewFacts) -> Option<f64>| report.range(|view| of(view).map(|share| 100.0 * share));
    let mut add = |name, range: Option<String>| rows.extend(range.map(|text| (name, text)));
    let range = report.range(|view| view.points_seen.map(|count| count as f64));
    add("points seen", range.map(|range| format!("{range:.0} by a view")));
    let range = percent(&|view| view.coverage);
    add("coverage", range.map(|range| format!("{range:.0} % of a picture show points that it saw")));
    let range = percent(&|view| view.unexplained);
    add("unexplained", range.map(|range| format!("{range:.0} % of a picture show no point at all")));
    let range = percent(&|view| view.sharpness);
    add("sharpness", range.map(|range| format!("{range:.0} % of the median; below 60 % is blurred")));
    let range = report.range(|view| view.exposure);
    add("exposure", range.map(|range| format!("{range:.2} stops from the median")));
    let mut text = table(&rows);
    text += "\nNumbers are medians, with the 5th and 95th percentile.\n\n";
    if report.findings.is_empty() {
        return text + "Nothing is wrong with it.\n";
    }
    for finding in &report.findings {
        text += &format!("! {finding}\n");
    }
    text
}

/// How often each text occurs, from most to least; at most four of them.
fn counted(views: &[ViewFacts], of: impl Fn(&ViewFacts) -> String) -> String {
    const LISTED: usize = 4;
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    views.iter().for_each(|view| *counts.entry(of(view)).or_default() += 1);
    let mut counts: Vec<(String, usize)> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    if let [(only, _)] = counts.as_slice() {
        return only.clone();
    }
    let listed: Vec<String> = counts.iter().take(LISTED).map(|(text, count)| format!("{text} ({count})")).collect();
    match counts.len().saturating_sub(LISTED) {
        0 => listed.join(", "),
        more => format!("{} and {more} more", listed.join(", ")),
    }
}

fn lens(view: &ViewFacts) -> String {
    let camera = &view.camera;
    let kind = match camera.lens {
        None => "",
        Some(lens) if lens.is_wide() => "fisheye, ",
        Some(_) => "with distortion, ",
    };
    let bearing = |x: f64| camera.ray(x, camera.cy).map(|ray| ray.x.atan2(ray.z).to_degrees());
    let angle = match (bearing(0.0), bearing(camera.width as f64)) {
        (Some(left), Some(right)) => format!("{:.0}° wide, ", right - left),
        // the lens does not reach the borders
        _ => String::new(),
    };
    format!("{kind}{angle}focal length {:.0} px", camera.fx)
}

fn points(report: &Report) -> String {
    match report.views_per_point {
        _ if report.points == 0 => "none: surfaces are found by training alone".to_owned(),
        Some(views) => format!("{}, each seen by {views:.1} views on average", report.points),
        None => format!("{}; it is not known which view saw which", report.points),
    }
}

#[cfg(test)]
mod tests {
    use dpges_train::config::DataConfig;
    use dpges_train::dataset::{BuiltinOptions, builtin};

    use super::*;

    #[test]
    fn a_summary_says_what_there_is_and_what_is_wrong() {
        let options =
            BuiltinOptions { width: 48, height: 32, train_views: 4, test_views: 2, points: 800, ..Default::default() };
        let dataset = builtin(&options);
        let text = summary(&Source::Builtin, &dataset, &Report::of(&dataset, Effort::Full).unwrap());
        for part in [
            "dataset      builtin: built-in\n",
            "views        4 for training, 2 held out\n",
            "pictures     48 x 32 px\n",
            "cameras      52° wide, focal length 50 px\n",
            "points       800, each seen by ",
            "% of a picture show points that it saw",
            "stops from the median",
            "! there are only 4 training views; expect",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let fisheye = builtin(&BuiltinOptions { fisheye: true, ..options });
        let text = summary(&Source::Builtin, &fisheye, &Report::of(&fisheye, Effort::Quick).unwrap());
        assert!(text.contains("cameras      fisheye, 170° wide, focal length "), "{text}");
        let mut masked = dataset.clone();
        masked.train[0].repaint(|picture| picture.counted = Some((0..48 * 32).map(|i| i < 48).collect())).unwrap();
        let text = summary(&Source::Builtin, &masked, &Report::of(&masked, Effort::Full).unwrap());
        assert!(text.contains("masks        1 of 6 views have masks, or"), "{text}");
        let clean = builtin(&BuiltinOptions::default());
        let text = summary(&Source::Builtin, &clean, &Report::of(&clean, Effort::Full).unwrap());
        assert!(text.ends_with("Nothing is wrong with it.\n"), "{text}");
    }

    #[test]
    fn sizes_are_counted() {
        let dataset = Source::Builtin.load(&DataConfig { max_resolution: 16, ..DataConfig::default() }).unwrap();
        let mut views = Report::of(&dataset, Effort::Quick).unwrap().views;
        views.truncate(5);
        let of = |views: &[ViewFacts]| counted(views, |view| format!("{} px", view.camera.width));
        assert_eq!(of(&views), "16 px");
        (views[0].camera.width, views[1].camera.width) = (20, 20);
        assert_eq!(of(&views), "16 px (3), 20 px (2)");
        for (width, view) in (1..).zip(&mut views) {
            view.camera.width = width;
        }
        assert_eq!(of(&views), "1 px (1), 2 px (1), 3 px (1), 4 px (1) and 1 more");
    }
}

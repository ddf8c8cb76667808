//! The content of a dataset, in words.

use std::collections::BTreeMap;

use super::{Report, ViewFacts};
use crate::names::list_up_to;
use crate::{Dataset, Split};

/// Different sizes or lenses that are listed before the rest is counted.
const LISTED: usize = 4;

/// Names and values; those of the report are medians, with the 5th and 95th percentile.
pub fn rows(dataset: &Dataset, report: &Report) -> Vec<(&'static str, String)> {
    let count = |role: Split| report.views.iter().filter(|view| view.role == role).count();
    let points = match report.views_per_point {
        _ if report.points == 0 => "none: surfaces are found by training alone".to_owned(),
        Some(views) => format!("{}, each seen by {views:.1} views on average", report.points),
        None => format!("{}; it is not known which view saw which", report.points),
    };
    let mut rows = vec![
        ("views", format!("{} for training, {} held out", count(Split::Train), count(Split::Test))),
        ("pictures", counted(&report.views, |view| format!("{} x {} px", view.camera.width, view.camera.height))),
        ("cameras", counted(&report.views, lens)),
        ("extent", format!("{:.3} world units", dataset.extent)),
        ("points", points),
    ];
    let masked = dataset.masked();
    if masked.masked_views > 0 {
        rows.push(("masks", masked.to_string()));
    }
    type Number = fn(&ViewFacts) -> Option<f64>;
    let numbers: [(&str, Number, usize, &str); 5] = [
        ("points seen", |view| view.points_seen.map(|count| count as f64), 0, "by a view"),
        ("coverage", |view| Some(100.0 * view.coverage?), 0, "% of a picture show points that it saw"),
        ("unexplained", |view| Some(100.0 * view.unexplained?), 0, "% of a picture show no point at all"),
        ("sharpness", |view| Some(100.0 * view.sharpness?), 0, "% of the median; below 60 % is blurred"),
        ("exposure", |view| view.exposure, 2, "stops from the median"),
    ];
    for (name, number, digits, text) in numbers {
        rows.extend(report.range(number).map(|range| (name, format!("{range:.digits$} {text}"))));
    }
    rows
}

/// How often each text occurs, from most to least.
fn counted(views: &[ViewFacts], of: impl Fn(&ViewFacts) -> String) -> String {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    views.iter().for_each(|view| *counts.entry(of(view)).or_default() += 1);
    let mut counts: Vec<(String, usize)> = counts.into_iter().collect();
    counts.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    if let [(only, _)] = counts.as_slice() {
        return only.clone();
    }
    let texts: Vec<String> = counts.iter().map(|(text, count)| format!("{text} ({count})")).collect();
    list_up_to(LISTED, &texts)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::Effort;
    use crate::fixtures::assert_says;
    use crate::{BuiltinOptions, builtin};

    #[test]
    fn a_summary_says_what_there_is() {
        let options =
            BuiltinOptions { width: 48, height: 32, train_views: 4, test_views: 2, points: 800, ..Default::default() };
        let mut dataset = builtin(&options);
        dataset.train[0].repaint(|picture| picture.counted = Some((0..48 * 32).map(|i| i < 48).collect())).unwrap();
        let summary = |dataset: &Dataset| format!("{:?}", rows(dataset, &Report::of(dataset, Effort::Full).unwrap()));
        let parts = [
            "4 for training, 2 held out",
            "48 x 32 px",
            "52° wide, focal length 50 px",
            "800, each seen by ",
            "1 of 6 views have masks, or",
            "% of a picture show points that it saw",
            "stops from the median",
        ];
        assert_says(summary(&dataset), &parts);
        let fisheye = builtin(&BuiltinOptions { fisheye: true, ..options });
        assert_says(summary(&fisheye), &["fisheye, 170° wide, focal length "]);
    }

    #[test]
    fn sizes_are_counted() {
        let dataset = builtin(&BuiltinOptions { width: 16, height: 16, ..BuiltinOptions::default() });
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

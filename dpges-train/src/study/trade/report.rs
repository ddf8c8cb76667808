//! `report.html`: everything on one page that needs no other file and no script.

use std::fmt::Write as _;
use std::path::Path;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use dpges_train::metrics::Metric;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::point::{Kind, Point, further};
use super::store::Trade;
use crate::cli::{Failure, Result};

/// Most points whose pictures are shown.
const PICTURES: usize = 9;
const QUALITY: u8 = 88;

const STYLE: &str = "body { font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; }
table { border-collapse: collapse; font-size: 14px; }
td, th { border-bottom: 1px solid #ccc; padding: 0.15em 0.6em; text-align: right; }
td:first-child, th:first-child { text-align: left; }
tr.best td { font-weight: bold; }
svg, img { height: auto; max-width: 100%; }
figure { display: inline-block; margin: 0.5em; max-width: 22em; vertical-align: top; }
code { overflow-wrap: anywhere; }
";

/// What the page says besides the points.
pub struct About<'a> {
    pub command: &'a str,
    /// When it was made.
    pub date: &'a str,
}

/// The page for `trade`, whose pictures are in `folder`, with `plots` as SVG and the `photograph` of the first view, relative
/// to the folder.
///
/// # Errors
/// If a picture cannot be read.
pub fn page(folder: &Path, trade: &Trade, plots: &[String], photograph: &str, about: &About) -> Result<String> {
    let subject = &trade.subject;
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<meta name=\"viewport\" \
         content=\"width=device-width\"/>\n<title>Speed and accuracy</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <h1>Speed and accuracy</h1>\n<table>\n"
    );
    let size = |[width, height]: [usize; 2]| format!("{width} × {height} px");
    for (name, value) in [
        ("scene", subject.scene.clone()),
        ("dataset", subject.dataset.clone()),
        ("views", format!("{} ({}), of {}", subject.views.len(), subject.split, size(subject.view_size))),
        ("frames", format!("{}, {} rounds over the views", size(subject.frame_size), subject.rounds)),
        ("device", subject.device.clone()),
        ("date", about.date.to_owned()),
    ] {
        _ = writeln!(page, "<tr><td>{name}</td><td>{}</td></tr>", escaped(&value));
    }
    _ = writeln!(page, "</table>\n<p><code>{}</code></p>", escaped(about.command));
    page += "<h2>Frontiers</h2>\n<p>Upper left is better. The line joins the points that no other beats. Bars are standard \
             deviations over seeds.</p>\n";
    for plot in plots {
        _ = writeln!(page, "<div>{}</div>", plot.trim());
    }
    page += "<h2>Pictures</h2>\n";
    figure(&mut page, folder, photograph, "photograph")?;
    for point in shown(trade) {
        let caption = format!("{}: {:.2} dB, {:.2} ms, {}", point.label, point.psnr, point.frame_ms, megabytes(point));
        figure(&mut page, folder, &point.picture, &caption)?;
    }
    page += "<h2>Points</h2>\n<p>Points on a frontier are bold.</p>\n<table>\n<tr>";
    let further = further(&trade.points);
    let titles = further.iter().map(|metric| metric.title);
    let of_quality = ["point", "seed", "PSNR, dB", "SSIM", "FLIP"].into_iter().chain(titles);
    let of_cost = ["frame, ms", "99 %, ms", "file", "primitives", "GPU, MB", "training, s", "training, MB"];
    for name in of_quality.chain(of_cost) {
        _ = write!(page, "<th>{name}</th>");
    }
    page += "</tr>\n";
    for point in &trade.points {
        row(&mut page, trade, point, &further);
    }
    page += "</table>\n";
    if !trade.not_run.is_empty() {
        let list = trade.not_run.iter().map(|label| escaped(label)).collect::<Vec<_>>().join("; ");
        _ = writeln!(page, "<p>Not measured, because the time was over: {list}. The same command goes on.</p>");
    }
    Ok(page + "</body>\n</html>\n")
}

fn row(page: &mut String, trade: &Trade, point: &Point, further: &[&Metric]) {
    let is_best = frontier_labels(trade).any(|label| *label == point.label);
    let known = |value: Option<String>| value.unwrap_or_default();
    let of_quality = [
        escaped(&point.label),
        known(point.seed.map(|seed| seed.to_string())),
        format!("{:.2}", point.psnr),
        format!("{:.4}", point.ssim),
        format!("{:.4}", point.flip),
    ];
    let of_cost = [
        format!("{:.2}", point.frame_ms),
        format!("{:.2}", point.frame_p99_ms),
        megabytes(point),
        point.primitives().to_string(),
        known(point.gpu_bytes.map(|bytes| format!("{:.1}", bytes as f64 / 1e6))),
        known(point.training_seconds.map(|seconds| format!("{seconds:.0}"))),
        known(point.training_peak_bytes.map(|bytes| format!("{:.0}", bytes as f64 / 1e6))),
    ];
    *page += if is_best { "<tr class=\"best\">" } else { "<tr>" };
    for field in of_quality.into_iter().chain(further.iter().map(|metric| point.text(metric))).chain(of_cost) {
        _ = write!(page, "<td>{field}</td>");
    }
    *page += "</tr>\n";
}

fn megabytes(point: &Point) -> String {
    format!("{:.2} MB", point.bytes as f64 / 1e6)
}

fn frontier_labels(trade: &Trade) -> impl Iterator<Item = &String> {
    let frontiers = &trade.frontiers;
    let all = [&frontiers.frame_ms, &frontiers.bytes, &frontiers.training_seconds, &frontiers.training_peak_bytes];
    all.into_iter().flatten()
}

/// The scene as it was trained, then points of frontiers: first seeds only, dearest first.
fn shown(trade: &Trade) -> Vec<&Point> {
    let mut shown: Vec<&Point> =
        trade.points.iter().filter(|point| point.kind == Kind::Rendering && point.knobs.is_empty()).take(1).collect();
    let frontiers = [&trade.frontiers.frame_ms, &trade.frontiers.bytes, &trade.frontiers.training_seconds];
    for label in frontiers.into_iter().flat_map(|labels| labels.iter().rev()) {
        let Some(point) = trade.points.iter().find(|point| point.label == *label) else { continue };
        if shown.len() < PICTURES && shown.iter().all(|other| other.label != point.label) {
            shown.push(point);
        }
    }
    shown
}

fn figure(page: &mut String, folder: &Path, file: &str, caption: &str) -> Result<()> {
    let path = folder.join(file);
    let picture = image::open(&path).map_err(|error| {
        Failure::with_help(format!("cannot read {}: {error}", path.display()), "remove trade.json to measure anew")
    })?;
    let picture = picture.into_rgb8();
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, QUALITY).write_image(
        picture.as_raw(),
        picture.width(),
        picture.height(),
        ExtendedColorType::Rgb8,
    )?;
    let (data, caption) = (BASE64_STANDARD.encode(&jpeg), escaped(caption));
    _ = writeln!(
        page,
        "<figure><img alt=\"{caption}\" src=\"data:image/jpeg;base64,{data}\"/><figcaption>{caption}</figcaption></figure>"
    );
    Ok(())
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use dpges_render::Rgb8Image;
    use dpges_train::eval::pictures::save_png;

    use super::super::plot::{AXES, Plot};
    use super::super::point::tests::point;
    use super::super::store::tests::subject;
    use super::super::store::{Frontiers, Trade};
    use super::*;

    /// Every element ends where it should, and nothing refers to another file.
    fn check(page: &str) {
        let page = page.strip_prefix("<!doctype html>\n").unwrap();
        let mut open: Vec<&str> = Vec::new();
        for tag in page.split('<').skip(1) {
            let (tag, text) = tag.split_once('>').expect("a tag ends");
            assert!(!text.contains('>') || open.contains(&"style"), "{text}");
            let name = tag.trim_start_matches('/').split([' ', '/', '\n']).next().unwrap();
            if tag.starts_with('/') {
                assert_eq!(open.pop(), Some(name));
            } else if !tag.ends_with('/') {
                open.push(name);
            }
            for (attribute, value) in tag.split(' ').filter_map(|part| part.split_once('=')) {
                let is_own = value.starts_with("\"data:image/jpeg;base64,");
                assert!(!["src", "href", "xlink:href", "data", "action"].contains(&attribute) || is_own, "{tag}");
            }
            assert!(!["script", "link", "iframe", "object"].contains(&name), "{tag}");
        }
        assert!(open.is_empty(), "{open:?}");
        assert!(!page.contains("url(") && !page.contains("@import"));
    }

    #[test]
    fn the_page_is_well_formed_and_needs_no_other_file() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("pictures")).unwrap();
        let picture = Rgb8Image { width: 16, height: 8, bytes: vec![90; 3 * 16 * 8] };
        for name in ["photograph", "a"] {
            save_png(&picture, &folder.path().join(format!("pictures/{name}.png"))).unwrap();
        }
        let points = vec![point("as trained", 30.0, 5.0, 100), point("layers=1", 29.0, 3.0, 100)];
        let plots: Vec<String> = AXES.iter().filter_map(|axis| Plot::new(&points, axis)?.svg().ok()).collect();
        assert_eq!(plots.len(), 2);
        let frontiers = Frontiers { frame_ms: vec!["layers=1".to_owned()], ..Frontiers::default() };
        let not_run = vec!["budget-half, seed 0".to_owned()];
        let mut trade = Trade { subject: subject(), points, not_run, frontiers };
        let about = About { command: "dpges trade 'a <b>' --out c", date: "2001-02-03T04:05:06Z" };
        let made = page(folder.path(), &trade, &plots, "pictures/photograph.png", &about).unwrap();
        check(&made);
        for part in [
            "&lt;an adapter&gt; &amp; &quot;more&quot;",
            "dpges trade 'a &lt;b&gt;' --out c",
            "2001-02-03",
            "<tr class=\"best\"><td>layers=1</td>",
            "budget-half, seed 0",
            "median frame time",
        ] {
            assert!(made.contains(part), "{part}");
        }
        assert_eq!(made.matches("<img ").count(), 3);
        trade.points[0].picture = "pictures/absent.png".to_owned();
        let Err(error) = page(folder.path(), &trade, &plots, "pictures/photograph.png", &about) else { panic!("made") };
        let Failure::Failed(report) = error else { panic!("wrong usage") };
        assert!(report.to_string().contains("absent.png"), "{report}");
    }
}

//! Files of a study: a table as CSV, plots, and a page that needs no other file and no script.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use dpges_core::scene::atomic::write_atomically;
use dpges_render::Rgb8Image;
use dpges_train::eval::pictures::{jpeg, save_png};
use serde_json::Value;

use super::measure::MEASURES;
use super::plot::Plot;
use super::row::Row;
use super::store::Study;
use super::table::{Table, csv, escaped};
use super::{Result, StudyError};

/// Most rows whose pictures are shown.
const PICTURES: usize = 9;
const QUALITY: u8 = 88;

const STYLE: &str = "body { font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; }
table { border-collapse: collapse; font-size: 14px; }
td, th { border-bottom: 1px solid #ccc; padding: 0.15em 0.6em; text-align: right; }
td:first-child, th:first-child { text-align: left; }
tr.best td { font-weight: bold; }
svg, img { height: auto; max-width: 100%; }
figure { display: inline-block; margin: 0.5em; max-width: 22em; vertical-align: top; }
figure.wide { max-width: 100%; }
code { overflow-wrap: anywhere; }
";

/// Writes everything but the JSON, of a finished study; returns the paths of all files, one a line.
///
/// # Errors
/// If a file cannot be written, or a picture of a row cannot be read.
pub fn write(study: &Study) -> Result<String> {
    let name = study.shape.name;
    let mut paths = String::new();
    let mut note = |path: PathBuf| {
        _ = writeln!(paths, "{}", path.display());
        path
    };
    let csv = csv(study);
    write_atomically(&note(study.folder.join(format!("{name}.csv"))), |file| file.write_all(csv.as_bytes()))?;
    note(study.path());
    let mut plots = Vec::new();
    for cost in &MEASURES {
        let Some((plot, (file, _))) = Plot::new(&study.content.rows, cost).zip(cost.plot) else { continue };
        let svg = plot.svg()?;
        let mut path = |ending: &str| note(study.folder.join(format!("{name}_{file}.{ending}")));
        write_atomically(&path("svg"), |file| file.write_all(svg.as_bytes()))?;
        save_png(&plot.picture()?, &path("png"))?;
        plots.push(svg);
    }
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let date = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    let page = page(study, &plots, &command, &date)?;
    write_atomically(&note(study.folder.join("report.html")), |file| file.write_all(page.as_bytes()))?;
    study.content.figures.iter().for_each(|figure| {
        note(study.folder.join(&figure.file));
    });
    Ok(paths)
}

/// The table in Markdown, and what it is of.
pub fn printed(study: &Study) -> String {
    let mut text = String::new();
    let of = &study.content;
    if study.shape.frontier_alone {
        _ = writeln!(text, "{} rows; those that no other beats:\n", of.rows.len());
    }
    text += &Table::printed(study).markdown();
    text += "\n";
    sentences(study).iter().for_each(|sentence| _ = writeln!(text, "{sentence}"));
    text + "\n"
}

/// The sentences below the table.
fn sentences(study: &Study) -> Vec<String> {
    let content = &study.content;
    let mut sentences = content.notes.clone();
    let seeds = content.seeds();
    let list = seeds.join(", ");
    match seeds.len() {
        0 => {}
        1 => sentences.push(format!("Seed {list}.")),
        _ => sentences
            .push(format!("Mean ± sample standard deviation over seeds {list}; differences are taken seed by seed.")),
    }
    if !content.not_run.is_empty() {
        let list = content.not_run.join("; ");
        sentences.push(format!("Not measured, because the time was over; the same command goes on: {list}."));
    }
    sentences
}

/// The page, with `plots` as SVG.
fn page(study: &Study, plots: &[String], command: &str, date: &str) -> Result<String> {
    let title = study.shape.title;
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n<meta name=\"viewport\" \
         content=\"width=device-width\"/>\n<title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n\
         <h1>{title}</h1>\n"
    );
    page += &Table::whole(study).html();
    for sentence in sentences(study) {
        _ = writeln!(page, "<p>{}</p>", escaped(&sentence));
    }
    page += "<h2>Frontiers</h2>\n<p>Upper left is better. The line joins what nothing else beats; in the table that is bold. \
             Bars are standard deviations over seeds.</p>\n";
    for plot in plots {
        _ = writeln!(page, "<div>{}</div>", plot.trim());
    }
    page += "<h2>Pictures</h2>\n";
    for figure in &study.content.figures {
        page += &shown_figure(&study.folder, &figure.file, &figure.caption, " class=\"wide\"")?;
    }
    for (row, file) in pictured(study) {
        let number = |key: &str| row.get(key).unwrap_or(f64::NAN);
        let (psnr, frame, megabytes) = (number("psnr"), number("frame_ms"), number("bytes") / 1e6);
        let caption = format!("{}: {psnr:.2} dB, {frame:.2} ms, {megabytes:.2} MB", row.label);
        page += &shown_figure(&study.folder, file, &caption, "")?;
    }
    page += "<h2>Subject</h2>\n<table>\n";
    let date = Value::from(date);
    for (name, value) in study.content.subject.iter().map(|(name, value)| (&name[..], value)).chain([("date", &date)]) {
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        let value = value
            .as_array()
            .map_or_else(|| text(value), |values| values.iter().map(text).collect::<Vec<_>>().join(", "));
        _ = writeln!(page, "<tr><td>{name}</td><td>{}</td></tr>", escaped(&value));
    }
    _ = writeln!(page, "</table>\n<p><code>{}</code></p>", escaped(command));
    Ok(page + "</body>\n</html>\n")
}

/// Rows with pictures: the first, then those on frontiers, the dearest first, one for each label.
fn pictured(study: &Study) -> Vec<(&Row, &str)> {
    let content = &study.content;
    let best = content.frontiers.values().flat_map(|labels| labels.iter().rev());
    let labels = content.rows.first().map(|row| &row.label).into_iter().chain(best);
    let mut shown: Vec<(&Row, &str)> = Vec::new();
    for row in labels.filter_map(|label| content.rows.iter().find(|row| row.label == *label)) {
        if let Some(file) = &row.picture
            && shown.len() < PICTURES
            && shown.iter().all(|(other, _)| other.label != row.label)
        {
            shown.push((row, file));
        }
    }
    shown
}

fn shown_figure(folder: &Path, file: &str, caption: &str, class: &str) -> Result<String> {
    let path = folder.join(file);
    let unreadable = |error: image::ImageError| StudyError::Picture { path: path.clone(), reason: error.to_string() };
    let picture = image::open(&path).map_err(unreadable)?.into_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let jpeg = jpeg(&Rgb8Image { width, height, bytes: picture.into_raw() }, QUALITY)?;
    let (data, caption) = (BASE64_STANDARD.encode(&jpeg), escaped(caption));
    Ok(format!(
        "<figure{class}><img alt=\"{caption}\" src=\"data:image/jpeg;base64,{data}\"/><figcaption>{caption}</figcaption></figure>\n"
    ))
}

#[cfg(test)]
mod tests {
    use super::super::row::tests::{drawn, seeded};
    use super::super::store::Figure;
    use super::super::store::tests::subject;
    use super::super::{compare, trade};
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
        let picture = Rgb8Image { width: 16, height: 8, bytes: vec![90; 3 * 16 * 8] };
        ["photograph", "a"]
            .iter()
            .for_each(|name| save_png(&picture, &folder.path().join(format!("{name}.png"))).unwrap());
        let mut study = Study::new(&trade::SHAPE, folder.path(), subject());
        study.content.figures.push(Figure { file: "photograph.png".into(), caption: "photograph".into() });
        for mut row in [drawn("as trained", 30.0, 5.0, 100), drawn("layers=1", 29.0, 3.0, 100)] {
            row.picture = Some("a.png".to_owned());
            study.add(row).unwrap();
        }
        study.leave_out("budget-half", Some(0));
        study.finish().unwrap();
        let plots: Vec<String> =
            MEASURES.iter().filter_map(|cost| Plot::new(&study.content.rows, cost)?.svg().ok()).collect();
        assert_eq!(plots.len(), 2);
        let made = page(&study, &plots, "dpges trade 'a <b>' --out c", "2001-02-03T04:05:06Z").unwrap();
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
        study.content.rows[0].picture = Some("absent.png".to_owned());
        assert!(write(&study).unwrap_err().to_string().contains("absent.png"));
    }

    #[test]
    fn all_files_are_written_and_named() {
        let folder = tempfile::tempdir().unwrap();
        let mut study = Study::new(&compare::SHAPE, folder.path(), subject());
        study.content.notes.push("At most 7 primitives.".to_owned());
        study.content.rows = [seeded("dpges", &[20.0, 21.0]), seeded("mcmc", &[22.0, 23.0])].concat();
        study.finish().unwrap();
        let paths = write(&study).unwrap();
        let names: Vec<&str> = paths.lines().map(|path| path.rsplit('/').next().unwrap()).collect();
        let expected = "comparison.csv comparison.json comparison_bytes.svg comparison_bytes.png \
                        comparison_training_time.svg comparison_training_time.png report.html";
        assert_eq!(names.join(" "), expected);
        assert!(paths.lines().all(|path| Path::new(path).is_file()));
        let text = printed(&study);
        let end = "At most 7 primitives.\nMean ± sample standard deviation over seeds 0, 1; differences are taken seed by seed.\n\n";
        assert!(text.starts_with("| method |") && text.ends_with(end), "{text}");
    }
}

//! All photographs small, in one picture; what something was found about has a red frame, and stripes what does not count.

use dpges_render::Rgb8Image;
use dpges_train::dataset::check::Report;
use dpges_train::dataset::{Dataset, View};
use plotters::prelude::{BitMapBackend, Color, IntoDrawingArea, IntoFont, RGBColor, Rectangle, Text};
use rayon::prelude::*;

use super::super::Result;
use super::fault;
use dpges_train::study::plot_font::{self, FAMILY};

/// Photographs on a sheet at most: those that are marked, and an even choice of the others.
const MOST: usize = 400;
const COLUMNS: usize = 8;
/// Longer side of a photograph, height of its name, space between two, width of the frame, px.
const SIDE: usize = 150;
const NAME: usize = 18;
const SPACE: usize = 10;
const FRAME: usize = 4;
/// Size of letters, px; letters of a name that fit.
const LETTERS: i32 = 12;
const LONGEST_NAME: usize = 24;

/// Width of the stripes over what does not count, px, and their grey.
const STRIPE: usize = 3;
const STRIPE_GREY: f32 = 0.5;

const PAPER: RGBColor = RGBColor(255, 255, 255);
const INK: RGBColor = RGBColor(40, 40, 40);
const MARK: RGBColor = RGBColor(220, 30, 30);

/// The photographs of `dataset` by the order of the views of `report`.
///
/// # Errors
/// If a photograph cannot be read again, or the sheet not be drawn.
pub fn contact_sheet(dataset: &Dataset, report: &Report) -> Result<Rgb8Image> {
    let views: Vec<&View> = dataset.train.iter().chain(&dataset.test).chain(&dataset.validation).collect();
    let step = views.len().div_ceil(MOST).max(1);
    let is_marked = |view: &View| report.is_flagged(&view.name);
    let chosen: Vec<&View> = views
        .into_iter()
        .enumerate()
        .filter(|(index, view)| index % step == 0 || is_marked(view))
        .map(|(_, view)| view)
        .collect();
    let small: Vec<Rgb8Image> = chosen.par_iter().map(|view| small(view)).collect::<dpges_core::Result<_>>()?;
    drawn(&chosen, &small, is_marked).map_err(fault)
}

fn drawn(chosen: &[&View], small: &[Rgb8Image], is_marked: impl Fn(&View) -> bool) -> Result<Rgb8Image, String> {
    let columns = COLUMNS.min(chosen.len()).max(1);
    let rows = chosen.len().div_ceil(columns);
    let (cell_width, cell_height) = (SIDE + 2 * FRAME + SPACE, SIDE + 2 * FRAME + NAME + SPACE);
    let (width, height) = (columns * cell_width + SPACE, rows * cell_height + SPACE);
    let mut bytes = vec![255; 3 * width * height];
    plot_font::register()?;
    {
        let size = (width as u32, height as u32);
        let area = BitMapBackend::with_buffer(&mut bytes, size).into_drawing_area();
        let draw = || -> Result<(), Box<dyn std::error::Error>> {
            area.fill(&PAPER)?;
            let font = (FAMILY, LETTERS).into_font();
            for (index, (view, small)) in chosen.iter().zip(small).enumerate() {
                let (x, y) = place(index, columns);
                let (right, bottom) = (x + small.width + 2 * FRAME, y + small.height + 2 * FRAME);
                if is_marked(view) {
                    let corners = [(x as i32, y as i32), (right as i32 - 1, bottom as i32 - 1)];
                    area.draw(&Rectangle::new(corners, MARK.filled()))?;
                }
                let ink = if is_marked(view) { MARK } else { INK };
                let at = ((x + FRAME) as i32, (bottom + 2) as i32);
                area.draw(&Text::new(short(&view.name), at, font.color(&ink)))?;
            }
            area.present()?;
            Ok(())
        };
        draw().map_err(|error| error.to_string())?;
    }
    for (index, small) in small.iter().enumerate() {
        let (x, y) = place(index, columns);
        for row in 0..small.height {
            let at = 3 * ((y + FRAME + row) * width + x + FRAME);
            bytes[at..][..3 * small.width].copy_from_slice(&small.bytes[3 * row * small.width..][..3 * small.width]);
        }
    }
    Ok(Rgb8Image { width, height, bytes })
}

/// Upper left corner of a frame, px.
fn place(index: usize, columns: usize) -> (usize, usize) {
    let (cell_width, cell_height) = (SIDE + 2 * FRAME + SPACE, SIDE + 2 * FRAME + NAME + SPACE);
    (SPACE + index % columns * cell_width, SPACE + index / columns * cell_height)
}

/// The end of a long name, which is what names of photographs differ in.
fn short(name: &str) -> String {
    let count = name.chars().count();
    if count <= LONGEST_NAME {
        return name.to_owned();
    }
    let end: String = name.chars().skip(count + 1 - LONGEST_NAME).collect();
    format!("…{end}")
}

/// A photograph of at most 150 px, with stripes over what does not count; each pixel is the mean of those that it stands for.
fn small(view: &View) -> dpges_core::Result<Rgb8Image> {
    let picture = view.picture()?;
    let (width, height) = (picture.width, picture.height);
    let longer = width.max(height);
    let along = |length: usize| if longer <= SIDE { length } else { (length * SIDE / longer).max(1) };
    let (columns, rows) = (along(width), along(height));
    let (area, planes) = (width * height, picture.planes());
    let ignored: Option<Vec<f32>> =
        picture.counted.as_ref().map(|counted| counted.iter().map(|&counts| if counts { 0.0 } else { 1.0 }).collect());
    let mean = |plane: &[f32], column: usize, row: usize| {
        let (x, y) = (column * width / columns, row * height / rows);
        let (right, bottom) = ((column + 1) * width / columns, (row + 1) * height / rows);
        let sum: f32 = (y..bottom).map(|y| plane[y * width + x..y * width + right].iter().sum::<f32>()).sum();
        sum / ((right - x) * (bottom - y)) as f32
    };
    let value = |channel: usize, pixel: usize| {
        let (column, row) = (pixel % columns, pixel / columns);
        let shown = mean(&planes[channel * area..][..area], column, row);
        match &ignored {
            Some(ignored) if ((column + row) / STRIPE).is_multiple_of(2) => {
                shown + mean(ignored, column, row) * (STRIPE_GREY - shown)
            }
            _ => shown,
        }
    };
    let value = &value;
    let planes: Vec<f32> =
        (0..3).flat_map(|channel| (0..rows * columns).map(move |pixel| value(channel, pixel))).collect();
    Ok(Rgb8Image::from_planes(&planes, columns, rows))
}

#[cfg(test)]
mod tests {
    use dpges_train::dataset::check::{Effort, Finding, Kind};
    use dpges_train::dataset::{BuiltinOptions, builtin};

    use super::*;

    #[test]
    fn all_photographs_are_there_and_those_that_were_found_are_marked() {
        let options = BuiltinOptions { width: 300, height: 200, train_views: 9, test_views: 1, ..Default::default() };
        let dataset = builtin(&BuiltinOptions { points: 10, supersampling: 1, ..options });
        let mut report = Report::of(&dataset, Effort::Quick).unwrap();
        report.findings = vec![Finding {
            kind: Kind::Blurred,
            views: vec!["train_008".to_owned()],
            message: String::new(),
            advice: "",
        }];
        let sheet = contact_sheet(&dataset, &report).unwrap();
        assert_eq!((sheet.width, sheet.height), (8 * 168 + 10, 2 * 186 + 10));
        let pixel = |x: usize, y: usize| <[u8; 3]>::try_from(&sheet.bytes[3 * (y * sheet.width + x)..][..3]).unwrap();
        let mark = [MARK.0, MARK.1, MARK.2];
        // the ninth is the first of the second row
        assert_eq!(pixel(11, 10 + 186 + 20), mark);
        assert_ne!(pixel(11, 10 + 20), mark);
        let expected = small(&dataset.train[0]).unwrap();
        assert_eq!((expected.width, expected.height), (150, 100));
        assert_eq!(pixel(10 + FRAME + 70, 10 + FRAME + 50)[..], expected.bytes[3 * (50 * 150 + 70)..][..3]);
        let dark = |x: usize, y: usize| pixel(x, y)[0] < 200;
        let letters =
            (0..100).flat_map(|x| (0..14).map(move |y| (x, y))).filter(|&(x, y)| dark(14 + x, 10 + 108 + 2 + y));
        assert!(letters.count() > 20, "the first has a name below it");
    }

    #[test]
    fn what_does_not_count_is_striped() {
        let options = BuiltinOptions { width: 60, height: 30, train_views: 1, test_views: 0, ..Default::default() };
        let mut dataset = builtin(&BuiltinOptions { points: 0, ..options });
        let view = &mut dataset.train[0];
        view.repaint(|picture| {
            picture.bytes.fill(255);
            picture.counted = Some((0..60 * 30).map(|pixel| pixel % 60 < 30).collect());
        })
        .unwrap();
        let sheet = small(view).unwrap();
        let grey = |x: usize, y: usize| sheet.bytes[3 * (y * 60 + x)];
        assert!((0..30).all(|x| grey(x, 10) == 255));
        let stripes: Vec<bool> = (30..42).map(|x| grey(x, 0) < 130).collect();
        assert_eq!(stripes, [[true; 3], [false; 3]].concat().repeat(2));
        assert_ne!(grey(32, 0), grey(32, 1), "they are diagonal");
    }

    #[test]
    fn long_names_are_cut_at_their_beginning() {
        assert_eq!(short("train_000"), "train_000");
        assert_eq!(short("a/very/long/folder/of/photographs/IMG_1234.jpg"), "…hotographs/IMG_1234.jpg");
    }
}

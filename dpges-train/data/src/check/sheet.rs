//! All photographs small, in one picture; what something was found about has a red frame, and stripes what does not count.

use epaint_default_fonts::UBUNTU_LIGHT;
use image::{Rgb, RgbImage, imageops};
use plotters::prelude::{BitMapBackend, IntoDrawingArea, IntoFont, RGBColor, Text};
use plotters::style::{FontStyle, register_font};

use super::Report;
use crate::{Dataset, Picture, View, pictures};

/// Photographs on a sheet at most: those that are marked, and an even choice of the others.
const MOST: usize = 400;
const COLUMNS: usize = 8;
/// Longer side of a photograph, height of its name, space between two, width of the frame, px.
const SIDE: usize = 150;
const NAME: usize = 18;
const SPACE: usize = 10;
const FRAME: usize = 4;
/// Distance between two photographs along a row and along a column, px.
const CELL: [usize; 2] = [SIDE + 2 * FRAME + SPACE, SIDE + 2 * FRAME + NAME + SPACE];
/// Font and size of letters, px; letters of a name that fit.
const FAMILY: &str = "sans-serif";
const LETTERS: i32 = 12;
const LONGEST_NAME: usize = 24;
/// Width of the stripes over what does not count, px.
const STRIPE: usize = 3;
const STRIPE_COLOUR: Rgb<u8> = Rgb([128; 3]);
const INK: Rgb<u8> = Rgb([40; 3]);
const MARK: Rgb<u8> = Rgb([220, 30, 30]);

/// Why there is no sheet.
#[derive(Debug, thiserror::Error)]
pub enum SheetError {
    #[error(transparent)]
    Photograph(#[from] dpges_core::Error),
    #[error("the names of the photographs cannot be drawn: {0}; this is a fault of the program")]
    Drawing(String),
}

/// The photographs of `dataset` by the order of the views of `report`.
///
/// # Errors
/// If a photograph cannot be read again, or names cannot be drawn.
pub fn contact_sheet(dataset: &Dataset, report: &Report) -> Result<Picture, SheetError> {
    let step = dataset.views().count().div_ceil(MOST).max(1);
    let is_chosen = |&(index, view): &(usize, &View)| index % step == 0 || report.is_flagged(&view.name);
    let chosen: Vec<&View> = dataset.views().enumerate().filter(is_chosen).map(|(_, view)| view).collect();
    let small: Vec<RgbImage> = pictures(chosen.iter().copied())
        .map(|(_, picture)| Ok(small(&*picture?)))
        .collect::<dpges_core::Result<_>>()?;
    let columns = COLUMNS.min(chosen.len()).max(1);
    let [width, height] = [columns * CELL[0] + SPACE, chosen.len().div_ceil(columns) * CELL[1] + SPACE];
    let mut sheet = RgbImage::from_pixel(width as u32, height as u32, Rgb([255; 3]));
    let mut names = Vec::new();
    for (index, (view, small)) in chosen.iter().zip(small).enumerate() {
        let [x, y] = [index % columns * CELL[0] + SPACE, index / columns * CELL[1] + SPACE].map(|at| at as i64);
        let frame = FRAME as i64;
        let ink = if report.is_flagged(&view.name) {
            let [width, height] = [small.width(), small.height()].map(|side| side + 2 * FRAME as u32);
            imageops::replace(&mut sheet, &RgbImage::from_pixel(width, height, MARK), x, y);
            MARK
        } else {
            INK
        };
        imageops::replace(&mut sheet, &small, x + frame, y + frame);
        let below = y + 2 * frame + i64::from(small.height()) + 2;
        names.push((short(&view.name), ((x + frame) as i32, below as i32), ink));
    }
    write(&mut sheet, &names).map_err(|error| SheetError::Drawing(error.to_string()))?;
    Ok(Picture { width, height, bytes: sheet.into_raw(), alpha: None, counted: None })
}

/// Writes texts from their upper left corners on.
fn write(sheet: &mut RgbImage, texts: &[(String, (i32, i32), Rgb<u8>)]) -> Result<(), Box<dyn std::error::Error>> {
    register_font(FAMILY, FontStyle::Normal, UBUNTU_LIGHT).map_err(|_| "the font cannot be read")?;
    let size = sheet.dimensions();
    let area = BitMapBackend::with_buffer(sheet, size).into_drawing_area();
    for (text, at, Rgb([r, g, b])) in texts {
        let style = (FAMILY, LETTERS).into_font().color(&RGBColor(*r, *g, *b));
        area.draw(&Text::new(text.as_str(), *at, style)).map_err(|error| error.to_string())?;
    }
    area.present().map_err(|error| error.to_string())?;
    Ok(())
}

/// The end of a long name, which is what names of photographs differ in.
fn short(name: &str) -> String {
    match name.char_indices().rev().nth(LONGEST_NAME - 1) {
        Some((start, _)) if start > 0 => format!("…{}", name[start..].chars().skip(1).collect::<String>()),
        _ => name.to_owned(),
    }
}

/// A photograph of at most 150 px, with stripes over what does not count.
fn small(picture: &Picture) -> RgbImage {
    let (width, height) = (picture.width, picture.height);
    let longer = width.max(height).max(SIDE);
    let [columns, rows] = [width, height].map(|side| (side * SIDE / longer).max(1));
    let whole = RgbImage::from_raw(width as u32, height as u32, picture.bytes.clone()).expect("three bytes a pixel");
    let mut small = imageops::thumbnail(&whole, columns as u32, rows as u32);
    for (x, y, pixel) in small.enumerate_pixels_mut() {
        let (column, row) = (x as usize, y as usize);
        if !picture.counts(row * height / rows * width + column * width / columns)
            && ((column + row) / STRIPE).is_multiple_of(2)
        {
            *pixel = STRIPE_COLOUR;
        }
    }
    small
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::Effort;
    use crate::check::tests::finding;
    use crate::{BuiltinOptions, builtin};

    #[test]
    fn all_photographs_are_there_and_those_that_were_found_are_marked() {
        let options = BuiltinOptions { width: 300, height: 200, train_views: 9, test_views: 1, ..Default::default() };
        let dataset = builtin(&BuiltinOptions { points: 10, supersampling: 1, ..options });
        let mut report = Report::of(&dataset, Effort::Quick).unwrap();
        report.findings = vec![finding("train_008")];
        let sheet = contact_sheet(&dataset, &report).unwrap();
        assert_eq!((sheet.width, sheet.height), (8 * 168 + 10, 2 * 186 + 10));
        let pixel = |x: usize, y: usize| <[u8; 3]>::try_from(&sheet.bytes[3 * (y * sheet.width + x)..][..3]).unwrap();
        // the ninth is the first of the second row
        assert_eq!(pixel(11, 10 + 186 + 20), MARK.0);
        assert_ne!(pixel(11, 10 + 20), MARK.0);
        let expected = small(&dataset.train[0].picture().unwrap());
        assert_eq!(expected.dimensions(), (150, 100));
        assert_eq!(pixel(10 + FRAME + 70, 10 + FRAME + 50), expected.get_pixel(70, 50).0);
        let dark = |x: usize, y: usize| pixel(x, y)[0] < 200;
        let letters =
            (0..100).flat_map(|x| (0..14).map(move |y| (x, y))).filter(|&(x, y)| dark(14 + x, 10 + 108 + 2 + y));
        assert!(letters.count() > 20, "the first has a name below it");
    }

    #[test]
    fn what_does_not_count_is_striped() {
        let mut picture = Picture::from_planes(&[1.0; 3 * 60 * 30], 60, 30);
        picture.counted = Some((0..60 * 30).map(|pixel| pixel % 60 < 30).collect());
        let small = small(&picture);
        let grey = |x: u32, y: u32| small.get_pixel(x, y).0[0];
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

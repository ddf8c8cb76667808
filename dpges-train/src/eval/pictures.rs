//! PNGs of renders beside their photographs, and names for the files of a set of views.

use std::collections::HashSet;
use std::io::Write;
use std::path::Path;

use dpges_core::Result;
use dpges_core::scene::atomic::write_atomically;
use dpges_render::{Rgb8Image, false_colour};
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageResult};

use crate::dataset::{Picture, View};
use crate::eval::rendered::{Rendered, to_picture};
use crate::metrics::flip_map;

/// Photograph · render · surfels only, if there are any · error, from left to right. There is no error where pixels do not
/// count.
///
/// # Errors
/// [`dpges_core::Error::Io`] if the photograph cannot be read again.
pub fn comparison(view: &View, render: &Rendered) -> Result<Rgb8Image> {
    let picture = view.picture()?;
    let photograph = photograph(&picture);
    let image = to_picture(render.image());
    let surfels = render.peeled().map(|render| to_picture(&render.composite.surfel_image));
    let error = false_colour::error(&where_it_counts(&picture, &image), &photograph);
    let parts: Vec<Rgb8Image> = [Some(photograph), Some(image), surfels, Some(error)].into_iter().flatten().collect();
    Ok(Rgb8Image::beside(&parts))
}

/// Photograph · render · FLIP, dark blue where there is none and yellow where it is 1, from left to right.
///
/// # Errors
/// [`dpges_core::Error::Io`] if the photograph cannot be read again.
pub fn with_flip(view: &View, render: &Rendered) -> Result<Rgb8Image> {
    let picture = view.picture()?;
    let photograph = photograph(&picture);
    let image = to_picture(render.image());
    let (width, height) = (photograph.width, photograph.height);
    let [reference, test] = [&photograph, &where_it_counts(&picture, &image)].map(planes);
    let errors = flip_map(&reference, &test, width, height);
    let flip = Rgb8Image::from_pixels(width, height, errors.iter().map(|&error| false_colour::ramp(error as f32)));
    Ok(Rgb8Image::beside(&[photograph, image, flip]))
}

/// [3, height, width], from 0 to 1.
pub(super) fn planes(image: &Rgb8Image) -> Vec<f32> {
    let channel = |channel: usize| image.bytes.iter().skip(channel).step_by(3).map(|&byte| f32::from(byte) / 255.0);
    (0..3).flat_map(channel).collect()
}

/// Two rows: photograph · each of `renders`, which have its size; and below each its error.
///
/// # Errors
/// [`dpges_core::Error::Io`] if the photograph cannot be read again.
pub fn sheet(view: &View, renders: &[Rgb8Image]) -> Result<Rgb8Image> {
    let picture = view.picture()?;
    let photograph = photograph(&picture);
    let (width, height) = (photograph.width, photograph.height);
    let error = |render: &Rgb8Image| false_colour::error(&where_it_counts(&picture, render), &photograph);
    let errors = renders.iter().map(error);
    let nothing = Rgb8Image { width, height, bytes: vec![255; 3 * width * height] };
    let below: Vec<Rgb8Image> = std::iter::once(nothing).chain(errors).collect();
    let above: Vec<Rgb8Image> = std::iter::once(photograph).chain(renders.iter().cloned()).collect();
    Ok(Rgb8Image::below(&[Rgb8Image::beside(&above), Rgb8Image::beside(&below)]))
}

/// `image` with the `photograph` where pixels do not count.
fn where_it_counts(photograph: &Picture, image: &Rgb8Image) -> Rgb8Image {
    let mut shown = image.clone();
    let pixels = shown.bytes.chunks_exact_mut(3).zip(photograph.bytes.chunks_exact(3)).enumerate();
    for (_, (shown, photograph)) in pixels.filter(|(pixel, _)| !photograph.counts(*pixel)) {
        shown.copy_from_slice(photograph);
    }
    shown
}

/// A photograph as a picture to show.
pub fn photograph(picture: &Picture) -> Rgb8Image {
    Rgb8Image { width: picture.width, height: picture.height, bytes: picture.bytes.clone() }
}

/// Writes a PNG. It replaces an existing file only once it is complete.
///
/// # Errors
/// [`dpges_core::Error::Io`] naming `path`.
pub fn save_png(image: &Rgb8Image, path: &Path) -> Result<()> {
    save_png_with(image, None, path)
}

/// The same with the opacities [height, width] of its pixels, if there are any.
///
/// # Errors
/// As [`save_png`].
pub fn save_png_with(image: &Rgb8Image, alpha: Option<&[u8]>, path: &Path) -> Result<()> {
    let rgba: Option<Vec<u8>> = alpha.map(|alpha| {
        let pixels = image.bytes.as_chunks::<3>().0.iter().zip(alpha);
        pixels.flat_map(|(&[red, green, blue], &alpha)| [red, green, blue, alpha]).collect()
    });
    let (bytes, colour) = match &rgba {
        Some(rgba) => (rgba, ExtendedColorType::Rgba8),
        None => (&image.bytes, ExtendedColorType::Rgb8),
    };
    write_atomically(path, |file| {
        let mut encoded = Vec::new();
        PngEncoder::new(&mut encoded)
            .write_image(bytes, image.width as u32, image.height as u32, colour)
            .map_err(std::io::Error::other)?;
        file.write_all(&encoded)
    })
}

/// Writes depths [height, width] as the channel `Z` of an OpenEXR file, in world units, 0 where there is nothing.
///
/// # Errors
/// As [`save_png`].
pub fn save_depth(depth: &[f32], [width, height]: [usize; 2], path: &Path) -> Result<()> {
    use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage};
    let channel = AnyChannel::new("Z", FlatSamples::F32(depth.to_vec()));
    let channels = AnyChannels::sort(std::iter::once(channel).collect());
    let layer = Layer::new((width, height), LayerAttributes::default(), Encoding::SMALL_FAST_LOSSLESS, channels);
    write_atomically(path, |file| {
        let mut encoded = std::io::Cursor::new(Vec::new());
        Image::from_layer(layer).write().non_parallel().to_buffered(&mut encoded).map_err(std::io::Error::other)?;
        file.write_all(encoded.get_ref())
    })
}

/// The bytes of a JPEG of `quality` 1 to 100.
pub fn jpeg(image: &Rgb8Image, quality: u8) -> ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    let (width, height) = (image.width as u32, image.height as u32);
    JpegEncoder::new_with_quality(&mut bytes, quality).encode(&image.bytes, width, height, ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

/// File names without extension, one for each name and all different. Separators of folders, and characters that are
/// not alphanumeric, `-`, `_` or `.`, become `_`.
pub fn file_stems<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut taken = HashSet::new();
    let mut stems = Vec::new();
    for name in names {
        let stem = stem(name);
        let unique = (1..).map(|number| if number == 1 { stem.clone() } else { format!("{stem}-{number}") });
        stems.extend(unique.into_iter().find(|name| taken.insert(name.clone())));
    }
    stems
}

fn stem(name: &str) -> String {
    let without = match name.rsplit_once('.') {
        Some((stem, "png" | "jpg" | "jpeg" | "PNG" | "JPG" | "JPEG")) => stem,
        _ => name,
    };
    let safe = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '_' | '.') { c } else { '_' };
    without.trim_start_matches(['.', '/']).chars().map(safe).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};

    fn views(names: &[&str]) -> Vec<View> {
        let tiny = BuiltinOptions { width: 2, height: 2, train_views: 1, points: 0, ..Default::default() };
        let view = builtin(&tiny).train.remove(0);
        names.iter().map(|name| View { name: (*name).to_owned(), ..view.clone() }).collect()
    }

    #[test]
    fn file_stems_are_safe_and_unique() {
        let names = ["images/a b.jpg", "images_a b.png", "./test/r_0", "v1.5.png", "../x"];
        assert_eq!(file_stems(names.into_iter()), ["images_a_b", "images_a_b-2", "test_r_0", "v1.5", "x"]);
    }

    #[test]
    fn a_sheet_has_errors_below_renders() {
        let view = views(&["a"]).remove(0);
        let exact = photograph(&view.picture().unwrap());
        let wrong = Rgb8Image { bytes: exact.bytes.iter().map(|byte| byte ^ 0x80).collect(), ..exact.clone() };
        let sheet = sheet(&view, &[exact.clone(), wrong.clone()]).unwrap();
        // three columns and two rows of 2 x 2 px, 2 px apart
        assert_eq!((sheet.width, sheet.height), (10, 6));
        let part = |column: usize, row: usize| -> Vec<u8> {
            let line = |y: usize| &sheet.bytes[3 * ((4 * row + y) * sheet.width + 4 * column)..][..6];
            [line(0), line(1)].concat()
        };
        assert_eq!([part(0, 0), part(1, 0), part(2, 0)], [exact.bytes.clone(), exact.bytes, wrong.bytes]);
        let of_ramp = |value: f32| false_colour::ramp(value).repeat(4);
        assert_eq!([part(0, 1), part(1, 1), part(2, 1)], [vec![255; 12], of_ramp(0.0), of_ramp(1.0)]);
    }

    #[test]
    fn there_is_no_error_where_pixels_do_not_count() {
        let mut view = views(&["a"]).remove(0);
        view.repaint(|picture| picture.counted = Some(vec![true, false, true, true])).unwrap();
        let picture = view.picture().unwrap();
        let exact = photograph(&picture);
        let wrong = Rgb8Image { bytes: exact.bytes.iter().map(|byte| byte ^ 0x80).collect(), ..exact.clone() };
        let shown = where_it_counts(&picture, &wrong);
        assert_eq!((&shown.bytes[3..6], &shown.bytes[..3]), (&exact.bytes[3..6], &wrong.bytes[..3]));
        assert_eq!(shown.bytes[6..], wrong.bytes[6..]);
    }

    #[test]
    fn planes_are_those_that_a_picture_is_made_of() {
        let picture = Rgb8Image { width: 2, height: 1, bytes: vec![0, 51, 255, 102, 204, 153] };
        let planes = planes(&picture);
        assert_eq!(planes, [0.0, 102.0, 51.0, 204.0, 255.0, 153.0].map(|byte: f32| byte / 255.0));
        assert_eq!(Rgb8Image::from_planes(&planes, 2, 1), picture);
    }

    #[test]
    fn pngs_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let picture = Rgb8Image { width: 2, height: 1, bytes: vec![1, 2, 3, 250, 0, 9] };
        save_png(&picture, &path).unwrap();
        let read = image::open(&path).unwrap().into_rgb8();
        assert_eq!((read.width(), read.into_raw()), (2, picture.bytes.clone()));
        assert!(save_png(&picture, &folder.path().join("absent/a.png")).unwrap_err().to_string().contains("absent"));
    }
}

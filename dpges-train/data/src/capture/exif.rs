//! Which camera took a photograph, as its EXIF says.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use exif::{In, Tag};
use image::ImageReader;
use rayon::prelude::*;

use super::error::{SfmError, io};

/// Whether the pictures, which are there, can share a camera: all have the same size and, as far as they say so, were
/// taken by the same camera with the same focal length.
///
/// # Errors
/// [`SfmError::Image`] for a file that is no picture.
pub(super) fn have_one_camera(pictures: &[PathBuf]) -> Result<bool, SfmError> {
    let cameras: BTreeSet<(u32, u32, Vec<String>)> =
        pictures.par_iter().map(|path| camera(path)).collect::<Result<_, _>>()?;
    Ok(cameras.len() <= 1)
}

/// Size in px, and what a picture says of its camera.
fn camera(path: &Path) -> Result<(u32, u32, Vec<String>), SfmError> {
    let undecodable = |source| SfmError::Image { path: path.to_owned(), source };
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let (width, height) = reader.map_err(io("cannot read", path))?.into_dimensions().map_err(undecodable)?;
    let file = File::open(path).map_err(io("cannot read", path))?;
    // pictures without EXIF, or with broken EXIF, say nothing
    let said = exif::Reader::new().read_from_container(&mut BufReader::new(file)).ok();
    let tags = [Tag::Make, Tag::Model, Tag::FocalLength, Tag::FocalLengthIn35mmFilm];
    let values = tags.iter().filter_map(|&tag| said.as_ref()?.get_field(tag, In::PRIMARY));
    Ok((width, height, values.map(|field| format!("{} {}", field.tag, field.display_value())).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{assert_says, insert_segment, write_png};

    #[test]
    fn a_camera_is_shared_by_pictures_of_one_size_and_one_focal_length() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write_png(&path("a.png"), 24, 16, [1, 2, 3]);
        write_png(&path("b.png"), 24, 16, [9, 2, 3]);
        write_png(&path("c.png"), 16, 24, [1, 2, 3]);
        for (name, millimetres) in [("near.jpg", 26), ("far.jpg", 77), ("again.jpg", 26)] {
            image::RgbImage::new(24, 16).save(path(name)).unwrap();
            // a directory that points to another, which holds `FocalLengthIn35mmFilm`
            let directory = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x1a\0\0\0\0\0\0\0";
            let entry = b"\x01\0\x05\xa4\x03\0\x01\0\0\0";
            let exif = [&directory[..], entry, &[millimetres, 0, 0, 0, 0, 0, 0, 0]].concat();
            insert_segment(&path(name), 0xe1, &exif);
        }
        let share = |names: &[&str]| have_one_camera(&names.iter().map(|name| path(name)).collect::<Vec<_>>());
        assert!(share(&["a.png", "b.png"]).unwrap() && !share(&["a.png", "b.png", "c.png"]).unwrap());
        assert!(share(&["near.jpg", "again.jpg"]).unwrap() && !share(&["near.jpg", "far.jpg"]).unwrap());
        std::fs::write(path("d.png"), "no picture").unwrap();
        assert_says(share(&["a.png", "d.png"]).unwrap_err(), &["d.png", "replace or remove"]);
    }
}

//! Pictures of the scene as files.

use std::path::{Path, PathBuf};

use dpges_core::scene::atomic::write_atomically;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use crate::Rgb8Image;

#[derive(Clone, Debug)]
pub struct ScreenshotForm {
    pub file: String,
    /// Width and height in px; `None`: as in the window.
    pub size: Option<[usize; 2]>,
}

impl Default for ScreenshotForm {
    fn default() -> Self {
        Self { file: "screenshot.png".to_owned(), size: None }
    }
}

/// `path`, or with a number behind its name if there is such a file already.
pub fn unused(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map_or_else(String::new, |extension| format!(".{}", extension.to_string_lossy()));
    let numbered = (2..).map(|number| path.with_file_name(format!("{stem}-{number}{extension}")));
    std::iter::once(path.to_owned()).chain(numbered).find(|path| !path.exists()).unwrap_or_else(|| path.to_owned())
}

pub fn save_png(picture: &Rgb8Image, path: &Path) -> dpges_core::Result<()> {
    write_atomically(path, |file| {
        PngEncoder::new(file)
            .write_image(&picture.bytes, picture.width as u32, picture.height as u32, ExtendedColorType::Rgb8)
            .map_err(std::io::Error::other)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_screenshot_takes_the_place_of_another() {
        let folder = tempfile::tempdir().unwrap();
        let wanted = folder.path().join("shot.png");
        let picture = Rgb8Image { width: 1, height: 2, bytes: vec![1, 2, 3, 4, 5, 6] };
        for name in ["shot.png", "shot-2.png", "shot-3.png"] {
            let path = unused(&wanted);
            assert_eq!(path, folder.path().join(name));
            save_png(&picture, &path).unwrap();
        }
        assert_eq!(image::open(&wanted).unwrap().into_rgb8().into_raw(), picture.bytes);
        let absent = folder.path().join("absent/shot.png");
        assert!(save_png(&picture, &absent).unwrap_err().to_string().contains("absent"));
    }
}

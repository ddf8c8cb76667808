//! Photographs as planes of floats: decoding, compositing, downscaling.

use std::path::Path;

use image::imageops::{self, FilterType};
use image::{ColorType, ImageBuffer, ImageDecoder, ImageError, ImageReader, Luma, Pixel, Rgb};

use super::error::{DatasetError, Result};

/// An image in display-referred values, as stored in the file; EXIF orientation is not applied, because
/// poses and intrinsics refer to the stored pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    /// Red, green and blue planes in 0..1, [3, height, width], composited on the background.
    pub planes: Vec<f32>,
    /// Coverage in 0..1, [height, width]. `None` if the file has no alpha channel.
    pub alpha: Option<Vec<f32>>,
}

impl Picture {
    /// Red, green and blue of the pixel in column `x`, row `y`.
    pub fn rgb(&self, x: usize, y: usize) -> [f32; 3] {
        std::array::from_fn(|channel| self.planes[(channel * self.height + y) * self.width + x])
    }

    /// The picture downscaled to `width` × `height` px by a Catmull-Rom filter, widened by the reduction.
    pub(super) fn downscaled(&self, width: usize, height: usize) -> Self {
        let mut interleaved = Vec::with_capacity(self.planes.len());
        for y in 0..self.height {
            for x in 0..self.width {
                interleaved.extend(self.rgb(x, y));
            }
        }
        let size = [self.width, self.height, width, height].map(|side| side as u32);
        let planes = planar(&resize::<Rgb<f32>>(interleaved, size));
        let alpha = self.alpha.as_ref().map(|alpha| resize::<Luma<f32>>(alpha.clone(), size));
        Self { width, height, planes, alpha }
    }
}

/// The header of an image file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub width: usize,
    pub height: usize,
    pub has_alpha: bool,
}

/// Size and kind of an image, without decoding its pixels.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Decode`].
pub(super) fn header(path: &Path) -> Result<Header> {
    let decoder = reader(path)?.into_decoder().map_err(|source| undecodable(path, source))?;
    let (width, height) = decoder.dimensions();
    let colour: ColorType = decoder.color_type();
    Ok(Header { width: width as usize, height: height as usize, has_alpha: colour.has_alpha() })
}

/// Decodes a PNG or JPEG of 8 or 16 bits, grey or coloured. If the file has alpha (not premultiplied), colour is
/// composited in float: `alpha · colour + (1 − alpha) · background`.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Decode`].
pub(super) fn decode(path: &Path, background: [f64; 3]) -> Result<Picture> {
    let decoded = reader(path)?.decode().map_err(|source| undecodable(path, source))?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    if !decoded.color().has_alpha() {
        return Ok(Picture { width, height, planes: planar(decoded.into_rgb32f().as_raw()), alpha: None });
    }
    let rgba = decoded.into_rgba32f();
    let mut planes = vec![0.0; 3 * width * height];
    let mut alpha = vec![0.0; width * height];
    for (pixel, rgba) in rgba.pixels().enumerate() {
        let [colour @ .., a] = rgba.0;
        for (channel, colour) in colour.into_iter().enumerate() {
            planes[channel * width * height + pixel] = a * colour + (1.0 - a) * background[channel] as f32;
        }
        alpha[pixel] = a;
    }
    Ok(Picture { width, height, planes, alpha: Some(alpha) })
}

pub(super) fn reader(path: &Path) -> Result<ImageReader<std::io::BufReader<std::fs::File>>> {
    ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(|source| DatasetError::Read { path: path.to_owned(), source })
}

pub(super) fn undecodable(path: &Path, source: ImageError) -> DatasetError {
    DatasetError::Decode { path: path.to_owned(), source }
}

/// [height · width, 3] to [3, height · width].
fn planar(interleaved: &[f32]) -> Vec<f32> {
    (0..3).flat_map(|channel| interleaved[channel..].iter().step_by(3).copied()).collect()
}

/// `size` is from width, from height, to width, to height.
fn resize<P: Pixel<Subpixel = f32> + 'static>(samples: Vec<f32>, size: [u32; 4]) -> Vec<f32> {
    let [from_width, from_height, to_width, to_height] = size;
    let buffer = ImageBuffer::<P, _>::from_raw(from_width, from_height, samples).expect("samples fill the image");
    let mut resized = imageops::resize(&buffer, to_width, to_height, FilterType::CatmullRom).into_raw();
    resized.iter_mut().for_each(|value| *value = value.clamp(0.0, 1.0));
    resized
}

#[cfg(test)]
mod tests {
    use image::{DynamicImage, GrayImage, ImageBuffer, Luma, Rgba, RgbaImage};

    use super::*;

    fn saved(name: &str, image: impl Into<DynamicImage>) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        image.into().save(&path).unwrap();
        (folder, path)
    }

    #[test]
    fn grey_and_sixteen_bit_images_become_three_planes() {
        let (_folder, path) = saved("grey.png", GrayImage::from_fn(3, 2, |x, y| Luma([(x * 50 + y) as u8])));
        let picture = decode(&path, [0.0; 3]).unwrap();
        assert_eq!((picture.width, picture.height, &picture.alpha), (3, 2, &None));
        assert!(picture.rgb(2, 1).iter().all(|value| (value - 101.0 / 255.0).abs() < 1e-7));
        assert_eq!(header(&path).unwrap(), Header { width: 3, height: 2, has_alpha: false });

        let deep = ImageBuffer::from_fn(2, 2, |x, _| Rgb([(x * 257) as u16, 65535u16, 1000]));
        let (_folder, path) = saved("deep.png", DynamicImage::ImageRgb16(deep));
        let rgb = decode(&path, [0.0; 3]).unwrap().rgb(1, 0);
        for (found, expected) in rgb.into_iter().zip([257.0, 65535.0, 1000.0]) {
            assert!((found - expected / 65535.0).abs() < 1e-7);
        }
    }

    #[test]
    fn alpha_is_composited_in_float() {
        let (_folder, path) = saved("a.png", RgbaImage::from_fn(2, 1, |x, _| Rgba([200, 100, 0, 51 * x as u8])));
        let picture = decode(&path, [1.0, 0.5, 0.0]).unwrap();
        assert_eq!(picture.rgb(0, 0), [1.0, 0.5, 0.0]);
        let expected = [0.2 * 200.0 / 255.0 + 0.8, 0.2 * 100.0 / 255.0 + 0.4, 0.0];
        for (found, expected) in picture.rgb(1, 0).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6);
        }
        assert_eq!(picture.alpha.unwrap(), [0.0, 0.2]);
        assert!(header(&path).unwrap().has_alpha);
    }

    #[test]
    fn exif_orientation_is_ignored() {
        let jpeg = saved("photo.jpg", image::RgbImage::from_fn(16, 8, |x, _| Rgb([(x * 15) as u8; 3])));
        let plain = std::fs::read(&jpeg.1).unwrap();
        let tiff = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        let mut turned = plain[..2].to_vec();
        turned.extend([0xff, 0xe1]);
        turned.extend((tiff.len() as u16 + 2).to_be_bytes());
        turned.extend(tiff);
        turned.extend(&plain[2..]);
        std::fs::write(&jpeg.1, turned).unwrap();
        let picture = decode(&jpeg.1, [0.0; 3]).unwrap();
        assert_eq!((picture.width, picture.height), (16, 8));
        assert!(picture.rgb(15, 0)[0] > picture.rgb(0, 0)[0]);
    }

    #[test]
    fn downscaling_averages_fine_detail_instead_of_aliasing() {
        let stripes: Vec<f32> = (0..3 * 64 * 32).map(|i| (i % 2) as f32).collect();
        let picture = Picture { width: 64, height: 32, planes: stripes, alpha: Some(vec![0.25; 64 * 32]) };
        let small = picture.downscaled(16, 8);
        assert_eq!((small.width, small.height, small.planes.len()), (16, 8, 3 * 16 * 8));
        for y in 2..6 {
            for x in 2..14 {
                assert!((small.rgb(x, y)[0] - 0.5).abs() < 0.02, "{:?}", small.rgb(x, y));
            }
        }
        assert!(small.alpha.unwrap().iter().all(|a| (a - 0.25).abs() < 1e-5));
    }

    #[test]
    fn unreadable_images_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.png");
        std::fs::write(&path, b"\x89PNG\r\n\x1a\nnothing else").unwrap();
        for error in [decode(&path, [0.0; 3]).unwrap_err(), header(&path).unwrap_err()] {
            assert!(error.to_string().contains("broken.png") && error.to_string().contains("replace it"), "{error}");
        }
    }
}

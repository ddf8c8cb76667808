//! Photographs in files: decoding, making smaller.

use std::fs::File;
use std::io::{self, Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use exif::{In, Tag};
use image::{ColorType, DynamicImage, ImageDecoder, ImageError, ImageReader, ImageResult};

use super::alpha::Alpha;
use super::{jpeg, resize};
use crate::Picture;
use crate::conventions::unread_format;
use crate::error::{DatasetError, Result, read, unreadable};

/// Bytes of a file that are read for its header at first. The crate `image` reads the whole of a JPEG.
const BEGINNING: u64 = 1 << 18;
/// Bytes at the end of a file in which a JPEG or a PNG ends; if not, something follows, or something is missing.
const END: u64 = 64;
const END_OF_JPEG: [u8; 2] = [0xff, 0xd9];
const END_OF_PNG: [u8; 4] = *b"IEND";

impl Picture {
    /// The picture made smaller, to `width` × `height` px, by a Catmull-Rom filter that is widened by the reduction, and
    /// rounded to 8 bits.
    pub(crate) fn downscaled(self, width: usize, height: usize) -> Self {
        let (from, to) = ([self.width, self.height], [width, height]);
        Self {
            width,
            height,
            counted: self.counted.map(|counted| resize::downscaled_mask(&counted, from, to)),
            bytes: resize::downscaled::<3>(&self.bytes, from, to),
            alpha: self.alpha.map(|alpha| resize::downscaled::<1>(&alpha, from, to)),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    pub width: usize,
    pub height: usize,
    pub has_alpha: bool,
    /// Whether a value has more than 8 bits.
    pub is_deep: bool,
    /// Of EXIF: 1 for upright.
    pub orientation: u32,
}

/// Size and kind of an image, without decoding its pixels.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Decode`], [`DatasetError::PictureFormat`], [`DatasetError::CutShort`].
pub(crate) fn header(path: &Path) -> Result<Header> {
    let (beginning, end) = ends(path).map_err(unreadable(path))?;
    check_format(path, &beginning)?;
    if !end.windows(2).any(|bytes| bytes == END_OF_JPEG) && !end.windows(4).any(|bytes| bytes == END_OF_PNG) {
        check_whole(path, &read(path)?)?;
    }
    let found = header_in(&beginning).or_else(|_| header_in(&read(path).map_err(io::Error::other)?));
    found.map_err(|source| undecodable(path, source))
}

/// The first bytes of a file, and its last.
fn ends(path: &Path) -> io::Result<(Vec<u8>, Vec<u8>)> {
    let (mut file, mut beginning, mut end) = (File::open(path)?, Vec::new(), Vec::new());
    (&mut file).take(BEGINNING).read_to_end(&mut beginning)?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(END)))?;
    file.read_to_end(&mut end)?;
    Ok((beginning, end))
}

fn header_in(bytes: &[u8]) -> ImageResult<Header> {
    let decoder = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?.into_decoder()?;
    let (width, height) = decoder.dimensions();
    let colour: ColorType = decoder.color_type();
    let is_deep = colour.bits_per_pixel() > 8 * u16::from(colour.channel_count());
    // pictures without EXIF, or with broken EXIF, say nothing
    let said = exif::Reader::new().read_from_container(&mut Cursor::new(bytes)).ok();
    let orientation = said.and_then(|said| said.get_field(Tag::Orientation, In::PRIMARY)?.value.get_uint(0));
    let orientation = orientation.filter(|orientation| (1..=8).contains(orientation)).unwrap_or(1);
    Ok(Header { width: width as usize, height: height as usize, has_alpha: colour.has_alpha(), is_deep, orientation })
}

fn check_format(path: &Path, beginning: &[u8]) -> Result<()> {
    let format = if beginning.is_empty() { Some("nothing: it is empty") } else { unread_format(beginning) };
    format.map_or(Ok(()), |format| Err(DatasetError::PictureFormat { path: path.to_owned(), format }))
}

/// # Errors
/// [`DatasetError::CutShort`] for a JPEG, PNG or WebP that ends before its end.
fn check_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let is_whole = match bytes {
        [0xff, 0xd8, ..] => jpeg_ends(bytes),
        [0x89, b'P', b'N', b'G', ..] => bytes.windows(4).any(|bytes| bytes == END_OF_PNG),
        [b'R', b'I', b'F', b'F', a, b, c, d, ..] => {
            u64::from(u32::from_le_bytes([*a, *b, *c, *d])) + 8 <= bytes.len() as u64 + u64::from(bytes.len() % 2 == 1)
        }
        _ => true,
    };
    if is_whole { Ok(()) } else { Err(DatasetError::CutShort { path: path.to_owned(), bytes: bytes.len() }) }
}

/// Whether a JPEG has the marker of its end. A decoder fills what is missing with grey.
fn jpeg_ends(bytes: &[u8]) -> bool {
    let mut at = 2;
    loop {
        // the next marker: in what is compressed, 0 follows each byte of a marker, and some only part it
        let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xd0..=0xd7 | 0xff);
        let Some(found) = bytes.get(at..).and_then(|rest| rest.windows(2).position(is_marker)) else { return false };
        at += found + 2;
        match (bytes[at - 1], bytes.get(at..at + 2)) {
            (0xd9, _) => return true,
            (0x01 | 0xd8, _) => {}
            (_, Some(&[high, low])) => at += usize::from(u16::from_be_bytes([high, low])).max(2),
            (_, _) => return false,
        }
    }
}

/// Decodes a PNG, JPEG or WebP, grey or coloured; 16 bits are rounded to 8. [`Alpha`] says what the alpha of the file means.
///
/// # Errors
/// The errors of [`decoded`].
pub(crate) fn decode(path: &Path, alpha: Alpha) -> Result<Picture> {
    Ok(alpha.applied(decoded(path)?))
}

/// The image in a file.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Decode`], [`DatasetError::PictureFormat`], [`DatasetError::CutShort`],
/// [`DatasetError::Damaged`].
pub(crate) fn decoded(path: &Path) -> Result<DynamicImage> {
    let bytes = read(path)?;
    check_format(path, &bytes)?;
    check_whole(path, &bytes)?;
    if let Some(reason) = jpeg::damage(&bytes) {
        return Err(DatasetError::Damaged { path: path.to_owned(), reason });
    }
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(unreadable(path))?;
    reader.decode().map_err(|source| undecodable(path, source))
}

fn undecodable(path: &Path, source: ImageError) -> DatasetError {
    DatasetError::Decode { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, ImageBuffer, Luma, Rgb, Rgba, RgbaImage};

    use super::*;
    use crate::fixtures::{assert_says, insert_segment};

    fn saved(name: &str, image: impl Into<DynamicImage>) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        image.into().save(&path).unwrap();
        (folder, path)
    }

    #[test]
    fn grey_and_sixteen_bit_images_become_three_bytes_per_pixel() {
        let (_folder, path) = saved("grey.png", GrayImage::from_fn(3, 2, |x, y| Luma([(x * 50 + y) as u8])));
        let picture = decode(&path, Alpha::Matte([0.0; 3])).unwrap();
        assert_eq!((picture.width, picture.height, &picture.alpha), (3, 2, &None));
        assert_eq!(picture.bytes[15..], [101; 3]);
        assert_eq!(
            header(&path).unwrap(),
            Header { width: 3, height: 2, has_alpha: false, is_deep: false, orientation: 1 }
        );

        let deep = ImageBuffer::from_fn(2, 2, |x, _| Rgb([(x * 257) as u16, 65535u16, 1000]));
        let (_folder, path) = saved("deep.png", DynamicImage::ImageRgb16(deep));
        assert_eq!(decode(&path, Alpha::Matte([0.0; 3])).unwrap().bytes[3..6], [1, 255, 4]);
        assert!(header(&path).unwrap().is_deep);
    }

    #[test]
    fn alpha_is_composited_in_float() {
        let (_folder, path) = saved("a.png", RgbaImage::from_fn(2, 1, |x, _| Rgba([200, 100, 0, 51 * x as u8])));
        let picture = decode(&path, Alpha::Matte([1.0, 0.5, 0.0])).unwrap();
        assert_eq!(picture.bytes[..3], [255, 128, 0]);
        // 0.2 · 200 + 0.8 · 255, 0.2 · 100 + 0.8 · 127.5, 0
        assert_eq!(picture.bytes[3..6], [244, 122, 0]);
        assert_eq!(picture.alpha.unwrap(), [0, 51]);
        assert!(header(&path).unwrap().has_alpha);
    }

    #[test]
    fn alpha_that_is_a_mask_leaves_colours_alone() {
        let alphas = [0, 127, 128, 255];
        let image = RgbaImage::from_fn(4, 1, |x, _| Rgba([200, 100, 0, alphas[x as usize]]));
        let (_folder, path) = saved("a.png", image);
        let picture = decode(&path, Alpha::Mask).unwrap();
        assert_eq!((picture.counted, picture.alpha.is_none()), (Some(vec![false, false, true, true]), true));
        assert_eq!(picture.bytes, [200, 100, 0].repeat(4));
        let (_folder, path) = saved("b.png", image::RgbImage::new(2, 2));
        assert_eq!(decode(&path, Alpha::Mask).unwrap().counted, None);
    }

    #[test]
    fn exif_orientation_is_said_and_ignored() {
        let (_folder, path) = saved("photo.jpg", image::RgbImage::from_fn(16, 8, |x, _| Rgb([(x * 15) as u8; 3])));
        insert_segment(&path, 0xe1, b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0");
        let picture = decode(&path, Alpha::Matte([0.0; 3])).unwrap();
        assert_eq!((picture.width, picture.height, header(&path).unwrap().orientation), (16, 8, 6));
        assert!(picture.rgb(15, 0)[0] > picture.rgb(0, 0)[0]);
    }

    #[test]
    fn a_header_behind_much_else_is_found() {
        let (_folder, path) = saved("photo.jpg", image::RgbImage::new(40, 24));
        (0..6).for_each(|_| insert_segment(&path, 0xfe, &[7; 0xffff - 2]));
        assert!(path.metadata().unwrap().len() > BEGINNING);
        assert_eq!(
            header(&path).unwrap(),
            Header { width: 40, height: 24, has_alpha: false, is_deep: false, orientation: 1 }
        );
    }

    #[test]
    fn downscaling_averages_fine_detail_instead_of_aliasing() {
        let stripes: Vec<u8> = (0..64 * 32).flat_map(|pixel| [(pixel % 2 * 255) as u8; 3]).collect();
        let picture = Picture { width: 64, height: 32, bytes: stripes, alpha: Some(vec![64; 64 * 32]), counted: None };
        let small = picture.downscaled(16, 8);
        assert_eq!((small.width, small.height, small.bytes.len()), (16, 8, 3 * 16 * 8));
        for y in 2..6 {
            for x in 2..14 {
                assert!((small.rgb(x, y)[0] - 0.5).abs() < 0.02, "{:?}", small.rgb(x, y));
            }
        }
        assert_eq!(small.alpha.unwrap(), [64; 16 * 8]);
    }

    #[test]
    fn pictures_of_other_formats_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        for (begin, format) in [
            (&b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"[..], "HDR"),
            (b"\x76\x2f\x31\x01\x02\0\0\0", "EXR"),
            (b"II*\0\x10\0\0\0CR", "TIFF"),
            (b"\0\0\0\x18ftypheic\0\0", "HEIC"),
            (b"", "it is empty"),
        ] {
            std::fs::write(&path, begin).unwrap();
            assert_says(decode(&path, Alpha::Mask).unwrap_err(), &["a.exr", format, "to JPEG or PNG"]);
            assert_says(header(&path).unwrap_err(), &["a.exr", format]);
        }
    }

    #[test]
    fn unreadable_images_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("broken.png");
        std::fs::write(&path, b"\x89PNG\r\n\x1a\nnothing else").unwrap();
        for error in [decode(&path, Alpha::Matte([0.0; 3])).unwrap_err(), header(&path).unwrap_err()] {
            assert_says(error, &["broken.png", "cut short"]);
        }
        std::fs::write(&path, b"no picture at all").unwrap();
        for error in [decode(&path, Alpha::Matte([0.0; 3])).unwrap_err(), header(&path).unwrap_err()] {
            assert_says(error, &["broken.png", "replace it"]);
        }
    }

    #[test]
    fn pictures_that_are_cut_short_are_refused_whatever_follows_whole_ones() {
        for (name, exif) in [("a.jpg", true), ("a.jpg", false), ("a.png", false), ("a.webp", false)] {
            let noise = |x: u32, y: u32| Rgb([1, 3, 7].map(|factor| (x * x * factor + y * y * 13 + x * y) as u8));
            let (_folder, path) = saved(name, image::RgbImage::from_fn(64, 48, noise));
            if exif {
                // a thumbnail with an end of its own
                insert_segment(&path, 0xe1, b"Exif\0\0\xff\xd8 thumbnail \xff\xd9");
            }
            let whole = std::fs::read(&path).unwrap();
            for share in [20, 50, 90, 99] {
                std::fs::write(&path, &whole[..whole.len() * share / 100]).unwrap();
                for error in [decode(&path, Alpha::Mask).unwrap_err(), header(&path).unwrap_err()] {
                    assert_says(error, &[name, "cut short", &(whole.len() * share / 100).to_string()]);
                }
            }
            std::fs::write(&path, [&whole[..], &[0; 200], b"a film of a phone"].concat()).unwrap();
            assert_eq!(header(&path).unwrap().width, 64);
            assert_eq!(decode(&path, Alpha::Mask).unwrap().height, 48);
        }
    }
}

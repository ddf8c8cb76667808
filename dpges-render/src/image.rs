//! Pictures with 8 bits per channel, as a PNG stores them.

/// Width of the line between pictures that stand side by side, px.
const SEPARATOR: usize = 2;

/// A picture of 8-bit red, green and blue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rgb8Image {
    /// px
    pub width: usize,
    /// px
    pub height: usize,
    /// [height, width, 3]
    pub bytes: Vec<u8>,
}

impl Rgb8Image {
    /// From `width` · `height` pixels, row by row.
    pub fn from_pixels(width: usize, height: usize, pixels: impl Iterator<Item = [u8; 3]>) -> Self {
        let bytes: Vec<u8> = pixels.flatten().collect();
        debug_assert_eq!(bytes.len(), 3 * width * height);
        Self { width, height, bytes }
    }

    /// From `planes` [3, height, width], clamped to [0, 1] and rounded as `dpges_train::metrics::quantised` rounds.
    pub fn from_planes(planes: &[f32], width: usize, height: usize) -> Self {
        let count = width * height;
        let pixels = (0..count).map(|pixel| std::array::from_fn(|channel| to_byte(planes[channel * count + pixel])));
        Self::from_pixels(width, height, pixels)
    }

    /// Joins pictures of the same height from left to right, with a thin white line between them.
    pub fn beside(images: &[Self]) -> Self {
        let height = images.iter().map(|image| image.height).min().unwrap_or(0);
        let separators = SEPARATOR * images.len().saturating_sub(1);
        let width = images.iter().map(|image| image.width).sum::<usize>() + separators;
        let row = |y: usize| {
            let parts = images.iter().map(|image| &image.bytes[3 * y * image.width..3 * (y + 1) * image.width]);
            parts.collect::<Vec<_>>().join(&[255; 3 * SEPARATOR][..])
        };
        Self { width, height, bytes: (0..height).flat_map(row).collect() }
    }

    /// Joins pictures of the same width from top to bottom, with a thin white line between them.
    pub fn below(images: &[Self]) -> Self {
        let width = images.iter().map(|image| image.width).min().unwrap_or(0);
        let separators = SEPARATOR * images.len().saturating_sub(1);
        let height = images.iter().map(|image| image.height).sum::<usize>() + separators;
        let rows = |image: &Self| {
            let rows = image.bytes.chunks_exact(3 * image.width.max(1)).map(|row| &row[..3 * width]);
            rows.collect::<Vec<_>>().concat()
        };
        let parts: Vec<Vec<u8>> = images.iter().map(rows).collect();
        Self { width, height, bytes: parts.join(&vec![255; 3 * SEPARATOR * width][..]) }
    }
}

pub(crate) fn to_byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0).round_ties_even() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_clamped_and_interleaved() {
        let image = Rgb8Image::from_planes(&[-1.0, 0.5, 1.0, 0.2, 7.0, 0.0], 2, 1);
        assert_eq!(image.bytes, [0, 255, 255, 128, 51, 0]);
    }

    #[test]
    fn pictures_stand_beside_each_other() {
        let one = Rgb8Image { width: 1, height: 2, bytes: vec![1, 2, 3, 4, 5, 6] };
        let two = Rgb8Image { width: 1, height: 2, bytes: vec![7; 6] };
        let both = Rgb8Image::beside(&[one, two]);
        assert_eq!((both.width, both.height), (4, 2));
        assert_eq!(both.bytes[..12], [1, 2, 3, 255, 255, 255, 255, 255, 255, 7, 7, 7]);
        assert_eq!(both.bytes[12..15], [4, 5, 6]);
        assert_eq!(Rgb8Image::beside(&[]).bytes.len(), 0);
    }

    #[test]
    fn pictures_stand_below_each_other() {
        let one = Rgb8Image { width: 2, height: 1, bytes: vec![1, 2, 3, 4, 5, 6] };
        let two = Rgb8Image { width: 2, height: 1, bytes: vec![7; 6] };
        let both = Rgb8Image::below(&[one, two]);
        assert_eq!((both.width, both.height), (2, 4));
        assert_eq!(both.bytes, [&[1, 2, 3, 4, 5, 6][..], &[255; 12], &[7; 6]].concat());
        assert_eq!(Rgb8Image::below(&[]).bytes.len(), 0);
    }
}

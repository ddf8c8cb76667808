//! A photograph in memory, 8 bits per value.

/// A pixel with at most this alpha shows the background rather than what is before it.
const TRANSPARENT: u8 = 127;

/// An image in display-referred values, as stored in the file; EXIF orientation is not applied, because
/// poses and intrinsics refer to the stored pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    /// Red, green and blue of every pixel, row by row, composited on the background.
    pub bytes: Vec<u8>,
    /// Coverage, of 255, [height × width]. `None` if the file has no alpha channel, or if that is a mask.
    pub alpha: Option<Vec<u8>>,
    /// Whether a pixel counts, [height × width]. `None` if all do.
    pub counted: Option<Vec<bool>>,
}

impl Picture {
    /// An opaque picture of `planes` [3, height, width], clamped to [0, 1] and rounded to 8 bits, halves to even numbers.
    pub fn from_planes(planes: &[f32], width: usize, height: usize) -> Self {
        let area = width * height;
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round_ties_even() as u8;
        let bytes = (0..area).flat_map(|pixel| [0, 1, 2].map(|channel| byte(planes[channel * area + pixel]))).collect();
        Self { width, height, bytes, alpha: None, counted: None }
    }

    /// Red, green and blue planes in 0..1, [3, height, width].
    pub fn planes(&self) -> Vec<f32> {
        let mut planes = Vec::with_capacity(self.bytes.len());
        for channel in 0..3 {
            planes.extend(self.bytes.iter().skip(channel).step_by(3).map(|&byte| unit(byte)));
        }
        planes
    }

    /// Number of pixels.
    pub fn area(&self) -> usize {
        self.width * self.height
    }

    /// Red, green and blue of the pixel in column `x`, row `y`, in 0..1.
    pub fn rgb(&self, x: usize, y: usize) -> [f32; 3] {
        self.colour(y * self.width + x)
    }

    /// Red, green and blue in 0..1 of a pixel, counted row by row.
    pub fn colour(&self, pixel: usize) -> [f32; 3] {
        std::array::from_fn(|channel| unit(self.bytes[3 * pixel + channel]))
    }

    /// Whether the pixel counts.
    pub fn counts(&self, pixel: usize) -> bool {
        self.counted.as_ref().is_none_or(|counted| counted[pixel])
    }

    /// Number of pixels that do not count.
    pub fn ignored_pixels(&self) -> usize {
        self.counted.as_ref().map_or(0, |counted| counted.iter().filter(|&&counts| !counts).count())
    }

    /// Whether the pixel shows the background rather than what is before it. This is unknown for a pixel that does not
    /// count.
    pub fn is_transparent(&self, pixel: usize) -> bool {
        self.alpha.as_ref().is_some_and(|alpha| alpha[pixel] <= TRANSPARENT) && self.counts(pixel)
    }

    /// Alpha in 0..1 of a pixel.
    pub fn alpha(&self, pixel: usize) -> f32 {
        self.alpha.as_ref().map_or(1.0, |alpha| unit(alpha[pixel]))
    }

    /// Sets `values` [height × width] to 0 where pixels do not count.
    pub fn clear_ignored<T: Default>(&self, values: &mut [T]) {
        if let Some(counted) = &self.counted {
            values.iter_mut().zip(counted).filter(|(_, counts)| !**counts).for_each(|(value, _)| *value = T::default());
        }
    }

    /// Lets only those of the pixels count that `counted` [height × width] counts.
    pub(crate) fn count_only(&mut self, counted: Vec<bool>) {
        match &mut self.counted {
            Some(own) => own.iter_mut().zip(counted).for_each(|(own, counts)| *own &= counts),
            None => self.counted = Some(counted),
        }
    }

    /// Size in memory, bytes.
    pub fn size_bytes(&self) -> usize {
        self.bytes.len() + self.alpha.as_ref().map_or(0, Vec::len) + self.counted.as_ref().map_or(0, Vec::len)
    }
}

/// The linear light of a display-referred value, both in 0..1: the inverse of the transfer function of sRGB.
pub(crate) fn linear(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

fn unit(byte: u8) -> f32 {
    f32::from(byte) / 255.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_are_the_bytes_in_units() {
        let picture =
            Picture { width: 2, height: 1, bytes: vec![0, 51, 255, 102, 204, 153], alpha: None, counted: None };
        let planes = picture.planes();
        assert_eq!(planes, [0.0, 102.0, 51.0, 204.0, 255.0, 153.0].map(|byte: f32| byte / 255.0));
        assert_eq!(Picture::from_planes(&planes, 2, 1), picture);
        assert_eq!((picture.colour(1), picture.rgb(1, 0)), ([0.4, 0.8, 0.6], [0.4, 0.8, 0.6]));
    }

    #[test]
    fn a_byte_more_per_pixel_for_alpha_and_for_a_mask() {
        let mut picture = Picture::from_planes(&[0.5; 12], 2, 2);
        assert_eq!((picture.size_bytes(), picture.alpha(3), picture.is_transparent(3)), (12, 1.0, false));
        picture.alpha = Some(vec![0, 127, 128, 255]);
        assert_eq!(picture.size_bytes(), 16);
        assert_eq!([0, 1, 2, 3].map(|pixel| picture.is_transparent(pixel)), [true, true, false, false]);
        picture.count_only(vec![false, true, true, true]);
        picture.count_only(vec![true, true, false, true]);
        assert_eq!((picture.size_bytes(), picture.ignored_pixels(), picture.is_transparent(0)), (20, 2, false));
        let mut values = [1.0; 4];
        picture.clear_ignored(&mut values);
        assert_eq!(values, [0.0, 1.0, 0.0, 1.0]);
    }
}

//! Horizontal bands of an image. Kernels that scatter sums over pixels to primitives keep separate sums for
//! each of a fixed number of bands and add them in order. The result then does not depend on the number of
//! threads.

use std::ops::Range;

/// Number of bands. Each costs one set of sums.
pub const BAND_COUNT: usize = 8;

/// The rows of an image in [`BAND_COUNT`] bands.
#[derive(Clone, Copy, Debug)]
pub struct Bands {
    height: usize,
}

impl Bands {
    pub fn new(height: usize) -> Self {
        Self { height }
    }

    /// Image rows of a band; may be empty.
    pub fn rows(&self, band: usize) -> Range<usize> {
        self.height * band / BAND_COUNT..self.height * (band + 1) / BAND_COUNT
    }

    /// Pixels of a band, as positions within a plane.
    pub fn pixels(&self, band: usize, width: usize) -> Range<usize> {
        let rows = self.rows(band);
        rows.start * width..rows.end * width
    }

    /// The part of every plane of a [P, H, W] image that belongs to each band: `[band][plane]`.
    pub fn split<'a, V>(&self, image: &'a mut [V], width: usize) -> Vec<Vec<&'a mut [V]>> {
        let mut bands: Vec<Vec<&mut [V]>> = (0..BAND_COUNT).map(|_| Vec::new()).collect();
        // chunks of length 0 panic, and an empty image has such planes
        for mut plane in image.chunks_mut((self.height * width).max(1)) {
            for (band, parts) in bands.iter_mut().enumerate() {
                let (part, rest) = plane.split_at_mut(self.rows(band).len() * width);
                parts.push(part);
                plane = rest;
            }
        }
        bands
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_tile_every_plane_in_order() {
        let mut image: Vec<usize> = (0..2 * 21 * 3).collect();
        let bands = Bands::new(21);
        let split = bands.split(&mut image, 3);
        for (band, planes) in split.iter().enumerate() {
            for (plane, part) in planes.iter().enumerate() {
                assert_eq!(part.to_vec(), bands.pixels(band, 3).map(|p| plane * 63 + p).collect::<Vec<_>>());
            }
        }
        assert_eq!((0..BAND_COUNT).map(|band| bands.rows(band).len()).sum::<usize>(), 21);
    }
}

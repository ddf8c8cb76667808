//! Numbers as pixels, and pixels as lossless WebP.

use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageFormat};

/// Width and height are multiples of this.
const BLOCK: usize = 4;
/// Alpha of quaternions whose first component is the largest; values below stand for no quaternion.
const LARGEST_IS_FIRST: u8 = 252;

/// A picture.
pub struct Pixels {
    pub width: usize,
    pixels: Vec<[u8; 4]>,
}

impl Pixels {
    /// A nearly square picture.
    pub fn of(pixels: impl ExactSizeIterator<Item = [u8; 4]>) -> Self {
        let width = (pixels.len() as f64).sqrt().ceil() as usize;
        let (width, count) = (width.next_multiple_of(BLOCK), pixels.len());
        let mut picture = Self::rows(pixels, width);
        picture.pixels.resize(width * count.div_ceil(width).next_multiple_of(BLOCK), [0; 4]);
        picture
    }

    /// Rows of `width` pixels.
    pub fn rows(pixels: impl ExactSizeIterator<Item = [u8; 4]>, width: usize) -> Self {
        let mut pixels: Vec<_> = pixels.collect();
        pixels.resize(pixels.len().next_multiple_of(width), [0; 4]);
        Self { width, pixels }
    }

    pub fn to_webp(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let [width, height] = [self.width, self.pixels.len() / self.width].map(|side| side as u32);
        WebPEncoder::new_lossless(&mut bytes)
            .encode(self.pixels.as_flattened(), width, height, ExtendedColorType::Rgba8)
            .expect("sides are within those of WebP, and memory takes all that is written");
        bytes
    }

    pub fn from_webp(bytes: &[u8], name: &str) -> Result<Self, String> {
        let picture = image::load_from_memory_with_format(bytes, ImageFormat::WebP);
        let picture = picture.map_err(|error| format!("`{name}` cannot be read as WebP ({error})"))?.into_rgba8();
        Ok(Self { width: picture.width() as usize, pixels: picture.as_raw().as_chunks::<4>().0.to_vec() })
    }

    /// The first `count`.
    pub fn take(mut self, count: usize, name: &str) -> Result<Vec<[u8; 4]>, String> {
        if self.pixels.len() < count {
            return Err(format!("`{name}` has {} pixels, expected {count}", self.pixels.len()));
        }
        self.pixels.truncate(count);
        Ok(self.pixels)
    }
}

/// Near 0 as it is, far away its logarithm.
pub fn squeeze(x: f32) -> f64 {
    f64::from(x).abs().ln_1p().copysign(x.into())
}

pub fn expand(squeezed: f64) -> f64 {
    squeezed.abs().exp_m1().copysign(squeezed)
}

/// An opacity, but not 0 or 1, whose logits are infinite.
pub fn to_byte(opacity: f32) -> u8 {
    (255.0 * opacity).round().clamp(1.0, 254.0) as u8
}

/// (w, x, y, z) as the three smaller components in this order, and which is the largest.
pub fn pack_quaternion(q: [f32; 4]) -> [u8; 4] {
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = f64::from(q[largest].signum());
    let byte = |i: usize| (255.0 * (0.5 + 0.5 * SQRT_2 * sign * f64::from(q[i]))).round().clamp(0.0, 255.0) as u8;
    let [a, b, c] = others(largest).map(byte);
    [a, b, c, LARGEST_IS_FIRST + largest as u8]
}

/// No rotation where it is no quaternion.
pub fn unpack_quaternion([a, b, c, alpha]: [u8; 4]) -> [f32; 4] {
    let Some(largest) = alpha.checked_sub(LARGEST_IS_FIRST).map(usize::from) else { return [1.0, 0.0, 0.0, 0.0] };
    let (mut q, mut left) = ([0.0; 4], 1.0);
    for (i, byte) in others(largest).into_iter().zip([a, b, c]) {
        let component = (f64::from(byte) / 127.5 - 1.0) * FRAC_1_SQRT_2;
        q[i] = component as f32;
        left -= component * component;
    }
    q[largest] = left.max(0.0).sqrt() as f32;
    // three bytes at their bounds are longer than 1
    let length = q.iter().map(|component| component * component).sum::<f32>().sqrt();
    q.map(|component| component / length)
}

fn others(largest: usize) -> [usize; 3] {
    [0, 1, 2].map(|at| if at < largest { at } else { at + 1 })
}

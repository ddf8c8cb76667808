//! Makes 8-bit pictures smaller: the Catmull-Rom filter of [`image::imageops::resize`], to the bit, in less time and without
//! a picture of floats in between.

/// Reach of the filter, px of the smaller picture.
const REACH: f32 = 2.0;
/// Values of a row that are summed together, so that their sums stay in the cache nearest to the processor.
const BLOCK: usize = 2048;

/// The pixels of a line that a pixel of a shorter line is made of.
struct Tap {
    first: usize,
    /// Their sum is 1.
    weights: Vec<f32>,
}

/// `samples` [rows × columns × C] of size `from`, made smaller to size `to` (columns and rows).
pub(super) fn downscaled<const C: usize>(samples: &[u8], from: [usize; 2], to: [usize; 2]) -> Vec<u8> {
    let [columns, rows] = [0, 1].map(|axis| taps(from[axis], to[axis]));
    let mut small = Vec::with_capacity(C * to[0] * to[1]);
    let mut row = vec![0.0; C * from[0]];
    for tap in &rows {
        sum_rows(&mut row, samples, tap);
        let pixels = row.as_chunks::<C>().0;
        for Tap { first, weights } in &columns {
            let mut sums = [0.0f32; C];
            for (pixel, weight) in pixels[*first..].iter().zip(weights) {
                sums.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += value * weight);
            }
            small.extend(sums.map(rounded));
        }
    }
    small
}

/// Sets `row` to the weighted sum of those rows of `samples` that `tap` names.
fn sum_rows(row: &mut [f32], samples: &[u8], tap: &Tap) {
    let width = row.len();
    for (block, sums) in row.chunks_mut(BLOCK).enumerate() {
        sums.fill(0.0);
        for (at, weight) in (tap.first..).zip(&tap.weights) {
            let samples = &samples[at * width + block * BLOCK..];
            sums.iter_mut().zip(samples).for_each(|(sum, &sample)| *sum += f32::from(sample) * weight);
        }
    }
}

fn taps(from: usize, to: usize) -> Vec<Tap> {
    let ratio = from as f32 / to as f32;
    let stretch = ratio.max(1.0);
    let tap = |(at, [first, end]): (usize, [usize; 2])| {
        let centre = (at as f32 + 0.5) * ratio - 0.5;
        let mut weights: Vec<f32> = (first..end).map(|pixel| catmull_rom((pixel as f32 - centre) / stretch)).collect();
        let sum = weights.iter().fold(0.0, |sum, weight| sum + weight);
        weights.iter_mut().for_each(|weight| *weight /= sum);
        Tap { first, weights }
    };
    reaches(from, to).into_iter().enumerate().map(tap).collect()
}

/// For each of `to` pixels in a row, the range of `from` pixels that it is made of.
pub(super) fn reaches(from: usize, to: usize) -> Vec<[usize; 2]> {
    let ratio = from as f32 / to as f32;
    let reach = REACH * ratio.max(1.0);
    let of = |at: usize| {
        let centre = (at as f32 + 0.5) * ratio;
        let left = ((centre - reach).floor().max(0.0) as usize).min(from - 1);
        [left, ((centre + reach).ceil() as usize).clamp(left + 1, from)]
    };
    (0..to).map(of).collect()
}

/// `counted` [height × width] of a picture of size `from` made smaller, to size `to` (widths and heights, px). A pixel
/// counts if all pixels within reach of its filter do: what does not count has no part in the colour of what does.
pub(super) fn downscaled_mask(counted: &[bool], from: [usize; 2], to: [usize; 2]) -> Vec<bool> {
    let [columns, rows] = [0, 1].map(|axis| reaches(from[axis], to[axis]));
    let mut tall = Vec::with_capacity(from[0] * to[1]);
    for [top, bottom] in rows {
        let counts = |column: usize| (top..bottom).all(|row| counted[row * from[0] + column]);
        tall.extend((0..from[0]).map(counts));
    }
    let mut small = Vec::with_capacity(to[0] * to[1]);
    for row in tall.chunks_exact(from[0]) {
        small.extend(columns.iter().map(|&[left, right]| row[left..right].iter().all(|&counts| counts)));
    }
    small
}

/// Six times the cubic, then a sixth of it: the order in which the crate `image` rounds.
fn catmull_rom(x: f32) -> f32 {
    let x = x.abs();
    let (squared, cubed) = (x.powi(2), x.powi(3));
    let six = match x {
        ..1.0 => 9.0 * cubed + -15.0 * squared + 6.0,
        1.0..2.0 => -3.0 * cubed + 15.0 * squared + -24.0 * x + 12.0,
        _ => 0.0,
    };
    six / 6.0
}

/// Rounds to the nearest of 0..=255, halves up.
fn rounded(value: f32) -> u8 {
    let value = value.clamp(0.0, 255.0);
    let whole = value as u8;
    whole + u8::from(value - f32::from(whole) >= 0.5)
}

#[cfg(test)]
mod tests {
    use image::imageops::{self, FilterType};
    use image::{ImageBuffer, Luma, Pixel, Rgb};

    use super::*;

    /// The result of the crate `image`.
    fn expected<P: Pixel<Subpixel = u8> + 'static>(samples: &[u8], from: [usize; 2], to: [usize; 2]) -> Vec<u8> {
        let [width, height, to_width, to_height] = [from[0], from[1], to[0], to[1]].map(|side| side as u32);
        let picture = ImageBuffer::<P, _>::from_raw(width, height, samples.to_vec()).unwrap();
        imageops::resize(&picture, to_width, to_height, FilterType::CatmullRom).into_raw()
    }

    /// Noise, edges and flat parts.
    fn samples(count: usize) -> Vec<u8> {
        let hash = |at: usize| ((at as u32).wrapping_mul(2_654_435_761) >> 13) as u8;
        (0..count).map(|at| if at / 97 % 3 == 0 { (at / 5 % 2 * 255) as u8 } else { hash(at) }).collect()
    }

    #[test]
    fn pictures_are_those_of_the_crate_image_to_the_bit() {
        let sizes = [
            ([64, 32], [16, 8]),
            ([37, 53], [12, 17]),
            ([40, 30], [39, 30]),
            ([9, 5], [1, 1]),
            ([700, 5], [699, 4]),
            ([1300, 21], [411, 7]),
            ([3, 2000], [2, 801]),
        ];
        for (from, to) in sizes {
            let samples = samples(3 * from[0] * from[1]);
            assert!(
                downscaled::<3>(&samples, from, to) == expected::<Rgb<u8>>(&samples, from, to),
                "{from:?} to {to:?}"
            );
            let grey = &samples[..from[0] * from[1]];
            assert!(downscaled::<1>(grey, from, to) == expected::<Luma<u8>>(grey, from, to), "{from:?} to {to:?}");
        }
    }

    #[test]
    fn halves_are_rounded_up_and_values_stay_in_range() {
        let values = [-3.0, 0.0, 0.499_999_97, 0.5, 1.499_999_9, 1.5, 254.5, 255.0, 300.0];
        assert_eq!(values.map(rounded), [0, 0, 0, 1, 1, 2, 255, 255, 255]);
    }
}

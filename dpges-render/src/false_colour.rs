//! Depth, normals, transmittance and error as colours.

use crate::image::{Rgb8Image, to_byte};
use crate::percentile::{DEPTH_PERCENTILES, percentiles};

/// Viridis at eighths: equal steps look equally large, in grey and to colour-blind people too.
const RAMP: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 45, 123],
    [59, 82, 139],
    [44, 114, 142],
    [33, 145, 140],
    [40, 174, 128],
    [94, 201, 98],
    [173, 220, 48],
    [253, 231, 37],
];
/// Smallest coverage of a pixel with a meaningful depth.
const MIN_COVERAGE: f32 = 0.1;
/// Mean absolute difference per channel at the end of the ramp of [`error`], as a share of full scale.
pub const LARGEST_ERROR: f32 = 0.25;

/// Colour of `value`, dark blue at 0 to yellow at 1. Values outside take the colour of the nearer end.
pub fn ramp(value: f32) -> [u8; 3] {
    let position = value.clamp(0.0, 1.0) * (RAMP.len() - 1) as f32;
    let below = (position as usize).min(RAMP.len() - 2);
    let share = position - below as f32;
    std::array::from_fn(|channel| {
        let (from, to) = (f32::from(RAMP[below][channel]), f32::from(RAMP[below + 1][channel]));
        (from + share * (to - from)).round() as u8
    })
}

/// A picture of `values` [height, width] in shades of grey: 0 is black, 1 is white.
pub fn grey(values: &[f32], width: usize, height: usize) -> Rgb8Image {
    Rgb8Image::from_pixels(width, height, values.iter().map(|&value| [to_byte(value); 3]))
}

/// A picture of depth on the [`ramp`], and the depths at the ends of the ramp, world units: the 2nd and 98th
/// percentile, or `None` if nothing is covered. Near is dark. Pixels of which surfels cover less than a tenth are
/// black.
///
/// `depth` [height, width] is blended; `coverage` [height, width] is the sum of its weights.
pub fn depth(depth: &[f32], coverage: &[f32], width: usize, height: usize) -> (Rgb8Image, Option<[f32; 2]>) {
    let mean = |(&depth, &coverage): (&f32, &f32)| (coverage >= MIN_COVERAGE).then(|| depth / coverage);
    let depths: Vec<Option<f32>> = depth.iter().zip(coverage).map(mean).collect();
    let covered = depths.iter().flatten().map(|&depth| f64::from(depth)).collect();
    let range = percentiles(covered, DEPTH_PERCENTILES).map(|range| range.map(|depth| depth as f32));
    let [near, far] = range.unwrap_or_default();
    let span = (far - near).max(f32::MIN_POSITIVE);
    let pixels = depths.iter().map(|depth| depth.map_or([0; 3], |depth| ramp((depth - near) / span)));
    (Rgb8Image::from_pixels(width, height, pixels), range)
}

/// A picture of normals, `planes` [3, height, width]: x, y, z from −1 to 1 as red, green, blue. Grey: no normal.
pub fn normal(planes: &[f32], width: usize, height: usize) -> Rgb8Image {
    let planes: Vec<f32> = planes.iter().map(|value| 0.5 + 0.5 * value).collect();
    Rgb8Image::from_planes(&planes, width, height)
}

/// A picture of the mean absolute difference of two pictures of the same size, on the [`ramp`], which ends at a quarter
/// of full scale.
pub fn error(found: &Rgb8Image, expected: &Rgb8Image) -> Rgb8Image {
    let difference = |(a, b): (&[u8], &[u8])| {
        let sum: u32 = a.iter().zip(b).map(|(&a, &b)| u32::from(a.abs_diff(b))).sum();
        ramp(sum as f32 / (3.0 * 255.0 * LARGEST_ERROR))
    };
    let pixels = found.bytes.chunks_exact(3).zip(expected.bytes.chunks_exact(3)).map(difference);
    Rgb8Image::from_pixels(found.width, found.height, pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ramp_gets_lighter_and_keeps_its_ends() {
        assert_eq!((ramp(-1.0), ramp(0.0), ramp(1.0), ramp(9.0)), (RAMP[0], RAMP[0], RAMP[8], RAMP[8]));
        assert_eq!(ramp(0.5), RAMP[4]);
        let light = |value: f32| {
            let [r, g, b] = ramp(value).map(f32::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        assert!((0..100).all(|i| light(i as f32 / 100.0) < light((i + 1) as f32 / 100.0)));
    }

    #[test]
    fn depth_is_divided_by_coverage_and_black_where_nothing_is() {
        let (image, range) = depth(&[1.0, 1.0, 0.0, 3.0], &[1.0, 0.5, 0.0, 1.0], 4, 1);
        assert_eq!(range, Some([1.0, 3.0]));
        assert_eq!(image.bytes[..3], RAMP[0]);
        assert_eq!(image.bytes[3..6], RAMP[4]);
        assert_eq!(image.bytes[6..9], [0, 0, 0]);
        assert_eq!(image.bytes[9..], RAMP[8]);
        assert_eq!(depth(&[0.0], &[0.0], 1, 1).1, None);
    }

    #[test]
    fn equal_pictures_have_no_error() {
        let image = grey(&[0.0, 1.0], 2, 1);
        assert_eq!(error(&image, &image).bytes[..3], RAMP[0]);
        assert_eq!(error(&image, &grey(&[1.0, 1.0], 2, 1)).bytes[..3], RAMP[8]);
        assert_eq!(normal(&[1.0, 0.0, -1.0], 1, 1).bytes, [255, 128, 0]);
    }
}

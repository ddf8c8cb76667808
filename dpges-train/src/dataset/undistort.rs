//! Resamples photographs with radial and tangential distortion for a pinhole camera, which the renderer can fit.
//!
//! As COLMAP's `image_undistorter` with `blank_pixels` = 0, the pinhole camera is chosen so that every one of its
//! pixels lies on the photograph. COLMAP keeps the focal length and changes the size of the picture; here
//! size and principal point are kept and both focal lengths are multiplied by one zoom, so that sizes agree
//! with the files.

use super::Picture;
use super::lens::{Distortion, Lens};

/// Range of zooms. Outside, the pinhole picture would show a small part of the photograph, or blur it.
const ZOOM_RANGE: [f64; 2] = [0.5, 2.0];

/// The widest pinhole lens whose pixels all lie on the photograph; `None` if no zoom in [½, 2] achieves that.
pub(super) fn pinhole(lens: &Lens) -> Option<Lens> {
    if lens.distortion.is_zero() {
        return Some(*lens);
    }
    let zoomed =
        |zoom: f64| Lens { fx: lens.fx * zoom, fy: lens.fy * zoom, distortion: Distortion::default(), ..*lens };
    let [mut low, mut high] = ZOOM_RANGE;
    if !covers(lens, &zoomed(high)) {
        return None;
    }
    if covers(lens, &zoomed(low)) {
        return Some(zoomed(low));
    }
    for _ in 0..48 {
        let middle = 0.5 * (low + high);
        if covers(lens, &zoomed(middle)) { high = middle } else { low = middle }
    }
    Some(zoomed(high))
}

/// The `photograph`, taken through `lens`, resampled bilinearly for `pinhole` and rounded to 8 bits.
pub(super) fn resample(photograph: &Picture, lens: &Lens, pinhole: &Lens) -> Picture {
    let (width, height) = (photograph.width, photograph.height);
    let pixels = width * height;
    let mut bytes = Vec::with_capacity(3 * pixels);
    let mut alpha = photograph.alpha.as_ref().map(|_| Vec::with_capacity(pixels));
    let mut counted = photograph.counted.as_ref().map(|_| Vec::with_capacity(pixels));
    for pixel in 0..pixels {
        let (u, v) = source_position(lens, pinhole, (pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
        let tap = Bilinear::new(u, v, width, height);
        bytes.extend([0, 1, 2].map(|channel| tap.sample(|pixel| photograph.bytes[3 * pixel + channel])));
        if let (Some(to), Some(from)) = (&mut alpha, &photograph.alpha) {
            to.push(tap.sample(|pixel| from[pixel]));
        }
        if let (Some(to), Some(from)) = (&mut counted, &photograph.counted) {
            to.push(tap.counts(from));
        }
    }
    Picture { width, height, bytes, alpha, counted }
}

/// Position on the photograph, px, of the position (x, y), px, of the pinhole picture.
pub(super) fn source_position(lens: &Lens, pinhole: &Lens, x: f64, y: f64) -> (f64, f64) {
    let (x, y) = lens.distortion.apply((x - pinhole.cx) / pinhole.fx, (y - pinhole.cy) / pinhole.fy);
    (lens.fx * x + lens.cx, lens.fy * y + lens.cy)
}

/// Whether all pixels of `pinhole` fall between pixel centres of the photograph, on the side of the distortion's
/// fold where it is one to one. Its border pixels decide.
fn covers(lens: &Lens, pinhole: &Lens) -> bool {
    const SLACK_PX: f64 = 1e-9;
    let (width, height) = (lens.width as f64, lens.height as f64);
    let inside = |x: f64, y: f64| {
        let (u, v) = source_position(lens, pinhole, x, y);
        let (u_dx, v_dx) = source_position(lens, pinhole, x + 1e-3, y);
        let (u_dy, v_dy) = source_position(lens, pinhole, x, y + 1e-3);
        let within = |value: f64, size: f64| (0.5 - SLACK_PX..=size - 0.5 + SLACK_PX).contains(&value);
        within(u, width) && within(v, height) && (u_dx - u) * (v_dy - v) - (u_dy - u) * (v_dx - v) > 0.0
    };
    let columns = (0..lens.width).map(|i| i as f64 + 0.5);
    let rows = (0..lens.height).map(|j| j as f64 + 0.5);
    columns.clone().all(|x| inside(x, 0.5) && inside(x, height - 0.5))
        && rows.clone().all(|y| inside(0.5, y) && inside(width - 0.5, y))
}

/// The four pixels around a position and their weights.
struct Bilinear {
    indices: [usize; 4],
    weights: [f32; 4],
}

impl Bilinear {
    fn new(u: f64, v: f64, width: usize, height: usize) -> Self {
        let axis = |position: f64, size: usize| {
            let clamped = (position - 0.5).clamp(0.0, (size - 1) as f64);
            let first = clamped as usize;
            (first, (first + 1).min(size - 1), (clamped - first as f64) as f32)
        };
        let (x0, x1, wx) = axis(u, width);
        let (y0, y1, wy) = axis(v, height);
        Self {
            indices: [y0 * width + x0, y0 * width + x1, y1 * width + x0, y1 * width + x1],
            weights: [(1.0 - wx) * (1.0 - wy), wx * (1.0 - wy), (1.0 - wx) * wy, wx * wy],
        }
    }

    fn sample(&self, of_pixel: impl Fn(usize) -> u8) -> u8 {
        let sum: f32 = self.indices.iter().zip(self.weights).map(|(&i, weight)| f32::from(of_pixel(i)) * weight).sum();
        sum.round() as u8
    }

    /// Whether all pixels that have a part in the sample count.
    fn counts(&self, counted: &[bool]) -> bool {
        self.indices.iter().zip(self.weights).all(|(&index, weight)| counted[index] || weight == 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(numerator: [f64; 4], tangential: [f64; 2]) -> Lens {
        let distortion = Distortion { numerator, tangential, ..Default::default() };
        Lens { width: 160, height: 120, fx: 130.0, fy: 128.0, cx: 77.0, cy: 63.5, distortion }
    }

    /// A smooth pattern over directions (x, y, 1); the same from every camera at one place.
    fn pattern(channel: usize, x: f64, y: f64) -> f32 {
        (0.5 + 0.4 * (x * (7.0 + channel as f64)).sin() * (y * 9.0 + 0.3).cos()) as f32
    }

    fn invert(distortion: &Distortion, x: f64, y: f64) -> (f64, f64) {
        let (mut a, mut b) = (x, y);
        for _ in 0..100 {
            let (dx, dy) = distortion.apply(a, b);
            (a, b) = (a + x - dx, b + y - dy);
        }
        (a, b)
    }

    fn photograph(lens: &Lens) -> Picture {
        let planes: Vec<f32> = (0..3 * lens.width * lens.height)
            .map(|i| {
                let pixel = i % (lens.width * lens.height);
                let u = (pixel % lens.width) as f64 + 0.5;
                let v = (pixel / lens.width) as f64 + 0.5;
                let (x, y) = invert(&lens.distortion, (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy);
                pattern(i / (lens.width * lens.height), x, y)
            })
            .collect();
        let alpha = Some(vec![255; lens.width * lens.height]);
        Picture { alpha, ..Picture::from_planes(&planes, lens.width, lens.height) }
    }

    #[test]
    fn a_distorted_pattern_is_straightened() {
        for lens in [lens([0.06, -0.08, 0.0, 0.0], [0.002, -0.003]), lens([-0.12, 0.02, 0.0, 0.0], [0.0, 0.001])] {
            let pinhole = pinhole(&lens).unwrap();
            let picture = resample(&photograph(&lens), &lens, &pinhole);
            let pixels = lens.width * lens.height;
            let mut worst = 0f32;
            let planes = picture.planes();
            for i in 0..3 * pixels {
                let x = ((i % pixels % lens.width) as f64 + 0.5 - pinhole.cx) / pinhole.fx;
                let y = ((i % pixels / lens.width) as f64 + 0.5 - pinhole.cy) / pinhole.fy;
                worst = worst.max((planes[i] - pattern(i / pixels, x, y)).abs());
            }
            // rounded to steps of 1/255 twice
            assert!(worst < 2e-3 + 1.01 / 255.0, "{worst}");
            assert!(picture.alpha.unwrap().iter().all(|&alpha| alpha == 255));
        }
    }

    #[test]
    fn what_does_not_count_has_no_part_in_what_does() {
        let lens = lens([0.06, -0.08, 0.0, 0.0], [0.002, -0.003]);
        let pinhole = pinhole(&lens).unwrap();
        let pixels = lens.width * lens.height;
        let is_counted = |pixel: usize| pixel % lens.width < 70 || pixel / lens.width > 40;
        let mut clean = photograph(&lens);
        clean.counted = Some((0..pixels).map(is_counted).collect());
        let mut overpainted = clean.clone();
        (0..pixels).filter(|&pixel| !is_counted(pixel)).for_each(|pixel| overpainted.bytes[3 * pixel] ^= 0x80);
        let [clean, overpainted] = [clean, overpainted].map(|picture| resample(&picture, &lens, &pinhole));
        let counted = clean.counted.clone().unwrap();
        let count = counted.iter().filter(|&&counts| counts).count();
        assert!((pixels / 3..pixels).contains(&count), "{count} of {pixels}");
        for pixel in (0..pixels).filter(|&pixel| counted[pixel]) {
            assert_eq!(clean.colour(pixel), overpainted.colour(pixel), "pixel {pixel}");
        }
        assert!(clean.bytes != overpainted.bytes);
    }

    #[test]
    fn the_zoom_is_the_smallest_that_leaves_no_blank_pixel() {
        let pincushion = lens([0.1, 0.0, 0.0, 0.0], [0.0, 0.0]);
        let barrel = lens([-0.1, 0.0, 0.0, 0.0], [0.0, 0.0]);
        assert!(pinhole(&pincushion).unwrap().fx > pincushion.fx);
        assert!(pinhole(&barrel).unwrap().fx < barrel.fx);
        for lens in [pincushion, barrel] {
            let pinhole = pinhole(&lens).unwrap();
            assert!((pinhole.fx / lens.fx - pinhole.fy / lens.fy).abs() < 1e-12);
            assert_eq!((pinhole.cx, pinhole.cy), (lens.cx, lens.cy));
            let wider = Lens { fx: pinhole.fx * 0.999, fy: pinhole.fy * 0.999, ..pinhole };
            assert!(covers(&lens, &pinhole) && !covers(&lens, &wider));
        }
    }

    #[test]
    fn tiny_distortion_changes_nothing_and_absurd_distortion_is_refused() {
        let tiny = lens([1e-9, 0.0, 0.0, 0.0], [0.0, 0.0]);
        assert!((pinhole(&tiny).unwrap().fx / tiny.fx - 1.0).abs() < 1e-6);
        let photograph = photograph(&tiny);
        let picture = resample(&photograph, &tiny, &pinhole(&tiny).unwrap());
        assert!(photograph.bytes.iter().zip(&picture.bytes).all(|(a, b)| a.abs_diff(*b) <= 1));
        assert!(pinhole(&lens([40.0, 0.0, 0.0, 0.0], [0.0, 0.0])).is_none());
    }
}

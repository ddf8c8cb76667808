//! Resamples photographs taken through a lens for a pinhole camera.
//!
//! As COLMAP's `image_undistorter` with `blank_pixels` = 0, the pinhole camera is chosen so that every one of its
//! pixels lies on the photograph. COLMAP keeps the focal length and changes the size of the picture; here
//! size and principal point are kept and both focal lengths are multiplied by one zoom, so that sizes agree
//! with the files. This keeps only the middle of a fisheye photograph.

use dpges_core::camera::{Camera, Projection};

use crate::Picture;

/// Range of zooms. Outside, the pinhole picture would show a small part of the photograph, or blur it.
const ZOOM_RANGE: [f64; 2] = [0.5, 2.0];

/// The widest pinhole camera whose pixels all lie on the photograph of `camera`; `None` if no zoom in [½, 2] achieves that.
pub(crate) fn pinhole(camera: &Camera) -> Option<Camera> {
    if camera.lens.is_none() {
        return Some(*camera);
    }
    let zoomed = |zoom: f64| Camera { fx: camera.fx * zoom, fy: camera.fy * zoom, lens: None, ..*camera };
    let [mut low, mut high] = ZOOM_RANGE;
    if !covers(camera, &zoomed(high)) {
        return None;
    }
    if covers(camera, &zoomed(low)) {
        return Some(zoomed(low));
    }
    for _ in 0..48 {
        let middle = 0.5 * (low + high);
        if covers(camera, &zoomed(middle)) { high = middle } else { low = middle }
    }
    Some(zoomed(high))
}

/// The `photograph`, taken by `camera`, resampled bilinearly for `pinhole` and rounded to 8 bits.
pub(crate) fn resample(photograph: &Picture, camera: &Camera, pinhole: &Camera) -> Picture {
    let (width, height) = (photograph.width, photograph.height);
    let pixels = width * height;
    let mut bytes = Vec::with_capacity(3 * pixels);
    let mut alpha = photograph.alpha.as_ref().map(|_| Vec::with_capacity(pixels));
    let mut counted = photograph.counted.as_ref().map(|_| Vec::with_capacity(pixels));
    for pixel in 0..pixels {
        let (u, v) = source_position(camera, pinhole, (pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
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

/// Position on the photograph, px, of the position (x, y), px, of the pinhole picture; NaN where the lens does not see.
pub(crate) fn source_position(camera: &Camera, pinhole: &Camera, x: f64, y: f64) -> (f64, f64) {
    let (a, b) = ((x - pinhole.cx) / pinhole.fx, (y - pinhole.cy) / pinhole.fy);
    let [x, y] = match &camera.lens {
        None => [a, b],
        Some(lens) if lens.distortion().projection == Projection::Perspective => lens.distortion().apply(a, b),
        Some(lens) => lens.position([a, b, 1.0]).unwrap_or([f64::NAN; 2]),
    };
    (camera.fx * x + camera.cx, camera.fy * y + camera.cy)
}

/// Whether all pixels of `pinhole` fall between pixel centres of the photograph, on the side of the distortion's
/// fold where it is one to one. Its border pixels decide.
fn covers(camera: &Camera, pinhole: &Camera) -> bool {
    const SLACK_PX: f64 = 1e-9;
    let (width, height) = (camera.width as f64, camera.height as f64);
    let inside = |x: f64, y: f64| {
        let (u, v) = source_position(camera, pinhole, x, y);
        let (u_dx, v_dx) = source_position(camera, pinhole, x + 1e-3, y);
        let (u_dy, v_dy) = source_position(camera, pinhole, x, y + 1e-3);
        let within = |value: f64, size: f64| (0.5 - SLACK_PX..=size - 0.5 + SLACK_PX).contains(&value);
        within(u, width) && within(v, height) && (u_dx - u) * (v_dy - v) - (u_dy - u) * (v_dx - v) > 0.0
    };
    let columns = (0..camera.width).map(|i| i as f64 + 0.5);
    let rows = (0..camera.height).map(|j| j as f64 + 0.5);
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
    use dpges_core::camera::{CameraFromWorld, Distortion, Lens};
    use glam::{DMat3, DVec3};

    use super::*;

    fn behind(projection: Projection, [k1, k2]: [f64; 2], tangential: [f64; 2]) -> Camera {
        let numerator = [k1, k2, 0.0, 0.0, 0.0, 0.0];
        let lens = Some(Lens::new(Distortion { numerator, tangential, ..Distortion::new(projection) }));
        let camera_from_world = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
        let (fx, fy, cx, cy) = (130.0, 128.0, 77.0, 63.5);
        Camera { camera_from_world, fx, fy, cx, cy, width: 160, height: 120, near: 0.01, lens }
    }

    fn camera(radial: [f64; 2], tangential: [f64; 2]) -> Camera {
        behind(Projection::Perspective, radial, tangential)
    }

    fn fisheye() -> Camera {
        behind(Projection::Equidistant, [0.03, -0.01], [0.0; 2])
    }

    /// A smooth pattern over directions (x, y, 1); the same from every camera at one place.
    fn pattern(channel: usize, x: f64, y: f64) -> f32 {
        (0.5 + 0.4 * (x * (7.0 + channel as f64)).sin() * (y * 9.0 + 0.3).cos()) as f32
    }

    fn photograph(camera: &Camera) -> Picture {
        let pixels = camera.width * camera.height;
        let planes: Vec<f32> = (0..3 * pixels)
            .map(|i| {
                let (x, y) = ((i % pixels % camera.width) as f64 + 0.5, (i % pixels / camera.width) as f64 + 0.5);
                let ray = camera.ray(x, y).unwrap();
                pattern(i / pixels, ray.x / ray.z, ray.y / ray.z)
            })
            .collect();
        let alpha = Some(vec![255; pixels]);
        Picture { alpha, ..Picture::from_planes(&planes, camera.width, camera.height) }
    }

    #[test]
    fn a_distorted_pattern_is_straightened() {
        let cameras = [camera([0.06, -0.08], [0.002, -0.003]), camera([-0.12, 0.02], [0.0, 0.001]), fisheye()];
        for camera in cameras {
            let pinhole = pinhole(&camera).unwrap();
            let picture = resample(&photograph(&camera), &camera, &pinhole);
            let pixels = camera.width * camera.height;
            let mut worst = 0f32;
            for (i, value) in picture.planes().into_iter().enumerate() {
                let x = ((i % pixels % camera.width) as f64 + 0.5 - pinhole.cx) / pinhole.fx;
                let y = ((i % pixels / camera.width) as f64 + 0.5 - pinhole.cy) / pinhole.fy;
                worst = worst.max((value - pattern(i / pixels, x, y)).abs());
            }
            // rounded to steps of 1/255 twice
            assert!(worst < 2e-3 + 1.01 / 255.0, "{worst}");
            assert!(picture.alpha.unwrap().iter().all(|&alpha| alpha == 255));
        }
    }

    #[test]
    fn what_does_not_count_has_no_part_in_what_does() {
        let camera = camera([0.06, -0.08], [0.002, -0.003]);
        let pinhole = pinhole(&camera).unwrap();
        let pixels = camera.width * camera.height;
        let is_counted = |pixel: usize| pixel % camera.width < 70 || pixel / camera.width > 40;
        let mut clean = photograph(&camera);
        clean.counted = Some((0..pixels).map(is_counted).collect());
        let mut overpainted = clean.clone();
        (0..pixels).filter(|&pixel| !is_counted(pixel)).for_each(|pixel| overpainted.bytes[3 * pixel] ^= 0x80);
        let [clean, overpainted] = [clean, overpainted].map(|picture| resample(&picture, &camera, &pinhole));
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
        let pincushion = camera([0.1, 0.0], [0.0; 2]);
        let barrel = camera([-0.1, 0.0], [0.0, 0.0]);
        assert!(pinhole(&pincushion).unwrap().fx > pincushion.fx);
        assert!(pinhole(&barrel).unwrap().fx < barrel.fx && pinhole(&fisheye()).unwrap().fx < fisheye().fx);
        for camera in [pincushion, barrel, fisheye()] {
            let pinhole = pinhole(&camera).unwrap();
            assert!((pinhole.fx / camera.fx - pinhole.fy / camera.fy).abs() < 1e-12);
            assert_eq!((pinhole.cx, pinhole.cy, pinhole.lens), (camera.cx, camera.cy, None));
            let wider = Camera { fx: pinhole.fx * 0.999, fy: pinhole.fy * 0.999, ..pinhole };
            assert!(covers(&camera, &pinhole) && !covers(&camera, &wider));
        }
    }

    #[test]
    fn tiny_distortion_changes_nothing_and_absurd_distortion_is_refused() {
        let tiny = camera([1e-9, 0.0], [0.0, 0.0]);
        assert!((pinhole(&tiny).unwrap().fx / tiny.fx - 1.0).abs() < 1e-6);
        let photograph = photograph(&tiny);
        let picture = resample(&photograph, &tiny, &pinhole(&tiny).unwrap());
        assert!(photograph.bytes.iter().zip(&picture.bytes).all(|(a, b)| a.abs_diff(*b) <= 1));
        assert!(pinhole(&camera([40.0, 0.0], [0.0, 0.0])).is_none());
    }
}

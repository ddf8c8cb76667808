//! Lenses whose radius is no polynomial of the angle, as polynomials that are as good.

use dpges_core::camera::{Distortion, Projection};
use nalgebra::{DMatrix, DVector};

/// Radii that are compared.
const SAMPLES: usize = 400;
/// Distance from the axis up to which a lens is fitted, over that of the farthest corner: Gaussians beyond the picture reach into
/// it.
const BEYOND: f64 = 1.3;
/// Angle from the axis at which a fit ends, rad.
const WIDEST: f64 = 3.0;

/// The fisheye lens whose radii in focal lengths are those of `ray`, which gives for a radius the distance from the axis and along
/// it, and ends where it folds. `None` if an error up to `corner`, in focal lengths too, is larger than `most`.
pub(super) fn equidistant(corner: f64, most: f64, ray: impl Fn(f64) -> Option<[f64; 2]>) -> Option<Distortion> {
    let radii = (1..=SAMPLES).map(|index| BEYOND * corner * (index as f64 / SAMPLES as f64));
    let mut samples: Vec<[f64; 2]> = Vec::new();
    for (radius, ray) in radii.map_while(|radius| Some((radius, ray(radius)?))) {
        let angle = ray[0].atan2(ray[1]);
        if angle > WIDEST || samples.last().is_some_and(|[last, _]| angle <= *last) {
            break;
        }
        samples.push([angle, radius]);
    }
    let widest = samples.last()?[0];
    let numerator = Distortion::new(Projection::Equidistant).numerator;
    let powers = DMatrix::from_fn(samples.len(), numerator.len(), |row, column| {
        (samples[row][0] / widest).powi(2 * (column as i32 + 1))
    });
    let factors = DVector::from_fn(samples.len(), |row, _| samples[row][1] / samples[row][0] - 1.0);
    let found = powers.svd(true, true).solve(&factors, 1e-14).ok()?;
    let numerator = std::array::from_fn(|i| found[i] / widest.powi(2 * (i as i32 + 1)));
    let distortion = Distortion { numerator, ..Distortion::new(Projection::Equidistant) };
    let fits =
        |[angle, radius]: &[f64; 2]| *radius > corner || (distortion.apply(*angle, 0.0)[0] - radius).abs() < most;
    samples.iter().all(fits).then_some(distortion)
}

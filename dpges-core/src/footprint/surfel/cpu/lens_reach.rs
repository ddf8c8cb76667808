//! The pixels that a disc can reach when it is seen through a lens.
//!
//! The disc is bounded by a rectangle on the plane across its line of sight, whose sides run along the angle θ from the
//! optical axis and across it. The lens turns angles into radii monotonically, so the ranges of θ and of the azimuth φ over
//! that rectangle give a sector of a ring on the picture; what moves positions off their radius is bounded by intervals.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::slope_range;
use crate::camera::Lens;
use crate::math::{V3, dot};

/// Nearest that a disc may come to the plane through the camera's centre across its line of sight, relative to its distance.
/// Nearer ones are bounded by the picture.
const LEAST_AHEAD: f64 = 0.05;

type Range = [f64; 2];

fn around(values: &[f64]) -> Range {
    values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &v| [low.min(v), high.max(v)])
}

fn plus(a: Range, b: Range) -> Range {
    [a[0] + b[0], a[1] + b[1]]
}

fn times(a: Range, b: Range) -> Range {
    around(&[a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]])
}

fn scaled(a: Range, factor: f64) -> Range {
    times(a, [factor, factor])
}

fn squared(a: Range) -> Range {
    let [low, high] = around(&[a[0] * a[0], a[1] * a[1]]);
    [if a[0] <= 0.0 && a[1] >= 0.0 { 0.0 } else { low }, high]
}

/// Angles from the optical axis, and azimuths.
struct Cone {
    angle: Range,
    azimuth: Range,
}

const FULL_TURN: Range = [-PI, PI];

/// Box, in focal lengths from the principal point, [x low, x high, y low, y high], of the disc with this centre and half-axes
/// in camera axes; `None` if the lens does not see it.
pub fn bounds(lens: &Lens, centre: V3<f64>, half_axes: [V3<f64>; 2]) -> Option<[f64; 4]> {
    let Some(cone) = cone(centre, half_axes) else {
        return Some([f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY]);
    };
    if lens.radius(cone.angle[0]) > lens.limit() {
        return None;
    }
    let undistorted = cone.angle.map(|angle| lens.radius(angle).min(lens.limit()));
    let radial = sector(undistorted.map(|radius| lens.radial(radius)), cone.azimuth);
    let distortion = lens.distortion();
    let [a, b] = if distortion.in_sequence { radial } else { sector(undistorted, cone.azimuth) };
    let ([p1, p2], [s1, s2], [t1, t2]) = (distortion.tangential, distortion.thin_prism, distortion.thin_prism_quartic);
    let (aa, bb, ab) = (squared(a), squared(b), scaled(times(a, b), 2.0));
    let quartic = squared(plus(aa, bb));
    // p₂ (r² + 2a²) + s₁ r² + t₁ r⁴ and its twin
    let aside = |along: Range, across: Range, p: f64, s: f64, t: f64| {
        plus(plus(scaled(along, 3.0 * p + s), scaled(across, p + s)), scaled(quartic, t))
    };
    let x = plus(radial[0], plus(scaled(ab, p1), aside(aa, bb, p2, s1, t1)));
    let y = plus(radial[1], plus(scaled(ab, p2), aside(bb, aa, p1, s2, t2)));
    Some([x[0], x[1], y[0], y[1]])
}

/// The directions in which a disc lies; `None` if it comes too near the plane across its line of sight.
fn cone(centre: V3<f64>, half_axes: [V3<f64>; 2]) -> Option<Cone> {
    let distance = dot(centre, centre).sqrt();
    let [x, y, z] = centre;
    let across = x.hypot(y);
    let (cos_azimuth, sin_azimuth) = if across > 0.0 { (x / across, y / across) } else { (1.0, 0.0) };
    let (angle, azimuth) = (across.atan2(z), sin_azimuth.atan2(cos_azimuth));
    let (sin, cos) = angle.sin_cos();
    // outwards from the optical axis, around it, and along the line of sight
    let frame = [
        [cos * cos_azimuth, cos * sin_azimuth, -sin],
        [-sin_azimuth, cos_azimuth, 0.0],
        [sin * cos_azimuth, sin * sin_azimuth, cos],
    ];
    let [a, b] = half_axes.map(|axis| frame.map(|direction| dot(axis, direction)));
    let is_ahead = distance - a[2].hypot(b[2]) > LEAST_AHEAD * distance;
    let slopes = |i: usize| slope_range([0.0, distance], [a[i], a[2]], [b[i], b[2]], 0.0);
    match (slopes(0), slopes(1)) {
        (Some(outwards), Some(around_axis)) if is_ahead => {
            Some(turned([sin, cos], angle, azimuth, outwards, around_axis))
        }
        _ => None,
    }
}

/// The cone of the rectangle of slopes `outwards` and `around_axis`, both around 0, about a direction.
fn turned([sin, cos]: [f64; 2], angle: f64, azimuth: f64, outwards: Range, around_axis: Range) -> Cone {
    let widest = around_axis[0].abs().max(around_axis[1].abs());
    // component away from the optical axis, and along it
    let at = |slope: f64| (sin + slope * cos, cos - slope * sin);
    // over a side across the plane the angle is extreme in the middle and at the wider end
    let angles = outwards.map(|slope| {
        let (away, along) = at(slope);
        [away.abs().atan2(along), away.hypot(widest).atan2(along)]
    });
    let [low, high] = around(angles.as_flattened());
    let covers_front = angle + outwards[0].atan() <= 0.0;
    let covers_back = angle + outwards[1].atan() >= PI;
    if covers_front || covers_back {
        // the directions within an angle of a pole are convex up to a right angle
        let from_front = covers_front || low <= FRAC_PI_2;
        let to_back = covers_back || high >= FRAC_PI_2;
        let angle = [if from_front { 0.0 } else { low }, if to_back { PI } else { high }];
        return Cone { angle, azimuth: FULL_TURN };
    }
    let away = at(outwards[0]).0.min(at(outwards[1]).0);
    Cone { angle: [low, high], azimuth: around_axis.map(|slope| azimuth + slope.atan2(away)) }
}

/// Box of a sector of a ring: ranges of x and y.
fn sector(radius: Range, azimuth: Range) -> [Range; 2] {
    let along = |quarter: f64| {
        // the cosine of azimuth − quarter
        let [low, high] = azimuth.map(|angle| angle - quarter);
        let ends = around(&[low.cos(), high.cos()]);
        let holds = |extreme: f64| ((low - extreme) / TAU).ceil() * TAU + extreme <= high;
        let cosine = [if holds(PI) { -1.0 } else { ends[0] }, if holds(0.0) { 1.0 } else { ends[1] }];
        times(radius, cosine)
    };
    [along(0.0), along(FRAC_PI_2)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::lenses::every_model;
    use crate::testing::random::Random;

    /// Positions of points of discs of every kind lie in the box, and boxes of small discs are small.
    #[test]
    fn no_point_of_a_disc_appears_outside_its_bounds() {
        for (name, distortion) in every_model() {
            let lens = Lens::new(distortion);
            let mut random = Random::new(7);
            let (mut seen, mut unseen, mut small, mut tight) = (0, 0, 0, 0);
            for disc in 0..4000 {
                let centre: V3<f64> = match disc % 4 {
                    0 => std::array::from_fn(|_| random.normal()),
                    // next to the optical axis, in front and behind
                    1 => [1e-3 * random.normal(), 1e-3 * random.normal(), random.between(-3.0, 3.0)],
                    2 => [random.normal(), random.normal(), random.between(0.5, 4.0)],
                    _ => [0.0, 0.0, random.between(0.2, 2.0)],
                };
                let size = [0.01, 0.1, 0.6, 3.0][random.below(4)];
                let half_axes = [0, 1].map(|_| std::array::from_fn(|_| size * random.normal()));
                let bounds = bounds(&lens, centre, half_axes);
                let mut box_of_points = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
                for point in 0..120 {
                    let turn = random.between(0.0, TAU);
                    let share = if point % 2 == 0 { 1.0 } else { random.unit().sqrt() };
                    let (u, v) = (share * turn.cos(), share * turn.sin());
                    let at = std::array::from_fn(|k| centre[k] + u * half_axes[0][k] + v * half_axes[1][k]);
                    let Some([x, y]) = lens.position(at) else { continue };
                    let [x0, x1, y0, y1] = bounds.unwrap_or_else(|| panic!("{name}: disc {disc} is seen at {at:?}"));
                    let slack = 1e-9 * (1.0 + x.abs() + y.abs());
                    assert!(
                        x >= x0 - slack && x <= x1 + slack && y >= y0 - slack && y <= y1 + slack,
                        "{name}: ({x}, {y}) of disc {disc} at {centre:?}, {half_axes:?} is outside {bounds:?}"
                    );
                    let [left, right, top, bottom] = box_of_points;
                    box_of_points = [left.min(x), right.max(x), top.min(y), bottom.max(y)];
                }
                match bounds {
                    Some([x0, x1, y0, y1]) if box_of_points[0] < box_of_points[1] => {
                        seen += 1;
                        let [left, right, top, bottom] = box_of_points;
                        let most = (right - left).max(bottom - top);
                        small += usize::from(size < 0.2);
                        tight += usize::from(size < 0.2 && (x1 - x0).max(y1 - y0) < 3.0 * most);
                    }
                    _ => unseen += 1,
                }
            }
            assert!(seen > 1000 && unseen > 50, "{name}: {seen} seen, {unseen} not");
            assert!(10 * tight > 7 * small, "{name}: {tight} of {small} are tight");
        }
    }
}

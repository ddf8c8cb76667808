use std::f64::consts::FRAC_PI_2;

use approx::assert_relative_eq;

use super::*;
use crate::testing::lenses::every_model;
use crate::testing::random::Random;

/// Points that a lens sees, at every angle up to its limit, on and off its axis.
fn points(lens: &Lens, count: usize) -> Vec<[f64; 3]> {
    let mut random = Random::new(17);
    let mut points = vec![[0.0, 0.0, 0.7], [1e-9, 0.0, 1.3], [1e-4, -2e-4, 0.9]];
    while points.len() < count {
        let point: [f64; 3] = std::array::from_fn(|_| random.normal());
        let [a, b] = lens.undistorted(point).unwrap_or([f64::INFINITY; 2]);
        if a.hypot(b) < 0.98 * lens.limit().min(3.0) {
            points.push(point);
        }
    }
    points
}

#[test]
fn rays_lead_back_to_the_points_that_they_show() {
    for (name, distortion) in every_model() {
        let lens = Lens::new(distortion);
        assert!(lens.is_sound() && lens.limit() > 0.8, "{name}: {}", lens.limit());
        for point in points(&lens, 300) {
            let ray = lens.ray(lens.position(point).unwrap()).unwrap_or_else(|| panic!("{name}: no ray to {point:?}"));
            for axis in 0..3 {
                assert_relative_eq!(lens.depth(point) * ray[axis], point[axis], epsilon = 1e-8, max_relative = 1e-8);
            }
        }
    }
}

/// Central differences of `of` at a point along each axis.
fn slopes<const N: usize>(point: [f64; 3], of: impl Fn([f64; 3]) -> [f64; N]) -> [[f64; N]; 3] {
    const STEP: f64 = 1e-6;
    [0, 1, 2].map(|axis| {
        let at = |step: f64| {
            let mut moved = point;
            moved[axis] += step;
            of(moved)
        };
        let (above, below) = (at(STEP), at(-STEP));
        std::array::from_fn(|i| (above[i] - below[i]) / (2.0 * STEP))
    })
}

#[test]
fn jacobians_and_the_way_back_are_central_differences() {
    let mut random = Random::new(5);
    for (name, distortion) in every_model() {
        let lens = Lens::new(distortion);
        for point in points(&lens, 200) {
            let seen = lens.look(point).unwrap();
            assert_eq!(seen.position, lens.position(point).unwrap());
            for (k, expected) in slopes(point, |point| lens.position(point).unwrap()).into_iter().enumerate() {
                for (row, slope) in seen.jacobian.iter().zip(expected) {
                    let near = (row[k] - slope).abs() < 1e-5 * (1.0 + slope.abs());
                    assert!(near, "{name} at {point:?}: {}, {slope}", row[k]);
                }
            }
            let grad_position: [f64; 2] = std::array::from_fn(|_| random.normal());
            let grad_jacobian: [[f64; 3]; 2] = std::array::from_fn(|_| std::array::from_fn(|_| random.normal()));
            let loss = |point: [f64; 3]| {
                let seen = lens.look(point).unwrap();
                let of_row = |i: usize| {
                    let of_jacobian: f64 = (0..3).map(|k| seen.jacobian[i][k] * grad_jacobian[i][k]).sum();
                    seen.position[i] * grad_position[i] + of_jacobian
                };
                [of_row(0) + of_row(1)]
            };
            let found = lens.look_backward(point, grad_position, grad_jacobian);
            let largest = found.iter().fold(1.0, |most: f64, v| most.max(v.abs()));
            for (found, [slope]) in found.into_iter().zip(slopes(point, loss)) {
                let near = (found - slope).abs() < 1e-5 * largest.max(slope.abs());
                assert!(near, "the backward pass of {name} at {point:?}: {found}, {slope}");
            }
        }
    }
}

#[test]
fn models_are_those_of_colmap() {
    let point = [0.9, -0.5, 0.8];
    let [x, y, z] = point;
    let (a, b) = (x / z, y / z);
    let models = every_model();
    let check = |model: usize, point: [f64; 3], expected: [f64; 2], epsilon: f64| {
        let found = Lens::new(models[model].1).position(point).unwrap();
        for (found, expected) in found.into_iter().zip(expected) {
            assert_relative_eq!(found, expected, epsilon = epsilon);
        }
    };

    let r2 = a * a + b * b;
    let radial = 1.0 - 0.2 * r2 + 0.05 * r2 * r2;
    let across = a * radial + 2.0 * 0.003 * a * b - 0.004 * (r2 + 2.0 * a * a);
    let down = b * radial + 0.003 * (r2 + 2.0 * b * b) - 2.0 * 0.004 * a * b;
    check(2, point, [across, down], 1e-12);

    let radius = x.hypot(y);
    let theta = radius.atan2(z);
    let t2 = theta * theta;
    let bent = theta * (1.0 + 0.04 * t2 - 0.012 * t2 * t2 + 0.003 * t2.powi(3) - 0.0002 * t2.powi(4));
    check(4, point, [bent * x / radius, bent * y / radius], 1e-12);

    let (u, v) = (theta * x / radius, theta * y / radius);
    let bulge = 0.02 * t2 - 0.01 * t2 * t2 + 0.001 * t2.powi(3);
    let across = u + u * bulge + 2.0 * 0.002 * u * v - 0.001 * (t2 + 2.0 * u * u) + 0.003 * t2;
    let down = v + v * bulge - 2.0 * 0.001 * u * v + 0.002 * (t2 + 2.0 * v * v) - 0.002 * t2;
    check(7, point, [across, down], 1e-12);

    let (omega, r) = (1.3f64, r2.sqrt());
    let factor = (2.0 * r * (0.5 * omega).tan()).atan() / (r * omega);
    check(8, point, [a * factor, b * factor], 1e-12);

    // of a program of its own
    for (point, expected) in [
        (point, [0.806_972_939_476_258_8, -0.448_063_681_023_826_1]),
        ([-0.4, 0.7, -0.1], [-0.854_489_485_448_965_5, 1.493_022_017_712_310_4]),
        ([0.2, 0.1, 1.0], [0.196_988_848_068_316_04, 0.098_483_586_355_042_05]),
    ] {
        check(9, point, expected, 1e-14);
    }
}

#[test]
fn sequence_matters_only_to_what_moves_positions_aside() {
    let (_, bent) = every_model()[9];
    let aside = Lens::new(Distortion { in_sequence: false, ..bent });
    let point = [0.9, -0.5, 0.8];
    let difference = |other: &Lens| {
        let ([a, b], [c, d]) = (Lens::new(bent).position(point).unwrap(), other.position(point).unwrap());
        (a - c).hypot(b - d)
    };
    assert!(difference(&aside) > 1e-6);
    let none = [0.0; 2];
    let radial = Distortion { tangential: none, thin_prism: none, thin_prism_quartic: none, ..bent };
    let straight = Distortion { in_sequence: false, ..radial };
    assert_eq!(Lens::new(radial).position(point), Lens::new(straight).position(point));
    assert!(Distortion { in_sequence: true, ..Distortion::new(Projection::Perspective) }.is_pinhole());
}

#[test]
fn a_fisheye_sees_behind_the_camera_and_a_perspective_lens_does_not() {
    let fisheye = Lens::new(Distortion::new(Projection::Equidistant));
    let [x, y] = fisheye.position([0.3, 0.0, -0.2]).unwrap();
    assert_relative_eq!(x, FRAC_PI_2 + (0.2f64 / 0.3).atan(), epsilon = 1e-12);
    assert_eq!(y, 0.0);
    assert_relative_eq!(fisheye.depth([0.3, 0.0, -0.4]), 0.5, epsilon = 1e-15);
    assert!(fisheye.position([0.01, 0.0, -1.0]).is_none());
    let perspective = Lens::new(every_model()[0].1);
    assert!(perspective.position([0.01, 0.0, -1.0]).is_none());
    assert_eq!(perspective.depth([0.3, 0.0, 0.4]), 0.4);
}

#[test]
fn a_lens_ends_where_it_would_fold() {
    // r (1 − 0.12 r²) turns back at r² = 1 / 0.36
    let lens = Lens::new(every_model()[0].1);
    let fold = (1.0f64 / 0.36).sqrt();
    assert_relative_eq!(lens.limit(), fold, epsilon = 1e-6);
    assert!(lens.position([0.99 * fold, 0.0, 1.0]).is_some() && lens.position([1.01 * fold, 0.0, 1.0]).is_none());
    let end = lens.radial(lens.limit());
    assert!(lens.ray([0.999 * end, 0.0]).is_some() && lens.ray([0.0, 1.001 * end]).is_none());
    // beyond, the nearest ray is that at the end
    let nearest = lens.nearest_ray([0.0, 1.5 * end]);
    assert_relative_eq!(nearest[1], lens.limit(), epsilon = 1e-12);
    assert_eq!((nearest[0], nearest[2]), (0.0, 1.0));
}

#[test]
fn lenses_that_show_nothing_are_unsound() {
    let perspective = Distortion::new(Projection::Perspective);
    for distortion in [
        Distortion { numerator: [f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0], ..perspective },
        Distortion { tangential: [0.0, f64::INFINITY], ..perspective },
        Distortion { denominator: [1e60, 0.0, 0.0], ..perspective },
        Distortion { thin_prism_quartic: [f64::NAN, 0.0], ..perspective },
        Distortion::new(Projection::FieldOfView(0.0)),
        Distortion::new(Projection::FieldOfView(4.0)),
        Distortion::new(Projection::FieldOfView(f64::NAN)),
    ] {
        assert!(!Lens::new(distortion).is_sound(), "{distortion:?}");
    }
}

#[test]
fn a_lens_is_stored_as_its_coefficients() {
    for (name, distortion) in every_model() {
        let lens = Lens::new(distortion);
        let text = serde_json::to_string(&lens).unwrap();
        assert_eq!(serde_json::from_str::<Lens>(&text).unwrap(), lens, "{name}: {text}");
    }
}

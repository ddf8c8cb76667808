//! FLIP: the difference that a person sees when two pictures alternate at the same place (Andersson, Nilsson,
//! Akenine-Möller, Oskarsson, Åström, Fairchild: *FLIP: A Difference Evaluator for Alternating Images*. HPG 2020; low
//! dynamic range).

use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::plane::Plane;

/// A display 0.7 m wide with 3840 px, seen from 0.7 m.
const PIXELS_PER_DEGREE: f64 = 3840.0 * PI / 180.0;

/// Contrast sensitivity functions of luminance, red against green, blue against yellow: weights a and widths b of Gaussians.
const SENSITIVITIES: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];
/// The largest b: all filters reach as far as the widest does.
const WIDEST: f64 = 0.04;
const COLOUR_EXPONENT: f64 = 0.7;
/// Differences below this share of the largest are stretched ...
const STRETCHED: f64 = 0.4;
/// ... up to this.
const STRETCHED_TO: f64 = 0.95;
/// Width of a feature, degrees.
const FEATURE_WIDTH: f64 = 0.082;
const FEATURE_EXPONENT: f64 = 0.5;

/// Mean FLIP of two pictures [3 × `height` × `width`], display-referred (sRGB) from 0 to 1: 0 if they are equal, at most 1.
///
/// # Panics
/// If the planes are not of that size.
pub fn flip(reference: &[f32], test: &[f32], width: usize, height: usize) -> f64 {
    // summed in order, so that the result is the same for any number of threads
    flip_map(reference, test, width, height).iter().sum::<f64>() / (width * height).max(1) as f64
}

/// FLIP of every pixel, row by row, of two pictures as [`flip`] takes them.
///
/// # Panics
/// If the planes are not of that size.
pub fn flip_map(reference: &[f32], test: &[f32], width: usize, height: usize) -> Vec<f64> {
    let [reference, test] = [reference, test].map(|planes| {
        assert_eq!(planes.len(), 3 * width * height, "a picture of {width}x{height} px");
        Seen::new(planes, width, height)
    });
    let largest = distance(hunt(DVec3::Y), hunt(DVec3::Z)).powf(COLOUR_EXPONENT);
    let errors = (0..width * height).into_par_iter().map(|pixel| {
        let colour = distance(reference.colours[pixel], test.colours[pixel]).powf(COLOUR_EXPONENT);
        let bend = STRETCHED * largest;
        let colour = if colour < bend {
            colour * STRETCHED_TO / bend
        } else {
            STRETCHED_TO + (colour - bend) / (largest - bend) * (1.0 - STRETCHED_TO)
        };
        let edges = (reference.edges[pixel] - test.edges[pixel]).abs();
        let points = (reference.points[pixel] - test.points[pixel]).abs();
        let feature = (edges.max(points) / 2f64.sqrt()).powf(FEATURE_EXPONENT);
        colour.powf(1.0 - feature)
    });
    errors.collect()
}

/// The visible part of a picture, a value per pixel.
struct Seen {
    /// CIELAB with Hunt's effect, without the contrast that the eye does not see.
    colours: Vec<DVec3>,
    edges: Vec<f64>,
    points: Vec<f64>,
}

impl Seen {
    fn new(planes: &[f32], width: usize, height: usize) -> Self {
        let area = width * height;
        let plane = Plane { width, height };
        let opponent: Vec<DVec3> = (0..area)
            .into_par_iter()
            .map(|pixel| {
                let colour = DVec3::from_array([0, 1, 2].map(|c| linear(f64::from(planes[c * area + pixel]))));
                opponent_from_xyz(xyz_from_linear() * colour / white())
            })
            .collect();
        let channel = |c: usize| opponent.iter().map(|colour| colour[c]).collect::<Vec<f64>>();
        let filtered: Vec<Vec<f64>> = (0..3).map(|c| filtered(&channel(c), SENSITIVITIES[c], plane)).collect();
        let linear_from_xyz = xyz_from_linear().inverse();
        let colours = (0..area).into_par_iter().map(|pixel| {
            let seen = DVec3::from_array([0, 1, 2].map(|c| filtered[c][pixel]));
            hunt((linear_from_xyz * (xyz_from_opponent(seen) * white())).clamp(DVec3::ZERO, DVec3::ONE))
        });
        let colours = colours.collect();
        let luminance: Vec<f64> = channel(0).into_iter().map(|y| (y + 16.0) / 116.0).collect();
        let deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE;
        let radius = (3.0 * deviation).ceil() as i64;
        let gaussian = |x: f64| (-x * x / (2.0 * deviation * deviation)).exp();
        let smooth = normalised(kernel(radius, gaussian));
        let magnitude = |derivative: Vec<f64>| {
            let derivative = normalised(derivative);
            let across = plane.convolved(&luminance, &derivative, &smooth);
            let down = plane.convolved(&luminance, &smooth, &derivative);
            across.into_iter().zip(down).map(|(x, y)| x.hypot(y)).collect::<Vec<f64>>()
        };
        let edges = magnitude(kernel(radius, |x| -x * gaussian(x)));
        let points = magnitude(kernel(radius, |x| (x * x / (deviation * deviation) - 1.0) * gaussian(x)));
        Self { colours, edges, points }
    }
}

fn linear(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Primaries and white of sRGB.
fn xyz_from_linear() -> DMat3 {
    DMat3::from_cols_array(&[
        10_135_552.0 / 24_577_794.0,
        2_613_072.0 / 12_288_897.0,
        1_425_312.0 / 73_733_382.0,
        8_788_810.0 / 24_577_794.0,
        8_788_810.0 / 12_288_897.0,
        8_788_810.0 / 73_733_382.0,
        4_435_075.0 / 24_577_794.0,
        887_015.0 / 12_288_897.0,
        70_074_185.0 / 73_733_382.0,
    ])
}

fn white() -> DVec3 {
    xyz_from_linear() * DVec3::ONE
}

/// Y, Cx, Cz of XYZ relative to white.
fn opponent_from_xyz(xyz: DVec3) -> DVec3 {
    DVec3::new(116.0 * xyz.y - 16.0, 500.0 * (xyz.x - xyz.y), 200.0 * (xyz.y - xyz.z))
}

fn xyz_from_opponent(colour: DVec3) -> DVec3 {
    let y = (colour.x + 16.0) / 116.0;
    DVec3::new(y + colour.y / 500.0, y, y - colour.z / 200.0)
}

/// CIELAB of a linear colour, with a and b in proportion to L (Hunt).
fn hunt(colour: DVec3) -> DVec3 {
    const KNEE: f64 = 6.0 / 29.0;
    let root = |t: f64| if t > KNEE.powi(3) { t.cbrt() } else { t / (3.0 * KNEE * KNEE) + 4.0 / 29.0 };
    let xyz = xyz_from_linear() * colour / white();
    let lab = opponent_from_xyz(DVec3::from_array(xyz.to_array().map(root)));
    DVec3::new(lab.x, 0.01 * lab.x * lab.y, 0.01 * lab.x * lab.z)
}

/// HyAB.
fn distance(a: DVec3, b: DVec3) -> f64 {
    (a.x - b.x).abs() + (a.y - b.y).hypot(a.z - b.z)
}

/// Values of `of` at −`radius` … `radius` px.
fn kernel(radius: i64, of: impl Fn(f64) -> f64) -> Vec<f64> {
    (-radius..=radius).map(|x| of(x as f64)).collect()
}

/// Positive weights sum to 1, negative ones to −1.
fn normalised(kernel: Vec<f64>) -> Vec<f64> {
    let sum = |sign: f64| kernel.iter().filter(|&&weight| weight * sign > 0.0).sum::<f64>().abs();
    let (positive, negative) = (sum(1.0), sum(-1.0));
    kernel
        .into_iter()
        .map(|weight| weight / if weight > 0.0 { positive } else { negative.max(f64::MIN_POSITIVE) })
        .collect()
}

/// A channel without the contrast that the eye does not see.
fn filtered(channel: &[f64], sensitivities: &[(f64, f64)], plane: Plane) -> Vec<f64> {
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i64;
    let (mut sums, mut total) = (vec![0.0; channel.len()], 0.0);
    for &(a, b) in sensitivities {
        let kernel = kernel(radius, |x| (-(PI * x / PIXELS_PER_DEGREE).powi(2) / b).exp());
        let weight = a * (PI / b).sqrt();
        total += weight * kernel.iter().sum::<f64>().powi(2);
        let convolved = plane.convolved(channel, &kernel, &kernel);
        sums.iter_mut().zip(convolved).for_each(|(sum, value)| *sum += weight * value);
    }
    sums.iter_mut().for_each(|sum| *sum /= total);
    sums
}

#[cfg(test)]
mod tests {
    use super::super::test_pictures::{noise, picture};
    use super::*;

    const WIDTH: usize = 48;
    const HEIGHT: usize = 36;

    fn ramp(c: usize, y: usize, x: usize) -> usize {
        40 + 4 * x + 2 * y + 20 * c
    }

    fn discs(c: usize, y: usize, x: usize) -> usize {
        if (x % 12).abs_diff(6).pow(2) + (y % 12).abs_diff(6).pow(2) < 16 { 60 + 70 * c } else { 200 - 40 * c }
    }

    /// Values of the published evaluator, flip-evaluator 1.7, for the same pictures at the same viewing conditions, in
    /// single precision.
    #[test]
    fn it_agrees_with_the_published_evaluator() {
        type Of = fn(usize, usize, usize) -> usize;
        let cases: [(&str, Of, Of, f64); 6] = [
            ("ramp, shifted", ramp, |c, y, x| ramp(c, y, x + 2), 0.328_567_95),
            ("ramp, darker", ramp, |c, y, x| ramp(c, y, x) * 3 / 4, 0.650_371_91),
            ("discs, noisy", discs, |c, y, x| (7 * discs(c, y, x) + noise(c, y, x)) / 8, 0.159_607_96),
            ("discs, moved", discs, |c, y, x| discs(c, y, x + 1), 0.166_653_86),
            ("noise, grey", noise, |_, _, _| 128, 0.412_582_81),
            ("white, black", |_, _, _| 255, |_, _, _| 0, 0.967_400_01),
        ];
        for (name, reference, test, expected) in cases {
            let [reference, test] = [reference, test].map(|of| picture(WIDTH, HEIGHT, of));
            let found = flip(&reference, &test, WIDTH, HEIGHT);
            assert!((found - expected).abs() < 5e-5, "{name}: {found}, expected {expected}");
        }
    }

    #[test]
    fn equal_pictures_do_not_differ() {
        let discs = picture(WIDTH, HEIGHT, discs);
        assert_eq!(flip(&discs, &discs, WIDTH, HEIGHT), 0.0);
        assert_eq!(flip_map(&discs, &discs, WIDTH, HEIGHT), vec![0.0; WIDTH * HEIGHT]);
        assert_eq!(flip(&[], &[], 0, 0), 0.0);
        assert!(flip(&[0.5; 3], &[0.6; 3], 1, 1) > 0.01);
    }
}

//! Colours as real spherical harmonics up to degree 3, in the basis of 3DGS: with the Condon–Shortley phase, constants
//! as in its rasteriser, order m = −l..l within degree l. `colour = 0.5 + Σ k_i Y_i(direction)`, with the unit direction
//! from the camera to the primitive.

use dpges_core::scene::lobes::{LOBE_LEN, is_absent, lobe_axis, softplus};
use dpges_core::scene::{ColourData, ColourModel, SH_C0};
use glam::{DMat3, DVec3};

/// Largest degree that every format can hold.
pub const MAX_DEGREE: usize = 3;
pub(super) const MAX_COEFFICIENTS: usize = 16;
const DEGREE: [usize; MAX_COEFFICIENTS] = [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3];
/// Raw β is bounded here, as it is where scenes are rendered.
const LARGEST_BETA: f64 = 14.0;

pub const fn coefficient_count(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// One primitive's colour: red, green and blue of every coefficient.
pub(super) type Coefficients = [[f64; 3]; MAX_COEFFICIENTS];

/// Values of all harmonics in a unit direction (3DGS).
fn basis(direction: DVec3) -> [f64; MAX_COEFFICIENTS] {
    let DVec3 { x, y, z } = direction;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        SH_C0,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.315_391_565_252_520_05 * (2.0 * zz - xx - yy),
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (xx - yy),
        -0.590_043_589_926_643_5 * y * (3.0 * xx - yy),
        2.890_611_442_640_554 * x * y * z,
        -0.457_045_799_464_465_8 * y * (4.0 * zz - xx - yy),
        0.373_176_332_590_115_4 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_799_464_465_8 * x * (4.0 * zz - xx - yy),
        1.445_305_721_320_277 * z * (xx - yy),
        -0.590_043_589_926_643_5 * x * (xx - 3.0 * yy),
    ]
}

/// The colour of primitive `row` as harmonics of all degrees.
///
/// Harmonics are kept as they are. A spherical Beta lobe is fitted by least squares over all directions of the
/// sphere. Because the harmonics are orthonormal and a lobe is symmetric about its axis μ, the coefficient of `Y_i` is
/// `λ_l Y_i(μ)` (Funk and Hecke) with `λ_l = 2π ∫₀¹ t^e P_l(t) dt`, exponent `e = 4 exp β` and the Legendre polynomial
/// `P_l` of the degree l of `Y_i`. A lower degree leaves the coefficients of the others as they are.
pub(super) fn coefficients(colour: &ColourData, row: usize) -> Coefficients {
    let mut fit: Coefficients = [[0.0; 3]; MAX_COEFFICIENTS];
    fit[0] = std::array::from_fn(|channel| f64::from(colour.base[3 * row + channel]));
    let width = colour.model.detail_len();
    let detail = &colour.detail[row * width..(row + 1) * width];
    match colour.model {
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
            for (k, raw) in fit[1..].iter_mut().zip(detail.as_chunks::<3>().0) {
                *k = raw.map(f64::from);
            }
        }
        ColourModel::SphericalBeta { .. } => {
            for lobe in detail.as_chunks::<LOBE_LEN>().0.iter().filter(|lobe| !is_absent(&lobe[..])) {
                add_lobe(&mut fit, lobe.map(f64::from));
            }
        }
    }
    fit
}

/// `colour` as harmonics of `degree`, up to [`MAX_DEGREE`]: exactly if they are, else lobes by least squares.
pub fn to_harmonics(colour: &ColourData, degree: usize) -> ColourData {
    let kept = coefficient_count(degree);
    let rows: Vec<Coefficients> = (0..colour.base.len() / 3).map(|row| coefficients(colour, row)).collect();
    let numbers = |k: &[[f64; 3]]| k.as_flattened().iter().map(|&k| k as f32).collect::<Vec<_>>();
    ColourData::new(
        ColourModel::SphericalHarmonics { degree },
        rows.iter().flat_map(|k| numbers(&k[..1])).collect(),
        rows.iter().flat_map(|k| numbers(&k[1..kept])).collect(),
    )
}

fn add_lobe(fit: &mut Coefficients, [red, green, blue, theta, phi, beta]: [f64; LOBE_LEN]) {
    let rgb = [red, green, blue].map(softplus);
    let weights = lobe_weights(4.0 * beta.min(LARGEST_BETA).exp());
    for ((k, y), degree) in fit.iter_mut().zip(basis(lobe_axis(theta, phi).into())).zip(DEGREE) {
        for channel in 0..3 {
            k[channel] += rgb[channel] * weights[degree] * y;
        }
    }
}

/// λ of each degree for a lobe of `exponent`.
fn lobe_weights(exponent: f64) -> [f64; MAX_DEGREE + 1] {
    let moment = |power: f64| 1.0 / (exponent + power + 1.0);
    let legendre = [
        moment(0.0),
        moment(1.0),
        0.5 * (3.0 * moment(2.0) - moment(0.0)),
        0.5 * (5.0 * moment(3.0) - 3.0 * moment(1.0)),
    ];
    legendre.map(|integral| std::f64::consts::TAU * integral)
}

/// How coefficients change when the world is rotated. Degrees do not mix.
pub(super) struct HarmonicsRotation {
    /// `[to][from]`; 0 where the degrees differ.
    matrix: [[f64; MAX_COEFFICIENTS]; MAX_COEFFICIENTS],
}

impl HarmonicsRotation {
    /// For colours in the world that `rotation` makes of the old one.
    pub fn new(rotation: DMat3) -> Self {
        let mut matrix = [[0.0; MAX_COEFFICIENTS]; MAX_COEFFICIENTS];
        for (direction, weight) in quadrature() {
            let (new, old) = (basis(direction), basis(rotation.transpose() * direction));
            for (to, row) in matrix.iter_mut().enumerate() {
                for (from, entry) in row.iter_mut().enumerate() {
                    if DEGREE[to] == DEGREE[from] {
                        *entry += weight * new[to] * old[from];
                    }
                }
            }
        }
        Self { matrix }
    }

    /// Rotates the coefficients of one primitive, `[[red, green, blue]; count]` flattened, in place.
    pub fn apply(&self, coefficients: &mut [f32]) {
        let (colours, _) = coefficients.as_chunks_mut::<3>();
        let old: Vec<[f64; 3]> = colours.iter().map(|colour| colour.map(f64::from)).collect();
        for (colour, row) in colours.iter_mut().zip(&self.matrix) {
            for channel in 0..3 {
                colour[channel] = old.iter().zip(row).map(|(k, entry)| entry * k[channel]).sum::<f64>() as f32;
            }
        }
    }
}

/// Directions and weights that integrate polynomials up to degree 7 over the sphere exactly: Gauss–Legendre nodes along
/// z, equal angles around it.
fn quadrature() -> impl Iterator<Item = (DVec3, f64)> {
    const NODES: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    ];
    const ANGLES: usize = 8;
    NODES.into_iter().flat_map(|(z, weight)| {
        let radius = (1.0 - z * z).sqrt();
        (0..ANGLES).map(move |step| {
            let (sin, cos) = (std::f64::consts::TAU * (step as f64 + 0.5) / ANGLES as f64).sin_cos();
            (DVec3::new(radius * cos, radius * sin, z), weight * std::f64::consts::TAU / ANGLES as f64)
        })
    })
}

/// Colour in a unit direction from the coefficients of one primitive, `[[red, green, blue]; count]` flattened.
#[cfg(test)]
pub(super) fn evaluate(coefficients: &[f32], direction: DVec3) -> [f64; 3] {
    let (colours, _) = coefficients.as_chunks::<3>();
    let terms = colours.iter().zip(basis(direction));
    terms.fold([0.5; 3], |sum, (k, y)| std::array::from_fn(|channel| sum[channel] + f64::from(k[channel]) * y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::directions;

    #[test]
    fn the_basis_is_orthonormal() {
        for i in 0..MAX_COEFFICIENTS {
            for j in 0..MAX_COEFFICIENTS {
                let product: f64 = quadrature().map(|(d, weight)| weight * basis(d)[i] * basis(d)[j]).sum();
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12, "{i} {j}: {product}");
            }
        }
    }

    #[test]
    fn no_other_coefficients_fit_a_lobe_better() {
        let (theta, phi) = (0.8f64, -1.9f64);
        let axis = DVec3::from(lobe_axis(theta, phi));
        // a lobe of exponent 8 as the renderer evaluates it
        let lobe = |direction: DVec3| direction.dot(axis).max(0.0).powf(8.0);
        let detail = vec![0.0, -0.1, 0.2, theta as f32, phi as f32, 2f32.ln()];
        let colour = ColourData::new(ColourModel::SphericalBeta { lobes: 1 }, vec![0.1, -0.2, 0.3], detail);
        let fit = coefficients(&colour, 0);
        // a raw colour of 0 means 0.1
        for (i, k) in fit.iter().enumerate().skip(1) {
            let mean: f64 = directions(4000).map(|d| 0.1 * lobe(d) * basis(d)[i]).sum::<f64>() / 4000.0;
            assert!((k[0] - 4.0 * std::f64::consts::PI * mean).abs() < 1e-5, "{i}: {} {mean}", k[0]);
        }
        assert!(fit[0][0] > 0.1 && fit[0][1] > -0.2 && fit[9][0] != fit[9][2]);
    }

    #[test]
    fn harmonics_are_kept() {
        let detail: Vec<f32> = (0..24).map(|i| 0.01 * i as f32).collect();
        let model = ColourModel::SphericalHarmonics { degree: 2 };
        let colour = ColourData::new(model, vec![1.0, 2.0, 3.0], detail.clone());
        let fit = coefficients(&colour, 0);
        assert_eq!(fit[0], [1.0, 2.0, 3.0]);
        assert_eq!(fit[8], [21, 22, 23].map(|i: usize| f64::from(detail[i])));
        assert_eq!(fit[9], [0.0; 3]);
    }
}

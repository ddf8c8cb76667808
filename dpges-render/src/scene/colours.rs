//! Colours as 32-bit words, halves of 16 bits; every primitive has the same number of words.
//!
//! Two words hold the base colour 0.5 + C0 k0. A spherical Beta lobe has three: its colour after the softplus, its
//! exponent 4 exp β, and its axis as a point of the octahedron in steps of 2⁻¹⁵. A coefficient of spherical harmonics
//! has two. The softplus, the exponential and the sines are computed here, once, not for every frame.

use dpges_core::scene::lobes::{lobe_axis, softplus};
use dpges_core::scene::{ColourData, ColourModel, SH_C0};
use half::f16;

use super::packing::fraction;

const LOBE_WORDS: usize = 3;
/// Of a base colour, or of a coefficient.
const RGB_WORDS: usize = 2;

/// Texels of four words that a primitive has.
pub fn texels(model: ColourModel) -> usize {
    let detail = match model {
        ColourModel::SphericalBeta { lobes } => LOBE_WORDS * lobes,
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
            RGB_WORDS * model.detail_len() / 3
        }
    };
    (RGB_WORDS + detail).div_ceil(4)
}

/// All texels, those of the first primitive first.
pub fn pack(colours: &ColourData) -> Vec<[u32; 4]> {
    let model = colours.model;
    let (bases, _) = colours.base.as_chunks::<3>();
    let width = model.detail_len();
    let mut packed = Vec::with_capacity(bases.len() * texels(model));
    let mut words = Vec::with_capacity(4 * texels(model));
    for (row, base) in bases.iter().enumerate() {
        words.clear();
        words.extend(rgb(base.map(|k| 0.5 + SH_C0 * f64::from(k))));
        let detail = &colours.detail[row * width..(row + 1) * width];
        match model {
            ColourModel::SphericalBeta { .. } => words.extend(detail.as_chunks::<6>().0.iter().flat_map(lobe)),
            ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
                words.extend(detail.as_chunks::<3>().0.iter().flat_map(|k| rgb(k.map(f64::from))));
            }
        }
        words.resize(4 * texels(model), 0);
        packed.extend(words.as_chunks::<4>().0);
    }
    packed
}

fn rgb([red, green, blue]: [f64; 3]) -> [u32; RGB_WORDS] {
    [halves(red, green), halves(blue, 0.0)]
}

fn lobe(raw: &[f32; 6]) -> [u32; LOBE_WORDS] {
    let [r, g, b, theta, phi, beta] = raw.map(f64::from);
    let [r, g, b] = [r, g, b].map(softplus);
    let [u, v] = octahedron(lobe_axis(theta, phi)).map(fraction);
    [halves(r, g), halves(b, 4.0 * beta.exp()), u | v << 16]
}

/// A unit vector as a point of the square from −1 to 1.
fn octahedron([x, y, z]: [f64; 3]) -> [f64; 2] {
    let sum = x.abs() + y.abs() + z.abs();
    let (u, v) = (x / sum, y / sum);
    if z >= 0.0 { [u, v] } else { [(1.0 - v.abs()).copysign(u), (1.0 - u.abs()).copysign(v)] }
}

/// Two numbers as halves, the first in the low bits; out of range, the largest that there is.
fn halves(low: f64, high: f64) -> u32 {
    let bits = |value: f64| u32::from(f16::from_f64(value.clamp(-65504.0, 65504.0)).to_bits());
    bits(low) | bits(high) << 16
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn primitives_have_as_many_texels_as_their_model_asks_for() {
        let count = |model: &str| texels(model.parse().unwrap());
        assert_eq!(["sb0", "sb1", "sb2", "sb3", "sh0", "sh1", "sh3"].map(count), [1, 2, 2, 3, 1, 2, 8]);
        for model in ["sb0", "sb3", "sh2"] {
            let model: ColourModel = model.parse().unwrap();
            let colours = ColourData::new(model, vec![0.0; 6], vec![0.1; 2 * model.detail_len()]);
            assert_eq!(pack(&colours).len(), 2 * texels(model));
        }
    }

    #[test]
    fn octahedron_points_come_back() {
        for axis in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, -0.48, 0.64], [-0.36, 0.48, -0.8], [1.0, 0.0, 0.0]] {
            let [u, v] = octahedron(axis);
            let z = 1.0 - u.abs() - v.abs();
            let fold = (-z).max(0.0);
            let point = [u - fold.copysign(u), v - fold.copysign(v), z];
            let length = point.iter().map(|v| v * v).sum::<f64>().sqrt();
            assert!(point.iter().zip(axis).all(|(p, a)| (p / length - a).abs() < 1e-12), "{axis:?}");
        }
    }

    #[test]
    fn halves_are_bounded() {
        assert_eq!(halves(1.0, -2.0), 0x3c00 | 0xc000 << 16);
        assert_eq!(halves(1e9, -1e9), 0x7bff | 0xfbff << 16);
    }
}

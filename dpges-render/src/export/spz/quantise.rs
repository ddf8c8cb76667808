//! Numbers of splats as the bytes of SPZ, and back.

use dpges_core::scene::SceneInfo;

use super::super::cloud::SplatCloud;
use super::super::error::ExportError;
use super::super::harmonics::coefficient_count;

const LARGEST_FIXED: f64 = 8_388_607.0;
/// More bits after the point than f32 has are of no use near the edge of a scene.
const MOST_FRACTIONAL_BITS: u8 = 20;
/// k0 is stored as `COLOUR_SCALE · k0 + 0.5`: room for colours somewhat outside 0..1.
const COLOUR_SCALE: f32 = 0.15;
/// Opacities are stored up to this byte: 255 would come back as an infinite logit.
const LARGEST_ALPHA: f32 = 254.0;
const LOG_SCALE_STEP: f32 = 1.0 / 16.0;
const SMALLEST_LOG_SCALE: f32 = -10.0;
/// What `u8::MAX` stands for.
const LARGEST_LOG_SCALE: f32 = SMALLEST_LOG_SCALE + 255.0 * LOG_SCALE_STEP;
/// Share of splats that may get another size: a few far away, or too small to be seen.
const MOST_RESIZED: f64 = 0.01;
/// Steps of the harmonics of degree 1 (5 bits) and above (4 bits), of 256.
const HARMONIC_STEPS: [i32; 2] = [8, 16];
/// Magnitude of the smaller components of a quaternion, 9 bits for 1/√2.
const QUATERNION_STEPS: f32 = 511.0;

/// The attributes of all splats as bytes: positions, alphas, colours, scales, rotations, harmonics.
#[derive(Default)]
pub struct Streams(pub [Vec<u8>; 6]);

/// As many as leave room for the farthest position.
pub fn fractional_bits(cloud: &SplatCloud) -> Result<u8, ExportError> {
    let farthest = cloud.positions.as_flattened().iter().fold(0.0, |far: f64, &x| far.max(f64::from(x.abs())));
    let fits = |bits: &u8| (farthest * f64::from(1u32 << bits)).round() <= LARGEST_FIXED;
    let too_far = ExportError::TooFar { found: farthest, limit: LARGEST_FIXED };
    (0..=MOST_FRACTIONAL_BITS).rev().find(fits).ok_or(too_far)
}

/// Refuses splats that are mostly smaller or larger than what SPZ holds. Of the smallest only the largest axis counts: surfels
/// are thinner than that.
pub fn check_sizes(cloud: &SplatCloud) -> Result<(), ExportError> {
    let fits = |[x, y, z]: &[f32; 3]| (SMALLEST_LOG_SCALE..=LARGEST_LOG_SCALE).contains(&x.max(*y).max(*z));
    let resized = cloud.log_scales.iter().filter(|scales| !fits(scales)).count();
    if resized as f64 > MOST_RESIZED * cloud.len() as f64 {
        let [smallest, largest] = [SMALLEST_LOG_SCALE, LARGEST_LOG_SCALE].map(|log_scale| f64::from(log_scale).exp());
        return Err(ExportError::Sizes { resized, count: cloud.len(), smallest, largest });
    }
    Ok(())
}

impl Streams {
    /// Bytes of each stream of `count` splats.
    pub fn lengths(count: u32, degree: u8) -> [u64; 6] {
        let rest = 3 * (coefficient_count(usize::from(degree)) - 1);
        [9, 1, 3, 3, 4, rest as u64].map(|bytes| bytes * u64::from(count))
    }

    pub fn of(cloud: &SplatCloud, fractional_bits: u8) -> Self {
        let unit = f64::from(1u32 << fractional_bits);
        let fixed = |&x: &f32| {
            let [a, b, c, _] = ((f64::from(x) * unit).round() as i32).to_le_bytes();
            [a, b, c]
        };
        let rows = || (0..cloud.len()).map(|row| cloud.harmonics_of(row));
        let steps = |index: usize| HARMONIC_STEPS[usize::from(index >= 3)];
        let rest = |k: &[[f32; 3]]| {
            let numbered = k[1..].iter().enumerate();
            numbered.flat_map(|(index, k)| k.map(|k| harmonic(k, steps(index)))).collect::<Vec<_>>()
        };
        let log_scale = |&s: &f32| to_byte((s - SMALLEST_LOG_SCALE) / LOG_SCALE_STEP);
        Self([
            cloud.positions.as_flattened().iter().flat_map(fixed).collect(),
            cloud.opacities.iter().map(|o| to_byte((o * 255.0).min(LARGEST_ALPHA))).collect(),
            rows().flat_map(|k| k[0].map(|k0| to_byte((COLOUR_SCALE * k0 + 0.5) * 255.0))).collect(),
            cloud.log_scales.as_flattened().iter().map(log_scale).collect(),
            cloud.quaternions.iter().flat_map(|&q| pack_quaternion(q).to_le_bytes()).collect(),
            rows().flat_map(rest).collect(),
        ])
    }

    /// Harmonics of `degree`, of the `stored` coefficients above the base colour. Rotations may be those of version 2.
    pub fn to_cloud(&self, degree: usize, stored: usize, fractional_bits: u8, old_rotations: bool) -> SplatCloud {
        let [positions, alphas, colours, scales, rotations, harmonics] = &self.0;
        let unit = f64::from(1u32 << fractional_bits);
        let coordinate = |&[a, b, c]: &[u8; 3]| {
            // shifted up and down again, for the sign
            let fixed = i32::from_le_bytes([0, a, b, c]) >> 8;
            (f64::from(fixed) / unit) as f32
        };
        let coordinates: Vec<f32> = positions.as_chunks::<3>().0.iter().map(coordinate).collect();
        let log_scales = |bytes: &[u8; 3]| bytes.map(|s| SMALLEST_LOG_SCALE + LOG_SCALE_STEP * f32::from(s));
        let base = |k0: u8| (f32::from(k0) / 255.0 - 0.5) / COLOUR_SCALE;
        let kept = 3 * (coefficient_count(degree) - 1);
        let coefficients = |(row, colour): (usize, &[u8; 3])| {
            let rest = &harmonics[3 * row * stored..][..kept];
            let rest = rest.iter().map(|&k| (f32::from(k) - 128.0) / 128.0);
            colour.map(base).into_iter().chain(rest).collect::<Vec<_>>()
        };
        let quaternions = match old_rotations {
            true => rotations.as_chunks::<3>().0.iter().map(|&q| old_quaternion(q)).collect(),
            false => rotations.as_chunks::<4>().0.iter().map(|&q| unpack_quaternion(u32::from_le_bytes(q))).collect(),
        };
        SplatCloud {
            positions: coordinates.as_chunks::<3>().0.to_vec(),
            quaternions,
            log_scales: scales.as_chunks::<3>().0.iter().map(log_scales).collect(),
            opacities: alphas.iter().map(|&o| f32::from(o) / 255.0).collect(),
            degree,
            harmonics: colours.as_chunks::<3>().0.iter().enumerate().flat_map(coefficients).collect(),
            info: SceneInfo::default(),
        }
    }
}

fn to_byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// The nearest multiple of `step` from 128, as 0 is.
fn harmonic(k: f32, step: i32) -> u8 {
    let fine = (k * 128.0).round() as i32 + 128;
    ((fine + step / 2).div_euclid(step) * step).clamp(0, 255) as u8
}

/// (w, x, y, z) as the index of the largest component in the order (x, y, z, w), and the others in that order.
fn pack_quaternion([w, x, y, z]: [f32; 4]) -> u32 {
    let xyzw = [x, y, z, w];
    let largest = (1..4).fold(0, |best, i| if xyzw[i].abs() > xyzw[best].abs() { i } else { best });
    let others = (0..4).filter(|&i| i != largest);
    others.fold(largest as u32, |packed, i| {
        let negative = xyzw[i].is_sign_negative() != xyzw[largest].is_sign_negative();
        let magnitude = (QUATERNION_STEPS * xyzw[i].abs() * std::f32::consts::SQRT_2).round().min(QUATERNION_STEPS);
        packed << 10 | u32::from(negative) << 9 | magnitude as u32
    })
}

fn old_quaternion(xyz: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = xyz.map(|component| f32::from(component) / 127.5 - 1.0);
    [(1.0 - x * x - y * y - z * z).max(0.0).sqrt(), x, y, z]
}

fn unpack_quaternion(packed: u32) -> [f32; 4] {
    let largest = (packed >> 30) as usize;
    let (mut xyzw, mut bits, mut squared) = ([0.0f32; 4], packed, 0.0);
    for i in (0..4).rev().filter(|&i| i != largest) {
        let magnitude = (bits & 511) as f32 / QUATERNION_STEPS * std::f32::consts::FRAC_1_SQRT_2;
        xyzw[i] = if bits >> 9 & 1 == 1 { -magnitude } else { magnitude };
        squared += magnitude * magnitude;
        bits >>= 10;
    }
    xyzw[largest] = (1.0 - squared).max(0.0).sqrt();
    let [x, y, z, w] = xyzw;
    [w, x, y, z]
}

#[cfg(test)]
mod tests {
    use super::super::super::cloud::tests::sample;
    use super::*;

    #[test]
    fn harmonics_are_rounded_to_multiples_around_zero() {
        assert_eq!([0.0, 0.027, 0.032, -0.032, 2.0, -2.0].map(|k| harmonic(k, 8)), [128, 128, 136, 128, 255, 0]);
        assert_eq!(harmonic(0.5, 16), 192);
    }

    #[test]
    fn sizes_that_do_not_fit_are_refused_unless_they_are_few() {
        let with = |count: usize, scales: [f32; 3]| {
            let mut cloud = sample(200, 0);
            cloud.log_scales[..count].fill(scales);
            check_sizes(&cloud)
        };
        for scales in [[-10.1, -12.0, -30.0], [0.0, 6.0, 0.0]] {
            assert!(with(2, scales).is_ok());
            let error = with(3, scales).unwrap_err().to_string();
            assert!(error.contains("3 of 200") && error.contains("4.540e-5") && error.contains("SOG"), "{error}");
        }
        assert!(with(200, [-9.9, -12.0, -30.0]).is_ok());
    }

    #[test]
    fn the_largest_component_is_named_and_the_signs_are_relative_to_it() {
        assert_eq!(pack_quaternion([1.0, 0.0, 0.0, 0.0]), 3 << 30);
        for quaternion in [[-0.6, 0.8, 0.0, 0.0], [0.6, -0.8, -0.0, -0.0]] {
            assert_eq!(pack_quaternion(quaternion), 1 << 9 | 434);
        }
        assert_eq!(unpack_quaternion(1 << 9 | 434).map(|component| (10.0 * component).round()), [-6.0, 8.0, 0.0, 0.0]);
    }
}

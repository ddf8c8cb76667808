//! Shapes of primitives in 32 bytes each, two texels of four 32-bit words.
//!
//! Texel A holds the position and one scalar as f32. Texel B holds the unit quaternion in steps of 2⁻¹⁵ and the
//! log-scales: two of a surfel as f32, three of a Gaussian in steps of 3.1e-5 (21 bits each).

use dpges_core::scene::{GaussianData, SurfelData};

const LARGEST_LOG_SCALE: f32 = 32.0;
const LOG_SCALE_STEPS: f32 = ((1 << 21) - 1) as f32;

/// Texels A and B of every primitive.
#[derive(Debug)]
pub struct Shapes {
    pub places: Vec<[f32; 4]>,
    pub forms: Vec<[u32; 4]>,
}

/// A: position, margin. B: quaternion, log-scales.
pub fn surfels(surfels: &SurfelData) -> Shapes {
    let log_scales = surfels.log_scales.as_chunks::<2>().0.iter().map(|scales| scales.map(f32::to_bits));
    shapes(&surfels.positions, &surfels.margins, &surfels.quaternions, log_scales)
}

/// A: position, opacity. B: quaternion, log-scales.
pub fn gaussians(gaussians: &GaussianData) -> Shapes {
    let log_scales = gaussians.log_scales.as_chunks::<3>().0.iter().map(|&scales| pack_log_scales(scales));
    shapes(&gaussians.positions, &gaussians.opacities, &gaussians.quaternions, log_scales)
}

fn shapes(
    positions: &[f32],
    scalars: &[f32],
    quaternions: &[f32],
    log_scales: impl Iterator<Item = [u32; 2]>,
) -> Shapes {
    let (positions, quaternions) = (positions.as_chunks::<3>().0.iter(), quaternions.as_chunks::<4>().0.iter());
    let forms = quaternions.zip(log_scales).map(|(&quaternion, [low, high])| {
        let [wx, yz] = pack_quaternion(quaternion);
        [wx, yz, low, high]
    });
    let places = positions.zip(scalars).map(|(&[x, y, z], &scalar)| [x, y, z, scalar]);
    Shapes { places: places.collect(), forms: forms.collect() }
}

/// A quaternion (w, x, y, z) at unit length; the identity for a zero quaternion.
pub fn unit_quaternion(quaternion: [f32; 4]) -> [f64; 4] {
    let wide = quaternion.map(f64::from);
    let length = wide.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length > 1e-12 { wide.map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Unit quaternion (w, x, y, z) as four signed 16-bit fractions.
fn pack_quaternion(quaternion: [f32; 4]) -> [u32; 2] {
    let [w, x, y, z] = unit_quaternion(quaternion).map(fraction);
    [w | x << 16, y | z << 16]
}

/// A number from −1 to 1 as a signed 16-bit fraction, in the low bits.
pub fn fraction(value: f64) -> u32 {
    u32::from(((value.clamp(-1.0, 1.0) * 32767.0).round() as i16) as u16)
}

fn pack_log_scales(log_scales: [f32; 3]) -> [u32; 2] {
    let steps = |value: f32| {
        let share = (value + LARGEST_LOG_SCALE) / (2.0 * LARGEST_LOG_SCALE);
        (share.clamp(0.0, 1.0) * LOG_SCALE_STEPS).round() as u64
    };
    let [a, b, c] = log_scales.map(steps);
    let all = a | b << 21 | c << 42;
    [all as u32, (all >> 32) as u32]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpack_log_scales([low, high]: [u32; 2]) -> [f32; 3] {
        let all = u64::from(low) | u64::from(high) << 32;
        [0, 21, 42].map(|shift| {
            let steps = (all >> shift) & ((1 << 21) - 1);
            steps as f32 / LOG_SCALE_STEPS * 2.0 * LARGEST_LOG_SCALE - LARGEST_LOG_SCALE
        })
    }

    #[test]
    fn log_scales_come_back_to_half_a_step_and_are_bounded() {
        for scales in [[0.0, -7.3, 5.21], [-31.9, 31.9, 1e-4]] {
            let found = unpack_log_scales(pack_log_scales(scales));
            assert!(scales.iter().zip(found).all(|(a, b)| (a - b).abs() < 2e-5), "{scales:?} {found:?}");
        }
        assert_eq!(unpack_log_scales(pack_log_scales([-90.0, 90.0, 0.0]))[..2], [-32.0, 32.0]);
    }

    #[test]
    fn quaternions_are_normalised_and_zero_is_the_identity() {
        let signed = |word: u32| [word as u16 as i16, (word >> 16) as u16 as i16];
        assert_eq!(pack_quaternion([0.0; 4]).map(signed), [[32767, 0], [0, 0]]);
        assert_eq!(pack_quaternion([0.0, -3.0, 0.0, 0.0]).map(signed), [[0, -32767], [0, 0]]);
        assert_eq!(pack_quaternion([1e-3, 0.0, 0.0, 1e-3]).map(signed), [[23170, 0], [0, 23170]]);
    }
}

//! Rotations by their three smallest components.

use std::f64::consts::FRAC_1_SQRT_2;

use super::planes::largest;

const LEN: usize = 4;

/// Bits of the symbols of a rotation: the index of the largest component, then the three others in order.
pub const fn bits(bits: u8) -> [u8; LEN] {
    [2, bits, bits, bits]
}

/// Symbols of `quaternions` [N, 4], which need not have unit length, of `bits` per component: N × 4, as [`bits()`] says.
///
/// A rotation has two quaternions; the one with a positive largest component is stored, and that component follows from
/// the others, which lie between −1/√2 and 1/√2. Their 2^bits − 1 levels include 0. A quaternion of zeros has no
/// rotation, and becomes the identity.
pub fn encode(quaternions: &[f32], bits: u8) -> Vec<u32> {
    let half = half_levels(bits);
    let mut symbols = Vec::with_capacity(quaternions.len());
    for quaternion in quaternions.as_chunks::<LEN>().0 {
        let raw = quaternion.map(f64::from);
        let larger = |a: usize, b: usize| if raw[b].abs() > raw[a].abs() { b } else { a };
        let index = (1..LEN).fold(0, larger);
        let length = raw.iter().map(|component| component * component).sum::<f64>().sqrt().copysign(raw[index]);
        symbols.push(index as u32);
        symbols.extend(others(index).map(|component| {
            let unit = if length == 0.0 { 0.0 } else { raw[component] / length };
            ((unit / FRAC_1_SQRT_2 * half).round().clamp(-half, half) + half) as u32
        }));
    }
    symbols
}

/// Undoes [`encode`]: quaternions [N, 4] of unit length with a positive largest component. The other three components are
/// those of the unit quaternion up to half a step, which is 1/√2 / (2^bits − 2).
pub fn decode(symbols: &[u32], bits: u8) -> Result<Vec<f32>, String> {
    let half = half_levels(bits);
    let unused = largest(bits);
    let mut quaternions = Vec::with_capacity(symbols.len());
    for row in symbols.as_chunks::<LEN>().0 {
        let index = row[0] as usize;
        if row[1..].contains(&unused) || index >= LEN {
            return Err(format!("has the symbols {row:?}, expected an index and three symbols below {unused}"));
        }
        let mut unit = [0.0; LEN];
        for (component, &symbol) in others(index).zip(&row[1..]) {
            unit[component] = (f64::from(symbol) - half) / half * FRAC_1_SQRT_2;
        }
        let rest = 1.0 - unit.iter().map(|component| component * component).sum::<f64>();
        // the sum exceeds 1 for symbols that no rotation has
        unit[index] = rest.max(0.0).sqrt();
        quaternions.extend(unit.map(|component| component as f32));
    }
    Ok(quaternions)
}

/// Levels on either side of 0.
fn half_levels(bits: u8) -> f64 {
    f64::from(largest(bits) / 2)
}

fn others(index: usize) -> impl Iterator<Item = usize> {
    (0..LEN).filter(move |&component| component != index)
}

/// Panics unless `found` [N, 4] are the unit quaternions of `raw` [N, 4] up to half a step, but for their largest components.
#[cfg(test)]
pub fn check_within_half_a_step(raw: &[f32], found: &[f32], bits: u8) {
    assert_eq!(raw.len(), found.len());
    let half_step = FRAC_1_SQRT_2 / f64::from(largest(bits) - 1);
    for (raw, found) in raw.as_chunks::<LEN>().0.iter().zip(found.as_chunks::<LEN>().0) {
        let length = raw.iter().map(|&component| f64::from(component).powi(2)).sum::<f64>().sqrt();
        let index = (0..LEN).max_by(|&a, &b| raw[a].abs().total_cmp(&raw[b].abs())).expect("four components");
        for component in others(index) {
            let unit = f64::from(raw[component]) / length.copysign(raw[index].into());
            let error = (unit - f64::from(found[component])).abs();
            assert!(error <= half_step + 1e-7, "{raw:?} became {found:?} at {bits} bits");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn come_back(quaternions: &[f32], bits: u8) -> Vec<f32> {
        decode(&encode(quaternions, bits), bits).unwrap()
    }

    #[test]
    fn components_are_within_half_a_step() {
        let quaternions: Vec<f32> = (0..4000).map(|i| (i as f32 * 0.7).sin() + 0.3 * (i as f32 * 1.9).cos()).collect();
        for bits in [2u8, 3, 6, 8, 12, 16, 24] {
            let found = come_back(&quaternions, bits);
            check_within_half_a_step(&quaternions, &found, bits);
            for unit in found.as_chunks::<4>().0 {
                let length = unit.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>();
                assert!(bits < 6 || (length - 1.0).abs() < 1e-6, "{unit:?}");
            }
        }
    }

    #[test]
    fn rotations_along_the_axes_are_exact_and_signs_do_not_matter() {
        for index in 0..4 {
            let mut axis = [0.0; 4];
            axis[index] = 1.0;
            for factor in [1.0, -3.0, 1e-20, 1e20] {
                for bits in [2, 7, 16] {
                    assert_eq!(come_back(&axis.map(|c: f32| c * factor), bits), axis, "{factor} at {bits} bits");
                }
            }
        }
        let two_axes = [0.5f32.sqrt(), 0.0, 0.0, -(0.5f32.sqrt())];
        assert_eq!(come_back(&two_axes, 8), two_axes);
    }

    #[test]
    fn no_rotation_and_extremes_are_finite() {
        assert_eq!(come_back(&[0.0; 4], 8), [1.0, 0.0, 0.0, 0.0]);
        for value in [f32::MAX, f32::from_bits(1)] {
            assert_eq!(come_back(&[value; 4], 16), come_back(&[1.0; 4], 16));
        }
    }

    #[test]
    fn symbols_that_no_rotation_has_are_errors_or_finite() {
        assert!(decode(&[0, 255, 0, 0], 8).unwrap_err().contains("below 255"));
        let impossible = decode(&[3, 0, 254, 0], 8).unwrap();
        assert!(impossible.iter().all(|component| component.is_finite()) && impossible[3] == 0.0);
    }
}

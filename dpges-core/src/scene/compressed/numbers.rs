//! An attribute whose numbers are kept one by one: bounds of its blocks, then planes of symbols.
//!
//! `groups` says how many neighbouring components share a range; three are red, green and blue.

use super::planes::{self, largest};

/// Bytes of `values` [rows, width], all finite, of which every `block_len` rows are a block, the last may be shorter: the
/// lowest and the highest number of every block and group as little-endian f32, then the [`planes`] of the symbols, of
/// channels only those of green and the differences of the two others from it.
pub fn encode(values: &[f32], groups: &[usize], bits: u8, block_len: usize) -> Vec<u8> {
    let width: usize = groups.iter().sum();
    let steps = f64::from(largest(bits));
    let (mut bytes, mut symbols) = (Vec::new(), vec![0; values.len()]);
    // an attribute of width 0 has no values, whatever the length of its chunks
    let block = (block_len * width).max(1);
    for (values, symbols) in values.chunks(block).zip(symbols.chunks_mut(block)) {
        let mut first = 0;
        for &len in groups {
            let components = first..first + len;
            first += len;
            let numbers = || values.chunks_exact(width).flat_map(|row| &row[components.clone()]).copied();
            let bounds = [numbers().fold(f32::INFINITY, f32::min), numbers().fold(f32::NEG_INFINITY, f32::max)];
            bytes.extend_from_slice(bounds.map(f32::to_le_bytes).as_flattened());
            let [low, high] = bounds.map(f64::from);
            for (row, symbols) in values.chunks_exact(width).zip(symbols.chunks_exact_mut(width)) {
                for (symbol, &value) in symbols[components.clone()].iter_mut().zip(&row[components.clone()]) {
                    // 0 / 0 where all are equal: a cast makes it 0
                    *symbol = ((f64::from(value) - low) / (high - low) * steps).round() as u32;
                }
                subtract_green(&mut symbols[components.clone()], bits);
            }
        }
    }
    bytes.extend(planes::encode(&symbols, &vec![bits; width]));
    bytes
}

/// Undoes [`encode`] for a number of `rows`, up to half a step: half of (high − low) / (2^bits − 1) of the block, and the
/// rounding of `f32`. Results lie within the bounds.
///
/// # Errors
/// A message about `bytes`: bounds of a block that are missing, not finite, or the wrong way round, or see
/// [`planes::decode`].
pub fn decode(bytes: &[u8], rows: usize, groups: &[usize], bits: u8, block_len: usize) -> Result<Vec<f32>, String> {
    let width: usize = groups.iter().sum();
    let bound_bytes = rows.div_ceil(block_len).saturating_mul(groups.len() * 2 * size_of::<f32>());
    let (bounds, rest) = bytes.split_at_checked(bound_bytes).ok_or("ends within the bounds of its blocks")?;
    let bounds: Vec<f32> = bounds.as_chunks::<4>().0.iter().map(|&bound| f32::from_le_bytes(bound)).collect();
    let (ranges, _) = bounds.as_chunks::<2>();
    if let Some([low, high]) = ranges.iter().find(|[low, high]| !(low.is_finite() && high.is_finite() && low <= high)) {
        return Err(format!("has a block from {low} to {high}, expected finite bounds in order"));
    }
    let steps = f64::from(largest(bits));
    let mut symbols = planes::decode(rest, rows, &vec![bits; width])?;
    let mut values = Vec::with_capacity(symbols.len());
    for (at, row) in symbols.chunks_exact_mut(width.max(1)).enumerate() {
        let mut first = 0;
        for (&len, range) in groups.iter().zip(&ranges[at / block_len * groups.len()..]) {
            let group = &mut row[first..first + len];
            first += len;
            add_green(group, bits);
            let [low, high] = range.map(f64::from);
            let value = |symbol: u32| (low + (high - low) * (f64::from(symbol) / steps)).clamp(low, high) as f32;
            values.extend(group.iter().map(|&symbol| value(symbol)));
        }
    }
    Ok(values)
}

/// Replaces red and blue of a group of three by their differences from green: from 0, 1, −1, 2, −2 … on, as 0, 1, 2, 3, 4 …
fn subtract_green(group: &mut [u32], bits: u8) {
    let most = largest(bits);
    let [red, green, blue] = group else { return };
    for other in [red, blue] {
        let difference = other.wrapping_sub(*green) & most;
        *other = if difference <= most / 2 { 2 * difference } else { 2 * (most - difference) + 1 };
    }
}

fn add_green(group: &mut [u32], bits: u8) {
    let most = largest(bits);
    let [red, green, blue] = group else { return };
    for folded in [red, blue] {
        let difference = if *folded % 2 == 0 { *folded / 2 } else { most - *folded / 2 };
        *folded = green.wrapping_add(difference) & most;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::compressed::layout::LOBE_GROUPS as LOBES;
    use crate::scene::compressed::tests::check_groups;

    /// The values come back within half a step of their block and one rounding of `f32`.
    fn check(values: &[f32], groups: &[usize], bits: u8, block_len: usize) {
        let width: usize = groups.iter().sum();
        let bytes = encode(values, groups, bits, block_len);
        let found = decode(&bytes, values.len() / width, groups, bits, block_len).unwrap();
        assert_eq!(found.len(), values.len());
        for (values, found) in values.chunks(block_len * width).zip(found.chunks(block_len * width)) {
            check_groups("numbers", groups, values, found, bits);
        }
    }

    #[test]
    fn errors_are_within_half_a_step() {
        let values: Vec<f32> =
            (0..600).map(|i| 3.0 * (i as f32 * 0.37).sin() + 40.0 * (i as f32 * 0.011).cos()).collect();
        let (most, least) = (f32::MAX, f32::MIN_POSITIVE);
        for bits in 2..=24 {
            for block_len in [1, 7, 2048] {
                check(&values, &[1, 1, 1], bits, block_len);
                check(&values, &LOBES, bits, block_len);
                check(&[most, -most, 0.0, least, -least, f32::from_bits(1), 1e20, -1e-20], &[1], bits, block_len);
            }
        }
        assert!(decode(&encode(&[], &LOBES, 8, 64), 0, &LOBES, 8, 64).unwrap().is_empty());
    }

    #[test]
    fn equal_values_and_the_ends_of_a_block_are_exact() {
        let come_back = |values: &[f32], bits: u8| decode(&encode(values, &[1], bits, 4), values.len(), &[1], bits, 4);
        for values in [vec![0.1f32; 9], vec![-0.0; 9], vec![f32::MAX; 9]] {
            assert_eq!(come_back(&values, 5).unwrap(), values);
        }
        assert_eq!(come_back(&[0.1, 0.7, -0.3, 0.1], 2).unwrap()[1..3], [0.7, -0.3]);
    }

    #[test]
    fn bounds_that_cannot_be_are_told() {
        for bounds in [[f32::NAN, 1.0], [0.0, f32::INFINITY], [2.0, 1.0]] {
            let mut bytes = encode(&[0.5], &[1], 8, 4);
            bytes[..8].copy_from_slice(bounds.map(f32::to_le_bytes).as_flattened());
            assert!(decode(&bytes, 1, &[1], 8, 4).unwrap_err().contains("expected finite bounds in order"));
        }
        assert!(decode(&[0; 7], 1, &[1], 8, 4).unwrap_err().contains("ends within the bounds"));
    }

    #[test]
    fn differences_from_green_are_undone_and_small_ones_stay_small() {
        for bits in [2, 3, 8] {
            let most = largest(bits);
            for (green, other) in (0..=most).flat_map(|green| (0..=most).map(move |other| (green, other))) {
                let before = [other, green, most - other];
                let mut symbols = before;
                subtract_green(&mut symbols, bits);
                assert!(symbols.iter().all(|&symbol| symbol <= most) && symbols[1] == green);
                assert!(green.abs_diff(other) > most / 2 || symbols[0] <= 2 * green.abs_diff(other));
                add_green(&mut symbols, bits);
                assert_eq!(symbols, before);
            }
        }
        let grey: Vec<f32> = (0..5000).flat_map(|i| [(i as f32 * 0.37).sin(); 3]).collect();
        assert!(2 * encode(&grey, &[3], 8, 2048).len() < encode(&grey, &[1, 1, 1], 8, 2048).len());
    }
}

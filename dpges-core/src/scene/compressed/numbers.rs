//! An attribute whose numbers are kept one by one: bounds of its blocks, then planes of symbols.

use super::planes;
use super::quantise::{Groups, Quantised, dequantise, largest, quantise};

/// Bytes of `values` [rows, width]: the [bounds](Quantised::bounds) as little-endian f32, then the [`planes`] of the
/// symbols, of channels only those of green and the differences of the two others from it.
pub fn encode(values: &[f32], groups: &Groups, bits: u8, block_len: usize) -> Vec<u8> {
    let Quantised { bounds, mut symbols } = quantise(values, groups, bits, block_len);
    subtract_green(&mut symbols, groups, bits);
    let mut bytes: Vec<u8> = bounds.iter().flat_map(|bound| bound.to_le_bytes()).collect();
    bytes.extend(planes::encode(&symbols, &vec![bits; groups.width()]));
    bytes
}

/// Undoes [`encode`] for a number of `rows`, up to what [`dequantise`] says.
///
/// # Errors
/// A message about `bytes`: see [`planes::decode`] and [`dequantise`].
pub fn decode(bytes: &[u8], rows: usize, groups: &Groups, bits: u8, block_len: usize) -> Result<Vec<f32>, String> {
    let bound_bytes = rows.div_ceil(block_len).saturating_mul(groups.len() * 2 * size_of::<f32>());
    let (bounds, rest) = bytes.split_at_checked(bound_bytes).ok_or("ends within the bounds of its blocks")?;
    let bounds = bounds.as_chunks::<4>().0.iter().map(|&bound| f32::from_le_bytes(bound)).collect();
    let mut symbols = planes::decode(rest, rows, &vec![bits; groups.width()])?;
    add_green(&mut symbols, groups, bits);
    dequantise(&Quantised { bounds, symbols }, groups, bits, block_len)
}

/// Replaces red and blue by their differences from green: from 0, 1, −1, 2, −2 … on, as 0, 1, 2, 3, 4 …
fn subtract_green(symbols: &mut [u32], groups: &Groups, bits: u8) {
    let most = largest(bits);
    for_channels(symbols, groups, |green, other| {
        let difference = other.wrapping_sub(green) & most;
        if difference <= most / 2 { 2 * difference } else { 2 * (most - difference) + 1 }
    });
}

/// Undoes [`subtract_green`].
fn add_green(symbols: &mut [u32], groups: &Groups, bits: u8) {
    let most = largest(bits);
    for_channels(symbols, groups, |green, folded| {
        let difference = if folded % 2 == 0 { folded / 2 } else { most - folded / 2 };
        green.wrapping_add(difference) & most
    });
}

/// Replaces red and blue by a function of green and themselves.
fn for_channels(symbols: &mut [u32], groups: &Groups, replacement: impl Fn(u32, u32) -> u32) {
    let channels: Vec<usize> = groups.channels().collect();
    for row in symbols.chunks_exact_mut(groups.width().max(1)) {
        for &red in &channels {
            let green = row[red + 1];
            row[red] = replacement(green, row[red]);
            row[red + 2] = replacement(green, row[red + 2]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lobes() -> Groups {
        Groups::new(vec![0, 0, 0, 1, 2, 3])
    }

    #[test]
    fn differences_from_green_are_undone_and_small_ones_stay_small() {
        for bits in [2, 3, 8] {
            let most = largest(bits);
            for green in 0..=most {
                for other in 0..=most {
                    let before = [other, green, most - other, other, 0, green];
                    let mut symbols = before;
                    subtract_green(&mut symbols, &lobes(), bits);
                    assert!(symbols.iter().all(|&symbol| symbol <= most));
                    assert_eq!((symbols[1], &symbols[3..]), (green, &before[3..]));
                    if green.abs_diff(other) <= most / 2 {
                        assert!(symbols[0] <= 2 * green.abs_diff(other));
                    }
                    add_green(&mut symbols, &lobes(), bits);
                    assert_eq!(symbols, before);
                }
            }
        }
    }

    #[test]
    fn numbers_come_back_within_half_a_step() {
        let values: Vec<f32> = (0..6 * 500).map(|i| (i as f32 * 0.37).sin()).collect();
        for bits in [2, 7, 8, 9, 16, 24] {
            let bytes = encode(&values, &lobes(), bits, 64);
            let found = decode(&bytes, 500, &lobes(), bits, 64).unwrap();
            let half_step = 1.0 / largest(bits) as f32;
            assert!(values.iter().zip(&found).all(|(value, found)| (value - found).abs() <= half_step + 1e-6));
        }
        assert!(decode(&encode(&[], &lobes(), 8, 64), 0, &lobes(), 8, 64).unwrap().is_empty());
    }

    #[test]
    fn equal_channels_take_the_room_of_one() {
        let grey: Vec<f32> = (0..5000).flat_map(|i| [(i as f32 * 0.37).sin(); 3]).collect();
        let alone = encode(&grey, &Groups::new(vec![0, 1, 2]), 8, 2048).len();
        assert!(2 * encode(&grey, &Groups::new(vec![0; 3]), 8, 2048).len() < alone);
    }

    #[test]
    fn every_truncation_is_an_error() {
        let values: Vec<f32> = (0..6 * 40).map(|i| (i as f32 * 0.37).sin()).collect();
        let bytes = encode(&values, &lobes(), 9, 16);
        for end in 0..bytes.len() {
            assert!(decode(&bytes[..end], 40, &lobes(), 9, 16).is_err(), "{end} of {} bytes", bytes.len());
        }
    }
}

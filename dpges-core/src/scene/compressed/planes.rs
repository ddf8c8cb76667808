//! Symbols as deflated planes of bytes.

use miniz_oxide::deflate::core::{
    CompressionStrategy, CompressorOxide, TDEFLFlush, TDEFLStatus, compress_to_output,
    create_comp_flags_from_zip_params,
};
use miniz_oxide::inflate::{TINFLStatus, decompress_to_vec_zlib_with_limit};

/// Effort of deflate, up to 10.
const EFFORT: i32 = 9;
/// Window of deflate; a value other than 0 asks for a zlib stream.
const WINDOW_BITS: i32 = 15;

pub const fn largest(bits: u8) -> u32 {
    (1 << bits) - 1
}

/// The planes of `symbols` [rows, width], row-major; those of component i are below 2 to the power of `bits[i]`, and width
/// is the length of `bits`.
///
/// A plane is one byte of one component, of all rows: the lowest bytes of the first component, the next bytes of that
/// component where it has more than 8 bits, and so on. Every plane is a zlib stream with a checksum, behind its length as
/// a little-endian u64. Without rows there are no planes.
pub fn encode(symbols: &[u32], bits: &[u8]) -> Vec<u8> {
    let mut encoded = Vec::new();
    if symbols.is_empty() {
        return encoded;
    }
    for (component, &of) in bits.iter().enumerate() {
        for shift in shifts(of) {
            let column = symbols.iter().skip(component).step_by(bits.len());
            let plane: Vec<u8> = column.map(|symbol| (symbol >> shift) as u8).collect();
            let deflated = deflate(&plane);
            encoded.extend_from_slice(&(deflated.len() as u64).to_le_bytes());
            encoded.extend_from_slice(&deflated);
        }
    }
    encoded
}

/// Undoes [`encode`] for a number of `rows`, never holding more than is expected.
///
/// # Errors
/// A message about `encoded`: too short, too long, not a zlib stream, a stream of another number of rows, a symbol of
/// too many bits.
pub fn decode(encoded: &[u8], rows: usize, bits: &[u8]) -> Result<Vec<u32>, String> {
    let mut symbols = vec![0; rows * bits.len()];
    let mut rest = encoded;
    if !symbols.is_empty() {
        for (component, &of) in bits.iter().enumerate() {
            for shift in shifts(of) {
                let plane = inflate(take(&mut rest)?, rows)?;
                let column = symbols.iter_mut().skip(component).step_by(bits.len());
                column.zip(plane).for_each(|(symbol, byte)| *symbol |= u32::from(byte) << shift);
            }
            let most = largest(of);
            if let Some(&symbol) = symbols.iter().skip(component).step_by(bits.len()).find(|&&symbol| symbol > most) {
                return Err(format!("has the symbol {symbol}, expected at most {most}"));
            }
        }
    }
    if rest.is_empty() { Ok(symbols) } else { Err(format!("has {} bytes too many", rest.len())) }
}

/// Where the bytes of a symbol begin, the lowest first.
fn shifts(bits: u8) -> impl Iterator<Item = u32> {
    (0..u32::from(bits)).step_by(8)
}

/// The next plane of `rest`, still deflated.
fn take<'a>(rest: &mut &'a [u8]) -> Result<&'a [u8], String> {
    let short = || "ends within a plane".to_owned();
    let (length, planes) = rest.split_first_chunk().ok_or_else(short)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| short())?;
    let (plane, left) = planes.split_at_checked(length).ok_or_else(short)?;
    *rest = left;
    Ok(plane)
}

/// A zlib stream of `plane`. Where the bytes are noise, looking for what repeats makes it larger than their statistics
/// alone do: whichever is smaller.
fn deflate(plane: &[u8]) -> Vec<u8> {
    let with = |strategy: CompressionStrategy| {
        let flags = create_comp_flags_from_zip_params(EFFORT, WINDOW_BITS, strategy as i32);
        let mut deflated = Vec::new();
        let (status, _) =
            compress_to_output(&mut CompressorOxide::new(flags), plane, TDEFLFlush::Finish, |bytes: &[u8]| {
                deflated.extend_from_slice(bytes);
                true
            });
        assert!(status == TDEFLStatus::Done, "all of the plane was given, and all that comes of it is taken");
        deflated
    };
    let (repeats, statistics) = (with(CompressionStrategy::Default), with(CompressionStrategy::HuffmanOnly));
    if statistics.len() < repeats.len() { statistics } else { repeats }
}

fn inflate(deflated: &[u8], rows: usize) -> Result<Vec<u8>, String> {
    // room for one byte too many, so that the end of the stream is read, and a longer stream told apart
    match decompress_to_vec_zlib_with_limit(deflated, rows.saturating_add(1)) {
        Ok(plane) if plane.len() == rows => Ok(plane),
        Ok(plane) => Err(format!("has a plane of {} rows, expected {rows}", plane.len())),
        Err(error) if error.status == TINFLStatus::HasMoreOutput => {
            Err(format!("has a plane of more than {rows} rows"))
        }
        Err(error) => Err(format!("has a plane that is broken: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// Some that repeat, some that do not.
    fn symbols(rows: usize, bits: &[u8]) -> Vec<u32> {
        let mut random = Random::new(1);
        let mut symbol = |at: usize| if at.is_multiple_of(3) { at as u32 / 30 } else { random.below(1 << 31) as u32 };
        (0..rows * bits.len()).map(&mut symbol).zip(bits.iter().cycle()).map(|(s, &bits)| s & largest(bits)).collect()
    }

    #[test]
    fn what_was_encoded_is_decoded() {
        for bits in [&[2u8][..], &[8], &[9], &[16, 17], &[24, 2, 8], &[]] {
            for rows in [0, 1, 2, 1000, 70_000] {
                let symbols = symbols(rows, bits);
                let encoded = encode(&symbols, bits);
                assert_eq!(decode(&encoded, rows, bits).unwrap(), symbols, "{rows} rows of {bits:?}");
                assert_eq!(encode(&symbols, bits), encoded);
            }
        }
    }

    #[test]
    fn what_repeats_and_what_is_seldom_takes_little_room() {
        assert!(encode(&[5; 10_000], &[8]).len() < 100);
        let seldom: Vec<u32> = symbols(10_000, &[8]).into_iter().map(|symbol| symbol % 4).collect();
        assert!(encode(&seldom, &[8]).len() < 3200, "two bits each, and a few for the code");
    }

    #[test]
    fn streams_of_another_length_or_content_are_told() {
        let encoded = encode(&symbols(40, &[8]), &[8]);
        assert!(decode(&encoded, 41, &[8]).unwrap_err().contains("40 rows, expected 41"));
        assert!(decode(&encoded, 39, &[8]).is_err());
        assert!(decode(&encoded, 7, &[8]).unwrap_err().contains("more than 7 rows"));
        assert!(decode(&encode(&[200], &[8]), 1, &[7]).unwrap_err().contains("symbol 200, expected at most 127"));
        let mut broken = encoded.clone();
        *broken.last_mut().unwrap() ^= 1;
        assert!(decode(&broken, 40, &[8]).unwrap_err().contains("broken"), "the checksum");
        for length in [u64::MAX, 1 << 63, encoded.len() as u64] {
            let mut lying = encoded.clone();
            lying[..8].copy_from_slice(&length.to_le_bytes());
            assert!(decode(&lying, 40, &[8]).unwrap_err().contains("ends within a plane"));
        }
        assert!(decode(&[&encoded[..], &[0]].concat(), 40, &[8]).unwrap_err().contains("1 bytes too many"));
        let mut nothing = encoded;
        nothing[..8].fill(0);
        assert!(decode(&nothing, 40, &[8]).unwrap_err().contains("broken"));
    }

    #[test]
    fn a_bomb_is_given_up_early() {
        let bomb = encode(&vec![0; 1 << 22], &[8]);
        assert!(bomb.len() < 1 << 13);
        assert!(decode(&bomb, 10, &[8]).unwrap_err().contains("more than 10 rows"));
    }
}

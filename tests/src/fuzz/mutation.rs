//! Changes of the content of a file.

use proptest::collection::vec;
use proptest::prelude::*;

/// A change at a place, which is taken modulo the length of the file.
#[derive(Clone, Debug)]
pub struct Mutation {
    pub at: usize,
    pub what: What,
}

#[derive(Clone, Debug)]
pub enum What {
    /// Flips a bit.
    Flip(u8),
    Truncate,
    Insert(Vec<u8>),
    /// Removes as many bytes.
    Remove(usize),
    /// Repeats as many bytes so often.
    Repeat(usize, usize),
    /// A little-endian integer of so many bytes in place of what is there.
    Integer(usize, u64),
    /// In place of the first decimal number at or after the place.
    Number(String),
}

/// Integers that lengths, counts and types of files go wrong with.
const INTEGERS: [u64; 12] =
    [0, 1, 2, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 1 << 40, 1 << 62, 1 << 63, u64::MAX];

const NUMBERS: &str = "0 -0 -1 1e999 -1e999 1e-320 1e30 NaN inf 9223372036854775808 18446744073709551616 0.1 true null \"\" \
                       [[[[[[[[[[[[[[[[";

/// A few changes.
pub fn mutations() -> impl Strategy<Value = Vec<Mutation>> {
    let what = prop_oneof![
        4 => (0..8u8).prop_map(What::Flip),
        1 => Just(What::Truncate),
        1 => vec(any::<u8>(), 1..9).prop_map(What::Insert),
        1 => (1..40usize).prop_map(What::Remove),
        1 => (1..40usize, 1..200usize).prop_map(|(length, times)| What::Repeat(length, times)),
        3 => (prop::sample::select(vec![1, 2, 4, 8]), prop::sample::select(INTEGERS.to_vec()))
            .prop_map(|(width, value)| What::Integer(width, value)),
        3 => prop::sample::select(NUMBERS.split(' ').collect::<Vec<_>>()).prop_map(|number| What::Number(number.to_owned())),
    ];
    let mutation = (any::<prop::sample::Index>(), what).prop_map(|(at, what)| Mutation { at: at.index(1 << 30), what });
    vec(mutation, 1..4)
}

/// `bytes` after `changes`, one after the other.
pub fn mutated(bytes: &[u8], changes: &[Mutation]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    changes.iter().for_each(|change| apply(&mut bytes, change));
    bytes
}

fn apply(bytes: &mut Vec<u8>, Mutation { at, what }: &Mutation) {
    let length = bytes.len();
    let start = at % (length + 1);
    let end = |count: usize| (start + count).min(length);
    match what {
        What::Flip(bit) => {
            if let Some(byte) = bytes.get_mut(at % length.max(1)) {
                *byte ^= 1 << bit;
            }
        }
        What::Truncate => bytes.truncate(start),
        What::Insert(new) => drop(bytes.splice(start..start, new.iter().copied())),
        What::Remove(count) => drop(bytes.drain(start..end(*count))),
        What::Repeat(count, times) => {
            let part = bytes[start..end(*count)].repeat(*times);
            drop(bytes.splice(start..start, part));
        }
        What::Integer(width, value) => {
            let end = end(*width);
            bytes[start..end].copy_from_slice(&value.to_le_bytes()[..end - start]);
        }
        What::Number(number) => {
            let is_part = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-' | b'+');
            let Some(found) = bytes[start..].iter().position(is_part) else { return };
            let start = start + found;
            let end = bytes[start..].iter().position(|byte| !is_part(byte)).map_or(length, |found| start + found);
            drop(bytes.splice(start..end, number.bytes()));
        }
    }
}

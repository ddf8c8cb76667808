//! Changes of the content of a file.

use proptest::collection::vec;
use proptest::prelude::*;

/// A change. Places are taken modulo the length of the file.
#[derive(Clone, Debug)]
pub enum Mutation {
    Flip {
        at: usize,
        bit: u8,
    },
    Truncate {
        at: usize,
    },
    Insert {
        at: usize,
        bytes: Vec<u8>,
    },
    Remove {
        at: usize,
        length: usize,
    },
    Repeat {
        at: usize,
        length: usize,
        times: usize,
    },
    /// A little-endian integer of `width` bytes in place of what is there.
    Integer {
        at: usize,
        width: usize,
        value: u64,
    },
    /// `number` in place of the first decimal number at or after `at`.
    Number {
        at: usize,
        number: String,
    },
}

/// Integers that lengths, counts and types of files go wrong with.
const INTEGERS: [u64; 12] =
    [0, 1, 2, 0x7f, 0xff, 0xffff, 0x7fff_ffff, 0xffff_ffff, 1 << 40, 1 << 62, 1 << 63, u64::MAX];

const NUMBERS: [&str; 16] = [
    "0",
    "-0",
    "-1",
    "1e999",
    "-1e999",
    "1e-320",
    "1e30",
    "NaN",
    "inf",
    "9223372036854775808",
    "18446744073709551616",
    "0.1",
    "true",
    "null",
    "\"\"",
    "[[[[[[[[[[[[[[[[",
];

/// A few changes.
pub fn mutations() -> impl Strategy<Value = Vec<Mutation>> {
    let at = || any::<prop::sample::Index>().prop_map(|index| index.index(1 << 30));
    let mutation = prop_oneof![
        4 => (at(), 0..8u8).prop_map(|(at, bit)| Mutation::Flip { at, bit }),
        1 => at().prop_map(|at| Mutation::Truncate { at }),
        1 => (at(), vec(any::<u8>(), 1..9)).prop_map(|(at, bytes)| Mutation::Insert { at, bytes }),
        1 => (at(), 1..40usize).prop_map(|(at, length)| Mutation::Remove { at, length }),
        1 => (at(), 1..40usize, 1..200usize).prop_map(|(at, length, times)| Mutation::Repeat { at, length, times }),
        3 => (at(), prop::sample::select(vec![1, 2, 4, 8]), prop::sample::select(INTEGERS.to_vec()))
            .prop_map(|(at, width, value)| Mutation::Integer { at, width, value }),
        3 => (at(), prop::sample::select(NUMBERS.to_vec()))
            .prop_map(|(at, number)| Mutation::Number { at, number: number.to_owned() }),
    ];
    vec(mutation, 1..4)
}

/// `bytes` after `changes`, one after the other.
pub fn mutated(bytes: &[u8], changes: &[Mutation]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    changes.iter().for_each(|change| apply(&mut bytes, change));
    bytes
}

fn apply(bytes: &mut Vec<u8>, change: &Mutation) {
    let length = bytes.len();
    let place = |at: usize| at % (length + 1);
    match change {
        Mutation::Flip { at, bit } => {
            if let Some(byte) = bytes.get_mut(at % length.max(1)) {
                *byte ^= 1 << bit;
            }
        }
        Mutation::Truncate { at } => bytes.truncate(place(*at)),
        Mutation::Insert { at, bytes: new } => drop(bytes.splice(place(*at)..place(*at), new.iter().copied())),
        Mutation::Remove { at, length: count } => drop(bytes.drain(place(*at)..(place(*at) + count).min(length))),
        Mutation::Repeat { at, length: count, times } => {
            let part = bytes[place(*at)..(place(*at) + count).min(length)].repeat(*times);
            drop(bytes.splice(place(*at)..place(*at), part));
        }
        Mutation::Integer { at, width, value } => {
            let start = place(*at);
            let end = (start + width).min(length);
            bytes[start..end].copy_from_slice(&value.to_le_bytes()[..end - start]);
        }
        Mutation::Number { at, number } => {
            let is_part = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-' | b'+');
            let Some(start) = bytes[place(*at)..].iter().position(is_part).map(|found| place(*at) + found) else {
                return;
            };
            let end = bytes[start..].iter().position(|byte| !is_part(byte)).map_or(length, |found| start + found);
            drop(bytes.splice(start..end, number.bytes()));
        }
    }
}

//! FNV-1a, 64 bits: whether two things that should be the same are. It is no protection against malice.

/// The hash of the bytes so far.
#[derive(Clone, Copy, Debug)]
pub struct Hash(u64);

impl Default for Hash {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Hash {
    pub fn of(bytes: &[u8]) -> u64 {
        let mut hash = Self::default();
        hash.add(bytes);
        hash.value()
    }

    pub fn add(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }

    pub fn add_numbers(&mut self, numbers: &[f32]) {
        numbers.iter().for_each(|number| self.add(&number.to_le_bytes()));
    }

    pub fn value(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_strings_have_known_hashes() {
        // of the authors' test vectors
        assert_eq!(
            [Hash::of(b""), Hash::of(b"a"), Hash::of(b"foobar")],
            [0xcbf2_9ce4_8422_2325, 0xaf63_dc4c_8601_ec8c, 0x8594_4171_f739_67e8]
        );
        let mut hash = Hash::default();
        hash.add_numbers(&[1.0, -2.0]);
        assert_eq!(hash.value(), Hash::of(&[0, 0, 128, 63, 0, 0, 0, 192]));
    }
}

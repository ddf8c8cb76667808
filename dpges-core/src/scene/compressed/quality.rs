//! How many bits every attribute has.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::scene::schema::RateGroup;

/// Bits per number of every attribute of surfels and Gaussians, from [`MIN_BITS`](Self::MIN_BITS) to
/// [`MAX_BITS`](Self::MAX_BITS). The coefficients of an environment are kept as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quality {
    pub positions: u8,
    /// Bits of each of the three smallest components of a rotation.
    pub quaternions: u8,
    pub log_scales: u8,
    pub opacities: u8,
    /// Bits of the depth margins, and of everything else that does not learn.
    pub margins: u8,
    pub base: u8,
    /// Bits of lobes, or of the higher coefficients of harmonics.
    pub detail: u8,
}

impl Quality {
    pub const MIN_BITS: u8 = 2;
    pub const MAX_BITS: u8 = 24;

    /// 16 bits and more: what is lost is far below what a photograph can show.
    pub const HIGHEST: Self = Self { positions: 20, ..Self::even(16) };
    /// Room for scenes that are looked at from closer than their photographs.
    pub const HIGH: Self = Self { positions: 15, margins: 8, ..Self::even(9) };
    /// For most uses.
    pub const MEDIUM: Self = Self { positions: 12, margins: 6, ..Self::even(7) };
    /// Where size matters most.
    pub const LOW: Self = Self { positions: 11, margins: 4, detail: 5, ..Self::even(6) };

    /// Every level with its name, the best first.
    pub const LEVELS: [(&str, Self); 4] =
        [("highest", Self::HIGHEST), ("high", Self::HIGH), ("medium", Self::MEDIUM), ("low", Self::LOW)];

    /// The names of the numbers of [`list`](Self::list).
    pub const NAMES: [&str; 7] = ["positions", "quaternions", "log_scales", "opacities", "margins", "base", "detail"];

    const fn even(bits: u8) -> Self {
        Self::from_list([bits; 7])
    }

    /// Bits per number of every attribute, in the order of [`NAMES`](Self::NAMES).
    pub const fn list(&self) -> [u8; 7] {
        let Self { positions, quaternions, log_scales, opacities, margins, base, detail } = *self;
        [positions, quaternions, log_scales, opacities, margins, base, detail]
    }

    pub const fn from_list(bits: [u8; 7]) -> Self {
        let [positions, quaternions, log_scales, opacities, margins, base, detail] = bits;
        Self { positions, quaternions, log_scales, opacities, margins, base, detail }
    }

    pub(super) const fn bits(&self, group: RateGroup) -> u8 {
        match group {
            RateGroup::Positions => self.positions,
            RateGroup::Quaternions => self.quaternions,
            RateGroup::LogScales => self.log_scales,
            RateGroup::Opacities | RateGroup::DegreesOfFreedom | RateGroup::OpacityBase | RateGroup::OpacityDetail => {
                self.opacities
            }
            RateGroup::Fixed => self.margins,
            RateGroup::Base => self.base,
            RateGroup::Detail | RateGroup::WeightedSum | RateGroup::Environment | RateGroup::Exposure => self.detail,
        }
    }

    /// # Errors
    /// [`Error::Option`] naming the first attribute whose number of bits is out of range.
    pub fn check(&self) -> Result<()> {
        let (least, most) = (Self::MIN_BITS, Self::MAX_BITS);
        let wrong = Self::NAMES.into_iter().zip(self.list()).find(|(_, bits)| !(least..=most).contains(bits));
        wrong.map_or(Ok(()), |(option, bits)| {
            Err(Error::Option { option, expected: format!("{least} to {most} bits"), found: format!("{bits} bits") })
        })
    }
}

impl Default for Quality {
    fn default() -> Self {
        Self::MEDIUM
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_attribute_of_a_better_level_has_fewer_bits() {
        for pair in Quality::LEVELS.windows(2) {
            let [(_, better), (name, worse)] = pair else { unreachable!("pairs") };
            assert!(better.list().iter().zip(worse.list()).all(|(better, worse)| *better >= worse), "{name}");
            assert!(better.check().is_ok() && worse.check().is_ok());
        }
    }

    #[test]
    fn lists_have_the_order_of_the_names() {
        let bits = [2, 3, 4, 5, 6, 7, 8];
        let quality = Quality::from_list(bits);
        assert_eq!(quality.list(), bits);
        let json = serde_json::to_value(quality).unwrap();
        assert!(Quality::NAMES.into_iter().zip(bits).all(|(name, bits)| json[name] == bits));
    }

    #[test]
    fn bits_out_of_range_are_named() {
        for (bits, found) in [(1, "1 bits"), (25, "25 bits")] {
            let error = Quality { base: bits, ..Quality::HIGH }.check().unwrap_err().to_string();
            assert!(error.contains("`base`") && error.contains(found) && error.contains("2 to 24"), "{error}");
        }
    }
}

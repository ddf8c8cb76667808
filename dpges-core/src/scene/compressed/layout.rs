//! The header of a compressed scene, and the storage of every attribute.

use serde::{Deserialize, Serialize};

use super::Quality;
use crate::scene::schema::{Attribute, Columns, RateGroup, Width};
use crate::scene::{ColourModel, GaussianData, SurfelData};

/// Primitives, or lobes, of a block.
const BLOCK_LEN: u32 = 2048;
/// A scene takes no more memory than this many times the size of its file, and [`SMALL`] besides.
const LARGEST_RATIO: u64 = 256;
/// Bytes of memory that no file is too small for.
const SMALL: u64 = 64 << 20;

/// The entry `compressed` of the metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layout {
    pub surfels: u64,
    pub gaussians: u64,
    block_len: u32,
    pub bits: Quality,
}

impl Layout {
    pub fn new(surfels: usize, gaussians: usize, bits: Quality) -> Self {
        Self { surfels: surfels as u64, gaussians: gaussians as u64, block_len: BLOCK_LEN, bits }
    }

    pub fn block_len(&self) -> usize {
        self.block_len as usize
    }

    /// Whether a file of `file_len` bytes may hold such a scene under `model`: so that memory is bounded by the size of
    /// the file, whatever it claims.
    pub fn check(&self, model: ColourModel, file_len: usize) -> Result<(), String> {
        self.bits.check().map_err(|error| error.to_string())?;
        if self.block_len == 0 {
            return Err("`block_len` is 0, expected at least 1".to_owned());
        }
        let bytes = |attributes: &[Attribute], count: u64| {
            let numbers = attributes.iter().map(|attribute| attribute.width.under(model)).sum::<usize>();
            count.checked_mul((size_of::<f32>() * numbers) as u64)
        };
        let surfels = bytes(SurfelData::ATTRIBUTES, self.surfels);
        let gaussians = bytes(GaussianData::ATTRIBUTES, self.gaussians);
        let total = surfels.zip(gaussians).and_then(|(surfels, gaussians)| surfels.checked_add(gaussians));
        let most = SMALL.saturating_add(LARGEST_RATIO.saturating_mul(file_len as u64));
        match total.filter(|&bytes| bytes <= most && isize::try_from(bytes).is_ok()) {
            Some(_) => Ok(()),
            None => Err(format!(
                "{} surfels and {} Gaussians are more than a compressed file of {file_len} bytes may hold, expected at \
                 most {most} bytes of numbers",
                self.surfels, self.gaussians
            )),
        }
    }
}

/// How the numbers of an attribute are kept.
pub enum Kept {
    /// [One by one](super::numbers), in these groups.
    Numbers(Vec<usize>),
    Rotations,
    /// As counts of the lobes that are there, of so many, and as the [numbers](LOBE_GROUPS) of those lobes.
    Lobes(usize),
}

impl Kept {
    pub fn of(attribute: &Attribute, model: ColourModel) -> Self {
        let width = attribute.width.under(model);
        match (attribute.rate, attribute.width, model) {
            (RateGroup::Quaternions, ..) => Self::Rotations,
            (_, Width::Detail, ColourModel::SphericalBeta { lobes }) => Self::Lobes(lobes),
            // red, green and blue of one coefficient after the other
            (RateGroup::Base | RateGroup::Detail, ..) => Self::Numbers(vec![3; width / 3]),
            _ => Self::Numbers(vec![1; width]),
        }
    }
}

/// Groups of a lobe: red, green and blue share a range, the others do not.
pub const LOBE_GROUPS: [usize; 4] = [3, 1, 1, 1];

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_LOBES: ColourModel = ColourModel::SphericalBeta { lobes: 2 };

    #[test]
    fn memory_is_bounded_by_the_size_of_the_file() {
        let check = |surfels: u64, gaussians: u64, file_len: usize| {
            Layout { surfels, gaussians, ..Layout::new(0, 0, Quality::LOW) }.check(TWO_LOBES, file_len)
        };
        // a surfel has 25 numbers, a Gaussian 26
        assert!(check(SMALL / 100, 0, 0).is_ok() && check(SMALL / 100 + 1, 0, 0).is_err());
        assert!(check(0, SMALL / 104, 0).is_ok() && check(0, SMALL / 104 + 1, 0).is_err());
        assert!(check(SMALL / 100 + 1, 0, 1).is_ok());
        for lie in [u64::MAX, 1 << 63, 1 << 40] {
            for error in [check(lie, 0, 1_000_000), check(0, lie, 1_000_000), check(lie, lie, 1_000_000)] {
                assert!(error.unwrap_err().contains("more than a compressed file of 1000000 bytes may hold"));
            }
        }
    }

    #[test]
    fn colours_share_a_range() {
        let groups = |attribute: &Attribute, model: &str| match Kept::of(attribute, model.parse().unwrap()) {
            Kept::Numbers(groups) => groups,
            _ => panic!("{} is kept as numbers", attribute.name),
        };
        let [positions, quaternions, log_scales, .., base, detail] = GaussianData::ATTRIBUTES else { panic!() };
        assert_eq!([groups(positions, "sh1"), groups(log_scales, "sb2")], [[1, 1, 1], [1, 1, 1]]);
        assert_eq!((groups(base, "sb2"), groups(detail, "sh1")), (vec![3], vec![3, 3, 3]));
        assert!(matches!(Kept::of(detail, TWO_LOBES), Kept::Lobes(2)));
        assert!(matches!(Kept::of(quaternions, TWO_LOBES), Kept::Rotations));
    }
}

//! The compressed scene file: a quarter to a sixth of the [scene file](super::file), with a bounded error per number.
//!
//! It is a safetensors file as well, and is read by whatever reads scene files: [`SceneData::load`] and
//! [`SceneData::from_bytes`] tell the two apart. [`SceneData::save_compressed`] writes it.
//!
//! # Metadata
//!
//! `format` = "dpges-scene-compressed", `version` = "1", `info` = [`SceneInfo`] as JSON, and `compressed`, JSON like
//!
//! ```json
//! {"surfels": 5168, "gaussians": 32507, "block_len": 2048, "bits": {"positions": 12, "quaternions": 7, …}}
//! ```
//!
//! with the numbers of primitives, the rows of a block, and the [`Quality`]: bits b of a number of every attribute.
//!
//! # Tensors
//!
//! Every attribute of the [schema](super::schema) is one tensor of bytes with the name of the attribute. Surfels, and
//! Gaussians, are in the order of a Morton curve through the bounding box of their positions, so that those of a block
//! are near each other. The order of primitives has no meaning.
//!
//! | attribute | bytes |
//! |---|---|
//! | all but the following | bounds, then planes |
//! | `quaternions` | planes of the index of the largest component of the unit quaternion (2 bits) and of the three others |
//! | `colour.detail` of spherical Beta colours | two tensors in its place: `colour.lobe_counts`, planes of 8 bits, and `colour.lobes`, bounds and planes of the lobes that are there, as in the scene file |
//!
//! *Bounds* are the lowest and the highest value of every block and group, little-endian f32 [blocks, groups, 2]. A
//! component is a group, but the red, green and blue of a coefficient or lobe are one together.
//!
//! A *symbol* is a number of b bits: the value is `low + (high − low) · symbol / (2^b − 1)` of its block and group. Red and
//! blue are kept as differences d from the symbol of green, modulo 2^b, folded: 2 d from 0 on, −2 d − 1 below. A component
//! of a rotation is `(symbol − h) / h / √2` with h = 2^(b−1) − 1; the largest is positive and makes the length 1.
//!
//! *Planes* are all rows of one byte of a component, its lowest byte first, component after component; each is a zlib
//! stream behind its length, a little-endian u64. A set without rows has no planes.
//!
//! The `environment`, if there is one, is as in the scene file.
//!
//! # Errors of a number
//!
//! Half a step: (high − low) / (2^b − 1) / 2 of its block, and one rounding of f32. Half a step of the three smallest
//! components of a unit quaternion is 1/√2 / (2^b − 2); its length and its sign, which mean nothing, are lost. Numbers that are
//! equal throughout a block, the bounds of a block, counts of lobes, and the environment are exact.
//!
//! # Files of strangers
//!
//! The reader holds the numbers that the header claims only if they are at most 64 MiB and 256 times the size of the
//! file together; every stream is inflated no farther than to the rows that are expected, and has a checksum. Values lie
//! within the bounds, which have to be finite.

mod layout;
mod numbers;
mod order;
mod planes;
mod quality;
mod rotation;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use safetensors::SafeTensors;

use self::layout::{Kept, LOBE_GROUPS, Layout};
use super::container::{Rows, lobe_names, payload, scene_file};
use super::lobes::{pack, unpack};
use super::schema::Columns;
use super::{ColourModel, GaussianData, Rendering, SceneData, SceneInfo, SurfelData};
use crate::error::{Error, Result};
use crate::scene::atomic::write_atomically;

pub use order::along_morton_curve;
pub use quality::Quality;

pub(super) const FORMAT: &str = "dpges-scene-compressed";
pub(super) const VERSION: &str = "1";
/// Entry of the metadata.
const LAYOUT: &str = "compressed";
/// Bits of a count of lobes.
const COUNT_BITS: u8 = 8;

impl SceneData {
    /// Writes the compressed scene file; an existing file is replaced only once the new one is complete.
    ///
    /// # Errors
    /// The errors of [`to_compressed`](Self::to_compressed), [`Error::Io`].
    pub fn save_compressed(&self, path: &Path, quality: &Quality) -> Result<()> {
        let bytes = self.to_compressed(quality, path)?;
        write_atomically(path, |file| file.write_all(&bytes))
    }

    /// The bytes of the compressed scene file, which depend on nothing but the scene and the quality. Errors name it
    /// `path`.
    ///
    /// # Errors
    /// [`Error::Option`] naming the attribute with too few or too many bits, [`Error::Shape`] or [`Error::NonFinite`]
    /// naming the tensor, [`Error::SceneFile`] naming the field of the info that is out of range, if kernels are Student's t,
    /// or if the scene repeats itself so much that no reader would trust the file.
    pub fn to_compressed(&self, quality: &Quality, path: &Path) -> Result<Vec<u8>> {
        let wrong = |reason| Error::SceneFile { path: path.to_owned(), reason };
        quality.check()?;
        self.validate(path)?;
        if self.info.rendering == Rendering::Students {
            return Err(wrong(
                "a scene of Student's t kernels (SSS) cannot be compressed; save it as it is".to_owned(),
            ));
        }
        let model = self.info.colour_model;
        let layout = Layout::new(self.surfels.len(), self.gaussians.len(), *quality);
        let mut stored = Vec::new();
        let surfels = self.surfels.select(&along_morton_curve(&self.surfels.positions));
        store(&surfels, surfels.len(), model, &layout, &mut stored);
        let gaussians = self.gaussians.select(&along_morton_curve(&self.gaussians.positions));
        store(&gaussians, gaussians.len(), model, &layout, &mut stored);
        let of_layout = serde_json::to_string(&layout).map_err(|error| wrong(error.to_string()))?;
        let more = Some((LAYOUT, of_layout));
        let bytes = scene_file(self, stored, [FORMAT, VERSION], more).map_err(wrong)?;
        layout.check(model, bytes.len()).map_err(wrong)?;
        Ok(bytes)
    }
}

fn store<C: Columns<Value = Vec<f32>>>(
    columns: &C,
    count: usize,
    model: ColourModel,
    layout: &Layout,
    stored: &mut Vec<Rows<'_>>,
) {
    let block_len = layout.block_len();
    for (attribute, values) in columns.iter().filter(|(attribute, _)| !attribute.is_left_out(model)) {
        let bits = layout.bits.bits(attribute.rate);
        match Kept::of(attribute, model) {
            Kept::Numbers(groups) => {
                stored.push(Rows::bytes(attribute.name, numbers::encode(values, &groups, bits, block_len)));
            }
            Kept::Rotations => {
                let symbols = rotation::encode(values, bits);
                stored.push(Rows::bytes(attribute.name, planes::encode(&symbols, &rotation::bits(bits))));
            }
            Kept::Lobes(lobes) => {
                let (counts, present) = pack(values, count, lobes);
                let counts: Vec<u32> = counts.into_iter().map(u32::from).collect();
                let [counted, listed] = lobe_names(attribute);
                stored.push(Rows::bytes(counted, planes::encode(&counts, &[COUNT_BITS])));
                stored.push(Rows::bytes(listed, numbers::encode(&present, &LOBE_GROUPS, bits, block_len)));
            }
        }
    }
}

/// The primitives of a compressed file of `file_len` bytes.
pub(super) fn read(
    file: &SafeTensors,
    metadata: &HashMap<String, String>,
    info: &SceneInfo,
    file_len: usize,
) -> Result<(SurfelData, GaussianData), String> {
    let layout = metadata.get(LAYOUT).ok_or_else(|| format!("metadata `{LAYOUT}` is missing"))?;
    let layout: Layout = serde_json::from_str(layout).map_err(|error| format!("metadata `{LAYOUT}`: {error}"))?;
    layout.check(info.colour_model, file_len)?;
    let surfels = read_columns::<SurfelData>(file, layout.surfels as usize, info.colour_model, &layout)?;
    let gaussians = read_columns::<GaussianData>(file, layout.gaussians as usize, info.colour_model, &layout)?;
    Ok((surfels, gaussians))
}

fn read_columns<C: Columns>(
    file: &SafeTensors,
    count: usize,
    model: ColourModel,
    layout: &Layout,
) -> Result<C::With<Vec<f32>>, String> {
    let block_len = layout.block_len();
    C::try_generate(model, |attribute| {
        if attribute.is_left_out(model) {
            return Ok(Vec::new());
        }
        let bits = layout.bits.bits(attribute.rate);
        let named = |name: &str, reason: String| format!("tensor `{name}` {reason}");
        let name = attribute.name;
        match Kept::of(attribute, model) {
            Kept::Numbers(groups) => numbers::decode(payload(file, name)?, count, &groups, bits, block_len)
                .map_err(|reason| named(name, reason)),
            Kept::Rotations => planes::decode(payload(file, name)?, count, &rotation::bits(bits))
                .and_then(|symbols| rotation::decode(&symbols, bits))
                .map_err(|reason| named(name, reason)),
            Kept::Lobes(lobes) => {
                let [counted, listed] = lobe_names(attribute);
                let counts = planes::decode(payload(file, counted)?, count, &[COUNT_BITS])
                    .map_err(|reason| named(counted, reason))?;
                // 8 bits each
                let counts: Vec<u8> = counts.into_iter().map(|count| count as u8).collect();
                let total = counts.iter().map(|&count| usize::from(count).min(lobes)).sum();
                let present = numbers::decode(payload(file, listed)?, total, &LOBE_GROUPS, bits, block_len)
                    .map_err(|reason| named(listed, reason))?;
                unpack(&counts, &present, lobes).map_err(|reason| named(counted, reason))
            }
        }
    })
}

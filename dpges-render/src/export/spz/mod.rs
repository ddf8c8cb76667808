//! Splats in an SPZ file (Niantic): quantised, about a tenth of the size of a PLY file.
//!
//! Version 4 is a header of 32 bytes, records of extensions, a table with the compressed and the plain size of each stream, and
//! one Zstandard stream per attribute; attributes without numbers have no stream. Versions 2 and 3 are a header of 16 bytes and
//! the same streams one after the other, all of it compressed by gzip. All are little endian. The streams hold, in this order:
//!
//! | stream | per splat | value |
//! |---|---|---|
//! | positions | 3 × 24 bits, signed | fixed point, with as many fractional bits as the header says |
//! | alphas | 1 byte | opacity × 255 |
//! | colours | 3 bytes | (0.15 k0 + 0.5) × 255 |
//! | scales | 3 bytes | (ln s + 10) × 16 |
//! | rotations | 32 bits | index of the largest component, the three others with 9 bits and a sign; in version 2 x, y, z as bytes |
//! | harmonics | 3 bytes per coefficient | 128 k + 128, rounded to 5 bits in degree 1 and to 4 bits above |
//!
//! SPZ has axes with x right, y up, and z towards the viewer (RUB); [`Up`] says how they come about. All that a file says of
//! its scene stands in a record of version 4, and in the comment of gzip in version 3, which other programs pass over.

mod quantise;

use std::io::{Read, Write};

use dpges_core::scene::{Rendering, SceneInfo, ScreenFilter};
use flate2::read::GzDecoder;
use flate2::{Compression, GzBuilder};

use self::quantise::{Streams, check_sizes, fractional_bits};
use super::cloud::SplatCloud;
use super::error::ExportError;
use super::harmonics::coefficient_count;
use super::notes::{Notes, kept_degree};
use super::{SAYS_ALL, all_of};
use crate::up::Up;

const MAGIC: [u8; 4] = *b"NGSP";
const HEADER_LEN: usize = 32;
const LEGACY_HEADER_LEN: usize = 16;
const ENTRY_LEN: usize = 16;
/// The splats are made for a low-pass filter that dims what it widens (Mip-Splatting).
const ANTIALIASED: u8 = 1;
const HAS_EXTENSIONS: u8 = 2;
/// Type of the record with all that a file says of its scene; the upper half is the vendor.
const RECORD: u32 = 0xd9e5_0001;
/// Level that Niantic's library uses.
const ZSTD_LEVEL: i32 = 12;

/// Versions that are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// gzip; what most readers understand.
    Three,
    /// Zstandard.
    #[default]
    Four,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Header {
    count: u32,
    degree: u8,
    fractional_bits: u8,
    flags: u8,
}

impl Header {
    /// The first 16 bytes of a file of `version`, with the number of streams, which version 3 does not say.
    fn bytes(self, version: u32, streams: u8) -> Vec<u8> {
        let last = [self.degree, self.fractional_bits, self.flags, streams];
        [MAGIC, version.to_le_bytes(), self.count.to_le_bytes(), last].concat()
    }
}

/// The bytes of the file of `cloud`, turned upright.
///
/// # Errors
/// [`ExportError::TooFar`] if a position does not fit, [`ExportError::Sizes`] if many sizes do not, [`ExportError::TooMany`].
pub fn to_spz(cloud: &SplatCloud, version: SpzVersion) -> Result<Vec<u8>, ExportError> {
    let cloud = cloud.rotated(Up::of(&cloud.info).to_rub());
    let limit = i32::MAX as usize;
    let count = u32::try_from(cloud.len()).ok().filter(|_| cloud.len() <= limit);
    let count = count.ok_or(ExportError::TooMany { count: cloud.len(), limit })?;
    let fractional_bits = fractional_bits(&cloud)?;
    check_sizes(&cloud)?;
    let flags = if cloud.info.screen_filter == ScreenFilter::Compensated { ANTIALIASED } else { 0 };
    let header = Header { count, degree: cloud.degree as u8, fractional_bits, flags };
    let (streams, said) = (Streams::of(&cloud, fractional_bits), all_of(&cloud.info));
    let written = match version {
        SpzVersion::Three => write_gzip(header, &streams, &said),
        SpzVersion::Four => write_zstd(header, &streams, &said),
    };
    Ok(written.expect("memory takes all that is written"))
}

fn write_gzip(header: Header, streams: &Streams, said: &str) -> std::io::Result<Vec<u8>> {
    let comment = format!("{SAYS_ALL}{said}");
    let mut encoder = GzBuilder::new().comment(comment).write(Vec::new(), Compression::default());
    encoder.write_all(&header.bytes(3, 0))?;
    streams.0.iter().try_for_each(|stream| encoder.write_all(stream))?;
    encoder.finish()
}

fn write_zstd(header: Header, streams: &Streams, said: &str) -> std::io::Result<Vec<u8>> {
    let plain: Vec<&Vec<u8>> = streams.0.iter().filter(|stream| !stream.is_empty()).collect();
    let mut compressor = zstd::bulk::Compressor::new(ZSTD_LEVEL)?;
    compressor.set_parameter(zstd::zstd_safe::CParameter::ChecksumFlag(true))?;
    let compressed = plain.iter().map(|stream| compressor.compress(stream)).collect::<std::io::Result<Vec<_>>>()?;
    let mut bytes = Header { flags: header.flags | HAS_EXTENSIONS, ..header }.bytes(4, plain.len() as u8);
    bytes.extend(((HEADER_LEN + 8 + said.len()) as u32).to_le_bytes());
    bytes.resize(HEADER_LEN, 0);
    [RECORD, said.len() as u32].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
    bytes.extend(said.as_bytes());
    for (plain, compressed) in plain.iter().zip(&compressed) {
        bytes.extend((compressed.len() as u64).to_le_bytes());
        bytes.extend((plain.len() as u64).to_le_bytes());
    }
    compressed.iter().for_each(|stream| bytes.extend(stream));
    Ok(bytes)
}

/// The splats of a file of version 2 to 4, in axes with −y upwards if it does not say what is up in its scene.
pub(super) fn read(bytes: &[u8]) -> Result<(SplatCloud, Notes), String> {
    let File { header, version, streams, said } =
        if bytes.starts_with(&MAGIC) { read_zstd(bytes) } else { read_gzip(bytes) }?;
    let mut notes = Notes { own: said.is_some(), ..Notes::default() };
    let stored = coefficient_count(usize::from(header.degree)) - 1;
    let degree = kept_degree(stored, &mut notes)?;
    let filter = if header.flags & ANTIALIASED == 0 { ScreenFilter::Plain } else { ScreenFilter::Compensated };
    let foreign = || SceneInfo { screen_filter: filter, rendering: Rendering::Ellipsoids, ..SceneInfo::default() };
    let info = said.unwrap_or_else(foreign);
    let cloud = streams.to_cloud(degree, stored, header.fractional_bits, version == 2);
    let to_scene = Up::of(&info).to_rub().transpose();
    Ok((SplatCloud { info, ..cloud.rotated(to_scene) }, notes))
}

/// The content of a file.
struct File {
    header: Header,
    version: u64,
    streams: Streams,
    said: Option<SceneInfo>,
}

fn read_gzip(bytes: &[u8]) -> Result<File, String> {
    let mut decoder = GzDecoder::new(bytes);
    let mut head = [0; LEGACY_HEADER_LEN];
    let failed = |error: std::io::Error| format!("it is neither version 4 nor gzip, or truncated ({error})");
    decoder.read_exact(&mut head).map_err(failed)?;
    let (header, version) = parse_header(&head, [2, 3])?;
    let mut streams = Streams::default();
    let mut lengths = Streams::lengths(header.count, header.degree);
    if version == 2 {
        lengths[4] = 3 * u64::from(header.count);
    }
    for (stream, len) in streams.0.iter_mut().zip(lengths) {
        // read as far as there is something: a header that lies must not take the memory
        let read = decoder.by_ref().take(len).read_to_end(stream).map_err(failed)?;
        if read as u64 != len {
            return Err(format!("it ends early: a stream has {read} of {len} bytes"));
        }
    }
    // the checksum is at the end
    std::io::copy(&mut decoder, &mut std::io::sink()).map_err(|error| format!("it is damaged ({error})"))?;
    let comment = decoder
        .header()
        .and_then(|header| header.comment())
        .and_then(|comment| comment.strip_prefix(SAYS_ALL.as_bytes()));
    let said = comment.and_then(|text| serde_json::from_slice(text).ok());
    Ok(File { header, version, streams, said })
}

fn read_zstd(bytes: &[u8]) -> Result<File, String> {
    let head = bytes.get(..HEADER_LEN).ok_or("its header is truncated")?;
    let (header, version) = parse_header(head, [4, 4])?;
    let (stream_count, table_at) = (usize::from(head[15]), number::<4>(head, 16) as usize);
    let mut streams = Streams::default();
    let lengths = Streams::lengths(header.count, header.degree);
    let wanted: Vec<_> = streams.0.iter_mut().zip(lengths).filter(|(_, len)| *len > 0).collect();
    if wanted.len() != stream_count {
        return Err(format!("it has {stream_count} streams, expected {}", wanted.len()));
    }
    let table = bytes.get(table_at..table_at.saturating_add(ENTRY_LEN * stream_count));
    let table = table.filter(|_| table_at >= HEADER_LEN).ok_or("its table of streams is truncated")?;
    let mut rest = &bytes[table_at + table.len()..];
    for (index, (stream, len)) in wanted.into_iter().enumerate() {
        let (packed, plain) = (number::<8>(table, ENTRY_LEN * index), number::<8>(table, ENTRY_LEN * index + 8));
        if plain != len {
            return Err(format!("stream {index} has {plain} bytes, expected {len}"));
        }
        let packed = usize::try_from(packed).ok().filter(|&packed| packed <= rest.len());
        let (compressed, after) = rest.split_at(packed.ok_or(format!("stream {index} is truncated"))?);
        let mut decoder = zstd::stream::read::Decoder::new(compressed).map_err(|error| error.to_string())?;
        let failed = |error: std::io::Error| format!("stream {index}: {error}");
        decoder.by_ref().take(len).read_to_end(stream).map_err(failed)?;
        if stream.len() as u64 != len {
            return Err(format!("stream {index} ends early"));
        }
        // the checksum is at the end
        if decoder.read(&mut [0]).map_err(failed)? > 0 {
            return Err(format!("stream {index} goes on behind its end"));
        }
        rest = after;
    }
    let said = said_in(&bytes[HEADER_LEN..table_at]);
    Ok(File { header, version, streams, said })
}

/// Our record among those of extensions.
fn said_in(mut records: &[u8]) -> Option<SceneInfo> {
    while records.len() >= 8 {
        let (kind, len) = (number::<4>(records, 0), number::<4>(records, 4) as usize);
        let payload = records.get(8..)?.get(..len)?;
        if kind == u64::from(RECORD) {
            return serde_json::from_slice(payload).ok();
        }
        records = &records[8 + len..];
    }
    None
}

fn parse_header(head: &[u8], [oldest, newest]: [u64; 2]) -> Result<(Header, u64), String> {
    if head[..4] != MAGIC {
        return Err("it is no SPZ file".to_owned());
    }
    let version = number::<4>(head, 4);
    if !(oldest..=newest).contains(&version) {
        return Err(format!("it has version {version}, expected 2, 3 or 4"));
    }
    let [degree, fractional_bits, flags] = [head[12], head[13], head[14]];
    if degree > 4 || fractional_bits > 23 {
        return Err(format!("degree {degree} or {fractional_bits} fractional bits cannot be read"));
    }
    Ok((Header { count: number::<4>(head, 8) as u32, degree, fractional_bits, flags }, version))
}

fn number<const LEN: usize>(bytes: &[u8], at: usize) -> u64 {
    let mut wide = [0; 8];
    wide[..LEN].copy_from_slice(&bytes[at..at + LEN]);
    u64::from_le_bytes(wide)
}

#[cfg(test)]
mod tests {
    use super::super::cloud::tests::sample;
    use super::*;

    const VERSIONS: [SpzVersion; 2] = [SpzVersion::Three, SpzVersion::Four];

    fn read(bytes: &[u8]) -> Result<SplatCloud, String> {
        super::read(bytes).map(|(cloud, _)| cloud)
    }

    fn nearest_quaternion(found: [f32; 4], expected: [f32; 4]) -> f32 {
        let distance = |sign: f32| (0..4).map(|i| (found[i] - sign * expected[i]).abs()).fold(0.0, f32::max);
        distance(1.0).min(distance(-1.0))
    }

    #[test]
    fn files_of_both_versions_come_back_within_their_steps() {
        for version in VERSIONS {
            for degree in 0..=3 {
                let cloud = sample(300, degree);
                let read = read(&to_spz(&cloud, version).unwrap()).unwrap();
                assert_eq!((read.len(), read.degree), (300, degree));
                let near =
                    |a: &[f32], b: &[f32], tolerance: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance);
                for row in 0..300 {
                    // 3 world units need 2 bits before the point
                    assert!(near(&read.positions[row], &cloud.positions[row], 0.51 / f32::from(2u8).powi(20)));
                    assert!(near(&read.log_scales[row], &cloud.log_scales[row], 0.5 / 16.0 + 1e-5));
                    assert!((read.opacities[row] - cloud.opacities[row]).abs() <= 0.501 / 255.0);
                    assert!(nearest_quaternion(read.quaternions[row], cloud.quaternions[row]) < 2e-3);
                    let (found, expected) = (read.harmonics_of(row), cloud.harmonics_of(row));
                    assert!(near(&found[0], &expected[0], 0.501 / 255.0 / 0.15));
                    for (index, (found, expected)) in found.iter().zip(expected).enumerate().skip(1) {
                        let step = if index < 4 { 8.0 } else { 16.0 };
                        assert!(near(found, expected, (0.5 * step + 0.51) / 128.0), "{index} {found:?} {expected:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn files_of_others_stand_upright_and_have_older_rotations() {
        // one splat of version 2, turned by a quarter about x
        let head = Header { count: 1, degree: 0, fractional_bits: 8, flags: 0 };
        let body = [&[0, 1, 0, 0, 2, 0, 0, 3, 0][..], &[200], &[128; 3], &[160; 3], &[218, 128, 128]].concat();
        let mut encoder = GzBuilder::new().write(Vec::new(), Compression::default());
        encoder.write_all(&[head.bytes(2, 0), body].concat()).unwrap();
        let (read, notes) = super::read(&encoder.finish().unwrap()).unwrap();
        assert!(!notes.own && read.info.screen_filter == ScreenFilter::Plain);
        // y is up in the file, and −y in the scene
        assert_eq!((read.positions[0], read.log_scales[0]), ([1.0, -2.0, -3.0], [0.0; 3]));
        let [w, x, ..] = read.quaternions[0];
        assert!((w.abs() - x.abs()).abs() < 0.02 && (w * w + x * x - 1.0).abs() < 0.02, "{w} {x}");
    }

    #[test]
    fn the_bytes_are_those_of_the_format() {
        let cloud = sample(2, 0);
        let bytes = to_spz(&cloud, SpzVersion::Four).unwrap();
        assert_eq!(bytes[..8], *b"NGSP\x04\0\0\0");
        assert_eq!(bytes[8..16], [2, 0, 0, 0, 0, bytes[13], 3, 5]);
        let table_at = 40 + all_of(&cloud.info).len();
        assert_eq!((number::<4>(&bytes, 16) as usize, &bytes[20..32]), (table_at, &[0; 12][..]));
        assert_eq!(bytes[32..36], RECORD.to_le_bytes());
        let sizes: Vec<u64> = (0..5).map(|i| number::<8>(&bytes, table_at + 16 * i + 8)).collect();
        assert_eq!(sizes, [18, 2, 6, 6, 8]);
        assert_eq!(to_spz(&cloud, SpzVersion::Three).unwrap()[..2], [0x1f, 0x8b]);
    }

    #[test]
    fn positions_take_the_bits_they_need() {
        let mut cloud = sample(2, 0);
        cloud.positions[0] = [0.01, 5000.25, -3.0];
        let read = read(&to_spz(&cloud, SpzVersion::Four).unwrap()).unwrap();
        assert_eq!(read.positions[0][1], 5000.25);
        cloud.positions[0][1] = 9e6;
        let error = to_spz(&cloud, SpzVersion::Four).unwrap_err().to_string();
        assert!(error.contains("9.000e6") && error.contains("nearer to the origin"), "{error}");
    }

    #[test]
    fn a_byte_that_differs_is_told() {
        for version in VERSIONS {
            let bytes = to_spz(&sample(50, 3), version).unwrap();
            let whole = read(&bytes).unwrap();
            let read_after = |at: usize| {
                let mut damaged = bytes.clone();
                damaged[at] ^= 0x10;
                read(&damaged).ok()
            };
            let places = (bytes.len() / 2..bytes.len()).step_by(7);
            let found: Vec<_> = places.clone().filter_map(read_after).collect();
            // another distance to equal bytes is no damage
            assert!(found.iter().all(|found| *found == whole), "{version:?}");
            assert!(10 * found.len() < places.count(), "{version:?}: {} are read", found.len());
        }
    }

    #[test]
    fn broken_files_are_told_and_take_no_memory() {
        for version in VERSIONS {
            let bytes = to_spz(&sample(50, 3), version).unwrap();
            for end in [0, 3, 15, 40, 100, bytes.len() - 20] {
                assert!(read(&bytes[..end]).is_err(), "{version:?} {end}");
            }
        }
        let mut lying = to_spz(&sample(2, 0), SpzVersion::Four).unwrap();
        lying[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(read(&lying).unwrap_err().contains("expected"));
        lying[4] = 5;
        assert!(read(&lying).unwrap_err().contains("version 5"));
    }
}

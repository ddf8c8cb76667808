//! Splats in PLY files: as 3DGS writes them, without `scale_2` (2DGS), and compressed in chunks of 256 (PlayCanvas).

use std::borrow::Cow;

use dpges_core::scene::{Rendering, SH_C0, SceneInfo, ScreenFilter};
use glam::{DVec3, dvec3};
use serde_ply::{ElementDef, PlyFormat, PlyHeader, PlyReader, PropertyType, ScalarType};

use super::SAYS_ALL;
use super::cloud::SplatCloud;
use super::notes::{Notes, kept_degree, placed};

/// Splats of a chunk.
const CHUNK: usize = 256;
/// Discs are as thin as what is flattened.
const THIN: f64 = -7.0;
/// Logarithm of the scale of what has none.
const SMALLEST: f64 = -80.0;

/// The rows of an element of numbers.
struct Rows<'a> {
    names: Vec<&'a str>,
    /// Bytes before each number of a row, and its type.
    numbers: Vec<(usize, ScalarType)>,
    stride: usize,
    big_endian: bool,
    bytes: &'a [u8],
}

impl<'a> Rows<'a> {
    /// Those of `element` at the beginning of `bytes`, and what follows.
    fn new(element: &'a ElementDef, format: PlyFormat, bytes: &'a [u8]) -> Result<(Self, &'a [u8]), String> {
        let (mut numbers, mut stride) = (Vec::new(), 0usize);
        for property in &element.properties {
            let PropertyType::Scalar(kind) = property.property_type else {
                return Err(format!("`{}` of its {} is a list", property.name, element.name));
            };
            let kind = if format == PlyFormat::Ascii { ScalarType::F64 } else { kind };
            numbers.push((stride, kind));
            stride += size(kind);
        }
        let (len, kind) = (stride.saturating_mul(element.count), &element.name);
        let cut_short = || format!("it ends early: its {kind} has {len} bytes, {} are left", bytes.len());
        let (bytes, rest) = bytes.split_at_checked(len).ok_or_else(cut_short)?;
        let names = element.properties.iter().map(|property| &*property.name).collect();
        Ok((Self { names, numbers, stride, big_endian: format == PlyFormat::BinaryBigEndian, bytes }, rest))
    }

    fn len(&self) -> usize {
        self.bytes.len() / self.stride.max(1)
    }

    fn column(&self, name: &str) -> Result<usize, String> {
        let at = self.names.iter().position(|known| *known == name);
        at.ok_or_else(|| format!("there are no splats: it has no property `{name}` (is it a point cloud or a mesh?)"))
    }

    fn columns<const N: usize>(&self, names: [&str; N]) -> Result<[usize; N], String> {
        let found = names.into_iter().map(|name| self.column(name)).collect::<Result<Vec<_>, _>>()?;
        Ok(found.try_into().expect("as many"))
    }

    fn get(&self, row: usize, column: usize) -> f64 {
        let (offset, kind) = self.numbers[column];
        let mut eight = [0; 8];
        let bytes = &self.bytes[row * self.stride + offset..];
        let size = bytes.len().min(8);
        eight[..size].copy_from_slice(&bytes[..size]);
        macro_rules! number {
            ($kind:ty) => {{
                let mut own = [0; size_of::<$kind>()];
                own.copy_from_slice(&eight[..size_of::<$kind>()]);
                if self.big_endian { <$kind>::from_be_bytes(own) } else { <$kind>::from_le_bytes(own) }
            } as f64};
        }
        match kind {
            ScalarType::I8 => number!(i8),
            ScalarType::U8 => number!(u8),
            ScalarType::I16 => number!(i16),
            ScalarType::U16 => number!(u16),
            ScalarType::I32 => number!(i32),
            ScalarType::U32 => number!(u32),
            ScalarType::F32 => number!(f32),
            ScalarType::F64 => number!(f64),
        }
    }

    fn row<const N: usize>(&self, row: usize, columns: [usize; N]) -> [f64; N] {
        columns.map(|column| self.get(row, column))
    }
}

fn size(kind: ScalarType) -> usize {
    match kind {
        ScalarType::I8 | ScalarType::U8 => 1,
        ScalarType::I16 | ScalarType::U16 => 2,
        ScalarType::I32 | ScalarType::U32 | ScalarType::F32 => 4,
        ScalarType::F64 => 8,
    }
}

/// The `bytes` behind `element`, whose properties may be lists.
fn after<'a>(element: &ElementDef, format: PlyFormat, bytes: &'a [u8]) -> Result<&'a [u8], String> {
    let kind = |kind: ScalarType| if format == PlyFormat::Ascii { ScalarType::F64 } else { kind };
    let cut_short = || format!("it ends early, in its {}", element.name);
    let mut at = 0usize;
    // rows of nothing have no end to look for, however many there are
    let rows = if element.properties.is_empty() { 0 } else { element.count };
    for _ in 0..rows {
        for property in &element.properties {
            let bytes_there = match property.property_type {
                PropertyType::Scalar(scalar) => size(kind(scalar)),
                PropertyType::List { count_type, data_type } => {
                    let count = kind(count_type);
                    let first = bytes.get(at..).ok_or_else(cut_short)?;
                    if first.len() < size(count) {
                        return Err(cut_short());
                    }
                    let big_endian = format == PlyFormat::BinaryBigEndian;
                    let rows =
                        Rows { names: Vec::new(), numbers: vec![(0, count)], stride: 0, big_endian, bytes: first };
                    size(count).saturating_add((rows.get(0, 0) as usize).saturating_mul(size(kind(data_type))))
                }
            };
            at = at.saturating_add(bytes_there);
        }
        if at > bytes.len() {
            return Err(cut_short());
        }
    }
    Ok(&bytes[at..])
}

/// The header, and the rows after it; words of text as numbers of 64 bits.
fn parts(bytes: &[u8]) -> Result<(PlyHeader, Cow<'_, [u8]>), String> {
    let header = PlyReader::from_reader(bytes).map_err(|error| error.to_string())?.header().clone();
    let end = bytes.windows(10).position(|window| window == b"end_header").unwrap_or(0) + 10;
    let line = bytes[end..].iter().position(|&byte| byte == b'\n').map_or(bytes.len(), |at| end + at + 1);
    if header.format != PlyFormat::Ascii {
        return Ok((header, Cow::Borrowed(&bytes[line..])));
    }
    let text = String::from_utf8_lossy(&bytes[line..]);
    let number = |word: &str| word.parse::<f64>().map_err(|_| format!("`{word}` is no number"));
    let numbers = text.split_whitespace().map(number).collect::<Result<Vec<f64>, _>>()?;
    Ok((header, numbers.into_iter().flat_map(f64::to_le_bytes).collect()))
}

/// The splats of a file; what it says of its scene stands in their info.
pub(super) fn read_ply(bytes: &[u8]) -> Result<(SplatCloud, Notes), String> {
    let (header, bytes) = parts(bytes)?;
    let (mut vertices, mut chunks, mut details, mut rest) = (None, None, None, &*bytes);
    for element in &header.elem_defs {
        let slot = match &*element.name {
            "vertex" => &mut vertices,
            "chunk" => &mut chunks,
            "sh" => &mut details,
            // nothing of splats follows
            _ if vertices.is_some() => break,
            _ => {
                rest = after(element, header.format, rest)?;
                continue;
            }
        };
        let (rows, behind) = Rows::new(element, header.format, rest)?;
        (*slot, rest) = (Some(rows), behind);
    }
    let vertices = vertices.ok_or("it has no element `vertex`")?;
    let comments = || header.comments.iter().map(|comment| comment.trim());
    let said = comments().find_map(|comment| serde_json::from_str(comment.strip_prefix(SAYS_ALL)?).ok());
    let mut notes = Notes { own: said.is_some(), ..Notes::default() };
    let mode = comments().find_map(|comment| comment.strip_prefix("SplatRenderMode:")).map_or("default", str::trim);
    let discs = mode == "2dgs" || (vertices.column("scale_0").is_ok() && vertices.column("scale_2").is_err());
    // Brush's words, and Postshot's
    let is_mip = mode == "mip" || comments().any(|comment| comment == "antialiased 1");
    let foreign = SceneInfo {
        screen_filter: if is_mip { ScreenFilter::Compensated } else { ScreenFilter::Plain },
        rendering: if discs { Rendering::Discs } else { Rendering::Ellipsoids },
        ..SceneInfo::default()
    };
    let info: SceneInfo = said.unwrap_or(foreign);
    let details = details.as_ref().unwrap_or(&vertices);
    let harmonics: Vec<usize> = (0..).map_while(|at| details.column(&format!("f_rest_{at}")).ok()).collect();
    let (coefficients, packed) = (harmonics.len() / 3, chunks.is_some());
    let degree = kept_degree(coefficients, &mut notes)?;
    if details.len() < vertices.len() {
        return Err(format!("it has harmonics of {} splats, and {} splats", details.len(), vertices.len()));
    }
    let splat: Box<dyn Fn(usize) -> Splat> = match chunks {
        Some(chunks) => Box::new(unpacked(&vertices, chunks)?),
        None => Box::new(plain(&vertices)?),
    };
    let mut cloud = SplatCloud { degree, info, ..SplatCloud::default() };
    let (kept, mut positions) = (cloud.harmonics_len() / 3 - 1, Vec::new());
    for row in 0..vertices.len() {
        let Splat { position, quaternion, log_scales, opacity, base } = splat(row);
        let detail = (0..kept).flat_map(|at| [0, 1, 2].map(|channel| harmonics[channel * coefficients + at]));
        let value = |column: usize| match details.get(row, column) {
            // bytes span −4 to 4, the ends exactly
            byte if packed && (byte == 0.0 || byte == 255.0) => 8.0 * byte / 255.0 - 4.0,
            byte if packed => (byte + 0.5) / 32.0 - 4.0,
            number => number,
        };
        let harmonics: Vec<f32> = base.into_iter().chain(detail.map(value)).map(|k| k as f32).collect();
        let finite = [&quaternion[..], &log_scales, &[opacity]].concat().iter().all(|number| number.is_finite());
        if !(finite && position.is_finite() && harmonics.iter().all(|k| k.is_finite())) {
            notes.not_finite += 1;
            continue;
        }
        positions.push(position);
        cloud.quaternions.push(quaternion.map(|x| x as f32));
        cloud.log_scales.push(log_scales.map(|x| x as f32));
        cloud.opacities.push(opacity as f32);
        cloud.harmonics.extend(harmonics);
    }
    let [x, y, z] = cloud.info.offset;
    (cloud.positions, cloud.info.offset) = placed(positions, dvec3(x, y, z));
    Ok((cloud, notes))
}

struct Splat {
    position: DVec3,
    quaternion: [f64; 4],
    log_scales: [f64; 3],
    opacity: f64,
    base: [f64; 3],
}

fn plain<'a>(vertices: &'a Rows) -> Result<impl Fn(usize) -> Splat + 'a, String> {
    let positions = vertices.columns(["x", "y", "z"])?;
    let colours = vertices.columns(["f_dc_0", "f_dc_1", "f_dc_2"])?;
    let (scales, thickness) = (vertices.columns(["scale_0", "scale_1"])?, vertices.column("scale_2").ok());
    let rotations = vertices.columns(["rot_0", "rot_1", "rot_2", "rot_3"])?;
    let opacity = vertices.column("opacity")?;
    Ok(move |row| {
        let flat = |log_scale: f64| if log_scale == f64::NEG_INFINITY { SMALLEST } else { log_scale };
        let [x, y] = vertices.row(row, scales).map(flat);
        Splat {
            position: vertices.row(row, positions).into(),
            quaternion: vertices.row(row, rotations),
            log_scales: [x, y, thickness.map_or(x.min(y) + THIN, |column| flat(vertices.get(row, column)))],
            opacity: 1.0 / (1.0 + (-vertices.get(row, opacity)).exp()),
            base: vertices.row(row, colours),
        }
    })
}

fn unpacked<'a>(vertices: &'a Rows, chunks: Rows<'a>) -> Result<impl Fn(usize) -> Splat + 'a, String> {
    let packed = vertices.columns(["packed_position", "packed_rotation", "packed_scale", "packed_color"])?;
    let range = |of: &str, axes: [&str; 3]| {
        let ends = ["min", "max"].map(|end| axes.map(|axis| chunks.column(&format!("{end}_{of}{axis}"))));
        let [low, high] = ends.map(|[x, y, z]| Ok::<_, String>([x?, y?, z?]));
        Ok::<_, String>([low?, high?])
    };
    let (positions, scales) = (range("", ["x", "y", "z"])?, range("scale_", ["x", "y", "z"])?);
    let colours = range("", ["r", "g", "b"]).ok();
    if chunks.len() < vertices.len().div_ceil(CHUNK) {
        return Err(format!("it has {} chunks for {} splats", chunks.len(), vertices.len()));
    }
    let bits = |word: u32, shift: u32, count: u32| {
        let most = (1u32 << count) - 1;
        f64::from(word >> shift & most) / f64::from(most)
    };
    let three = move |word: u32| [bits(word, 21, 11), bits(word, 11, 10), bits(word, 0, 11)];
    Ok(move |row| {
        let within = |range: [[usize; 3]; 2], shares: [f64; 3]| -> [f64; 3] {
            let [low, high] = range.map(|columns| chunks.row(row / CHUNK, columns));
            std::array::from_fn(|axis| low[axis] * (1.0 - shares[axis]) + high[axis] * shares[axis])
        };
        let [position, rotation, scale, colour] = vertices.row(row, packed).map(|word| word as u32);
        let smaller = [20, 10, 0].map(|shift| (bits(rotation, shift, 10) - 0.5) * std::f64::consts::SQRT_2);
        let largest = (1.0 - smaller.iter().map(|part| part * part).sum::<f64>()).max(0.0).sqrt();
        let mut quaternion = smaller.to_vec();
        quaternion.insert((rotation >> 30) as usize, largest);
        let rgb = [24, 16, 8].map(|shift| bits(colour, shift, 8));
        Splat {
            position: within(positions, three(position)).into(),
            quaternion: [0, 1, 2, 3].map(|at| quaternion[at]),
            log_scales: within(scales, three(scale)),
            opacity: bits(colour, 0, 8),
            base: colours.map_or(rgb, |colours| within(colours, rgb)).map(|channel| (channel - 0.5) / SH_C0),
        }
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_1_SQRT_2;

    use super::super::cloud::tests::sample;
    use super::super::{Coordinates, to_ply};
    use super::*;

    fn edited(bytes: &[u8], edit: impl Fn(String) -> String) -> Vec<u8> {
        let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap();
        let head = edit(String::from_utf8(bytes[..end].to_vec()).unwrap());
        [head.as_bytes(), &bytes[end..]].concat()
    }

    #[test]
    fn what_was_written_is_read() {
        for degree in 0..=3 {
            let cloud = sample(9, degree);
            let (read, notes) = read_ply(&to_ply(&cloud, Coordinates::Scene)).unwrap();
            assert!(notes.own && read.info == cloud.info);
            assert_eq!((read.positions, read.harmonics), (cloud.positions, cloud.harmonics));
            assert!(read.opacities.iter().zip(&cloud.opacities).all(|(a, b)| (a - b).abs() < 1e-6));
        }
        // in the coordinates of a survey, which f32 does not hold
        let mut cloud = sample(9, 1);
        cloud.info.offset = [448_251.0, 5_411_933.0, 213.0];
        let (read, _) = read_ply(&to_ply(&cloud, Coordinates::Dataset)).unwrap();
        for (position, original) in read.positions.iter().zip(&cloud.positions) {
            let at = DVec3::from(read.info.offset) + glam::Vec3::from(*position).as_dvec3();
            let expected = DVec3::from(cloud.info.offset) + glam::Vec3::from(*original).as_dvec3();
            assert!((at - expected).length() < 1e-6, "{at} {expected}");
        }
    }

    #[test]
    fn files_of_others_say_their_filter_and_their_form() {
        let bytes = to_ply(&sample(3, 3), Coordinates::Scene);
        let foreign = |head: String| -> String {
            head.lines().filter(|line| !line.starts_with("comment")).map(|line| format!("{line}\n")).collect()
        };
        let (read, notes) = read_ply(&edited(&bytes, foreign)).unwrap();
        assert!(!notes.own && read.info.offset == [0.0; 3] && read.info.up.is_none());
        assert_eq!((read.info.screen_filter, read.info.rendering), (ScreenFilter::Plain, Rendering::Ellipsoids));
        let mode = |comment: &str| {
            let comment = format!("1.0\ncomment {comment}\n");
            read_ply(&edited(&bytes, |head| foreign(head).replacen("1.0\n", &comment, 1))).unwrap().0.info
        };
        for comment in ["SplatRenderMode: mip", "antialiased 1"] {
            assert_eq!(mode(comment).screen_filter, ScreenFilter::Compensated);
        }
        assert_eq!(mode("SplatRenderMode: 2dgs").rendering, Rendering::Discs);
        let discs = read_ply(&edited(&bytes, |head| foreign(head).replace("scale_2", "thickness"))).unwrap().0;
        assert_eq!(discs.info.rendering, Rendering::Discs);
        let cloud = read_ply(&edited(&bytes, |head| foreign(head).replace("opacity", "confidence"))).err().unwrap();
        assert!(cloud.contains("`opacity`") && cloud.contains("point cloud"), "{cloud}");
        let mut spoilt = sample(3, 0);
        spoilt.log_scales[1][2] = f32::NAN;
        spoilt.log_scales[2][2] = f32::NEG_INFINITY;
        let (read, notes) = read_ply(&to_ply(&spoilt, Coordinates::Scene)).unwrap();
        assert_eq!((read.len(), notes.not_finite), (2, 1));
        assert!(read_ply(&bytes[..bytes.len() - 5]).is_err());
    }

    #[test]
    fn elements_before_the_splats_are_passed_over() {
        let bytes = to_ply(&sample(3, 1), Coordinates::Scene);
        let (expected, _) = read_ply(&bytes).unwrap();
        let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let before = "element face 2\nproperty list uchar int vertex_indices\nproperty short flags\nelement vertex";
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap().replace("element vertex", before);
        let faces = [&[2u8][..], &[1; 8], &[7, 0], &[0], &[9, 0]].concat();
        let read = |faces: &[u8]| read_ply(&[head.as_bytes(), faces, &bytes[end..]].concat());
        assert_eq!(read(&faces).unwrap().0.positions, expected.positions);
        let cut = [head.as_bytes(), &faces[..5]].concat();
        assert!(read_ply(&cut).err().unwrap().contains("in its face"));
        let nothing = head.replace("element face 2", "element nothing 18000000000000000000\nelement face 2");
        assert_eq!(read_ply(&[nothing.as_bytes(), &faces, &bytes[end..]].concat()).unwrap().0.len(), 3);
        let words = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\nelement vertex 1\n\
                     property float x\nend_header\n3 0 1 2\n5\n";
        assert!(read_ply(words.as_bytes()).err().unwrap().contains("no splats"));
    }

    /// One splat by hand: in the middle of its chunk, a quarter of a turn about z, red, half opaque.
    #[test]
    fn chunks_are_unpacked() {
        let ranges = ["x", "y", "z", "scale_x", "scale_y", "scale_z"];
        let names = ["min", "max"].map(|end| ranges.map(|of| format!("property float {end}_{of}\n")).concat()).concat();
        let head = format!(
            "ply\nformat binary_little_endian 1.0\nelement chunk 1\n{names}element vertex 1\nproperty uint packed_position\n\
             property uint packed_rotation\nproperty uint packed_scale\nproperty uint packed_color\nelement sh 1\n{}end_header\n",
            (0..9).map(|at| format!("property uchar f_rest_{at}\n")).collect::<String>()
        );
        let mut bytes = head.into_bytes();
        let low: [f32; 12] = [-1.0, 0.0, 4.0, -5.0, -5.0, -5.0, 1.0, 0.0, 8.0, -3.0, -3.0, -3.0];
        bytes.extend(low.iter().flat_map(|x| x.to_le_bytes()));
        // w is the largest by index; z of sin 45° is the farthest step
        for word in [2047 << 21 | 2047, 511 << 20 | 511 << 10 | 1023, 0, 0xff_00_00_80] {
            bytes.extend(u32::to_le_bytes(word));
        }
        bytes.extend([255, 0, 128, 0, 0, 0, 0, 0, 0]);
        let (cloud, _) = read_ply(&bytes).unwrap();
        let at = DVec3::from(cloud.info.offset) + glam::Vec3::from(cloud.positions[0]).as_dvec3();
        assert_eq!((at.to_array(), cloud.log_scales[0], cloud.degree), ([1.0, 0.0, 8.0], [-5.0; 3], 1));
        let near =
            |found: f32, expected: f64| assert!((f64::from(found) - expected).abs() < 2e-3, "{found} {expected}");
        cloud.quaternions[0].into_iter().zip([FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2]).for_each(|(a, b)| near(a, b));
        near(cloud.opacities[0], 128.0 / 255.0);
        cloud.harmonics_of(0)[0].into_iter().zip([0.5, -0.5, -0.5]).for_each(|(k, half)| near(k, half / SH_C0));
        assert_eq!(cloud.harmonics_of(0)[1][0], 4.0);
        near(cloud.harmonics_of(0)[3][0], 0.5 / 256.0 * 8.0);
    }
}

//! Point clouds in PLY files, ASCII or binary: positions and optional colours.

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::{Path, PathBuf};

use dpges_core::scene::SH_C0;
use glam::DVec3;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_ply::{DeserializeError, PlyReader, PropertyType, ScalarType};

use super::source::RawPoints;
use crate::Tracks;
use crate::conventions::CLOUDS;
use crate::error::{DatasetError, Result, unreadable};
use crate::folder::Folder;

/// Colour of points without one in the file.
pub(super) const GREY: f32 = 0.5;

/// Names that programs give to the channels of a colour; the last are coefficients of splats.
const COLOURS: [[&str; 3]; 4] =
    [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"], SPLATS];
const SPLATS: [&str; 3] = ["f_dc_0", "f_dc_1", "f_dc_2"];
/// Names that PCL gives to a colour in one number, and the types of that.
const PACKED: [&str; 2] = ["rgb", "rgba"];
const PACKED_TYPES: [&str; 6] = ["float", "float32", "uint", "uint32", "int", "int32"];

#[derive(Deserialize)]
struct Vertex {
    x: f64,
    y: f64,
    z: f64,
    #[serde(default)]
    red: Option<f32>,
    #[serde(default)]
    green: Option<f32>,
    #[serde(default)]
    blue: Option<f32>,
    #[serde(default)]
    rgb_bits: Option<Packed>,
}

/// A colour as the bits 0xAARRGGBB of an integer or of a float.
struct Packed(u32);

impl Packed {
    /// Red, green and blue, 0 to 255.
    fn channels(&self) -> [f32; 3] {
        let [_, red, green, blue] = self.0.to_be_bytes();
        [red, green, blue].map(f32::from)
    }
}

impl<'de> Deserialize<'de> for Packed {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Reader;

        impl Visitor<'_> for Reader {
            type Value = Packed;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a packed colour")
            }

            fn visit_f32<E: Error>(self, value: f32) -> std::result::Result<Packed, E> {
                Ok(Packed(value.to_bits()))
            }

            fn visit_u32<E: Error>(self, value: u32) -> std::result::Result<Packed, E> {
                Ok(Packed(value))
            }

            fn visit_i32<E: Error>(self, value: i32) -> std::result::Result<Packed, E> {
                Ok(Packed(value.cast_unsigned()))
            }
        }

        deserializer.deserialize_any(Reader)
    }
}

/// A row of an element that is skipped.
#[derive(Deserialize)]
struct Skipped {}

/// The points of the PLY file beside cameras that do not name theirs, in folder `model` or above; none if there is none.
///
/// # Errors
/// The errors of [`points`].
pub(super) fn beside(folder: &Folder, model: &Path, used: &mut Vec<PathBuf>) -> Result<RawPoints> {
    let model = folder.key_of(model);
    let places = [model.as_str(), ""];
    let clouds = places.iter().flat_map(|place| CLOUDS.map(|name| format!("{place}/{name}.ply")));
    let Some(path) = clouds.into_iter().find_map(|cloud| folder.get(&cloud)) else { return Ok(RawPoints::default()) };
    used.push(path.clone());
    points(path)
}

/// The vertices of the file. Colours may be integers, floats in 0..1 or in 0..255, those of splats, or packed into
/// one number. The case of names does not matter. The views that see a
/// point are unknown. Positions may not be finite.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Ply`].
pub(super) fn points(path: &Path) -> Result<RawPoints> {
    let file = File::open(path).map_err(unreadable(path))?;
    let (Rows { positions, mut colours }, are_splats, kind) =
        vertices(BufReader::new(file)).map_err(|source| DatasetError::Ply { path: path.to_owned(), source })?;
    let largest = colours.as_flattened().iter().copied().fold(0.0, f32::max);
    let scale = match kind {
        // some programs write bytes into columns of 16 bits
        Some(PropertyType::Scalar(ScalarType::U16 | ScalarType::I16)) if largest > 255.0 => 65535.0,
        Some(PropertyType::Scalar(ScalarType::U8 | ScalarType::I8 | ScalarType::U16 | ScalarType::I16)) => 255.0,
        _ if largest > 1.0 => 255.0,
        _ => 1.0,
    };
    for channel in colours.as_flattened_mut() {
        let colour = if are_splats { 0.5 + SH_C0 as f32 * *channel } else { *channel / scale };
        *channel = if channel.is_nan() { GREY } else { colour.clamp(0.0, 1.0) };
    }
    Ok(RawPoints { positions, colours, seen_by: Tracks::default() })
}

/// All vertices, read one by one: large captures have tens of millions.
#[derive(Default)]
struct Rows {
    positions: Vec<DVec3>,
    /// As in the file; NaN where there is none.
    colours: Vec<[f32; 3]>,
}

impl<'de> Deserialize<'de> for Rows {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        struct Reader;

        impl<'de> Visitor<'de> for Reader {
            type Value = Rows;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("vertices")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut vertices: A) -> std::result::Result<Rows, A::Error> {
                let mut rows = Rows::default();
                while let Some(Vertex { x, y, z, red, green, blue, rgb_bits }) = vertices.next_element()? {
                    let channels = || [red, green, blue].map(|channel| channel.unwrap_or(f32::NAN));
                    rows.positions.push(DVec3::new(x, y, z));
                    rows.colours.push(rgb_bits.map_or_else(channels, |packed| packed.channels()));
                }
                Ok(rows)
            }
        }

        deserializer.deserialize_seq(Reader)
    }
}

/// The vertices, whether their colours are those of splats, and the type of these.
fn vertices(mut data: impl BufRead) -> std::result::Result<(Rows, bool, Option<PropertyType>), DeserializeError> {
    let mut header = Vec::new();
    while !header.trim_ascii_end().ends_with(b"end_header")
        && data.read_until(b'\n', &mut header).map_err(DeserializeError::custom)? > 0
    {}
    let (header, names) = renamed(&String::from_utf8_lossy(&header));
    let mut reader = PlyReader::from_reader(Cursor::new(header).chain(data))?;
    while let Some(element) = reader.current_element() {
        if element.name == "vertex" {
            let kind = match element.get_property("rgb_bits") {
                Some(_) => Some(PropertyType::Scalar(ScalarType::U8)),
                None => element.get_property("red").map(|property| property.property_type.clone()),
            };
            return Ok((reader.next_element()?, names == Some(SPLATS), kind));
        }
        reader.next_element::<Vec<Skipped>>()?;
    }
    Err(Error::custom("it has no `vertex` element"))
}

/// The header with the names of properties that [`Vertex`] has, and those that the channels of its colours had.
fn renamed(header: &str) -> (String, Option<[&'static str; 3]>) {
    let mut header: String = header.split_inclusive('\n').map(|line| in_lower_case(line, header)).collect();
    let end = if header.contains("\r\n") { "\r\n" } else { "\n" };
    let property = |name: &str| format!(" {name}{end}");
    let names = COLOURS.into_iter().find(|names| names.iter().all(|name| header.contains(&property(name))));
    for (name, usual) in names.into_iter().flatten().zip(COLOURS[0]) {
        header = header.replace(&property(name), &property(usual));
    }
    let packed = |name: &str| PACKED_TYPES.map(|kind| (format!("property {kind} {name}{end}"), kind));
    let found = PACKED.into_iter().flat_map(packed).find(|(line, _)| names.is_none() && header.contains(line));
    if let Some((line, kind)) = found {
        header = header.replace(&line, &format!("property {kind} rgb_bits{end}"));
    }
    (header, names)
}

/// A line of a `header` with the name of a property in lower case, unless another property is called so.
fn in_lower_case(line: &str, header: &str) -> String {
    let lower = line.to_lowercase();
    let name = lower.rsplit(' ').next().unwrap_or_default();
    let is_free = !header.contains(&format!(" {name}"));
    if line.starts_with("property") && is_free { lower } else { line.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::assert_says;

    fn written(data: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sparse_pc.ply");
        std::fs::write(&path, data).unwrap();
        (folder, path)
    }

    const ASCII: &str = "ply\nformat ascii 1.0\nelement camera 1\nproperty float focal\nelement vertex 2\n\
        property float x\nproperty float y\nproperty float z\nproperty float nx\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n\
        3.5\n1 2 3 0.5 255 51 0\n-1.5 0 0.25 0.5 0 0 102\n";

    #[test]
    fn ascii_and_binary_agree() {
        let (_folder, path) = written(ASCII.as_bytes());
        let ascii = points(&path).unwrap();
        assert_eq!(ascii.positions, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.5, 0.0, 0.25)]);
        assert_eq!(ascii.colours, [[1.0, 0.2, 0.0], [0.0, 0.0, 0.4]]);

        let header = "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty double x\nproperty double y\n\
            property double z\nproperty float red\nproperty float green\nproperty float blue\nend_header\n";
        let mut data = header.as_bytes().to_vec();
        for (position, colour) in ascii.positions.iter().zip(&ascii.colours) {
            data.extend(position.to_array().iter().flat_map(|value| value.to_le_bytes()));
            data.extend(colour.iter().flat_map(|value| value.to_le_bytes()));
        }
        let (_folder, path) = written(&data);
        let binary = points(&path).unwrap();
        assert_eq!((binary.positions, binary.colours), (ascii.positions, ascii.colours));
    }

    /// Two points with columns of a type for colours, of these names and values.
    fn with_colours(kind: &str, names: [&str; 3], values: [&str; 2]) -> Vec<[f32; 3]> {
        let columns: String = names.iter().map(|name| format!("property {kind} {name}\n")).collect();
        let columns = format!("property double z\n{columns}property float y\nproperty float x\n");
        let rows: String = values.iter().map(|values| format!("3 {values} 2 1\n")).collect();
        let header = format!("ply\nformat ascii 1.0\nelement vertex 2\n{columns}end_header\n");
        let (_folder, path) = written(format!("{header}{rows}").as_bytes());
        let found = points(&path).unwrap();
        assert_eq!(found.positions, [DVec3::new(1.0, 2.0, 3.0); 2]);
        found.colours
    }

    #[test]
    fn colours_are_read_by_the_names_and_ranges_of_other_programs() {
        let expected = [[1.0, 0.2, 0.0], [0.0, 0.4, 0.6]];
        let bytes = ["255 51 0", "0 102 153"];
        let near = |found: Vec<[f32; 3]>| {
            let pairs = found.as_flattened().iter().zip(expected.as_flattened());
            assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 1e-5), "{found:?}");
        };
        near(with_colours("uchar", ["red", "green", "blue"], bytes));
        near(with_colours("int", ["diffuse_red", "diffuse_green", "diffuse_blue"], bytes));
        near(with_colours("float", ["r", "g", "b"], bytes));
        near(with_colours("ushort", ["red", "green", "blue"], ["65535 13107 0", "0 26214 39321"]));
        near(with_colours("ushort", ["red", "green", "blue"], bytes));
        near(with_colours("uchar", ["Red", "Green", "Blue"], bytes));
        near(with_colours("float", ["red", "green", "blue"], ["1 0.2 0", "0 0.4 0.6"]));
        let of_splats = expected.map(|colour| colour.map(|c| ((f64::from(c) - 0.5) / SH_C0).to_string()).join(" "));
        near(with_colours("float", ["f_dc_0", "f_dc_1", "f_dc_2"], [&of_splats[0], &of_splats[1]]));
        assert_eq!(with_colours("float", ["nx", "ny", "nz"], ["0 0 1", "0 1 0"]), [[0.5; 3]; 2]);
    }

    #[test]
    fn packed_colours_and_names_in_capitals_are_read() {
        let colours = [[255, 51, 0], [0, 102, 153]].map(|[r, g, b]: [u32; 3]| r << 16 | g << 8 | b);
        for (kind, name, alpha) in [("float", "rgb", 0), ("uint", "rgba", 0xff00_0000), ("float", "RGB", 0xff00_0000)] {
            let header = format!(
                "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float X\nproperty float Y\n\
                 property float Z\nproperty {kind} {name}\nend_header\n"
            );
            let mut data = header.into_bytes();
            for colour in colours {
                data.extend([1f32, 2.0, 3.0].iter().flat_map(|value| value.to_le_bytes()));
                data.extend((colour | alpha).to_le_bytes());
            }
            let (_folder, path) = written(&data);
            let found = points(&path).unwrap();
            assert_eq!(found.positions, [DVec3::new(1.0, 2.0, 3.0); 2]);
            assert_eq!(found.colours, [[1.0, 0.2, 0.0], [0.0, 0.4, 0.6]], "{kind} {name}");
        }
        let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n";
        for (kind, shown) in [
            ("int", colours.map(|bits| bits.to_string())),
            ("float", colours.map(|bits| format!("{:e}", f32::from_bits(bits)))),
        ] {
            let rows = shown.map(|colour| format!("1 2 3 {colour}\n")).concat();
            let (_folder, path) = written(format!("{header}property {kind} rgb\nend_header\n{rows}").as_bytes());
            assert_eq!(points(&path).unwrap().colours, [[1.0, 0.2, 0.0], [0.0, 0.4, 0.6]], "{kind}");
        }
    }

    #[test]
    fn binary_points_without_colour_are_grey() {
        for (format, bytes) in [("little", f32::to_le_bytes as fn(f32) -> [u8; 4]), ("big", f32::to_be_bytes)] {
            let header = format!(
                "ply\nformat binary_{format}_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
            );
            let values = [1.0, 2.0, 3.0, f32::NAN, 0.0, 0.0].into_iter().flat_map(bytes);
            let (_folder, path) = written(&header.into_bytes().into_iter().chain(values).collect::<Vec<u8>>());
            let found = points(&path).unwrap();
            assert_eq!((found.positions[0], found.colours), (DVec3::new(1.0, 2.0, 3.0), vec![[0.5; 3]; 2]));
            assert!(found.positions[1].is_nan());
        }
    }

    #[test]
    fn broken_files_are_named() {
        let cases = [
            ASCII.as_bytes()[..ASCII.len() - 10].to_vec(),
            b"solid stl".to_vec(),
            ASCII.replace("element vertex", "element wertex").into_bytes(),
        ];
        for data in cases {
            let (_folder, path) = written(&data);
            assert_says(points(&path).unwrap_err(), &["sparse_pc.ply"]);
        }
        assert_says(points(Path::new("/absent/sparse_pc.ply")).unwrap_err(), &["cannot read /absent"]);
    }
}

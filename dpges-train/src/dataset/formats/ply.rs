//! Point clouds in PLY files, ASCII or binary: positions and optional colours.

use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::DVec3;
use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_ply::{DeserializeError, ElementDef, PlyReader, PropertyType, ScalarType};

use super::source::RawPoints;
use crate::dataset::Tracks;
use crate::dataset::error::{DatasetError, Result, unreadable};

/// Colour of points without one in the file.
const GREY: f32 = 0.5;

#[derive(Deserialize)]
struct Vertex {
    x: f64,
    y: f64,
    z: f64,
    red: Option<f32>,
    green: Option<f32>,
    blue: Option<f32>,
}

/// A row of an element that is skipped.
#[derive(Deserialize)]
struct Skipped {}

/// The vertices of the file. `red`, `green` and `blue` may be integers, which span their range, or floats in 0..1. The
/// views that see a point are unknown.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Ply`], [`DatasetError::Malformed`] for coordinates that are not finite.
pub(super) fn points(path: &Path) -> Result<RawPoints> {
    let file = File::open(path).map_err(unreadable(path))?;
    let (Rows { positions, mut colours }, colour_scale) =
        vertices(BufReader::new(file)).map_err(|source| DatasetError::Ply { path: path.to_owned(), source })?;
    if let Some((index, position)) = positions.iter().enumerate().find(|(_, position)| !position.as_vec3().is_finite())
    {
        let what = format!("the position of vertex {index}");
        return Err(DatasetError::malformed(path, what, position, "finite coordinates"));
    }
    for channel in colours.as_flattened_mut() {
        *channel = if channel.is_nan() { GREY } else { (f64::from(*channel) * colour_scale).clamp(0.0, 1.0) as f32 };
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
                while let Some(Vertex { x, y, z, red, green, blue }) = vertices.next_element()? {
                    rows.positions.push(DVec3::new(x, y, z));
                    rows.colours.push([red, green, blue].map(|channel| channel.unwrap_or(f32::NAN)));
                }
                Ok(rows)
            }
        }

        deserializer.deserialize_seq(Reader)
    }
}

fn vertices(data: impl BufRead) -> std::result::Result<(Rows, f64), DeserializeError> {
    let mut reader = PlyReader::from_reader(data)?;
    while let Some(element) = reader.current_element() {
        if element.name == "vertex" {
            let scale = colour_scale(element);
            return Ok((reader.next_element()?, scale));
        }
        reader.next_element::<Vec<Skipped>>()?;
    }
    Err(serde::de::Error::custom("it has no `vertex` element"))
}

/// From the type of `red` to 0..1.
fn colour_scale(vertex: &ElementDef) -> f64 {
    match vertex.get_property("red").map(|property| &property.property_type) {
        Some(PropertyType::Scalar(ScalarType::U8 | ScalarType::I8)) => 1.0 / 255.0,
        Some(PropertyType::Scalar(ScalarType::U16 | ScalarType::I16)) => 1.0 / 65535.0,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixtures::assert_says;

    fn written(data: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
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

    #[test]
    fn points_without_colour_are_grey() {
        let (_folder, path) = written(
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
              end_header\n1 2 3\n",
        );
        assert_eq!(points(&path).unwrap().colours, [[0.5; 3]]);
    }

    #[test]
    fn broken_files_are_named() {
        let cases = [
            ASCII.as_bytes()[..ASCII.len() - 10].to_vec(),
            b"solid stl".to_vec(),
            ASCII.replace("element vertex", "element wertex").into_bytes(),
            ASCII.replace("0.25", "nan").into_bytes(),
        ];
        for data in cases {
            let (_folder, path) = written(&data);
            assert_says(points(&path).unwrap_err(), &["sparse_pc.ply"]);
        }
        assert_says(points(Path::new("/absent/sparse_pc.ply")).unwrap_err(), &["cannot read /absent"]);
    }
}

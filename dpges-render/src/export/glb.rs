//! Binary glTF: accessors, their bytes, and the container.

use gltf_json::accessor::{ComponentType, GenericComponentType, Type};
use gltf_json::buffer::{Target, View};
use gltf_json::validation::Checked::Valid;
use gltf_json::validation::USize64;
use gltf_json::{Accessor, Asset, Buffer, Index, Node, Root, Scene};
use serde_json::{Value, json};

use super::GENERATOR;

const MAGIC: u32 = u32::from_le_bytes(*b"glTF");
const JSON_CHUNK: u32 = u32::from_le_bytes(*b"JSON");
const BINARY_CHUNK: u32 = u32::from_le_bytes(*b"BIN\0");

/// A file with one scene, one node and one mesh.
pub struct GlbBuilder {
    pub root: Root,
    binary: Vec<u8>,
}

/// Values of an accessor as bytes.
pub struct Column {
    pub bytes: Vec<u8>,
    pub component: ComponentType,
    pub kind: Type,
    pub normalised: bool,
    /// `None` for indices.
    pub count: usize,
    pub target: Target,
    /// Smallest and largest value of each component.
    pub range: Option<[Value; 2]>,
}

impl Column {
    /// Attributes of `W` floats for each vertex.
    pub fn floats<const W: usize>(rows: impl Iterator<Item = [f32; W]>) -> Self {
        let bytes: Vec<u8> = rows.flatten().flat_map(f32::to_le_bytes).collect();
        let kind = match W {
            1 => Type::Scalar,
            3 => Type::Vec3,
            _ => Type::Vec4,
        };
        let count = bytes.len() / (4 * W);
        Self {
            bytes,
            component: ComponentType::F32,
            kind,
            normalised: false,
            count,
            target: Target::ArrayBuffer,
            range: None,
        }
    }

    /// Positions, with their range.
    pub fn positions(rows: &[[f32; 3]]) -> Self {
        let mut range = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        for row in rows {
            for axis in 0..3 {
                range[0][axis] = range[0][axis].min(row[axis]);
                range[1][axis] = range[1][axis].max(row[axis]);
            }
        }
        Self { range: Some(range.map(|corner| json!(corner))), ..Self::floats(rows.iter().copied()) }
    }

    /// Red, green, blue and alpha of each vertex, from 0 to 255.
    pub fn colours(rows: impl Iterator<Item = [u8; 4]>) -> Self {
        let bytes: Vec<u8> = rows.flatten().collect();
        let count = bytes.len() / 4;
        let (component, kind) = (ComponentType::U8, Type::Vec4);
        Self { bytes, component, kind, normalised: true, count, target: Target::ArrayBuffer, range: None }
    }

    pub fn indices(indices: &[u32]) -> Self {
        Self {
            bytes: indices.iter().flat_map(|index| index.to_le_bytes()).collect(),
            component: ComponentType::U32,
            kind: Type::Scalar,
            normalised: false,
            count: indices.len(),
            target: Target::ElementArrayBuffer,
            range: None,
        }
    }
}

impl GlbBuilder {
    pub fn new() -> Self {
        let asset = Asset { generator: Some(GENERATOR.to_owned()), ..Asset::default() };
        let mut root = Root { asset, ..Root::default() };
        let node = root.push(Node { mesh: Some(Index::new(0)), ..Node::default() });
        let scene = Scene { extensions: None, extras: Default::default(), nodes: vec![node] };
        root.scene = Some(root.push(scene));
        Self { root, binary: Vec::new() }
    }

    /// Index of the accessor of `column`.
    pub fn add(&mut self, column: Column) -> Index<Accessor> {
        let view = self.root.push(View {
            buffer: Index::new(0),
            byte_length: USize64::from(column.bytes.len()),
            byte_offset: Some(USize64::from(self.binary.len())),
            byte_stride: None,
            target: Some(Valid(column.target)),
            extensions: None,
            extras: Default::default(),
        });
        self.binary.extend(column.bytes);
        pad(&mut self.binary, 0);
        let (min, max) = column.range.map_or((None, None), |[min, max]| (Some(min), Some(max)));
        self.root.push(Accessor {
            buffer_view: Some(view),
            byte_offset: None,
            count: USize64::from(column.count),
            component_type: Valid(GenericComponentType(column.component)),
            extensions: None,
            extras: Default::default(),
            type_: Valid(column.kind),
            min,
            max,
            normalized: column.normalised,
            sparse: None,
        })
    }

    /// The bytes of the file, after `edit` of its JSON. `note` and the `offset` of the scene stand in `asset.extras`.
    pub fn finish(mut self, note: &str, offset: [f64; 3], edit: impl FnOnce(&mut Value)) -> Vec<u8> {
        let byte_length = USize64::from(self.binary.len());
        self.root.push(Buffer { byte_length, uri: None, extensions: None, extras: Default::default() });
        let mut document = serde_json::to_value(&self.root).expect("a document is JSON");
        document["asset"]["extras"] = json!({ "note": note, "offset": offset });
        edit(&mut document);
        let mut json = serde_json::to_vec(&document).expect("a document is JSON");
        pad(&mut json, b' ');
        let total = 12 + 8 + json.len() + 8 + self.binary.len();
        let mut bytes = Vec::with_capacity(total);
        for word in [MAGIC, 2, total as u32, json.len() as u32, JSON_CHUNK] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(json);
        for word in [self.binary.len() as u32, BINARY_CHUNK] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(self.binary);
        bytes
    }
}

/// Pads to a multiple of 4 bytes.
fn pad(bytes: &mut Vec<u8>, with: u8) {
    bytes.resize(bytes.len().next_multiple_of(4), with);
}

/// The JSON and the binary part of a file.
#[cfg(test)]
pub fn parts(bytes: &[u8]) -> (Value, &[u8]) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!((word(0), word(4), word(8) as usize, word(16)), (MAGIC, 2, bytes.len(), JSON_CHUNK));
    let end = 20 + word(12) as usize;
    assert_eq!((word(end + 4), end % 4), (BINARY_CHUNK, 0));
    assert_eq!(end + 8 + word(end) as usize, bytes.len());
    (serde_json::from_slice(&bytes[20..end]).unwrap(), &bytes[end + 8..])
}

/// The floats of the accessor `index`.
#[cfg(test)]
pub fn floats(document: &Value, binary: &[u8], index: &Value) -> Vec<f32> {
    let accessor = &document["accessors"][index.as_u64().unwrap() as usize];
    assert_eq!(accessor["componentType"], 5126);
    let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
    let bytes = &binary[number(&view["byteOffset"])..][..number(&view["byteLength"])];
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

//! Binary glTF: accessors, their bytes, and the container.

use serde_json::{Value, json};

use super::GENERATOR;

const MAGIC: u32 = u32::from_le_bytes(*b"glTF");
const JSON_CHUNK: u32 = u32::from_le_bytes(*b"JSON");
const BINARY_CHUNK: u32 = u32::from_le_bytes(*b"BIN\0");

/// Types of components.
const U8: u32 = 5121;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// Targets of buffers.
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// A file with one scene, one node, and one mesh of one primitive. A method that adds an accessor returns its index.
#[derive(Default)]
pub struct GlbBuilder {
    accessors: Vec<Value>,
    views: Vec<Value>,
    binary: Vec<u8>,
}

impl GlbBuilder {
    /// `W` floats for each vertex.
    pub fn floats<const W: usize>(&mut self, rows: impl Iterator<Item = [f32; W]>) -> usize {
        let kind = match W {
            1 => "SCALAR",
            3 => "VEC3",
            _ => "VEC4",
        };
        let bytes: Vec<u8> = rows.flatten().flat_map(f32::to_le_bytes).collect();
        let count = bytes.len() / (4 * W);
        self.add(VERTICES, json!({ "componentType": F32, "count": count, "type": kind }), bytes)
    }

    /// With their range.
    pub fn positions(&mut self, rows: &[[f32; 3]]) -> usize {
        let [mut min, mut max] = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        for row in rows {
            for axis in 0..3 {
                min[axis] = min[axis].min(row[axis]);
                max[axis] = max[axis].max(row[axis]);
            }
        }
        let index = self.floats(rows.iter().copied());
        (self.accessors[index]["min"], self.accessors[index]["max"]) = (json!(min), json!(max));
        index
    }

    /// Red, green, blue and alpha of each vertex, from 0 to 255.
    pub fn colours(&mut self, rows: impl Iterator<Item = [u8; 4]>) -> usize {
        let bytes: Vec<u8> = rows.flatten().collect();
        let count = bytes.len() / 4;
        self.add(VERTICES, json!({ "componentType": U8, "count": count, "type": "VEC4", "normalized": true }), bytes)
    }

    pub fn indices(&mut self, indices: &[u32]) -> usize {
        let bytes = indices.iter().flat_map(|index| index.to_le_bytes()).collect();
        self.add(INDICES, json!({ "componentType": U32, "count": indices.len(), "type": "SCALAR" }), bytes)
    }

    fn add(&mut self, target: u32, mut accessor: Value, bytes: Vec<u8>) -> usize {
        let (byte_length, byte_offset) = (bytes.len(), self.binary.len());
        accessor["bufferView"] = json!(self.views.len());
        self.accessors.push(accessor);
        self.views.push(json!({ "buffer": 0, "byteLength": byte_length, "byteOffset": byte_offset, "target": target }));
        self.binary.extend(bytes);
        pad(&mut self.binary, 0);
        self.accessors.len() - 1
    }

    /// The bytes of the file of `primitive`. `note` and the `offset` of the scene stand in `asset.extras`.
    pub fn finish(self, primitive: Value, extensions: &[&str], note: &str, offset: [f64; 3]) -> Vec<u8> {
        let mut document = json!({
            "accessors": self.accessors,
            "asset": { "generator": GENERATOR, "version": "2.0", "extras": { "note": note, "offset": offset } },
            "buffers": [{ "byteLength": self.binary.len() }],
            "bufferViews": self.views,
            "scene": 0,
            "meshes": [{ "primitives": [primitive] }],
            "nodes": [{ "mesh": 0 }],
            "scenes": [{ "nodes": [0] }],
        });
        if !extensions.is_empty() {
            document["extensionsUsed"] = json!(extensions);
        }
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

#[cfg(test)]
pub fn floats(document: &Value, binary: &[u8], index: &Value) -> Vec<f32> {
    let accessor = &document["accessors"][index.as_u64().unwrap() as usize];
    assert_eq!(accessor["componentType"], 5126);
    let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
    let bytes = &binary[number(&view["byteOffset"])..][..number(&view["byteLength"])];
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

//! Binary glTF: accessors, their bytes, and the container.

use std::path::Path;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use dpges_core::scene::SceneInfo;
use percent_encoding::percent_decode_str;
use serde_json::{Value, json};

use super::GENERATOR;

const MAGIC: u32 = u32::from_le_bytes(*b"glTF");
const JSON_CHUNK: u32 = u32::from_le_bytes(*b"JSON");
const BINARY_CHUNK: u32 = u32::from_le_bytes(*b"BIN\0");

/// Key of all of a scene's info in `asset.extras`.
pub const INFO: &str = "dpges";
/// Types of elements of 1 to 4 numbers.
const KINDS: [&str; 4] = ["SCALAR", "VEC2", "VEC3", "VEC4"];
/// Types of components.
const I8: u32 = 5120;
const U8: u32 = 5121;
const I16: u32 = 5122;
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;
/// Targets of buffers.
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;

/// Required extensions that change no number of an accessor, or that are read. Materials and textures colour no splat.
const READ: [&str; 2] = ["KHR_gaussian_splatting", "KHR_mesh_quantization"];
const OF_SURFACES: [&str; 2] = ["KHR_materials_", "KHR_texture_"];

/// Says that a material has the colours that it shows, whatever lamps there are.
const UNLIT: &str = "KHR_materials_unlit";

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
        let kind = KINDS[W - 1];
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

    /// The bytes of the file of `primitive`, in metres where the `info` of its scene says how long a world unit is. `note`, the
    /// offset of the scene in the unit of the file and all of its info stand in `asset.extras`.
    pub fn finish(self, primitive: Value, extension: Option<&str>, note: &str, info: &SceneInfo) -> Vec<u8> {
        let offset = info.scaled(info.metres_per_unit.unwrap_or(1.0)).offset;
        let extras = json!({ "note": note, "offset": offset, INFO: info });
        let mut document = json!({
            "accessors": self.accessors,
            "asset": { "generator": GENERATOR, "version": "2.0", "extras": extras },
            "buffers": [{ "byteLength": self.binary.len() }],
            "bufferViews": self.views,
            "scene": 0,
            "meshes": [{ "primitives": [primitive] }],
            "nodes": [{ "mesh": 0 }],
            "scenes": [{ "nodes": [0] }],
        });
        if document["meshes"][0]["primitives"][0].get("material").is_some() {
            let plain = json!({ "metallicFactor": 0, "roughnessFactor": 1 });
            document["materials"] = json!([{ "pbrMetallicRoughness": plain, "extensions": { UNLIT: {} } }]);
        }
        document["extensionsUsed"] = json!([extension.unwrap_or(UNLIT)]);
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

/// A glTF document with its buffers.
pub struct Gltf {
    pub document: Value,
    buffers: Vec<Vec<u8>>,
}

impl Gltf {
    /// From the bytes of a file, text or binary, whose buffers may lie in `folder`.
    pub fn read(bytes: &[u8], folder: &Path) -> Result<Self, String> {
        let (json, binary) = if bytes.starts_with(b"glTF") { parts(bytes)? } else { (bytes, None) };
        let document: Value = serde_json::from_slice(json).map_err(|error| format!("its JSON: {error}"))?;
        let mut required = document["extensionsRequired"].as_array().into_iter().flatten().filter_map(Value::as_str);
        let is_unknown = |name: &&str| !READ.contains(name) && !OF_SURFACES.iter().any(|of| name.starts_with(of));
        if let Some(name) = required.find(is_unknown) {
            return Err(format!("it requires the extension {name}, which cannot be read: write it without"));
        }
        let buffer = |(index, buffer): (usize, &Value)| match buffer["uri"].as_str() {
            // only the first may be the one in the file
            None => Ok(binary.filter(|_| index == 0).unwrap_or_default().to_vec()),
            Some(uri) => match uri.split_once(";base64,") {
                Some((_, text)) => BASE64_STANDARD.decode(text).map_err(|error| format!("a buffer: {error}")),
                None => {
                    let file = folder.join(&*percent_decode_str(uri).decode_utf8_lossy());
                    std::fs::read(file).map_err(|error| format!("its buffer `{uri}`: {error}"))
                }
            },
        };
        let buffers = document["buffers"].as_array().into_iter().flatten();
        let buffers = buffers.enumerate().map(buffer).collect::<Result<_, _>>()?;
        Ok(Self { document, buffers })
    }

    #[cfg(test)]
    pub fn buffer(&self, index: usize) -> &[u8] {
        &self.buffers[index]
    }

    /// `W` numbers for each element of accessor `index`; those of normalised integers are shares of their range.
    pub fn numbers<const W: usize>(&self, index: &Value) -> Result<Vec<[f32; W]>, String> {
        let number = |value: &Value| value.as_u64().unwrap_or(0) as usize;
        let accessor = &self.document["accessors"][number(index)];
        let wrong = |what: &str| format!("accessor {index} {what}");
        let (count, kind) = (number(&accessor["count"]), number(&accessor["componentType"]) as u32);
        if accessor["type"] != KINDS[W - 1] {
            return Err(wrong(&format!("has type {}, expected {}", accessor["type"], KINDS[W - 1])));
        }
        if accessor.get("sparse").is_some() || accessor.get("bufferView").is_none() {
            return Err(wrong("is sparse, which cannot be read"));
        }
        let view = &self.document["bufferViews"][number(&accessor["bufferView"])];
        let size = match kind {
            I8 | U8 => 1,
            I16 | U16 => 2,
            F32 => 4,
            other => return Err(wrong(&format!("has components of type {other}, which cannot be read"))),
        };
        let stride = view["byteStride"].as_u64().map_or(W * size, |stride| stride as usize);
        let (start, first) = (number(&accessor["byteOffset"]), number(&view["byteOffset"]));
        let buffer = self.buffers.get(number(&view["buffer"])).map_or(&[][..], |buffer| &buffer[..]);
        let end = first.saturating_add(number(&view["byteLength"])).min(buffer.len());
        let bytes = buffer.get(first..end).unwrap_or_default();
        let component = |at: usize| {
            let bytes = bytes.get(at..at + size)?;
            let (number, largest) = match kind {
                I8 => (f32::from(bytes[0] as i8), f32::from(i8::MAX)),
                U8 => (f32::from(bytes[0]), f32::from(u8::MAX)),
                I16 => (f32::from(i16::from_le_bytes(bytes.try_into().ok()?)), f32::from(i16::MAX)),
                U16 => (f32::from(u16::from_le_bytes(bytes.try_into().ok()?)), f32::from(u16::MAX)),
                _ => return Some(f32::from_le_bytes(bytes.try_into().ok()?)),
            };
            Some(if accessor["normalized"] == true { (number / largest).max(-1.0) } else { number })
        };
        // as far as there are bytes: a count that lies must not take the memory
        let rows = (0..count).map_while(|row| {
            let mut numbers = [0.0; W];
            for (column, number) in numbers.iter_mut().enumerate() {
                *number = component(start + row * stride + column * size)?;
            }
            Some(numbers)
        });
        let rows: Vec<[f32; W]> = rows.collect();
        if rows.len() == count {
            Ok(rows)
        } else {
            Err(wrong(&format!("ends after {} of {count} elements", rows.len())))
        }
    }
}

/// The JSON of a binary file, and its buffer where it has one.
fn parts(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let chunk = |at: usize, kind: u32| {
        let word = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
        let length = word(at)? as usize;
        if word(at + 4)? == kind { bytes.get(at + 8..)?.get(..length) } else { None }
    };
    let json = chunk(12, JSON_CHUNK).ok_or("it is truncated, or no binary glTF of version 2")?;
    Ok((json, chunk(20 + json.len().next_multiple_of(4), BINARY_CHUNK)))
}

//! Meshes as files: PLY in the axes of the dataset, binary glTF with y up.

use dpges_core::scene::SceneInfo;
use serde_json::json;

use super::super::error::ExportError;
use super::super::glb::GlbBuilder;
use super::super::{Coordinates, ply_head};
use super::TriangleMesh;
use crate::up::Up;

const NOTE: &str = "Mesh of the surfels alone: what Gaussians draw is missing";

impl TriangleMesh {
    /// A PLY file: binary, little endian, `x y z nx ny nz` as floats, `red green blue` as bytes, and `vertex_indices`. It
    /// is in the axes of the dataset; comments name what is up and the offset of `info`. In coordinates of the dataset `x y z`
    /// are doubles.
    pub fn to_ply(&self, info: &SceneInfo, coordinates: Coordinates) -> Vec<u8> {
        let mut text = ply_head(&[NOTE], &coordinates.info(info));
        text.push_str(&format!("element vertex {}\n", self.positions.len()));
        text.extend(["x", "y", "z"].map(|name| format!("property {} {name}\n", coordinates.ply_type())));
        text.extend(["nx", "ny", "nz"].map(|name| format!("property float {name}\n")));
        text.extend(["red", "green", "blue"].map(|name| format!("property uchar {name}\n")));
        text.push_str(&format!("element face {}\nproperty list uchar int vertex_indices\n", self.triangles.len()));
        text.push_str("end_header\n");
        let mut bytes = text.into_bytes();
        for (index, position) in self.positions.iter().enumerate() {
            bytes.extend(coordinates.ply_position(*position, info));
            bytes.extend(self.normals[index].iter().flat_map(|number| number.to_le_bytes()));
            bytes.extend(self.colours[index]);
        }
        for triangle in &self.triangles {
            bytes.push(3);
            bytes.extend(triangle.iter().flat_map(|corner| corner.to_le_bytes()));
        }
        bytes
    }

    /// A binary glTF file of the mesh of a scene, turned so that y is up, in metres where `info` says how long a world unit is. Vertex colours are linear, as glTF wants them, and
    /// unlit: photographs have their light in them.
    ///
    /// # Errors
    /// [`ExportError::TooMany`] if the file would exceed the 4 GiB that its header can say.
    pub fn to_glb(&self, info: &SceneInfo) -> Result<Vec<u8>, ExportError> {
        // 28 bytes a vertex, and about two triangles of 12 bytes to each
        let limit = u32::MAX as usize / 64;
        if self.positions.len().max(self.triangles.len() / 2) > limit {
            return Err(ExportError::TooMany { count: self.positions.len(), limit });
        }
        let rotation = Up::of(info).to_gltf().as_mat3();
        let metres = info.metres_per_unit.unwrap_or(1.0) as f32;
        let turn = |rows: &[[f32; 3]], factor: f32| -> Vec<[f32; 3]> {
            rows.iter().map(|&row| (factor * (rotation * glam::Vec3::from(row))).to_array()).collect()
        };
        let linear: Vec<u8> = (0..=255u8).map(to_linear).collect();
        let colours = self.colours.iter().map(|rgb| {
            let [red, green, blue] = rgb.map(|channel| linear[usize::from(channel)]);
            [red, green, blue, 255]
        });
        let mut glb = GlbBuilder::default();
        let attributes = json!({
            "POSITION": glb.positions(&turn(&self.positions, metres)),
            "NORMAL": glb.floats(turn(&self.normals, 1.0).into_iter()),
            "COLOR_0": glb.colours(colours),
        });
        let indices = glb.indices(self.triangles.as_flattened());
        Ok(glb.finish(json!({ "attributes": attributes, "indices": indices, "material": 0 }), None, NOTE, info))
    }
}

/// From sRGB.
fn to_linear(byte: u8) -> u8 {
    let value = f32::from(byte) / 255.0;
    let linear = if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) };
    crate::image::to_byte(linear)
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::super::super::glb::Gltf;
    use super::*;

    fn mesh() -> TriangleMesh {
        TriangleMesh {
            positions: vec![[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, -7.0, 8.5], [0.5, 0.25, 0.125]],
            normals: vec![[0.0, 0.0, 1.0]; 4],
            colours: vec![[0, 128, 255], [1, 2, 3], [4, 5, 6], [7, 8, 9]],
            triangles: vec![[0, 1, 2], [2, 1, 3]],
        }
    }

    fn info() -> SceneInfo {
        SceneInfo { up: Some([0.0, 0.0, 1.0]), offset: [1.0, 2.5, 3.0], ..SceneInfo::default() }
    }

    #[derive(Deserialize)]
    struct Vertex {
        x: f64,
        z: f64,
        nz: f32,
        green: u8,
    }

    #[derive(Deserialize)]
    struct Face {
        vertex_indices: Vec<u32>,
    }

    #[derive(Deserialize)]
    struct File {
        vertex: Vec<Vertex>,
        face: Vec<Face>,
    }

    #[test]
    fn a_general_reader_opens_the_ply() {
        let bytes = mesh().to_ply(&info(), Coordinates::Scene);
        assert!(String::from_utf8_lossy(&bytes).contains("comment Offset: 1 2.5 3 ("));
        let file: File = serde_ply::from_bytes(&bytes).unwrap();
        assert_eq!((file.vertex.len(), file.face.len()), (4, 2));
        let last = &file.vertex[2];
        assert_eq!((last.x, last.z, last.nz, last.green), (6.0, 8.5, 1.0, 5));
        assert_eq!(file.face[1].vertex_indices, [2, 1, 3]);
        let bytes = mesh().to_ply(&info(), Coordinates::Dataset);
        assert!(String::from_utf8_lossy(&bytes).contains("comment Offset: 0 0 0 ("));
        let last = &serde_ply::from_bytes::<File>(&bytes).unwrap().vertex[2];
        assert_eq!((last.x, last.z, last.nz, last.green), (7.0, 11.5, 1.0, 5));
    }

    #[test]
    fn the_glb_is_valid_upright_and_linear() {
        let bytes = mesh().to_glb(&info()).unwrap();
        let gltf = Gltf::read(&bytes, "nowhere".as_ref()).unwrap();
        let document = &gltf.document;
        let root: gltf_json::Root = serde_json::from_value(document.clone()).unwrap();
        let mut problems = Vec::new();
        gltf_json::validation::Validate::validate(&root, &root, gltf_json::Path::new, &mut |path, error| {
            problems.push(format!("{} {error}", path()));
        });
        assert!(problems.is_empty(), "{problems:?}");
        let primitive = &document["meshes"][0]["primitives"][0];
        let rows = |name: &str| gltf.numbers::<3>(&primitive["attributes"][name]).unwrap();
        assert_eq!((rows("POSITION")[1], rows("NORMAL")[0]), ([3.0, 5.0, -4.0], [0.0, 1.0, 0.0]));
        assert!(document["materials"][0]["extensions"]["KHR_materials_unlit"].is_object());
        assert_eq!(document["accessors"][primitive["indices"].as_u64().unwrap() as usize]["count"], 6);
        assert_eq!([0, 128, 255].map(to_linear), [0, 55, 255]);
    }
}

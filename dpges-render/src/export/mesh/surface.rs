//! Triangles where the distance changes its sign: surface nets, block by block.

use std::collections::HashMap;

use fast_surface_nets::ndshape::{ConstShape, ConstShape3u32};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use rayon::prelude::*;

use super::TriangleMesh;
use super::field::{BLOCK, BlockKey, Field, Voxel};

/// Lattice points along each side of what a block looks at: its own, and one more on either side.
const SIDE: u32 = BLOCK as u32 + 2;
type Shape = ConstShape3u32<SIDE, SIDE, SIDE>;

/// Vertices by the cell of the lattice that they lie in, and triangles of cells.
struct Piece {
    vertices: HashMap<[i32; 3], Vertex>,
    triangles: Vec<[[i32; 3]; 3]>,
}

#[derive(Clone, Copy)]
struct Vertex {
    position: [f32; 3],
    normal: [f32; 3],
    colour: [u8; 3],
}

/// The mesh of `field`, whose lattice points are `voxel` world units apart. It has no triangle next to a voxel that no
/// view knows. The same field gives the same mesh.
pub fn extract(field: &Field, voxel: f64) -> TriangleMesh {
    let mut keys: Vec<BlockKey> = field.blocks.iter().map(|block| block.key).collect();
    keys.sort_unstable();
    let pieces: Vec<Piece> = keys.par_iter().map(|&key| piece(field, key, voxel)).collect();
    let mut mesh = TriangleMesh::default();
    let mut index_of: HashMap<[i32; 3], u32> = HashMap::new();
    // blocks share the vertices of cells between them
    for Piece { vertices, triangles } in pieces {
        for triangle in triangles {
            let corners = triangle.map(|cell| {
                *index_of.entry(cell).or_insert_with(|| {
                    let vertex = vertices[&cell];
                    mesh.positions.push(vertex.position);
                    mesh.normals.push(vertex.normal);
                    mesh.colours.push(vertex.colour);
                    (mesh.positions.len() - 1) as u32
                })
            });
            mesh.triangles.push(corners);
        }
    }
    mesh
}

fn piece(field: &Field, key: BlockKey, voxel: f64) -> Piece {
    let origin = key.map(|i| i * BLOCK - 1);
    let point = |local: [u32; 3]| -> [i32; 3] { std::array::from_fn(|axis| origin[axis] + local[axis] as i32) };
    let voxels: Vec<Voxel> = (0..Shape::SIZE).map(|at| field.voxel(point(Shape::delinearize(at)))).collect();
    let distances: Vec<f32> =
        voxels.iter().map(|voxel| if voxel.weight > 0.0 { voxel.distance } else { 1.0 }).collect();
    let mut buffer = SurfaceNetsBuffer::default();
    surface_nets(&distances, &Shape {}, [0; 3], [SIDE - 1; 3], &mut buffer);
    let corners = |cell: [u32; 3]| -> [Voxel; 8] {
        std::array::from_fn(|corner| {
            let at = std::array::from_fn(|axis| cell[axis] + (corner as u32 >> axis & 1));
            voxels[Shape::linearize(at) as usize]
        })
    };
    let known: Vec<bool> =
        buffer.surface_points.iter().map(|&cell| corners(cell).iter().all(|voxel| voxel.weight > 0.0)).collect();
    let triangles = buffer.indices.as_chunks::<3>().0.iter();
    let triangles = triangles.filter(|triangle| triangle.iter().all(|&index| known[index as usize]));
    let cells = |triangle: &[u32; 3]| triangle.map(|index| point(buffer.surface_points[index as usize]));
    let vertex = |index: usize| {
        let (at, cell) = (buffer.positions[index], buffer.surface_points[index]);
        let normal = glam::Vec3::from(buffer.normals[index]).normalize_or_zero().to_array();
        let position = std::array::from_fn(|axis| ((f64::from(origin[axis]) + f64::from(at[axis])) * voxel) as f32);
        let inside = std::array::from_fn(|axis| at[axis] - cell[axis] as f32);
        (point(cell), Vertex { position, normal, colour: colour(&corners(cell), inside) })
    };
    let vertices = (0..buffer.positions.len()).filter(|&index| known[index]).map(vertex).collect();
    Piece { vertices, triangles: triangles.map(cells).collect() }
}

/// Colour at a place `inside` a cell, from 0 to 1 along each axis, between those of its corners.
fn colour(corners: &[Voxel; 8], inside: [f32; 3]) -> [u8; 3] {
    let share = |corner: usize| -> f32 {
        (0..3).map(|axis| if corner >> axis & 1 == 1 { inside[axis] } else { 1.0 - inside[axis] }).product()
    };
    std::array::from_fn(|channel| {
        let value: f32 = corners.iter().enumerate().map(|(at, voxel)| share(at) * voxel.colour[channel]).sum();
        crate::image::to_byte(value)
    })
}

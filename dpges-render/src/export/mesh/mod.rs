//! A mesh of the surfels: their rendered depths are [fused](Fusion) into a truncated signed distance field, and surface
//! nets make triangles of it.
//!
//! A mesh shows surfels only: details of Gaussians are missing, and holes stay holes.

mod field;
mod file;
mod fusion;
mod surface;

pub use fusion::{DepthView, Fusion, FusionOptions, SurfaceSample};

/// Triangles with a colour and a normal at every vertex, in the coordinates of the scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// `[V]` world units.
    pub positions: Vec<[f32; 3]>,
    /// `[V]` unit vectors, towards the side that is seen.
    pub normals: Vec<[f32; 3]>,
    /// `[V]` red, green, blue; display-referred.
    pub colours: Vec<[u8; 3]>,
    /// `[F]` vertices, counter-clockwise for those who see the front.
    pub triangles: Vec<[u32; 3]>,
}

//! Files for other programs: a scene as [splats](SplatCloud) that are sorted and blended (PLY, SPZ, glTF), or as a
//! [`mesh`] (PLY, glTF).
//!
//! Splats are an approximation: see [`flatten`](mod@flatten). The [`guide`](crate::guide) says what each format keeps.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use dpges_render::export::{UpAxis, flatten, to_ply};
//!
//! let scene = dpges_core::SceneData::load("scene.safetensors".as_ref())?;
//! std::fs::write("scene.ply", to_ply(&flatten(&scene, 3)?, UpAxis::Z))?;
//! # Ok(())
//! # }
//! ```

mod axes;
mod cloud;
mod error;
pub mod flatten;
mod glb;
mod harmonics;
pub mod html;
pub mod mesh;
mod splat_glb;
mod splat_ply;
#[cfg(test)]
mod splat_transform;
pub mod spz;

pub use axes::UpAxis;
pub use cloud::SplatCloud;
pub use error::ExportError;
pub use flatten::flatten;
pub use harmonics::{MAX_DEGREE, coefficient_count};
pub use splat_glb::to_glb;
pub use splat_ply::to_ply;

const GENERATOR: &str = concat!("dpges ", env!("CARGO_PKG_VERSION"));
/// The head of a PLY file up to its elements. `notes` are comments; positions are in axes with `up` upwards, and less than
/// those of the dataset by `offset`.
fn ply_head(notes: &[&str], up: UpAxis, [x, y, z]: [f64; 3]) -> String {
    let notes: String = notes.iter().map(|note| format!("comment {note}\n")).collect();
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment Exported from {GENERATOR}\n{notes}comment Vertical axis: {up}\n\
         comment Offset: {x} {y} {z} (add it to positions to get coordinates of the dataset)\n"
    )
}

/// The comment in files of splats, where the format has a place for it.
const APPROXIMATION: &str =
    "Approximation: sorted splats in place of depth-peeled surfels with order-free Gaussians (DP-GES)";

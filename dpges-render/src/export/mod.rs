//! Files of other programs: a scene as [splats](SplatCloud) that are sorted and blended (PLY, SPZ, SOG, glTF, OpenUSD), written and,
//! OpenUSD aside, [read](open()), or as a [`mesh`] (PLY, glTF).
//!
//! Splats are an approximation: see [`flatten`](mod@flatten). The [`guide`](crate::guide) says what each format keeps.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use dpges_render::export::{Coordinates, flatten, open, to_ply};
//!
//! let scene = open("scene.safetensors".as_ref())?.scene;
//! std::fs::write("scene.ply", to_ply(&flatten(&scene, 3)?, Coordinates::Scene))?;
//! # Ok(())
//! # }
//! ```

mod archive;
mod cloud;
mod error;
pub mod flatten;
mod glb;
mod harmonics;
pub mod html;
pub mod mesh;
mod notes;
mod open;
mod read_ply;
pub mod sog;
mod splat_glb;
mod splat_ply;
#[cfg(test)]
mod splat_transform;
pub mod spz;
mod usd;

pub use cloud::SplatCloud;
pub use error::ExportError;
pub use flatten::flatten;
pub use harmonics::{MAX_DEGREE, coefficient_count, to_harmonics};
pub use open::{Opened, open, read_splats};
pub use splat_glb::to_glb;
pub use splat_ply::to_ply;
pub use usd::{to_usda, to_usdz};

use dpges_core::scene::SceneInfo;

use crate::up::Up;

const GENERATOR: &str = concat!("dpges ", env!("CARGO_PKG_VERSION"));

/// Which coordinates a file has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coordinates {
    /// Those of the scene, which f32 holds; the file says how far the dataset is.
    #[default]
    Scene,
    /// Those of the dataset, in f64.
    Dataset,
}

impl Coordinates {
    /// `info` of what is written.
    fn info(self, info: &SceneInfo) -> SceneInfo {
        if self == Self::Dataset { SceneInfo { offset: [0.0; 3], ..info.clone() } } else { info.clone() }
    }

    /// Type of positions in PLY files.
    const fn ply_type(self) -> &'static str {
        match self {
            Self::Scene => "float",
            Self::Dataset => "double",
        }
    }

    fn ply_position(self, position: [f32; 3], info: &SceneInfo) -> Vec<u8> {
        match self {
            Self::Scene => position.iter().flat_map(|x| x.to_le_bytes()).collect(),
            Self::Dataset => {
                position.iter().zip(info.offset).flat_map(|(&x, to)| (f64::from(x) + to).to_le_bytes()).collect()
            }
        }
    }
}

/// Begins a text in a file that says all of its scene.
const SAYS_ALL: &str = "dpges ";

fn all_of(info: &SceneInfo) -> String {
    serde_json::to_string(info).expect("numbers and names become JSON")
}

/// The head of a PLY file up to its elements. `notes` are comments; `info` is that of what is written.
fn ply_head(notes: &[&str], info: &SceneInfo) -> String {
    let notes: String = notes.iter().map(|note| format!("comment {note}\n")).collect();
    let (up, [x, y, z]) = (Up::of(info), info.offset);
    let unit = info.metres_per_unit.map_or_else(String::new, |metres| format!("comment Unit: {metres} metres\n"));
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment Exported from {GENERATOR}\n{notes}comment Vertical axis: {up}\n\
         {unit}comment Offset: {x} {y} {z} (add it to positions to get coordinates of the dataset)\n"
    )
}

/// The comment in files of splats, where the format has a place for it.
const APPROXIMATION: &str =
    "Approximation: sorted splats in place of depth-peeled surfels with order-free Gaussians (DP-GES)";

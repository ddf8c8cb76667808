//! A scene in textures: attributes packed on the host, and what is computed from them for each frame.

mod colours;
mod packing;
mod pages;
mod textures;

#[cfg(feature = "export")]
pub(crate) use packing::unit_quaternion;
pub use pages::PackedCell;
pub(crate) use pages::{Fades, PAGE, Places, joined};
pub(crate) use textures::{Grid, SceneTextures, write};

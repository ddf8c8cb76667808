//! A scene in textures: attributes packed on the host, and what is computed from them for each frame.

mod colours;
mod packing;
mod pages;
mod textures;

pub(crate) use pages::{Fades, PAGE, PackedCell, Places};
pub(crate) use textures::{Grid, SceneTextures};

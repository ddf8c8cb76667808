//! Scenes in levels of detail: a folder with [`INDEX`], pack files of cells beside it, and the sky.
//!
//! The cells are trees, whose leaves are cells of level 0: together they hold every primitive of the scene once. The
//! children of a cell are one level finer, and its primitives stand for those of all its descendants, with about half their
//! number per level. A *cut* is drawn: of every way from a root to a leaf one cell. Each cell is a whole
//! [compressed scene file](super::compressed) somewhere in a pack file, so that any web server that knows ranges of bytes can
//! serve the folder. [`Index`] is what `index.json` says; [`Index::cell`] makes a scene of the bytes of a cell.
//!
//! The opacities of Gaussians are weights without an upper bound: what a merged Gaussian adds to the sums of a pixel is what
//! those it stands for add.

mod index;
mod read;
#[cfg(test)]
mod tests;

pub use index::{Cell, FORMAT, Index, Part, VERSION};

/// The file of a folder that says what the others hold.
pub const INDEX: &str = "index.json";
/// Name of the file with the cameras that a scene was exported with, in the convention of 3DGS.
pub const CAMERAS: &str = "cameras.json";

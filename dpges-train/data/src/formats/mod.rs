//! The layouts of datasets on disk: each is read as a [`Source`](source::Source).

pub(super) mod colmap;
pub(super) mod guest;
pub(super) mod nerfstudio;
mod ply;
pub(super) mod source;
mod split;
pub(super) mod transforms;

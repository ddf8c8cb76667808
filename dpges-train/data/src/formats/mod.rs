//! The layouts of datasets on disk: each is read as a [`Source`](source::Source).

pub(super) mod cloud;
pub(super) mod colmap;
pub(super) mod guest;
mod held_out;
pub(super) mod nerfstudio;
pub(super) mod plausible;
mod ply;
pub(super) mod source;
pub(super) mod transforms;

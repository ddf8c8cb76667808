//! Parts of the bench of the joint stage, apart from training itself.
//!
//! | module | says |
//! |---|---|
//! | [`pixels`] | what kind of pixel a pixel of a view is, by its layers |
//! | [`errors`] | how far pictures are from photographs, by kind of pixel |
//! | [`surfaces`] | where the surfels of a scene belong whose depth and normals are known |
//! | [`degrade`] | what is wrong with them, one thing at a time |
//! | [`table`] | means over seeds, in Markdown |

pub mod degrade;
pub mod errors;
pub mod pixels;
pub mod surfaces;
pub mod table;

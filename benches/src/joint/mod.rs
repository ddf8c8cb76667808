//! Parts of the bench of the joint stage, apart from training itself.

pub mod degrade;
pub mod errors;
pub mod pixels;
pub mod surfaces;

//! A *disc*: a surfel that the ray through a pixel meets. `cpu` and `cube` are twins.

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod cube;

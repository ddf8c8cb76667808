//! A *splat*: the ellipse that a Gaussian projects to (EWA). `cpu` and `cube` are twins.

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod cube;
pub(crate) mod tensors;

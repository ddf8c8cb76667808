//! Properties of each view besides the scene, learnt or known: its pose, its exposure, its depth map; and its photograph on a device.

pub mod corrections;
pub mod depth;
pub mod exposure;
pub mod pose;
pub mod target;

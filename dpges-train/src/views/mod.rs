//! What is learnt or known about each view besides the scene: its pose, its exposure, its depth map.

pub mod corrections;
pub mod depth;
pub mod exposure;
pub mod pose;

//! Moving through a scene: where the camera stands, what the hands do, and how one follows from the other. Nothing here
//! reads a clock or draws.

mod flight;
mod gestures;
mod motion;
mod navigator;
mod viewpoint;

pub use gestures::gestures;
pub use navigator::{Mode, Navigator};
pub use viewpoint::{Surroundings, Viewpoint};

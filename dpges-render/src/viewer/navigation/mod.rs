//! Moving through a scene: where the camera stands, what the hands do, and how one follows from the other. Nothing here
//! reads a clock or draws.

mod extent;
mod flight;
mod gestures;
mod motion;
mod navigator;
mod viewpoint;

pub use extent::{Extent, mean_up};
pub use gestures::gestures;
pub use navigator::{Mode, Navigator};
pub use viewpoint::{Lens, Surroundings, Viewpoint};

//! Moving through a scene: where the camera stands, what the hands do, and how one follows from the other. Nothing here
//! reads a clock, knows a toolkit or draws: the window and the page for browsers move by the same rules.

mod first_view;
mod flight;
pub(crate) mod hands;
mod motion;
mod navigator;
mod tour;
mod viewpoint;

pub use first_view::{first_view, overview};
pub use hands::{Drag, Input, Keys, Mode};
pub use motion::Motion;
pub use navigator::Navigator;
pub use tour::Tour;
pub use viewpoint::{Lens, Pose, Surroundings, Viewpoint};

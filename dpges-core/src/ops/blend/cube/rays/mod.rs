//! Each pixel's own order (StopThePop): the walk through a tile, and the backward pass.

mod replay;
mod walk;

pub use self::replay::{Said, replay};
pub use self::walk::{PIXEL_STATE, said_at, said_numbers, walk_rays};

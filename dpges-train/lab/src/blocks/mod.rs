//! Large captures in blocks: plan, coarse scene, one run for each block, merge. Every step is a run like any other; the same
//! step again does what is left of it.
//!
//! ```text
//! plan.json                 dataset, configuration, blocks with their bounds and cameras
//! plan.png                  blocks and cameras from above
//! coarse/                   the run of the whole capture
//! block-K/                  the run of a block, and what it begins with:
//!   block.json                its bounds, its views, and the name of the next file
//!   surroundings.safetensors  the part of the coarse scene that is drawn around it
//!   inside.safetensors        the part that it begins with
//! merged/                   the run that closes seams; scene.safetensors is the result
//!   joined.safetensors        the cores of all blocks, which it begins with
//! STEP/done.json            written last
//! ```
//!
//! | number | source |
//! |---|---|
//! | at most [`MOST_POINTS`](split::MOST_POINTS) points in a block, grown by [`GROWTH`](split::GROWTH) | BlockGaussian, `configs/rubble.yaml` |
//! | a camera belongs to a block that fills [`LEAST_SHARE`](cameras::LEAST_SHARE) of its picture | CityGaussianV2, `content_threshold` |
//! | the joint run takes [`JOINT_SHARE`](steps::JOINT_SHARE) of the steps, at the last learning rates of a run | chosen here |

pub mod cameras;
mod error;
mod picture;
pub mod plan;
mod scenes;
pub mod split;
pub mod steps;
#[cfg(test)]
mod tests;

pub use error::BlocksError;

type Result<T, E = BlocksError> = std::result::Result<T, E>;

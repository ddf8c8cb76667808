//! Which primitives can touch which tile of an image: a list per tile.
//!
//! On the CPU lists are in ascending order of index. On GPUs they are in no particular order unless order
//! is asked for, and a list that does not fit its buffer stands for all primitives.

#[cfg(feature = "gpu")]
pub(crate) mod boxes;
#[cfg(feature = "gpu")]
pub(crate) mod capacity;
pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod cube;

#[cfg(all(feature = "gpu", any(test, feature = "testing")))]
pub use capacity::cap_lists;

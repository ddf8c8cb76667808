//! Binning and culling: for every tile of an image, the list of the primitives that can touch it.
//!
//! Lists ascend by index.

#[cfg(feature = "gpu")]
pub(crate) mod boxes;
#[cfg(feature = "gpu")]
pub(crate) mod capacity;
pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod cube;

#[cfg(all(feature = "gpu", any(test, feature = "testing")))]
pub use capacity::cap_lists;

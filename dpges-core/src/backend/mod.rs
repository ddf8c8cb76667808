//! Differences between Burn's backends: the CPU's tensors as slices, element types, vector instructions,
//! entries on the tape, reads from a device.

pub mod device;
pub(crate) mod host;
pub mod kept;
pub(crate) mod lanes;
pub(crate) mod number;
pub mod readback;
pub(crate) mod real;
pub(crate) mod tape;
pub(crate) mod tensor_list;
mod vector_math;
pub(crate) mod vectorised;
pub(crate) mod vectors;

//! What the CubeCL kernels share: launching, uniforms, vectors, exact arithmetic,
//! gathering. It knows no operation.
//!
//! Every kernel keeps within what WebGPU guarantees: at most 7 buffers of its own (the eighth holds
//! the scalars), 16 KiB of workgroup memory, 256 units, no float atomics, no subgroups, no reliance
//! on NaN; infinity is never a constant but a uniform.

pub(crate) mod exact;
pub(crate) mod gather;
pub(crate) mod launch;
pub(crate) mod rect;
pub(crate) mod tile;
pub(crate) mod vector;
pub(crate) mod view;

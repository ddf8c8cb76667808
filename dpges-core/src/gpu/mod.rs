//! The kernel kit: launching, uniforms, vectors, exact arithmetic, records,
//! gathering, sums, prefix sums, sorting. It knows no operation.
//!
//! Every kernel stays within the limits that WebGPU guarantees: at most 7 buffers (an eighth holds the
//! scalars), 16 KiB of workgroup memory, 256 units, no float atomics, no subgroups. No kernel relies on
//! NaN, and infinity is a uniform, never a constant.

pub(crate) mod exact;
pub(crate) mod gather;
pub(crate) mod launch;
pub mod lens;
pub(crate) mod mask;
pub(crate) mod record;
pub(crate) mod rect;
pub(crate) mod reduce;
pub(crate) mod scan;
pub(crate) mod sort;
pub(crate) mod tile;
pub(crate) mod vector;
pub(crate) mod view;
pub(crate) mod work_split;

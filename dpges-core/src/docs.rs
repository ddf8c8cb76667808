//! The guides of `docs/`: how the crate is built, what it computes, and how exactly.

#[doc = include_str!("../docs/architecture.md")]
pub mod architecture {}

#[doc = include_str!("../docs/method.md")]
pub mod method {}

#[doc = include_str!("../docs/numerics.md")]
pub mod numerics {}

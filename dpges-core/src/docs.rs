//! The documents of `docs/`: how the crate is built, what it computes, and how exactly.

#[doc = include_str!("../docs/architecture.md")]
pub mod architecture {}

/// Formulas, differences from the paper, precision.
pub mod method {
    #[doc = include_str!("../docs/method/method.md")]
    pub mod formulas {}

    #[doc = include_str!("../docs/method/paper.md")]
    pub mod paper {}

    #[doc = include_str!("../docs/method/numerics.md")]
    pub mod numerics {}
}

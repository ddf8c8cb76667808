//! Scenes made smaller without training: what a primitive contributes to pictures, what of its colour can go, and which
//! primitives are waste.

pub mod clean;
mod contribution;
mod detail;

pub use contribution::Contributions;
pub use detail::{detail_of, with_detail};

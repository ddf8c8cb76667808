//! Scenes made smaller without training: what a primitive contributes to pictures, and what of its colour can go.

mod contribution;
mod detail;

pub use contribution::Contributions;
pub use detail::{detail_of, with_detail};

//! Studies: variants × seeds × measures.
//!
//! A [`variant::Variant`] is a way to train. Each is trained with each seed, a [`cell::Cell`] with a folder of its own. What
//! is measured of a scene is a [`row::Row`] of numbers by the names of [`measure::MEASURES`]. A [`store::Study`] keeps the
//! rows, and [`report`] writes them: a table, a plot for every cost and one page.
//!
//! [`ablate`], [`compare`] and [`trade`] say which variants there are; `trade` also draws one scene in many ways. [`benchmark`]
//! trains on many scenes.

pub mod ablate;
pub mod benchmark;
pub mod cell;
pub mod compare;
mod error;
pub mod evaluated;
mod frontier;
pub mod measure;
mod plot;
pub mod plot_font;
pub mod report;
pub mod row;
pub mod sheets;
pub mod spread;
pub mod store;
mod table;
pub mod trade;
pub mod variant;

pub use error::StudyError;

type Result<T, E = StudyError> = std::result::Result<T, E>;

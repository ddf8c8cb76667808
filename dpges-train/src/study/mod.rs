//! Studies: many trainings and measurements, and one report of them.

pub mod ablate;
pub mod compare;
pub mod plot_font;
pub mod series;
pub mod trade;

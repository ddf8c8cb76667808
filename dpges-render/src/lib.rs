//! Real-time rendering of trained scenes.

pub mod false_colour;
mod image;

pub use image::Rgb8Image;

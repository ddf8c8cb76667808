//! Studies, blocks and levels of detail: made of many runs of [`dpges_train`], or of their scenes.
//!
//! A [`study`] trains and measures many; [`blocks`] splits a large capture into runs and joins their scenes; [`lod`] makes coarser
//! levels of a scene.
//!
//! | crate | for |
//! |---|---|
//! | dpges-train, dpges-render, dpges-core, burn | runs, pictures, scenes, devices |
//! | glam, nalgebra | positions; the axes of merged primitives |
//! | image, plotters, epaint_default_fonts, base64 | plots, their letters, pictures within a report |
//! | clap | options of a benchmark |
//! | humantime | the date of a report |
//! | rand, rand_chacha, rayon | random numbers; what is computed in parallel |
//! | serde, serde_json, toml, tempfile, thiserror, tracing | reports, plans, errors, messages |

pub mod blocks;
#[cfg(test)]
mod fixtures;
pub mod lod;
pub mod study;

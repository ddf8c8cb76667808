//! Real-time rendering of trained scenes on the graphics pipeline of any GPU, without compute shaders and without Burn.
//!
//! [`RasterRenderer`] draws into a view of a texture of an application's own device; [`Headless`] makes pictures without a
//! window.
//!
//! ```no_run
//! use dpges_core::camera::Camera;
//! use dpges_core::scene::SceneData;
//! use dpges_render::{Headless, RenderOptions, Rgb8Image};
//!
//! fn picture(camera: &Camera) -> Result<Rgb8Image, Box<dyn std::error::Error>> {
//!     let scene = SceneData::load("runs/first/scene.safetensors".as_ref())?;
//!     Ok(Headless::new()?.picture(&scene, camera, &RenderOptions::from(&scene.info))?)
//! }
//! ```
//!
//! # How
//!
//! K passes over all surfels find the layers of every pixel: the depth test keeps the nearest fragment, and a comparison
//! with the previous layer rejects what was found before, by (depth, index), so that neither of two surfels that meet is
//! lost. With continuous peeling ([`RenderOptions::peeling`]), the first finds the nearest opaque fragment of every pixel, and
//! the depth test ends the others where their order to it becomes certain. One pass over the pixels makes the surfels' picture
//! and packs what Gaussians need to know of it. Gaussians are
//! then added in any order. Nothing is sorted, and colours and ellipses are computed once per primitive, by a pass in
//! which a fragment is a primitive. Scenes of blended Gaussians or discs are sorted by depth on the host for each frame.
//!
//! Attributes are packed: see `scene/packing.rs` and `scene/colours.rs`. Depths are near / z in 32-bit floats.
//!
//! # Dependencies
//!
//! | crate | for |
//! |---|---|
//! | wgpu | the graphics pipeline; the feature `native` adds the interfaces of desktops |
//! | dpges-core, without Burn | scenes, cameras, files |
//! | bytemuck, half, glam | texels, halves, cameras in f64 |
//! | radsort | the order of scenes that are blended |
//! | wgpu-profiler | times of passes |
//! | pollster | waiting for a device without a window |
//! | serde, serde_json | files of camera paths |
//! | thiserror | errors |
//! | zstd, flate2, zip, image, serde-ply, base64, percent-encoding, fast-surface-nets, rayon | feature `export`: the formats, the surface of a mesh |
//! | ureq | feature `http`: cells of scenes in levels of detail from web servers |
//! | eframe, egui, egui_plot, rfd, image | feature `viewer`: the window, its graph, dialogs, screenshots |
//! | egui_kittest, gltf-json, libtest-mimic, safetensors, tempfile, approx | tests |

pub mod error;
#[cfg(feature = "export")]
pub mod export;
pub mod false_colour;
#[cfg(test)]
mod fixtures;
#[cfg(not(target_arch = "wasm32"))]
pub mod frame_times;
mod groups;
#[doc = include_str!("../docs/view-and-export.md")]
pub mod guide {}
#[cfg(not(target_arch = "wasm32"))]
mod headless;
mod image;
pub mod navigation;
mod options;
mod order;
mod passes;
pub mod path;
pub mod percentile;
mod profile;
mod renderer;
mod scene;
pub mod stream;
mod targets;
mod texture;
mod up;
#[cfg(feature = "viewer")]
pub mod viewer;

pub use error::{RenderError, Result};
#[cfg(not(target_arch = "wasm32"))]
pub use headless::{Headless, PICTURE_FORMAT};
pub use image::Rgb8Image;
pub use options::{DepthSource, Display, MAX_LAYERS, Precision, RenderOptions};
pub use path::CameraPath;
pub use profile::PassTime;
pub use renderer::{RasterRenderer, check_drawn, check_drawn_as_trained};
pub use up::Up;

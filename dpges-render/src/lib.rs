//! Pictures of trained scenes: rendered views, and their layers in legible colours.
//!
//! ```no_run
//! use dpges_core::camera::Camera;
//! use dpges_core::scene::SceneData;
//! use dpges_render::{Renderer, Rgb8Image};
//!
//! fn picture(camera: &Camera) -> dpges_core::Result<Rgb8Image> {
//!     let scene = SceneData::load("runs/first/scene.safetensors".as_ref())?;
//!     let view = Renderer::new(&scene, &Default::default()).render(camera)?;
//!     Ok(Rgb8Image::from_tensor(view.image()))
//! }
//! ```

pub mod false_colour;
mod image;
mod layers;
mod renderer;

pub use image::Rgb8Image;
pub use layers::{LayerPictures, layer_pictures};
pub use renderer::{Rendered, Renderer};

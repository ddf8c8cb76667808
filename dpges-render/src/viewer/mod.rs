//! A window that shows a scene: [`run`] opens it and returns when it is closed. The [`guide`](crate::guide) describes it.

mod app;
mod canvas;
mod comparison;
mod dialogs;
mod editing;
mod edits;
mod error;
mod frame_times;
mod gestures;
#[cfg(test)]
mod gpu_tests;
mod keys;
mod live;
mod loading;
mod measuring;
mod messages;
mod panels;
mod path_editor;
mod pending;
mod picture;
mod question;
mod recent;
mod resolution;
mod screenshot;
mod start;
mod start_page;
mod state;
#[cfg(test)]
mod tests;
mod views;
mod window;

pub use error::ViewerError;
pub use live::{LiveProgress, LiveScene};
pub use loading::{Opened, Opener, open_scene};
pub use start::Start;
pub use views::{DatasetViews, Photograph, ReadViews, Views};
pub use window::{Gpu, ViewerOptions, run};

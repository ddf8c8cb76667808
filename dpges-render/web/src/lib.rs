//! The renderer in a browser: what the page's `viewer.js` calls. Other targets see an empty library.
#![cfg(target_arch = "wasm32")]

mod device;
mod page;
mod pixels;
mod viewer;

pub use viewer::Viewer;

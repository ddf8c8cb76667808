//! Messages from and to the page, as JSON: options, properties of a scene.

use dpges_core::scene::{Peeling, SceneInfo};
use dpges_render::{Display, RenderOptions};
use serde::{Deserialize, Serialize};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PageOptions {
    display: Display,
    layer_count: usize,
    modulation: f64,
    peeling: Peeling,
    /// Red, green, blue from 0 to 1.
    background: [f64; 3],
}

impl PageOptions {
    pub fn options(&self, scene: &SceneInfo) -> RenderOptions {
        let Self { display, layer_count, modulation, peeling, background } = *self;
        RenderOptions { display, layer_count, modulation, peeling, background, ..RenderOptions::from(scene) }
    }
}

#[derive(Serialize)]
pub struct Summary<'a> {
    pub surfels: usize,
    pub gaussians: usize,
    #[serde(flatten)]
    pub info: &'a SceneInfo,
}

#[derive(Serialize)]
pub struct Device<'a> {
    pub backend: &'a str,
    pub adapter: String,
    /// Bits per number between the passes.
    pub precision_bits: u32,
    /// Longest side of a picture, px.
    pub largest_px: u32,
}

//! A scene kept on a device, ready for one view after another.

use burn::tensor::{DType, Device};
use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::ops::composite::{Geometry, geometry};
use dpges_core::render::{Render, RenderOptions, render};
use dpges_core::scene::{Gaussians, SceneData, Surfels};

/// A scene as f32 tensors, with the options it was trained with.
#[derive(Clone, Debug)]
pub struct Renderer {
    surfels: Surfels,
    gaussians: Gaussians,
    options: RenderOptions,
}

impl Renderer {
    pub fn new(scene: &SceneData, device: &Device) -> Self {
        let model = scene.info.colour_model;
        Self {
            surfels: Surfels::from_data(&scene.surfels, model, device, DType::F32),
            gaussians: Gaussians::from_data(&scene.gaussians, model, device, DType::F32),
            options: RenderOptions::from(&scene.info),
        }
    }

    /// The view from `camera`, which stands in the scene's own coordinates.
    ///
    /// # Errors
    /// As [`render`].
    pub fn render(&self, camera: &Camera) -> Result<Render> {
        render(&self.surfels, &self.gaussians, camera, &self.options)
    }

    /// Blended depth and normal of the surfels in a `view` from `camera`.
    pub fn geometry(&self, camera: &Camera, view: &Render) -> Geometry {
        geometry(&self.surfels, camera, &view.layers, &view.composite.transmittance)
    }
}

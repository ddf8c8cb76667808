//! The two renderers, seen alike.

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::{Headless, Precision, RenderOptions, Rgb8Image};
use dpges_train::eval::rendered::{LayerPictures, Renderer, layer_pictures, to_picture};

use super::super::Result;

/// A picture, and those of its layers where they were asked for.
pub struct Painted {
    pub picture: Rgb8Image,
    pub layers: Option<LayerPictures>,
}

/// Makes pictures of one scene.
pub trait Painter {
    fn paint(&mut self, camera: &Camera) -> Result<Painted>;
}

/// The renderer that is trained with.
pub struct TrainingPainter {
    renderer: Renderer,
    layers: bool,
}

impl TrainingPainter {
    pub fn new(scene: &SceneData, device: &Device, layers: bool) -> Self {
        Self { renderer: Renderer::new(scene, device), layers }
    }
}

impl Painter for TrainingPainter {
    fn paint(&mut self, camera: &Camera) -> Result<Painted> {
        let render = self.renderer.render(camera)?;
        let peeled = render.peeled().filter(|_| self.layers);
        Ok(Painted {
            picture: to_picture(render.image()),
            layers: peeled.map(|view| layer_pictures(&self.renderer, camera, view)),
        })
    }
}

/// The real-time renderer.
pub struct RasterPainter {
    headless: Headless,
    renderer: dpges_render::Renderer,
    options: RenderOptions,
}

impl RasterPainter {
    /// Gaussians are summed in 16 bits if `half_sums`, otherwise as precisely as the adapter can.
    pub fn new(scene: &SceneData, half_sums: bool) -> Result<Self> {
        let headless = Headless::new()?;
        tracing::info!("rendering on {}", headless.adapter_name());
        let mut renderer = headless.renderer_with(half_sums.then_some(Precision::Half))?;
        renderer.upload(scene)?;
        Ok(Self { headless, renderer, options: RenderOptions::from(&scene.info) })
    }
}

impl Painter for RasterPainter {
    fn paint(&mut self, camera: &Camera) -> Result<Painted> {
        Ok(Painted { picture: self.headless.draw(&mut self.renderer, camera, &self.options)?, layers: None })
    }
}

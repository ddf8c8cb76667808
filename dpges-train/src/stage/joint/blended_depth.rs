//! The maps that trained Gaussians or discs show, blended in their order.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::camera::Camera;
use dpges_core::losses::geometry::expected_depth;
use dpges_core::ops::blend::Maps;
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::render::{Values, ViewRequest};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Gaussians, SceneInfo};

/// Gaussians or discs on a device, of which maps are rendered.
pub struct BlendedMaps {
    gaussians: Gaussians,
    options: BlendedOptions,
}

/// The depths of one view, [H × W] each.
pub struct ShownDepth {
    /// 1 − T, from 0 to 1.
    pub alpha: Vec<f32>,
    /// Mean depth, weighted by αT, world units.
    pub mean: Vec<f32>,
    /// Depth at which T falls below ½, world units.
    pub median: Vec<f32>,
}

impl BlendedMaps {
    /// Maps of `gaussians`, blended as a scene with `info` says.
    pub fn new(gaussians: &GaussianData, info: &SceneInfo, device: &Device) -> dpges_core::Result<Self> {
        let mut options = BlendedOptions::new(info)?;
        options.blend.maps = true;
        Ok(Self { gaussians: Gaussians::from_data(gaussians, device, DType::F32), options })
    }

    /// The maps of a view, and alpha [1, H, W].
    pub fn seen_by(&self, camera: &Camera) -> dpges_core::Result<(Maps, Tensor<3>)> {
        let view = ViewRequest { values: Values::KnownFinite, ..camera.into() };
        let blend = render_blended(&self.gaussians, view, &self.options)?.blend;
        Ok((blend.maps.expect("maps were asked for"), blend.alpha))
    }

    pub fn depths(&self, camera: &Camera) -> dpges_core::Result<ShownDepth> {
        let (Maps { depth, median_depth, .. }, alpha) = self.seen_by(camera)?;
        Ok(ShownDepth {
            alpha: tensor_to_rows(&alpha),
            mean: tensor_to_rows(&expected_depth(depth, alpha)),
            median: tensor_to_rows(&median_depth),
        })
    }
}

//! The depths that trained Gaussians show, blended in their order.

use burn::tensor::DType;
use dpges_core::camera::Camera;
use dpges_core::losses::geometry::expected_depth;
use dpges_core::ops::blend::Maps;
use dpges_core::render::Values;
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Gaussians, Rendering, SceneInfo, ScreenFilter};

use super::super::Context;

/// Gaussians on a device, whose depths are rendered.
pub struct BlendedDepth {
    gaussians: Gaussians,
    options: BlendedOptions,
}

/// One view, [H × W] each.
pub struct ShownDepth {
    /// 1 − T, from 0 to 1.
    pub alpha: Vec<f32>,
    /// Mean depth, weighted by αT, world units.
    pub mean: Vec<f32>,
    /// Depth at which T falls below ½, world units.
    pub median: Vec<f32>,
}

impl BlendedDepth {
    /// Depths of `gaussians`, blended with `filter`.
    ///
    /// # Errors
    /// The errors of [`BlendedOptions::new`].
    pub fn new(gaussians: &GaussianData, filter: ScreenFilter, context: &Context) -> dpges_core::Result<Self> {
        let info = SceneInfo { screen_filter: filter, ..context.scene_info(Rendering::Ellipsoids) };
        let mut options = BlendedOptions::new(&info)?;
        options.blend.maps = true;
        Ok(Self { gaussians: Gaussians::from_data(gaussians, &context.device, DType::F32), options })
    }

    /// # Errors
    /// [`dpges_core::Error`] if they cannot be rendered from `camera`.
    pub fn seen_by(&self, camera: &Camera) -> dpges_core::Result<ShownDepth> {
        let blend = render_blended(&self.gaussians, None, camera, &self.options, Values::KnownFinite)?.blend;
        let Some(Maps { depth, median_depth, .. }) = blend.maps else { unreachable!("maps were asked for") };
        Ok(ShownDepth {
            alpha: tensor_to_rows(&blend.alpha),
            mean: tensor_to_rows(&expected_depth(depth, blend.alpha)),
            median: tensor_to_rows(&median_depth),
        })
    }
}

//! One view of a scene of blended Gaussians: what DP-GES is initialised with, and compared with (3DGS, 2DGS, SSS).

use burn::tensor::Tensor;

use super::{ViewRequest, shown, validate_gaussians};
use crate::counters::transfers::uploaded;
use crate::error::{Error, Result};
use crate::ops::blend::{Blend, BlendOptions, Form, blend};
use crate::ops::colour::colour;
use crate::scene::{Gaussians, Rendering, SceneInfo};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlendedOptions {
    pub blend: BlendOptions,
    /// Display-referred colour behind everything.
    pub background: [f64; 3],
}

impl BlendedOptions {
    /// # Errors
    /// [`Error::Option`] if the scene is not one of blended Gaussians.
    pub fn new(info: &SceneInfo) -> Result<Self> {
        let form = match info.rendering {
            Rendering::Ellipsoids if info.blend_order.transparency().is_some() => Form::Whitened,
            Rendering::Ellipsoids => Form::Ellipsoids,
            Rendering::Discs => Form::Discs,
            Rendering::Students => Form::Students,
            Rendering::Peeled | Rendering::Summed => {
                let expected = "ellipsoids, discs or students".to_owned();
                return Err(Error::Option { option: "rendering", expected, found: info.rendering.to_string() });
            }
        };
        let blend = BlendOptions {
            form,
            filter: info.screen_filter,
            order: info.blend_order,
            max_alpha: info.max_alpha(),
            ..BlendOptions::default()
        };
        Ok(Self { blend, background: info.background })
    }
}

/// A rendered view of blended Gaussians.
#[derive(Clone, Debug)]
pub struct BlendedRender {
    /// [3, H, W] display-referred, not clamped, on the background.
    pub image: Tensor<3>,
    pub blend: Blend,
}

impl BlendedRender {
    /// The same view with an [environment](mod@crate::ops::environment) [3, H, W] behind everything, which adds to the
    /// background: `(1 − alpha) E`.
    #[must_use]
    pub fn in_front_of(self, environment: Tensor<3>) -> Self {
        Self { image: self.image + shown(&self.blend.alpha, environment), ..self }
    }
}

/// Renders a view, of which a camera is enough, of `gaussians`, nearest first. Colours below 0 count as 0 (3DGS).
///
/// # Errors
/// A typed error naming what does not fit: see [`validate_gaussians`], [`validate`](crate::camera::Camera::validate),
/// [`BlendOptions::validate`]. Also [`Error::Capacity`].
pub fn render_blended<'a>(
    gaussians: &Gaussians,
    view: impl Into<ViewRequest<'a>>,
    options: &BlendedOptions,
) -> Result<BlendedRender> {
    let ViewRequest { camera, values, pose, probe, .. } = view.into();
    camera.validate()?;
    validate_gaussians(gaussians, values)?;
    let colours = colour(&gaussians.colour, &gaussians.positions, camera.centre().to_array())?.clamp_min(0.0);
    let moved = pose.map(|probe| probe.gaussians(gaussians));
    let blend = blend(moved.as_ref().unwrap_or(gaussians), &colours, probe, camera, &options.blend)?;
    let image = if options.background == [0.0; 3] {
        blend.colour.clone()
    } else {
        let (device, dtype) = (blend.colour.device(), blend.colour.dtype());
        let background = uploaded(options.background.to_vec(), [3, 1, 1], &device, dtype);
        blend.colour.clone() + shown(&blend.alpha, background)
    };
    Ok(BlendedRender { image, blend })
}

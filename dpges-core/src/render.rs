//! One view of a scene, from parameters to pixels.

pub mod blended;
pub mod pose;
pub mod room;
pub mod summed;

use burn::tensor::{DType, Tensor};

use crate::backend::device::is_gpu;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::ops::colour::colour;
use crate::ops::composite::{Composite, CompositeOptions, composite};
use crate::ops::finite::{FiniteChecks, check_finite};
use crate::ops::peel::{Layers, PeelOptions, peel};
use crate::ops::splat::splat;
use crate::ops::visibility::{Visibility, visibility};
use crate::ranks::{Alone, Ranks};
use crate::scene::schema::Columns;
use crate::scene::{Gaussians, SceneInfo, Surfels};
use pose::PoseProbe;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RenderOptions {
    pub peel: PeelOptions,
    /// C_b, display-referred.
    pub background: [f64; 3],
    /// Stop the gradient from the Gaussians to the surfels (ablation).
    pub detach_transmittance: bool,
}

impl From<&SceneInfo> for RenderOptions {
    fn from(info: &SceneInfo) -> Self {
        Self { peel: PeelOptions::from(info), background: info.background, detach_transmittance: false }
    }
}

/// A rendered view. Images are [C, H, W] in display-referred values and not clamped.
#[derive(Clone, Debug)]
pub struct Render {
    /// Image, surfel image, Gaussian colour and weight.
    pub composite: Composite,
    pub layers: Layers,
    pub seen: Visibility,
    /// [N, 3] colours of the surfels from this camera.
    pub surfel_colours: Tensor<2>,
    /// [M, 3] colours of the Gaussians from this camera.
    pub gaussian_colours: Tensor<2>,
}

impl Render {
    /// The same view with an [environment](mod@crate::ops::environment) [3, H, W] behind everything, see
    /// [`Composite::in_front_of`].
    #[must_use]
    pub fn in_front_of(self, environment: Tensor<3>) -> Self {
        let open = self.seen.behind_all();
        Self { composite: self.composite.in_front_of(environment, open), ..self }
    }
}

/// Whether the values of the parameters are looked at before they are rendered; on a GPU that waits
/// for everything the device still has to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Values {
    Unknown,
    KnownFinite,
}

/// A view to render. Made from a [`Camera`] it has nothing but that.
#[derive(Clone, Copy, Debug)]
pub struct ViewRequest<'a> {
    pub camera: &'a Camera,
    pub values: Values,
    /// Receives the gradient of the camera.
    pub pose: Option<&'a PoseProbe>,
    /// Its gradient tells how much the picture wants each Gaussian to move: [M, 4] of blended ones, see
    /// [`blend`](mod@crate::ops::blend), or [M, 2] of summed ones, see [`splat_probed`](crate::ops::splat::splat_probed).
    /// Behind surfels there is none.
    pub probe: Option<&'a Tensor<2>>,
    /// Those over which Gaussians behind surfels are sharded: each renders its own. All get the same picture, and the whole
    /// gradient of surfels and own Gaussians.
    pub ranks: &'a dyn Ranks,
}

impl<'a> From<&'a Camera> for ViewRequest<'a> {
    fn from(camera: &'a Camera) -> Self {
        Self { camera, values: Values::Unknown, pose: None, probe: None, ranks: &Alone }
    }
}

/// The part of `behind` that shows through `alpha` [1, H, W].
fn shown(alpha: &Tensor<3>, behind: Tensor<3>) -> Tensor<3> {
    (alpha.clone() * -1.0 + 1.0) * behind
}

/// Checks shapes, element types and, where `values` asks for it, finiteness of everything that is rendered.
///
/// # Errors
/// [`Error::Shape`], [`Error::DType`] or [`Error::NonFinite`] naming the tensor.
pub fn validate(surfels: &Surfels, gaussians: &Gaussians, values: Values) -> Result<()> {
    surfels.check_shapes()?;
    gaussians.check_shapes()?;
    let mut check = InputCheck::new("surfels.positions", &surfels.positions);
    check.add(surfels, values)?;
    check.add(gaussians, values)?;
    check_finite(check.checks)
}

/// [`validate`] for a scene without surfels.
///
/// # Errors
/// The errors of [`validate`].
pub fn validate_gaussians(gaussians: &Gaussians, values: Values) -> Result<()> {
    gaussians.check_shapes()?;
    let mut check = InputCheck::new("gaussians.positions", &gaussians.positions);
    check.add(gaussians, values)?;
    check_finite(check.checks)
}

struct InputCheck {
    dtype: DType,
    expected: String,
    checks: FiniteChecks,
}

impl InputCheck {
    /// All tensors must have the element type of `first`, and one that its device computes in.
    fn new(name: &str, first: &Tensor<2>) -> Self {
        let dtype = first.dtype();
        let expected = if is_gpu(&first.device()) {
            "F32, what GPUs compute in".to_owned()
        } else {
            format!("F32 or F64, the same for all (`{name}` has {dtype:?})")
        };
        Self { dtype, expected, checks: FiniteChecks::default() }
    }

    fn add(&mut self, columns: &impl Columns<Value = Tensor<2>>, values: Values) -> Result<()> {
        for (attribute, tensor) in columns.iter() {
            let supported = match self.dtype {
                DType::F32 => true,
                DType::F64 => !is_gpu(&tensor.device()),
                _ => false,
            };
            if !supported || tensor.dtype() != self.dtype {
                let (tensor, found) = (attribute.name.to_owned(), format!("{:?}", tensor.dtype()));
                return Err(Error::DType { tensor, expected: self.expected.clone(), found });
            }
            if values == Values::Unknown {
                self.checks.add(attribute.name, tensor);
            }
        }
        Ok(())
    }
}

/// Renders a view, of which a camera is enough, of `surfels` and `gaussians` (DP-GES).
///
/// # Errors
/// A typed error naming what does not fit: see [`validate`], [`Camera::validate`], [`PeelOptions::validate`]. Also
/// [`Error::Capacity`]. Where Gaussians are sharded, these are the errors of this rank alone.
pub fn render<'a>(
    surfels: &Surfels,
    gaussians: &Gaussians,
    view: impl Into<ViewRequest<'a>>,
    options: &RenderOptions,
) -> Result<Render> {
    let ViewRequest { camera, values, pose, ranks, .. } = view.into();
    camera.validate()?;
    options.peel.validate()?;
    validate(surfels, gaussians, values)?;
    let centre = camera.centre().to_array();
    let surfel_colours = colour(&surfels.colour, &surfels.positions, centre)?;
    let gaussian_colours = colour(&gaussians.colour, &gaussians.positions, centre)?;
    let moved = pose.map(|probe| (probe.surfels(surfels), probe.gaussians(gaussians)));
    let (surfels, gaussians) = moved.as_ref().map_or((surfels, gaussians), |(surfels, gaussians)| (surfels, gaussians));
    let layers = peel(surfels, camera, &options.peel)?;
    let seen = visibility(&layers, &surfels.margins, options.peel.peeling)?;
    let sums = ranks.joined(splat(gaussians, &gaussian_colours, &seen.limits, camera)?);
    let blending =
        CompositeOptions { background: options.background, detach_transmittance: options.detach_transmittance };
    let composite = composite(&layers, &seen, &surfel_colours, &sums, &blending)?;
    Ok(Render { composite, layers, seen, surfel_colours, gaussian_colours })
}

//! `blend`: primitives blended front to back in the order of their depths (3DGS, 2DGS, SSS, HTGS).
//!
//! Primitives, coloured c_i, → planes [P, H, W] and median depth. With `T_i = Π_{j<i} (1 − α_j)` and
//! `w_i = α_i T_i`, the planes are
//!
//! | plane | value | |
//! |---|---|---|
//! | 0–2 | `Σ w_i c_i` | colour, without a background |
//! | 3 | `Σ w_i = 1 − T` | alpha |
//! | 4 | `Σ w_i z_i` | expected depth, not divided by alpha, world units |
//! | 5–7 | `Σ w_i n_i` | normal, camera axes, facing the camera |
//! | 8 | `Σ_{j<i} w_i w_j (m_i − m_j)²` | depth distortion (2DGS), m of z see [`far`] |
//!
//! P is 4, or 9 with [`BlendOptions::maps`]. Median depth is the z_i of the first fragment behind which
//! T ≤ ½, or 0 if there is none (2DGS). A primitive whose centre is at or behind the near plane does not exist. A pixel
//! ends before the first fragment that would take T below [`BlendOptions::min_transmittance`]. α is capped
//! at ± [`BlendOptions::max_alpha`], and a fragment with |α| below 1/255 does not exist.
//!
//! [`BlendOrder::Centres`]: all pixels share one order of primitives, by depth of the centre, then by index.
//!
//! [`BlendOrder::Rays`], of ellipsoids (StopThePop): a pixel has an order of its own, by the depth along its ray
//! `t* = dᵀ Σ⁻¹ (μ − o) / dᵀ Σ⁻¹ d`, with d the unit vector of the ray and scales of at least 2.5e-4 |μ − o| in Σ. A
//! fragment with t* below 0 does not exist. The order is made in steps:
//!
//! 1. The list of a tile is sorted by t* on the ray through the point of the tile at which α is largest, then as by centres.
//! 2. Each of its blocks of 4 × 4 px takes the primitives of the list that reach it, with t* on the ray through its middle.
//! 3. Each of their quads of 2 × 2 px takes what leaves the block, with t* on the ray through its middle.
//! 4. Each of their pixels takes the fragments that it has of what leaves the quad, with t* on its own ray. They are blended
//!    as they leave the pixel.
//!
//! Blocks, quads and pixels hold queues of at most [`QUEUES`], sorted by t*. When one is full and something comes, or when
//! nothing more comes, the smallest t* leaves; equal ones leave in the order in which they came.
//!
//! A pixel with no more than four fragments thus has them in the order of t*. The order does not depend on the backend, but
//! for rounding: a CPU walks through the queues of a tile together; on a GPU one unit runs the queue of a block, and every
//! pixel runs its own and that of its quad. Backward runs all of them again, so that nothing of the order is kept.
//!
//! [`BlendOrder::Whitened`] (HTGS): a pixel keeps the nearest [`CORE`] of its fragments with α of at least [`CORE_ALPHA`], by
//! their own z, those first whose centre is nearer if equal. They are blended in that order. The first of them that takes T
//! below [`BlendOptions::min_transmittance`] ends the pixel behind it. The other fragments are its tail: with T behind the core,
//! the weight of one is `T (1 − Π (1 − α_j)) α_i / Σ α_j` over the tail. With [`Transparency::Nearest`] there is no tail, with
//! [`Transparency::Tail`] no core. [`Transparency::Sorted`] is the order of centres; pixels end as cores do. Planes are sums with these weights;
//! distortion is that of any two fragments, whatever their order. Median depth is that of the core, or, where T ≤ ½ only
//! behind the tail, the mean z of the tail by α. Backward, each pixel finds its core again.
//!
//! [`Form::Ellipsoids`]: α = max(0, opacity) · compensation · exp(−½ dᵀ Q d), the footprint of
//! [`splat`](super::splat): EWA, a low-pass filter of 0.1 px², compensation; or, with [`ScreenFilter::Plain`],
//! 0.3 px² without compensation (3DGS, DBS). Gaussians trained that way change when they are splatted. z is that
//! of the centre, n the axis with the smallest scale.
//!
//! [`Form::Discs`]: α = max(0, opacity) · exp(−ρ/2) with ρ = min(u² + v², 2 |d|²): (u, v) in units of the
//! first two scales is where the ray meets the disc, d the distance in px from the centre of the box
//! around the disc at 3 σ. The second term is the low-pass filter of 2DGS; a disc that reaches the plane of
//! the camera at 3 σ has none. z is that of the hit with either term. A hit at or nearer than the near plane
//! does not exist. n is the third axis. The third scale is unused.
//!
//! [`Form::Students`]: α = opacity · (1 + r²/ν)^(−(ν + 2)/2) with r² = dᵀ Q d and ν the degrees of freedom, the
//! projection of ellipsoids without any low-pass filter. Opacity is from −1 to 1: a fragment below 0 takes its colour
//! away, and T grows behind it, also above 1. A fragment exists within a square around the projected centre, whose half
//! side is a number of standard deviations that depends on ν, rounded up to whole px (SSS). z and n as of ellipsoids.
//!
//! [`Form::Whitened`]: α = max(0, opacity) · exp(−½ r²), where r is the least distance of the ray from the centre in
//! the frame in which the Gaussian is a sphere of standard deviation 1, and z the depth at which it is that near (HTGS). There is
//! no projection and no low-pass filter. An ellipsoid that reaches the near plane at α = 1/255 does not exist. n as of
//! ellipsoids. HTGS also leaves out what reaches a far plane, and has α up to 1.
//!
//! Gradients: from the planes to positions, quaternions, log-scales, opacities, degrees of freedom and colours, all in
//! one pass. That of ν is exact; the published kernel leaves out a term of it. Median depth, a capped α, the order, the end of a pixel and the choice of a normal carry none.
//!
//! The *probe* is a [M, 4] tensor that no value depends on. Its gradient is Σ g_x, Σ g_y, Σ |g_x|, Σ |g_y|
//! over the pixels, where (g_x, g_y) is a pixel's gradient with respect to the projected centre in units
//! of half the image. 3DGS, 2DGS (only from hits with the disc) and AbsGS base densification on it. For
//! [`Form::Whitened`] it is Σ g_x, Σ g_y, Σ g_z, Σ (|g_x| + |g_y| + |g_z|), where g is a pixel's gradient with respect
//! to the centre in camera axes times half its depth (HTGS: the norm of the sum of g, and the last with g in world
//! axes).
//!
//! [`Transparency::Nearest`]: crate::scene::Transparency::Nearest
//! [`Transparency::Tail`]: crate::scene::Transparency::Tail
//! [`Transparency::Sorted`]: crate::scene::Transparency::Sorted

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{Int, Tensor};

use crate::backend::kept::Kept;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::scene::tensors::{check_shape, flat};
use crate::scene::{BlendOrder, Gaussians, HIGHEST_ALPHA, ScreenFilter};
use crate::tiles::capacity::within_capacity;

/// Red, green, blue, alpha.
pub const COLOUR_PLANES: usize = 4;
/// The planes above, expected depth, three of the normal, distortion.
pub const ALL_PLANES: usize = 9;
pub const ALPHA_PLANE: usize = 3;
pub const DEPTH_PLANE: usize = 4;
/// The first of three.
pub const NORMAL_PLANE: usize = 5;
pub const DISTORTION_PLANE: usize = 8;

/// Largest [`BlendOptions::max_alpha`].
pub const HIGHEST_MAX_ALPHA: f64 = HIGHEST_ALPHA;

/// K: most fragments of a pixel that have an order, and their least α (HTGS).
pub const CORE: usize = 16;
pub const CORE_ALPHA: f64 = 0.05;

/// Most entries of the queues of a block of 4 × 4 px, of a quad of 2 × 2 px and of a pixel (StopThePop).
pub const QUEUES: [usize; 3] = [64, 8, 4];

/// Depth that distortion maps to 1, near planes (2DGS: 100 world units where the near plane is at 0.2).
pub const FAR: f64 = 500.0;

/// Depth that distortion maps to 1: m = far / (far − near) · (1 − near / z).
pub fn far(near: f64) -> f64 {
    FAR * near
}

/// Form of the primitives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Form {
    /// Three scales, projected as a whole (3DGS).
    #[default]
    Ellipsoids,
    /// Two scales, met by rays (2DGS).
    Discs,
    /// Three scales, a kernel of Student's t distribution, an opacity of either sign (SSS).
    Students,
    /// Three scales, met by rays in the frame in which it is a sphere (HTGS).
    Whitened,
}

impl Form {
    /// Whether its footprint is an ellipse on the screen.
    pub const fn is_projected(self) -> bool {
        matches!(self, Self::Ellipsoids | Self::Students)
    }

    /// Whether a pixel ends behind the fragment that takes T below [`BlendOptions::min_transmittance`], not before it.
    const fn ends_behind(self) -> bool {
        matches!(self, Self::Whitened)
    }
}

/// Form of the primitives and thresholds of blending.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlendOptions {
    pub form: Form,
    /// The filter of ellipsoids; other forms have none.
    pub filter: ScreenFilter,
    /// [`BlendOrder::Rays`] of ellipsoids alone, [`BlendOrder::Whitened`] of [`Form::Whitened`], and only that.
    pub order: BlendOrder,
    /// Largest |α| of a fragment; above 0, at most [`HIGHEST_MAX_ALPHA`].
    pub max_alpha: f64,
    /// Smallest T at which a pixel ends; between 0 and 1.
    pub min_transmittance: f64,
    /// Whether to compute depth, normal and distortion.
    pub maps: bool,
}

impl Default for BlendOptions {
    /// Ellipsoids, α up to 0.999 (DBS), pixels end at 1e-4 (3DGS), no maps.
    fn default() -> Self {
        Self {
            form: Form::Ellipsoids,
            filter: ScreenFilter::default(),
            order: BlendOrder::default(),
            max_alpha: 0.999,
            min_transmittance: 1e-4,
            maps: false,
        }
    }
}

impl BlendOptions {
    /// # Errors
    /// [`Error::Option`] for a number outside its range, and for an order that the form does not have.
    pub fn validate(&self) -> Result<()> {
        let (fits, expected) = match (self.form, self.order) {
            (Form::Ellipsoids, order) => (order.transparency().is_none(), "centres or rays for ellipsoids"),
            (Form::Discs, order) => (order == BlendOrder::Centres, "centres for discs"),
            (Form::Students, order) => (order == BlendOrder::Centres, "centres for Student's t kernels"),
            (Form::Whitened, order) => {
                (order.transparency().is_some(), "hybrid, nearest, sorted or tail for whitened Gaussians")
            }
        };
        if !fits {
            let expected = expected.to_owned();
            return Err(Error::Option { option: "order", expected, found: self.order.to_string() });
        }
        let check = |option, value: f64, fits: bool, expected: String| {
            if fits { Ok(()) } else { Err(Error::Option { option, expected, found: value.to_string() }) }
        };
        let (alpha, through) = (self.max_alpha, self.min_transmittance);
        let at_most = format!("a number above 0 and at most {HIGHEST_MAX_ALPHA}");
        check("max_alpha", alpha, alpha > 0.0 && alpha <= HIGHEST_MAX_ALPHA, at_most)?;
        check("min_transmittance", through, through > 0.0 && through < 1.0, "a number between 0 and 1".into())
    }

    /// P
    pub fn planes(&self) -> usize {
        if self.maps { ALL_PLANES } else { COLOUR_PLANES }
    }
}

/// Primitives and the probe, or the gradients with respect to them.
#[derive(ExtensionType, Debug, Clone)]
pub struct BlendInput<B: Backend> {
    #[extension_type]
    pub gaussians: GaussianTensors<B>,
    /// `[M]` of students, `[0]` of other forms
    pub degrees_of_freedom: FloatTensor<B>,
    /// [M, 4], or [0, 4] without a probe
    pub probe: FloatTensor<B>,
}

impl<B: Backend> BlendInput<B> {
    /// The tensors of the Gaussians, the degrees of freedom, the probe.
    fn into_array(self) -> [FloatTensor<B>; 7] {
        let [positions, quaternions, log_scales, opacities, colours] = self.gaussians.into_array();
        [positions, quaternions, log_scales, opacities, colours, self.degrees_of_freedom, self.probe]
    }

    /// In the order of [`Self::into_array`].
    fn from_array(tensors: [FloatTensor<B>; 7]) -> Self {
        let [positions, quaternions, log_scales, opacities, colours, degrees_of_freedom, probe] = tensors;
        let gaussians = GaussianTensors { positions, quaternions, log_scales, opacities, colours };
        Self { gaussians, degrees_of_freedom, probe }
    }
}

/// Primitives in the order of their depths and by tile, which backward needs again. CPU backends make them anew, and
/// these are empty.
#[derive(ExtensionType, Debug, Clone)]
pub struct BlendLists<B: Backend> {
    /// `[M]` index of each primitive, nearest first; what follows counts them in this order
    pub order: IntTensor<B>,
    /// [M + 1] first pair of each primitive and a tile that it may touch
    pub starts: IntTensor<B>,
    /// `[pairs]` the pairs by tile, each tile's in the order of the primitives or, by rays, first by t*, and last those that
    /// do not touch, and places without a pair
    pub pairs: IntTensor<B>,
    /// `[pairs]` primitives of those; of any value where there is no pair
    pub primitives: IntTensor<B>,
    /// [tiles + 1] first of those of each tile
    pub offsets: IntTensor<B>,
}

impl<B: Backend> BlendLists<B> {
    /// In the order of the fields.
    pub fn from_array([order, starts, pairs, primitives, offsets]: [IntTensor<B>; 5]) -> Self {
        Self { order, starts, pairs, primitives, offsets }
    }
}

#[derive(ExtensionType, Debug, Clone)]
pub struct BlendOutput<B: Backend> {
    /// [P, H, W]
    pub planes: FloatTensor<B>,
    /// [1, H, W] world units, 0 where T stays above ½; no gradient. May be empty without maps.
    pub median_depth: FloatTensor<B>,
    #[extension_type]
    pub lists: BlendLists<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait BlendOps: Backend {
    /// On the tape, CPU kernels keep the sorted primitives and their lists in `kept` for the backward pass; GPU kernels return lists.
    fn blend(
        #[extension_type] input: BlendInput<Self>,
        camera: Camera,
        options: BlendOptions,
        kept: Kept,
    ) -> BlendOutput<Self>;
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait ContributionOps: Backend {
    /// See [`contributing`]; without a probe.
    fn contributing(
        #[extension_type] input: BlendInput<Self>,
        camera: Camera,
        options: BlendOptions,
        least: f64,
    ) -> IntTensor<Self>;
}

/// Blended primitives of one view.
#[derive(Clone, Debug)]
pub struct Blend {
    /// [3, H, W] not clamped, nothing behind the primitives
    pub colour: Tensor<3>,
    /// [1, H, W] 1 − T
    pub alpha: Tensor<3>,
    /// With [`BlendOptions::maps`].
    pub maps: Option<Maps>,
}

/// Geometry of one view.
#[derive(Clone, Debug)]
pub struct Maps {
    /// [1, H, W] world units, weighted by αT and not divided by alpha
    pub depth: Tensor<3>,
    /// [1, H, W] world units, 0 where T stays above ½; no gradient
    pub median_depth: Tensor<3>,
    /// [3, H, W] camera axes, facing the camera, weighted by αT
    pub normal: Tensor<3>,
    /// [1, H, W]
    pub distortion: Tensor<3>,
}

/// Blends `gaussians` in `colours` [M, 3], as seen from the camera. Only the gradient of `probe` [M, 4] means anything:
/// Σ g_x, Σ g_y, Σ |g_x|, Σ |g_y| over the pixels, with the gradient with respect to the projected centre in units of
/// half the image; that of [`Form::Whitened`] is described above.
///
/// # Errors
/// [`Error::Shape`], [`Error::Camera`] or [`Error::Option`] if the input is invalid, which students without degrees of
/// freedom are, and others with them; [`Error::Capacity`] if the tile lists or the planes do not fit a buffer.
pub fn blend(
    gaussians: &Gaussians,
    colours: &Tensor<2>,
    probe: Option<&Tensor<2>>,
    camera: &Camera,
    options: &BlendOptions,
) -> Result<Blend> {
    camera.validate()?;
    if matches!(options.form, Form::Discs | Form::Whitened) {
        camera.require_pinhole()?;
    }
    options.validate()?;
    let probe = match probe {
        Some(probe) => {
            check_shape("probe", probe, [gaussians.len(), 4])?;
            probe.clone()
        }
        None => Tensor::zeros([0, 4], (&colours.device(), colours.dtype())),
    };
    let degrees_of_freedom = match (&gaussians.degrees_of_freedom, options.form) {
        (Some(column), Form::Students) => flat(column),
        (None, Form::Ellipsoids | Form::Discs | Form::Whitened) => {
            Tensor::zeros([0], (&colours.device(), colours.dtype()))
        }
        (column, form) => {
            let expected = "students if they have degrees of freedom, and another form if not".to_owned();
            let found = format!("{form:?} {} them", if column.is_some() { "with" } else { "without" });
            return Err(Error::Option { option: "form", expected, found });
        }
    };
    let input = BlendInput {
        gaussians: GaussianTensors::new(gaussians, colours)?,
        degrees_of_freedom: degrees_of_freedom.into_dispatch(),
        probe: probe.into_dispatch(),
    };
    let out = within_capacity(|| Dispatch::blend(input, *camera, *options, Kept::default()))?;
    let planes = Tensor::<3>::from_dispatch(out.planes);
    let part =
        |first: usize, count: usize| planes.clone().slice([first..first + count, 0..camera.height, 0..camera.width]);
    let maps = options.maps.then(|| Maps {
        depth: part(DEPTH_PLANE, 1),
        median_depth: Tensor::from_dispatch(out.median_depth),
        normal: part(NORMAL_PLANE, 3),
        distortion: part(DISTORTION_PLANE, 1),
    });
    Ok(Blend { colour: part(0, 3), alpha: part(ALPHA_PLANE, 1), maps })
}

/// `[M]` 1 for every one of `gaussians` whose weight w_i is at least `least` at some pixel of the view, else 0. Of
/// [`Form::Whitened`] alone. Nothing is on a tape.
///
/// # Errors
/// Those of [`blend()`], and [`Error::Option`] for another form.
pub fn contributing(
    gaussians: &Gaussians,
    camera: &Camera,
    options: &BlendOptions,
    least: f64,
) -> Result<Tensor<1, Int>> {
    camera.validate()?;
    camera.require_pinhole()?;
    options.validate()?;
    if options.form != Form::Whitened {
        let (expected, found) = (format!("an order of {:?}", Form::Whitened), options.order.to_string());
        return Err(Error::Option { option: "order", expected, found });
    }
    let like = &gaussians.positions;
    let (device, dtype) = (like.device(), like.dtype());
    let colours = Tensor::zeros([gaussians.len(), 3], (&device, dtype));
    let input = BlendInput {
        gaussians: GaussianTensors::new(gaussians, &colours)?,
        degrees_of_freedom: Tensor::<1>::zeros([0], (&device, dtype)).into_dispatch(),
        probe: Tensor::<2>::zeros([0, 4], (&device, dtype)).into_dispatch(),
    };
    let options = BlendOptions { maps: false, ..*options };
    let marks = within_capacity(|| Dispatch::contributing(input, *camera, options, least))?;
    Ok(Tensor::from_dispatch(marks))
}

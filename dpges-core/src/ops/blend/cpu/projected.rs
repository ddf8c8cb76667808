//! A primitive of either form as a camera sees it.

use pulp::Simd;

use crate::backend::lanes::{Lanes, Mask};
use crate::backend::real::Real;
use crate::camera::Camera;
use crate::footprint::gaussian::cpu as splat;
use crate::footprint::gaussian::cpu::along_ray::AlongRay;
use crate::footprint::gaussian::cpu::lanes::{At, SplatLanes};
use crate::footprint::gaussian::cpu::{ParameterGrad, Parameters, Splat, SplatGrad};
use crate::footprint::moments::{MOMENTS, add_moments};
use crate::math::{CameraOf, V3, add, scale};
use crate::scene::ScreenFilter;
use crate::tiles::{PixelRect, TileGrid};

/// A camera in the element type of the kernels and in f64, and its filter of ellipsoids.
pub struct CameraPair<T> {
    pub camera: CameraOf<T>,
    pub exact: CameraOf<f64>,
    pub filter: ScreenFilter,
}

impl<T: Real> CameraPair<T> {
    pub fn new(camera: &Camera, filter: ScreenFilter) -> Self {
        Self { camera: CameraOf::new(camera), exact: CameraOf::new(camera), filter }
    }
}

/// A primitive at the pixels of a vector.
pub struct Drawn<T: Real, S: Simd> {
    /// Where there is a fragment.
    pub drawn: Mask<T, S>,
    /// α before it is capped; any finite number where there is no fragment.
    pub weight: Lanes<T, S>,
    /// z; any finite number where there is no fragment.
    pub depth: Lanes<T, S>,
}

impl<T: Real, S: Simd> Drawn<T, S> {
    /// `None` if there is no fragment.
    #[inline(always)]
    pub fn new(drawn: Mask<T, S>, weight: Lanes<T, S>, depth: Lanes<T, S>) -> Option<Self> {
        drawn.any().then_some(Self { drawn, weight, depth })
    }
}

/// Pixels in the backward pass, at offsets (`dx`, `dy`) px from the anchor of a footprint.
pub struct Group<T: Real, S: Simd> {
    pub dx: Lanes<T, S>,
    pub dy: T,
    /// Where something is blended; elsewhere all gradients are 0.
    pub blended: Mask<T, S>,
    /// αT
    pub covered: Lanes<T, S>,
    /// Gradient with respect to the exponent of α.
    pub power: Lanes<T, S>,
    /// With maps: z and the gradient with respect to it.
    pub depth: Lanes<T, S>,
    pub grad_depth: Lanes<T, S>,
}

/// Sums over the pixels of one primitive, by lanes or in total.
pub struct Sums<'a, V> {
    /// [`Projected::SUMS`]
    pub footprint: &'a mut [V],
    /// Three.
    pub colour: &'a mut [V],
    /// Gradient with respect to the projected centre, px: Σ x, Σ y, Σ |x|, Σ |y|; or, of [`Form::Whitened`], with respect to
    /// the centre times its depth: Σ x, Σ y, Σ z, Σ (|x| + |y| + |z|). Empty without a probe.
    ///
    /// [`Form::Whitened`]: crate::ops::blend::Form::Whitened
    pub probe: &'a mut [V],
    /// Three of the normal, and one that the footprint makes of the gradients of z. Empty without maps.
    pub maps: &'a mut [V],
}

impl<T: Real> Sums<'_, T> {
    /// The sums of an ellipse, which come first.
    pub fn ellipse(&self) -> SplatGrad<T> {
        SplatGrad {
            moments: std::array::from_fn(|i| self.footprint[i]),
            colour: std::array::from_fn(|c| self.colour[c]),
        }
    }

    /// Adds the gradient of the depth of the centre to that of the position, if there are maps.
    pub fn add_depth(&self, view: &CameraPair<T>, parameters: &Parameters<T>, grad: &mut ParameterGrad<T>) {
        if let [.., of_depth] = *self.maps {
            grad.position = add(grad.position, scale(view.camera.depth_slope(parameters.position), of_depth));
        }
    }
}

/// Which sums there are.
#[derive(Clone, Copy, Debug)]
pub struct Layout {
    pub footprint: usize,
    pub probe: bool,
    pub maps: bool,
}

impl Layout {
    pub fn width(&self) -> usize {
        self.footprint + 3 + self.probe_len() + if self.maps { 4 } else { 0 }
    }

    fn probe_len(&self) -> usize {
        if self.probe { 4 } else { 0 }
    }

    #[inline(always)]
    pub fn split<'a, V>(&self, sums: &'a mut [V]) -> Sums<'a, V> {
        let (footprint, rest) = sums.split_at_mut(self.footprint);
        let (colour, rest) = rest.split_at_mut(3);
        let (probe, maps) = rest.split_at_mut(self.probe_len());
        Sums { footprint, colour, probe, maps }
    }
}

/// The most that [`Projected::SUMS`] can be.
pub const MOST_SUMS: usize = 13;

/// One primitive seen by one camera.
pub trait Projected<T: Real>: Copy + Send + Sync + 'static {
    /// Sums over pixels that its gradient is made of, besides those of [`Layout`].
    const SUMS: usize;
    /// Whether its kernel has degrees of freedom.
    const HAS_DEGREES: bool = false;

    /// `None` where no pixel can see it.
    fn new(view: &CameraPair<T>, parameters: &Parameters<T>, colour: V3<T>) -> Option<Self>;

    /// Which axis is the normal: that with the smallest scale.
    fn normal_axis(parameters: &Parameters<T>) -> usize {
        let size = |axis: usize| parameters.log_scales[axis].as_f64();
        // the first of equal scales, as on GPUs
        (0..3).min_by(|&a, &b| size(a).total_cmp(&size(b))).unwrap_or(0)
    }

    fn colour(&self) -> V3<T>;

    /// Depth of the centre.
    fn centre_depth(&self) -> T;

    /// Point that offsets are counted from, px.
    fn anchor(&self) -> [T; 2];

    /// How rays meet it; `None` of a form that is not ordered by them.
    fn along_ray(&self, _: &CameraOf<T>, _: &Parameters<T>) -> Option<AlongRay<T>> {
        None
    }

    /// Pixels at which α can reach the cutoff.
    fn reach(&self, grid: TileGrid) -> PixelRect;

    /// Whether α can reach the cutoff at some pixel of the tile in a column and a row.
    // discs and what rays meet have no test that is finer than their rectangle
    #[inline(always)]
    fn touches(&self, _: usize, _: usize) -> bool {
        true
    }

    /// At offsets from the anchor, px; `None` if there is no fragment.
    fn draw<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> Option<Drawn<T, S>>;

    /// Adds pixels to the sums of the footprint and the probe and, with `MAPS`, of z.
    fn gather<S: Simd, const MAPS: bool>(&self, group: &Group<T, S>, sums: &mut Sums<Lanes<T, S>>);

    /// Factor on the sums of the probe: half the image in x and y for gradients per px.
    fn probe_units(camera: &Camera) -> [T; 4] {
        // half the image is 1 in normalised device coordinates, for which 3DGS gives its threshold
        let [half_width, half_height] = [camera.width, camera.height].map(|size| T::of(0.5 * size as f64));
        [half_width, half_height, half_width, half_height]
    }

    /// Gradients of the raw parameters from the sums; what the normal and the colour pass on is not included.
    fn backward(&self, view: &CameraPair<T>, parameters: &Parameters<T>, sums: &Sums<T>) -> ParameterGrad<T>;
}

/// Adds gradients in x and y to a probe.
#[inline(always)]
pub fn add_to_probe<T: Real, S: Simd>(probe: &mut [Lanes<T, S>], grad_x: Lanes<T, S>, grad_y: Lanes<T, S>) {
    // sums of absolute values, too: gradients of opposite signs cancel over a large primitive (AbsGS)
    if let [x, y, size_x, size_y] = probe {
        (*x, *y) = (*x + grad_x, *y + grad_y);
        (*size_x, *size_y) = (*size_x + grad_x.abs(), *size_y + grad_y.abs());
    }
}

/// Adds pixels to the sums of an ellipse: to its moments, and the gradient of its mean to the probe. `power` is −2 times the
/// gradient of r².
#[inline(always)]
pub fn add_to_ellipse<T: Real, S: Simd>(
    [p, q, r]: [T; 3],
    group: &Group<T, S>,
    power: Lanes<T, S>,
    moments: &mut [Lanes<T, S>],
    probe: &mut [Lanes<T, S>],
) {
    let all = |value: T| Lanes::splat(power.simd(), value);
    let (u, v) = (all(p).mul_add(group.dx, all(q * group.dy)), all(r * group.dy));
    add_moments(moments, power, u, v);
    if !probe.is_empty() {
        add_to_probe(probe, power * all(p) * u, power * all(q).mul_add(u, all(r) * v));
    }
}

/// Adds pixels to the sum of the gradients of z, if there are maps.
#[inline(always)]
pub fn add_depths<T: Real, S: Simd>(maps: &mut [Lanes<T, S>], grad_depth: Lanes<T, S>) {
    if let [.., of_depth] = maps {
        *of_depth = *of_depth + grad_depth;
    }
}

/// An ellipsoid's ellipse, anchored at its mean.
#[derive(Clone, Copy, Debug)]
pub struct Ellipse<T>(Splat<T>);

impl<T: Real> Projected<T> for Ellipse<T> {
    const SUMS: usize = MOMENTS;

    fn new(view: &CameraPair<T>, parameters: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        Splat::new(&view.camera, parameters, colour, view.filter).map(Self)
    }

    #[inline(always)]
    fn colour(&self) -> V3<T> {
        self.0.colour
    }

    fn centre_depth(&self) -> T {
        self.0.depth
    }

    #[inline(always)]
    fn anchor(&self) -> [T; 2] {
        self.0.mean
    }

    fn along_ray(&self, camera: &CameraOf<T>, parameters: &Parameters<T>) -> Option<AlongRay<T>> {
        Some(AlongRay::new(camera, parameters, self.0))
    }

    fn reach(&self, grid: TileGrid) -> PixelRect {
        self.0.reach(grid.width, grid.height)
    }

    #[inline(always)]
    fn touches(&self, tile_x: usize, tile_y: usize) -> bool {
        self.0.touches(tile_x, tile_y)
    }

    #[inline(always)]
    fn draw<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> Option<Drawn<T, S>> {
        let At { weight, .. } = SplatLanes::new(dx.simd(), &self.0).at(dx, dy)?;
        Drawn::new(Lanes::zero(dx.simd()).below(weight), weight, Lanes::splat(dx.simd(), self.0.depth))
    }

    #[inline(always)]
    fn gather<S: Simd, const MAPS: bool>(&self, group: &Group<T, S>, sums: &mut Sums<Lanes<T, S>>) {
        add_to_ellipse(self.0.root, group, group.power, sums.footprint, sums.probe);
        if MAPS {
            add_depths(sums.maps, group.grad_depth);
        }
    }

    fn backward(&self, view: &CameraPair<T>, parameters: &Parameters<T>, sums: &Sums<T>) -> ParameterGrad<T> {
        let mut grad = splat::backward(&view.camera, parameters, &self.0, &sums.ellipse(), view.filter);
        sums.add_depth(view, parameters, &mut grad);
        grad
    }
}

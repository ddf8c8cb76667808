//! One Gaussian seen by one camera: its elliptical footprint, the pixels it can reach, and the gradients of
//! its parameters.

pub mod along_ray;
pub mod student;
pub mod whitened;

use crate::backend::real::Real;
use crate::camera::{Lens, Seen};
use crate::footprint::CUTOFF;
use crate::footprint::moments::MOMENTS;
use crate::math::{
    CameraOf, M3, V3, add, apply, apply_transposed, column, cross, dot, rotation, rotation_backward, scale,
};
use crate::scene::ScreenFilter;
use crate::tiles::{PixelRect, TILE};

/// Lower bound of the squared factor by which the low-pass filter dims a Gaussian (GES).
pub const MIN_COMPENSATION_SQUARED: f64 = 2.5e-5;
/// The Jacobian is evaluated at most this fraction of the image size outside the image (3DGS: 1.3 × tan fov/2).
pub const JACOBIAN_MARGIN: f64 = 0.15;

/// Raw parameters of one Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<T> {
    pub position: V3<T>,
    pub quaternion: [T; 4],
    pub log_scales: V3<T>,
    pub opacity: T,
    /// ν of a Student's t kernel; infinite of a Gaussian one.
    pub degrees_of_freedom: T,
}

/// Footprint: `strength · exp(−½ (u² + v²))`, where u and v are the offset (dx, dy) px from the mean in units of the
/// standard deviations: `u = p dx + q dy`, `v = r dy`.
///
/// The form is not expanded into `a dx² + 2 b dx dy + c dy²`, whose terms cancel along a needle.
#[derive(Clone, Copy, Debug)]
pub struct Splat<T> {
    pub mean: [T; 2],
    /// p, q, r: the upper triangular root of the inverse covariance, 1 / px.
    pub root: [T; 3],
    /// Variances in x and y, px².
    variances: [T; 2],
    /// Opacity times the compensation for the low-pass filter, if it has one.
    pub strength: T,
    /// Depth of the centre.
    pub depth: T,
    pub colour: V3<T>,
    /// Value of the quadratic form at the cutoff 1/255.
    squared_radius: T,
}

/// Sums over the pixels of a Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct SplatGrad<T> {
    /// With g the gradient of the exponent: Σ g, Σ g u, Σ g v, Σ g u², Σ g u v, Σ g v².
    pub moments: [T; MOMENTS],
    pub colour: V3<T>,
}

/// Intermediate values of the projection (EWA).
struct Projection<T> {
    centre: V3<T>,
    /// x / z and y / z, clamped for the Jacobian, and whether they were not.
    slopes: [T; 2],
    unclamped: [bool; 2],
    /// Position through a lens, px, and whether the lens shows it well enough; `None` without a lens.
    through_lens: Option<([T; 2], bool)>,
    rotation: M3<T>,
    scales: V3<T>,
    /// Rows of J W.
    plane: [V3<T>; 2],
    /// Rows of J W R S.
    half: [V3<T>; 2],
    /// A, B, C of the filtered covariance, px².
    covariance: [T; 3],
    /// The larger of A and C, px². Determinants are those of covariances divided by it: that of a Gaussian as large as
    /// the world would overflow.
    size: T,
    determinant: T,
    /// Cross product of the rows of `half` divided by `size`; its square is the determinant of the unfiltered covariance.
    minors: V3<T>,
    /// Ratio of the determinants, and what it lacks to 1.
    ratio: T,
    lack: T,
    filter: ScreenFilter,
}

impl<T: Real> Projection<T> {
    #[inline(always)]
    fn new(camera: &CameraOf<T>, p: &Parameters<T>, filter: ScreenFilter) -> Self {
        let centre = camera.transform(p.position);
        let [x, y, z] = centre;
        let clamp = |slope: T, principal: T, focal: T, size: usize| {
            let size = T::of(size as f64);
            let margin = T::of(JACOBIAN_MARGIN) * size / focal;
            let clamped = slope.max(-principal / focal - margin).min((size - principal) / focal + margin);
            (clamped, clamped == slope)
        };
        let (sx, free_x) = clamp(x / z, camera.cx, camera.fx, camera.width);
        let (sy, free_y) = clamp(y / z, camera.cy, camera.fy, camera.height);
        let w = &camera.rotation;
        let mut plane =
            [scale(add(w[0], scale(w[2], -sx)), camera.fx / z), scale(add(w[1], scale(w[2], -sy)), camera.fy / z)];
        let mut through_lens = None;
        if let Some(lens) = &camera.lens {
            let seen = lens.look(centre.map(T::as_f64));
            let Seen { position, jacobian } = seen.unwrap_or(Seen { position: [0.0; 2], jacobian: [[0.0; 3]; 2] });
            let mean = [T::of(position[0]) * camera.fx + camera.cx, T::of(position[1]) * camera.fy + camera.cy];
            plane = [0, 1].map(|axis| {
                let row = scale(jacobian[axis].map(T::of), [camera.fx, camera.fy][axis]);
                apply_transposed(w, row)
            });
            through_lens = Some((mean, seen.is_some() && position[0].hypot(position[1]) <= camera.coverage));
        }
        let rotation = rotation(p.quaternion);
        let scales = p.log_scales.map(T::exp);
        let half = plane.map(|row| std::array::from_fn(|d| dot(row, column(&rotation, d)) * scales[d]));
        let low_pass = T::of(filter.variance());
        let covariance = [dot(half[0], half[0]) + low_pass, dot(half[0], half[1]), dot(half[1], half[1]) + low_pass];
        let size = covariance[0].max(covariance[2]);
        let length = size.sqrt();
        let minors = cross(half[0].map(|v| v / length), half[1].map(|v| v / length));
        // det(Σ + εI) = det Σ + ε tr Σ + ε², every term non-negative: no cancellation for needles
        let unfiltered = dot(minors, minors);
        let trace = covariance[0] / size + covariance[2] / size;
        let added = low_pass / size * (trace - low_pass / size);
        let determinant = unfiltered + added;
        Self {
            centre,
            slopes: [sx, sy],
            unclamped: [free_x, free_y],
            through_lens,
            rotation,
            scales,
            plane,
            half,
            covariance,
            size,
            determinant,
            minors,
            ratio: unfiltered / determinant,
            lack: added / determinant,
            filter,
        }
    }

    #[inline(always)]
    fn compensation(&self) -> T {
        match self.filter {
            ScreenFilter::Compensated => self.ratio.max(T::of(MIN_COMPENSATION_SQUARED)).sqrt(),
            ScreenFilter::Plain | ScreenFilter::Off => T::one(),
        }
    }

    /// Whether the compensation depends on the covariance.
    fn compensates(&self) -> bool {
        self.filter == ScreenFilter::Compensated && self.ratio > T::of(MIN_COMPENSATION_SQUARED)
    }
}

impl<T: Real> Splat<T> {
    /// `None` behind the near plane, where a lens does not see, where the weight stays below the cutoff, and where the
    /// projection overflows.
    #[inline(always)]
    pub fn new(camera: &CameraOf<T>, p: &Parameters<T>, colour: V3<T>, filter: ScreenFilter) -> Option<Self> {
        let projection = Projection::new(camera, p, filter);
        let [x, y, z] = projection.centre;
        let depth = camera.depth(projection.centre);
        let (mean, shown) = match projection.through_lens {
            None => ([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], true),
            Some(seen) => seen,
        };
        let strength = p.opacity.max(T::zero()) * projection.compensation();
        let [variance_x, covariance, variance_y] = projection.covariance;
        let (size, d) = (projection.size, projection.determinant);
        let visible = shown && depth > camera.near && strength >= T::of(CUTOFF) && d > T::zero() && size < T::INFINITY;
        let across = (variance_y / size / d / size).sqrt();
        visible.then(|| Self {
            mean,
            root: [across, -across * (covariance / variance_y), T::one() / variance_y.sqrt()],
            variances: [variance_x, variance_y],
            strength,
            depth,
            colour,
            squared_radius: T::of(2.0) * (strength / T::of(CUTOFF)).ln(),
        })
    }

    /// Pixels at which the weight can reach the cutoff: the bounding box of the ellipse.
    pub fn reach(&self, width: usize, height: usize) -> PixelRect {
        let squared = self.squared_radius.as_f64() * (1.0 + 1e-5);
        let [half_x, half_y] = self.variances.map(|variance| (squared * variance.as_f64()).sqrt());
        let (x, y) = (self.mean[0].as_f64(), self.mean[1].as_f64());
        PixelRect::covering([x - half_x, x + half_x, y - half_y, y + half_y], width, height)
    }

    /// Whether any pixel centre of the tile at a column and row of tiles can lie inside the ellipse.
    #[inline(always)]
    pub fn touches(&self, column: usize, row: usize) -> bool {
        self.reaches([column * TILE, row * TILE], [TILE; 2])
    }

    /// Whether any pixel centre of a rectangle can lie inside the ellipse: `first` column and row, `size`, px.
    #[inline(always)]
    pub fn reaches(&self, first: [usize; 2], size: [usize; 2]) -> bool {
        let (_, smallest) = self.nearest(first, size);
        let outside = smallest > self.squared_radius * T::of(1.0 + 1e-4) + T::of(1e-4);
        // NaN counts as touching
        !outside
    }

    /// Where between the pixel centres of a rectangle (`first` column and row, `size`, px) the weight is largest: the offset
    /// from the mean, px, and u² + v² there.
    #[inline(always)]
    pub fn nearest(&self, first: [usize; 2], size: [usize; 2]) -> ([T; 2], T) {
        let [p, q, r] = self.root;
        let nearest = |axis: usize| {
            let low = T::of(first[axis] as f64 + 0.5) - self.mean[axis];
            let high = low + T::of(size[axis] as f64 - 1.0);
            (low, high, T::zero().max(low).min(high))
        };
        let (x0, x1, dx) = nearest(0);
        let (y0, y1, dy) = nearest(1);
        // the convex form is smallest at the mean or on one of the two edges that face it
        let form = |dx: T, dy: T| {
            let [u, v] = self.in_deviations(dx, dy);
            u * u + v * v
        };
        let beside = (-p * q * dx / (q * q + r * r)).max(y0).min(y1);
        let below = (-q * dy / p).max(x0).min(x1);
        let (on_vertical, on_horizontal) = (form(dx, beside), form(below, dy));
        let offset = if on_horizontal < on_vertical { [below, dy] } else { [dx, beside] };
        (offset, on_vertical.min(on_horizontal))
    }

    /// Gradient with respect to the mean, per px.
    pub fn mean_gradient(&self, sum: &SplatGrad<T>) -> [T; 2] {
        let [_, mu, mv, ..] = sum.moments;
        let [p, q, r] = self.root;
        [p * mu, q * mu + r * mv]
    }

    /// An offset from the mean, px, in units of the standard deviations: (u, v).
    #[inline(always)]
    pub fn in_deviations(&self, dx: T, dy: T) -> [T; 2] {
        let [p, q, r] = self.root;
        [p * dx + q * dy, r * dy]
    }

    /// Weight at an offset (u, v) in standard deviations, 0 below the cutoff.
    #[inline(always)]
    pub fn weight(&self, u: T, v: T) -> T {
        let weight = self.strength * (T::of(-0.5) * (u * u + v * v)).exp_nonpositive();
        if weight >= T::of(CUTOFF) { weight } else { T::zero() }
    }
}

/// Gradients with respect to the raw parameters.
#[derive(Clone, Copy, Debug)]
pub struct ParameterGrad<T> {
    pub position: V3<T>,
    pub quaternion: [T; 4],
    pub log_scales: V3<T>,
    pub opacity: T,
    /// 0 of a Gaussian kernel.
    pub degrees_of_freedom: T,
}

/// Gradients with respect to the raw parameters, from the sums over the pixels (3DGS; compensation: GES).
pub fn backward<T: Real>(
    camera: &CameraOf<T>,
    p: &Parameters<T>,
    splat: &Splat<T>,
    sum: &SplatGrad<T>,
    filter: ScreenFilter,
) -> ParameterGrad<T> {
    let projection = Projection::new(camera, p, filter);
    let [total, _, _, muu, muv, mvv] = sum.moments;
    let (half, two) = (T::of(0.5), T::of(2.0));
    let [p0, q0, r0] = splat.root;
    let grad_mean = splat.mean_gradient(sum);
    // with Q = Rᵀ R and M = Σ g w wᵀ, w = R d: ∂Σ = ½ Rᵀ M R, and ∂H = 2 ∂Σ H = Rᵀ (M (R H)) for Σ = H Hᵀ + εI
    let [h0, h1] = projection.half;
    let (w0, w1) = (add(scale(h0, p0), scale(h1, q0)), scale(h1, r0));
    let (n0, n1) = (add(scale(w0, muu), scale(w1, muv)), add(scale(w0, muv), scale(w1, mvv)));
    let mut grad_half = [scale(n0, p0), add(scale(n0, q0), scale(n1, r0))];

    let grad_strength = total / splat.strength;
    let compensation = projection.compensation();
    let opacity = p.opacity.max(T::zero());
    if projection.compensates() {
        let grad_ratio = grad_strength * opacity * half / compensation;
        let per_size = T::of(filter.variance()) / projection.size;
        let by_ratio = two * grad_ratio / projection.determinant / projection.size;
        let (by_minors, by_half) = (by_ratio * projection.lack, -by_ratio * projection.ratio * per_size);
        let minors = projection.minors;
        grad_half[0] = add(grad_half[0], add(scale(cross(h1, minors), by_minors), scale(h0, by_half)));
        grad_half[1] = add(grad_half[1], add(scale(cross(minors, h0), by_minors), scale(h1, by_half)));
    }

    // half = plane · R S
    let factor: M3<T> =
        std::array::from_fn(|i| std::array::from_fn(|d| projection.rotation[i][d] * projection.scales[d]));
    let grad_factor: M3<T> = std::array::from_fn(|i| {
        std::array::from_fn(|d| projection.plane[0][i] * grad_half[0][d] + projection.plane[1][i] * grad_half[1][d])
    });
    let log_scales = std::array::from_fn(|d| dot(column(&grad_factor, d), column(&factor, d)));
    let grad_rotation: M3<T> =
        std::array::from_fn(|i| std::array::from_fn(|d| grad_factor[i][d] * projection.scales[d]));

    let grad_planes: [V3<T>; 2] = [0, 1].map(|axis| std::array::from_fn(|i| dot(grad_half[axis], factor[i])));
    let grad_centre = match &camera.lens {
        None => pinhole_backward(camera, &projection, grad_mean, grad_planes),
        Some(lens) => lens_backward(lens, camera, projection.centre, grad_mean, grad_planes),
    };
    ParameterGrad {
        position: apply_transposed(&camera.rotation, grad_centre),
        quaternion: rotation_backward(p.quaternion, &grad_rotation),
        log_scales,
        opacity: if p.opacity > T::zero() { grad_strength * compensation } else { T::zero() },
        degrees_of_freedom: T::zero(),
    }
}

/// Gradient with respect to the centre in camera axes from those with respect to the mean, px, and to the rows of J W.
#[inline(always)]
fn pinhole_backward<T: Real>(
    camera: &CameraOf<T>,
    projection: &Projection<T>,
    grad_mean: [T; 2],
    grad_planes: [V3<T>; 2],
) -> V3<T> {
    let [x, y, z] = projection.centre;
    // plane row 0 = fx / z (W₀ − s_x W₂), s_x = x / z unless clamped
    let mut grad_centre = [T::zero(); 3];
    for (axis, focal) in [(0, camera.fx), (1, camera.fy)] {
        let grad_plane = grad_planes[axis];
        grad_centre[2] = grad_centre[2] - dot(grad_plane, projection.plane[axis]) / z;
        let coordinate = [x, y][axis];
        if projection.unclamped[axis] {
            let grad_slope = -focal / z * dot(grad_plane, camera.rotation[2]);
            grad_centre[axis] = grad_centre[axis] + grad_slope / z;
            grad_centre[2] = grad_centre[2] - grad_slope * projection.slopes[axis] / z;
        }
        grad_centre[axis] = grad_centre[axis] + focal / z * grad_mean[axis];
        grad_centre[2] = grad_centre[2] - focal * coordinate / (z * z) * grad_mean[axis];
    }
    grad_centre
}

/// [`pinhole_backward`] through a lens.
fn lens_backward<T: Real>(
    lens: &Lens,
    camera: &CameraOf<T>,
    centre: V3<T>,
    grad_mean: [T; 2],
    grad_planes: [V3<T>; 2],
) -> V3<T> {
    let focals = [camera.fx, camera.fy];
    let grad_position = [0, 1].map(|axis| (focals[axis] * grad_mean[axis]).as_f64());
    let grad_jacobian =
        [0, 1].map(|axis| scale(apply(&camera.rotation, grad_planes[axis]), focals[axis]).map(T::as_f64));
    lens.look_backward(centre.map(T::as_f64), grad_position, grad_jacobian).map(T::of)
}

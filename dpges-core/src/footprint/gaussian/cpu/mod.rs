//! One Gaussian seen by one camera: its elliptical footprint, the pixels it can reach, and the gradients of
//! its parameters.

pub mod along_ray;
pub mod in_view;
pub mod lanes;
pub mod student;
pub mod whitened;

use crate::backend::number::Number;
use crate::backend::real::Real;
use crate::camera::{Lens, Seen};
use crate::footprint::CUTOFF;
use crate::footprint::moments::MOMENTS;
use crate::math::{CameraOf, M3, V3, add, apply, apply_transposed, cross, dot, rotation, scale, times, turn_backward};
use crate::scene::ScreenFilter;
use crate::tiles::{PixelRect, TILE};

/// Lower bound of the squared factor by which the low-pass filter dims a Gaussian (GES).
pub const MIN_COMPENSATION_SQUARED: f64 = 2.5e-5;
/// The Jacobian is evaluated at most this fraction of the image size outside the image (3DGS: 1.3 × tan fov/2).
pub const JACOBIAN_MARGIN: f64 = 0.15;
/// Scales are relative to the largest, or to this if that is smaller, world units.
pub const LEAST_SCALE: f64 = 1e-37;

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
#[derive(Clone, Copy, Debug, Default)]
pub struct SplatGrad<T> {
    /// Σ g, Σ g u, Σ g v, Σ g u², Σ g u v, Σ g v², with g the gradient of the exponent.
    pub moments: [T; MOMENTS],
    pub colour: V3<T>,
}

/// Intermediate values of the projection (EWA).
///
/// Determinants and products of axes are those of the footprint divided by its [`length`](Self::length): those of a Gaussian
/// as large as the world would overflow. Scales are relative to the largest. Nothing is computed as the difference of what
/// is nearly equal for a needle: its axes are nearly parallel in the image, but their cross products are products of two
/// scales and of the direction of the ray.
struct Projection<N: Number> {
    centre: V3<N>,
    /// x / z and y / z, clamped for the Jacobian, and whether they were not.
    slopes: [N; 2],
    unclamped: [N::Mask; 2],
    /// Position through a lens, px, and whether the lens shows it well enough; `None` without a lens.
    through_lens: Option<([N; 2], N::Mask)>,
    rotation: M3<N>,
    /// The largest scale, world units, and all scales relative to it.
    largest: N,
    relative: V3<N>,
    /// A, B, C of the filtered covariance, px².
    covariance: [N; 3],
    /// The larger of A and C, px², and its root.
    size: N,
    length: N,
    /// Rows of J W R, times the largest scale, over the length.
    axes: [V3<N>; 2],
    /// Their cross product over the root of the determinant.
    crossed: V3<N>,
    /// Variance of the filter over the size.
    low_pass: N,
    determinant: N,
    /// Ratio of the determinants, and what it lacks to 1.
    ratio: N,
    lack: N,
    filter: ScreenFilter,
}

impl<N: Number> Projection<N> {
    #[inline(always)]
    fn new(camera: &CameraOf<N>, p: &Parameters<N>, filter: ScreenFilter) -> Self {
        let centre = camera.transform(p.position);
        let [x, y, z] = centre;
        // far outside the image J grows without bound, and with it the ellipse: EWA is linear around the centre only
        let clamp = {
            #[inline(always)]
            |slope: N, principal: N, focal: N, size: usize| {
                let size = slope.constant(size as f64);
                let margin = slope.constant(JACOBIAN_MARGIN) * size / focal;
                let clamped = slope.max(-principal / focal - margin).min((size - principal) / focal + margin);
                // a clamped slope is a constant, without a gradient to the centre
                (clamped, clamped.at_least(slope) & slope.at_least(clamped))
            }
        };
        let (sx, free_x) = clamp(x / z, camera.cx, camera.fx, camera.width);
        let (sy, free_y) = clamp(y / z, camera.cy, camera.fy, camera.height);
        let (w, cofactors) = (&camera.rotation, &camera.cofactors);
        // rows of J W over the focal lengths and the depth, and their cross product
        let mut plane = [add(w[0], scale(w[2], -sx)), add(w[1], scale(w[2], -sy))];
        let mut normal = add(cofactors[2], add(scale(cofactors[0], sx), scale(cofactors[1], sy)));
        let mut magnification = [camera.fx / z, camera.fy / z];
        let mut through_lens = None;
        if let Some(lens) = &camera.lens {
            let [u, v, a, b, c, d, e, f, shown] = N::each(centre, |centre| {
                let seen = lens.look(centre);
                let Seen { position: [u, v], jacobian: [[a, b, c], [d, e, f]] } =
                    seen.unwrap_or(Seen { position: [0.0; 2], jacobian: [[0.0; 3]; 2] });
                let shown = seen.is_some() && u.hypot(v) <= camera.coverage;
                [u, v, a, b, c, d, e, f, f64::from(u8::from(shown))]
            });
            plane = [apply_transposed(w, [a, b, c]), apply_transposed(w, [d, e, f])];
            normal = cross(plane[0], plane[1]);
            magnification = [camera.fx, camera.fy];
            let mean = [u * camera.fx + camera.cx, v * camera.fy + camera.cy];
            through_lens = Some((mean, shown.constant(0.0).below(shown)));
        }
        let rotation = rotation(p.quaternion);
        let [a, b, c] = p.log_scales;
        let scales = [a.exp(), b.exp(), c.exp()];
        let largest = scales[0].max(scales[1]).max(scales[2]);
        let divisor = largest.max(largest.constant(LEAST_SCALE));
        let relative = [scales[0] / divisor, scales[1] / divisor, scales[2] / divisor];
        let [across, down] = magnification;
        let turned =
            [scale(apply_transposed(&rotation, plane[0]), across), scale(apply_transposed(&rotation, plane[1]), down)];
        let half = [times(turned[0], scales), times(turned[1], scales)];
        let added = z.constant(filter.variance());
        let covariance = [dot(half[0], half[0]) + added, dot(half[0], half[1]), dot(half[1], half[1]) + added];
        let size = covariance[0].max(covariance[2]);
        let length = size.sqrt();
        let per_length = largest / length;
        // one factor after the other: their product may overflow or vanish where the result does not
        let crossed = scale(scale(apply_transposed(&rotation, normal), across * per_length), down * per_length);
        // det(Σ + εI) = det Σ + ε tr Σ + ε², every term non-negative: no cancellation for needles
        let minors = times(pairs(relative), crossed);
        let unfiltered = dot(minors, minors);
        let low_pass = added / size;
        let trace = covariance[0] / size + covariance[2] / size;
        let added = low_pass * (trace - low_pass);
        let determinant = unfiltered + added;
        Self {
            centre,
            slopes: [sx, sy],
            unclamped: [free_x, free_y],
            through_lens,
            rotation,
            largest,
            relative,
            covariance,
            size,
            length,
            axes: [scale(turned[0], per_length), scale(turned[1], per_length)],
            crossed: scale(crossed, z.constant(1.0) / determinant.sqrt()),
            low_pass,
            determinant,
            ratio: unfiltered / determinant,
            lack: added / determinant,
            filter,
        }
    }

    /// How u and v change with the axes of the Gaussian times the largest scale, `root` · J W R: with Q = Rᵀ R, R (h₀ h₁) for
    /// the rows h of J W R. The first is the part of h₀ at right angles to h₁, and ε / C of the part along it.
    #[inline(always)]
    fn whitened(&self) -> [V3<N>; 2] {
        let [a0, a1] = self.axes;
        let root = (self.covariance[2] / self.size).sqrt();
        let v1 = scale(a1, root.constant(1.0) / root);
        let along = self.low_pass / root / self.determinant.sqrt();
        [add(cross(times(self.squares(), v1), self.crossed), scale(a0, along)), v1]
    }

    #[inline(always)]
    fn squares(&self) -> V3<N> {
        times(self.relative, self.relative)
    }

    #[inline(always)]
    fn compensation(&self) -> N {
        match self.filter {
            ScreenFilter::Compensated => self.ratio.max(self.ratio.constant(MIN_COMPENSATION_SQUARED)).sqrt(),
            ScreenFilter::Plain | ScreenFilter::Off => self.ratio.constant(1.0),
        }
    }
}

impl<N: Number> Splat<N> {
    /// The footprint and where it is seen: not behind the near plane, where a lens does not see, where the weight stays below
    /// the cutoff, and where the projection overflows.
    #[inline(always)]
    pub fn seen(camera: &CameraOf<N>, p: &Parameters<N>, colour: V3<N>, filter: ScreenFilter) -> (N::Mask, Self) {
        let projection = Projection::new(camera, p, filter);
        let [x, y, z] = projection.centre;
        let depth = camera.depth(projection.centre);
        let (zero, one, cutoff) = (z.constant(0.0), z.constant(1.0), z.constant(CUTOFF));
        let strength = p.opacity.max(zero) * projection.compensation();
        let [variance_x, covariance, variance_y] = projection.covariance;
        let (size, d) = (projection.size, projection.determinant);
        // comparisons that NaN fails: a projection that overflows is not drawn
        let mut visible = camera.near.below(depth)
            & strength.at_least(cutoff)
            & zero.below(d)
            & size.below(z.constant(f64::INFINITY));
        let mut mean = [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy];
        if let Some((through_lens, shown)) = projection.through_lens {
            (mean, visible) = (through_lens, visible & shown);
        }
        let across = (variance_y / size / d).sqrt() / projection.length;
        let splat = Self {
            mean,
            root: [across, -across * (covariance / variance_y), one / variance_y.sqrt()],
            variances: [variance_x, variance_y],
            strength,
            depth,
            colour,
            squared_radius: z.constant(2.0) * (strength / cutoff).ln(),
        };
        (visible, splat)
    }

    /// Gradient with respect to the mean, per px.
    #[inline(always)]
    pub fn mean_gradient(&self, sum: &SplatGrad<N>) -> [N; 2] {
        let [_, mu, mv, ..] = sum.moments;
        let [p, q, r] = self.root;
        [p * mu, q * mu + r * mv]
    }

    /// An offset from the mean, px, in units of the standard deviations: (u, v).
    #[inline(always)]
    pub fn in_deviations(&self, dx: N, dy: N) -> [N; 2] {
        let [p, q, r] = self.root;
        [p * dx + q * dy, r * dy]
    }
}

impl<T: Real> Splat<T> {
    /// `None` where it is not [`seen`](Self::seen).
    #[inline(always)]
    pub fn new(camera: &CameraOf<T>, p: &Parameters<T>, colour: V3<T>, filter: ScreenFilter) -> Option<Self> {
        let (visible, splat) = Self::seen(camera, p, colour, filter);
        visible.then_some(splat)
    }

    /// Pixels at which the weight can reach the cutoff: the bounding box of the ellipse.
    #[inline(always)]
    pub fn reach(&self, width: usize, height: usize) -> PixelRect {
        self.reach_within(f64::INFINITY, width, height)
    }

    /// [`reach`](Self::reach) up to an offset in x or y from the mean, px.
    #[inline(always)]
    fn reach_within(&self, bound: f64, width: usize, height: usize) -> PixelRect {
        // rounding must not cut off a pixel that reaches the cutoff
        let squared = self.squared_radius.as_f64() * (1.0 + 1e-5);
        let half = |axis: usize| (squared * self.variances[axis].as_f64()).sqrt().min(bound);
        let (half_x, half_y) = (half(0), half(1));
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
        // slack for the rounding of both sides: a tile too many costs little, a tile too few shows
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

    /// Weight at an offset (u, v) in standard deviations, 0 below the cutoff.
    #[inline(always)]
    pub fn weight(&self, u: T, v: T) -> T {
        let weight = self.strength * (T::of(-0.5) * (u * u + v * v)).exp_nonpositive();
        // `>=` as in `strength >= CUTOFF` above: an opacity of exactly 1/255 shows at its centre
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

/// Gradients with respect to the logarithms of the scales, to turns about the axes of the Gaussian, and to the rows of
/// J W R S.
struct ShapeGrad<T> {
    log_scales: V3<T>,
    turn: V3<T>,
    half: [V3<T>; 2],
}

#[inline(always)]
fn exponent_backward<N: Number>(projection: &Projection<N>, splat: &Splat<N>, sum: &SplatGrad<N>) -> ShapeGrad<N> {
    let [.., muu, muv, mvv] = sum.moments;
    let [p, q, r] = splat.root;
    // with Q = Rᵀ R and M = Σ g w wᵀ, w = R d: ∂Σ = ½ Rᵀ M R, and ∂H = 2 ∂Σ H = Rᵀ (M (R H)) for Σ = H Hᵀ + εI
    let [v0, v1] = projection.whitened();
    let (n0, n1) = (add(scale(v0, muu), scale(v1, muv)), add(scale(v0, muv), scale(v1, mvv)));
    let (relative, squares) = (projection.relative, projection.squares());
    // Hᵀ ∂H is symmetric: a turn from one axis to another matters as far as their scales differ
    let both = {
        #[inline(always)]
        |i: usize, j: usize| v0[i] * n0[j] + v1[i] * n1[j]
    };
    ShapeGrad {
        log_scales: times(squares, add(times(v0, n0), times(v1, n1))),
        turn: times(differences(relative), [both(1, 2), both(2, 0), both(0, 1)]),
        half: [times(relative, scale(n0, p)), times(relative, add(scale(n0, q), scale(n1, r)))],
    }
}

#[inline(always)]
fn ratio_backward<N: Number>(projection: &Projection<N>, grad_ratio: N) -> ShapeGrad<N> {
    let Projection { relative, axes: [a0, a1], crossed, low_pass, determinant, ratio, lack, .. } = *projection;
    let (squares, share) = (projection.squares(), low_pass / determinant);
    let minors = times(pairs(relative), crossed);
    let minors = times(minors, minors);
    let spread = times(squares, add(times(a0, a0), times(a1, a1)));
    let twice = ratio.constant(2.0) * grad_ratio;
    // lack ∂det Σ − ratio ε ∂tr Σ without the terms that cancel
    let log_scale = {
        #[inline(always)]
        |k: usize, i: usize, j: usize| {
            twice * share * ((spread[i] + spread[j] + low_pass) * (minors[i] + minors[j]) - minors[k] * spread[k])
        }
    };
    let both = {
        #[inline(always)]
        |k: usize, i: usize, j: usize| {
            let of_minors = (relative[k] * crossed[i]) * (relative[k] * crossed[j]);
            -twice * (lack * of_minors + ratio * share * (a0[i] * a0[j] + a1[i] * a1[j]))
        }
    };
    let (by_minors, by_axes) = (lack / determinant.sqrt(), -ratio * share);
    let of_axes = [
        add(scale(cross(times(squares, a1), crossed), by_minors), scale(a0, by_axes)),
        add(scale(cross(crossed, times(squares, a0)), by_minors), scale(a1, by_axes)),
    ];
    let per_length = twice / projection.length;
    // the other two of three axes in cyclic order
    ShapeGrad {
        log_scales: [log_scale(0, 1, 2), log_scale(1, 2, 0), log_scale(2, 0, 1)],
        turn: times(differences(relative), [both(0, 1, 2), both(1, 2, 0), both(2, 0, 1)]),
        half: [scale(times(relative, of_axes[0]), per_length), scale(times(relative, of_axes[1]), per_length)],
    }
}

/// Products of two of three scales, by the axis that is left out.
#[inline(always)]
fn pairs<N: Number>(scales: V3<N>) -> V3<N> {
    let [a, b, c] = scales;
    [b * c, c * a, a * b]
}

/// Differences of the squares of two of three scales, by the axis that is left out.
// a factor of the difference, not a difference of squares, whose digits cancel for equal scales
#[inline(always)]
fn differences<N: Number>([a, b, c]: V3<N>) -> V3<N> {
    [(b - c) * (b + c), (c - a) * (c + a), (a - b) * (a + b)]
}

/// Gradients with respect to the raw parameters, from the sums over the pixels (3DGS; compensation: GES).
#[inline(always)]
pub fn backward<N: Number>(
    camera: &CameraOf<N>,
    p: &Parameters<N>,
    splat: &Splat<N>,
    sum: &SplatGrad<N>,
    filter: ScreenFilter,
) -> ParameterGrad<N> {
    let projection = Projection::new(camera, p, filter);
    let total = sum.moments[0];
    let zero = total.constant(0.0);
    let grad_mean = splat.mean_gradient(sum);
    let mut shape = exponent_backward(&projection, splat, sum);
    if filter == ScreenFilter::Compensated {
        let ratio = projection.ratio;
        // ½ / ratio, because the strength has its root as a factor; at its bound the compensation is a constant
        let grad_ratio = total.constant(0.5) * total / ratio;
        let varies = ratio.constant(MIN_COMPENSATION_SQUARED).below(ratio);
        let of_ratio = ratio_backward(&projection, N::select(varies, grad_ratio, zero));
        shape = ShapeGrad {
            log_scales: add(shape.log_scales, of_ratio.log_scales),
            turn: add(shape.turn, of_ratio.turn),
            half: [add(shape.half[0], of_ratio.half[0]), add(shape.half[1], of_ratio.half[1])],
        };
    }
    let grad_centre = match &camera.lens {
        None => pinhole_backward(camera, &projection, grad_mean, &shape),
        Some(lens) => lens_backward(lens, camera, &projection, grad_mean, &shape),
    };
    // the gradient of the exponent is that of the strength times it; a Gaussian that is drawn has at least 1/255
    let grad_strength = total / splat.strength;
    ParameterGrad {
        position: apply_transposed(&camera.rotation, grad_centre),
        quaternion: turn_backward(p.quaternion, shape.turn),
        log_scales: shape.log_scales,
        opacity: N::select(zero.below(p.opacity), grad_strength * projection.compensation(), zero),
        degrees_of_freedom: zero,
    }
}

/// Gradient with respect to the centre in camera axes from those with respect to the mean, px, and to the shape.
#[inline(always)]
fn pinhole_backward<N: Number>(
    camera: &CameraOf<N>,
    projection: &Projection<N>,
    grad_mean: [N; 2],
    shape: &ShapeGrad<N>,
) -> V3<N> {
    let [x, y, z] = projection.centre;
    let zero = z.constant(0.0);
    let turned = apply_transposed(&projection.rotation, camera.rotation[2]);
    let depths = times(turned, scale(projection.relative, projection.largest));
    // row 0 of J W = fx / z (W₀ − s_x W₂), s_x = x / z unless clamped; 1 / z acts like all scales at once
    let [a, b, c] = shape.log_scales;
    let mut grad_centre = [zero, zero, -(a + b + c) / z];
    for (axis, focal) in [(0, camera.fx), (1, camera.fy)] {
        let coordinate = [x, y][axis];
        let grad_slope = -focal / z * dot(shape.half[axis], depths);
        let grad_slope = N::select(projection.unclamped[axis], grad_slope, zero) / z;
        grad_centre[axis] = grad_slope + focal / z * grad_mean[axis];
        grad_centre[2] =
            grad_centre[2] - grad_slope * projection.slopes[axis] - focal * coordinate / (z * z) * grad_mean[axis];
    }
    grad_centre
}

#[inline(always)]
fn lens_backward<N: Number>(
    lens: &Lens,
    camera: &CameraOf<N>,
    projection: &Projection<N>,
    grad_mean: [N; 2],
    shape: &ShapeGrad<N>,
) -> V3<N> {
    let scales = scale(projection.relative, projection.largest);
    let grad_jacobian = {
        #[inline(always)]
        |half: V3<N>, focal: N| {
            let grad_plane = apply(&projection.rotation, times(scales, half));
            scale(apply(&camera.rotation, grad_plane), focal)
        }
    };
    let [x, y, z] = projection.centre;
    let (u, v) = (camera.fx * grad_mean[0], camera.fy * grad_mean[1]);
    let [a, b, c] = grad_jacobian(shape.half[0], camera.fx);
    let [d, e, f] = grad_jacobian(shape.half[1], camera.fy);
    N::each([x, y, z, u, v, a, b, c, d, e, f], |[x, y, z, u, v, a, b, c, d, e, f]| {
        lens.look_backward([x, y, z], [u, v], [[a, b, c], [d, e, f]])
    })
}

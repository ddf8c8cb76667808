//! One surfel seen by one camera: where a ray meets its disc, and which pixels it can reach.

mod lens_reach;

use pulp::Simd;

use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::math::{CameraOf, M3, V3, add, apply_transposed, column, cross, dot, rotation, rotation_backward, scale};
use crate::tiles::PixelRect;

/// A ray misses the disc if the component of its direction along the normal is smaller than this.
pub const MIN_FACING: f64 = 1e-12;
/// Log-scales are bounded here: a larger surfel covers everything it faces, and its squared scale overflows.
pub const LARGEST_LOG_SCALE: f64 = 80.0;

/// A disc as linear functions of the pixel position, relative to an anchor pixel.
///
/// With r the ray through a pixel, c the centre, (t_u, t_v, n) the axes in camera space:
/// `u = r·(t_v × c) / (r·n s_u)`, `v = r·(c × t_u) / (r·n s_v)`, `z = n·c / r·n`. The two triple
/// products vanish at the projected centre, which is the anchor where there is one: a small, far
/// surfel then loses nothing to cancellation.
///
/// Through a lens they are linear functions of the ray instead, by its components z, x and y, and the anchor is 0.
#[derive(Clone, Copy, Debug)]
pub struct Plane<T> {
    /// px
    pub anchor: [T; 2],
    /// Value at the anchor, slope per px in x, slope per px in y; or slopes in z, x and y of the ray.
    pub u: [T; 3],
    pub v: [T; 3],
    pub facing: [T; 3],
    pub distance: T,
}

/// The point where a ray meets a disc.
#[derive(Clone, Copy, Debug)]
pub struct Hit<T> {
    pub u: T,
    pub v: T,
    pub depth: T,
    pub facing: T,
}

impl<T: Real> Hit<T> {
    /// u² + v²: the squared distance from the centre, in σ².
    #[inline(always)]
    pub fn squared(&self) -> T {
        self.u * self.u + self.v * self.v
    }
}

impl<T: Real> Plane<T> {
    /// u, v, depth and r·n where the rays through the pixels at offsets (`dx`, `dy`) px from the anchor meet the plane.
    #[inline(always)]
    pub fn meet<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> [Lanes<T, S>; 4] {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        self.at(dx.simd(), |[at_anchor, x, y]| all(x).mul_add(dx, all(at_anchor + y * dy)))
    }

    /// [`meet`](Self::meet) of rays through a lens.
    #[inline(always)]
    pub fn meet_by<S: Simd>(&self, [x, y, z]: V3<Lanes<T, S>>) -> [Lanes<T, S>; 4] {
        let all = |value: T| Lanes::splat(x.simd(), value);
        self.at(x.simd(), |linear| all(linear[0]) * z + all(linear[1]) * x + all(linear[2]) * y)
    }

    #[inline(always)]
    fn at<S: Simd>(&self, simd: S, linear: impl Fn([T; 3]) -> Lanes<T, S>) -> [Lanes<T, S>; 4] {
        let facing = linear(self.facing);
        // no test for 0: edge-on a hit is infinite or NaN, and callers drop it by its facing
        let inverse = Lanes::splat(simd, T::one()) / facing;
        let depth = Lanes::splat(simd, self.distance) * inverse;
        [linear(self.u) * inverse, linear(self.v) * inverse, depth, facing]
    }

    /// Where a ray through a lens meets the plane of the disc.
    #[inline(always)]
    pub fn hit_by(&self, [x, y, z]: V3<T>) -> Hit<T> {
        self.hit_of(|linear| linear[0] * z + linear[1] * x + linear[2] * y)
    }

    /// Where the ray through the point (`x`, `y`) px meets the plane of the disc.
    #[inline(always)]
    pub fn hit(&self, x: T, y: T) -> Hit<T> {
        let (dx, dy) = (x - self.anchor[0], y - self.anchor[1]);
        self.hit_of(|[at_anchor, x, y]| at_anchor + x * dx + y * dy)
    }

    #[inline(always)]
    fn hit_of(&self, linear: impl Fn([T; 3]) -> T) -> Hit<T> {
        let facing = linear(self.facing);
        let inverse = T::one() / facing;
        Hit { u: linear(self.u) * inverse, v: linear(self.v) * inverse, depth: self.distance * inverse, facing }
    }
}

impl Plane<f64> {
    pub fn cast<T: Real>(&self) -> Plane<T> {
        Plane {
            anchor: self.anchor.map(T::of),
            u: self.u.map(T::of),
            v: self.v.map(T::of),
            facing: self.facing.map(T::of),
            distance: T::of(self.distance),
        }
    }
}

/// One surfel in camera space, always in f64. An edge-on disc magnifies the rounding errors of its plane by
/// 1 / r·n, and in the gradients by the square of it.
#[derive(Clone, Copy, Debug)]
pub struct Disc {
    pub plane: Plane<f64>,
    /// Ray through the anchor.
    pub anchor_ray: V3<f64>,
    pub centre: V3<f64>,
    /// Columns t_u, t_v, n in camera axes.
    pub axes: M3<f64>,
    pub scales: [f64; 2],
    /// Whether the anchor is the projected centre.
    centred: bool,
}

/// Gradients of the linear functions of a surfel, summed over its pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct DiscGrad {
    /// Coefficients of r·(t_v × c): at the anchor, times offset in x, times offset in y (offsets in units of the ray).
    /// Through a lens times z, x and y of the ray.
    pub u: V3<f64>,
    pub v: V3<f64>,
    pub facing: V3<f64>,
    pub distance: f64,
    pub log_scales: [f64; 2],
}

impl DiscGrad {
    pub fn add(&mut self, other: &Self) {
        self.u = add(self.u, other.u);
        self.v = add(self.v, other.v);
        self.facing = add(self.facing, other.facing);
        self.distance += other.distance;
        self.log_scales[0] += other.log_scales[0];
        self.log_scales[1] += other.log_scales[1];
    }
}

impl Disc {
    pub fn new(camera: &CameraOf<f64>, surfel: &Parameters) -> Self {
        let centre = camera.transform(surfel.position);
        let axes = camera.axes(&rotation(surfel.quaternion));
        let [tangent_u, tangent_v, normal] = [0, 1, 2].map(|j| column(&axes, j));
        let centred = centre[2] > camera.near && camera.lens.is_none();
        let anchor_ray = if centred { [centre[0] / centre[2], centre[1] / centre[2], 1.0] } else { [0.0, 0.0, 1.0] };
        // through a lens, functions of the ray itself
        let [fx, fy, cx, cy] = match camera.lens {
            None => [camera.fx, camera.fy, camera.cx, camera.cy],
            Some(_) => [1.0, 1.0, 0.0, 0.0],
        };
        let anchor = [anchor_ray[0] * fx + cx, anchor_ray[1] * fy + cy];
        let scales = surfel.log_scales.map(|s| s.min(LARGEST_LOG_SCALE).exp());
        let (along_u, along_v) = (cross(tangent_v, centre), cross(centre, tangent_u));
        let linear = |k: V3<f64>, vanishes: bool| {
            let at_anchor = if vanishes { 0.0 } else { dot(anchor_ray, k) };
            [at_anchor, k[0] / fx, k[1] / fy]
        };
        let plane = Plane {
            anchor,
            u: linear(along_u, centred).map(|v| v / scales[0]),
            v: linear(along_v, centred).map(|v| v / scales[1]),
            facing: linear(normal, false),
            distance: dot(normal, centre),
        };
        Self { plane, anchor_ray, centre, axes, scales, centred }
    }

    /// Arguments of the linear functions at a pixel: 1 and the offset from the anchor in units of the ray.
    #[inline(always)]
    pub fn offset(&self, camera: &CameraOf<f64>, [x, y]: [f64; 2]) -> V3<f64> {
        [1.0, (x - self.plane.anchor[0]) / camera.fx, (y - self.plane.anchor[1]) / camera.fy]
    }

    /// Adds one pixel at an [`offset`](Self::offset), or at z, x and y of its ray through a lens, given the gradients with
    /// respect to the exponent −(u² + v²) / 2 of its kernel and to its depth.
    #[inline(always)]
    pub fn accumulate(&self, offset: V3<f64>, hit: &Hit<f64>, power: f64, grad_depth: f64, sum: &mut DiscGrad) {
        let (grad_u, grad_v) = (-power * hit.u, -power * hit.v);
        let towards_u = grad_u / (hit.facing * self.scales[0]);
        let towards_v = grad_v / (hit.facing * self.scales[1]);
        let towards_facing = -(grad_u * hit.u + grad_v * hit.v + grad_depth * hit.depth) / hit.facing;
        sum.u = add(sum.u, scale(offset, towards_u));
        sum.v = add(sum.v, scale(offset, towards_v));
        sum.facing = add(sum.facing, scale(offset, towards_facing));
        sum.distance += grad_depth / hit.facing;
        sum.log_scales[0] -= grad_u * hit.u;
        sum.log_scales[1] -= grad_v * hit.v;
    }

    /// Gradients with respect to world position, raw quaternion and log-scales.
    pub fn backward(
        &self,
        camera: &CameraOf<f64>,
        quaternion: [f64; 4],
        sum: &DiscGrad,
    ) -> (V3<f64>, [f64; 4], [f64; 2]) {
        let c = self.centre;
        let [tangent_u, tangent_v, normal] = [0, 1, 2].map(|j| column(&self.axes, j));
        // sums of gradient · ray, split into the anchor's ray and the offsets from it
        let beside = |g: V3<f64>| [g[1], g[2], 0.0];
        let whole = |g: V3<f64>| add(scale(self.anchor_ray, g[0]), beside(g));
        // c × ray sums: the anchor's part vanishes where the anchor is the projected centre
        let centre_cross = |g: V3<f64>| if self.centred { cross(c, beside(g)) } else { cross(c, whole(g)) };
        let (along_u, along_v) = (whole(sum.u), whole(sum.v));
        let grad_tangent_v = centre_cross(sum.u);
        let grad_tangent_u = scale(centre_cross(sum.v), -1.0);
        let grad_normal = add(whole(sum.facing), scale(c, sum.distance));
        let grad_centre = add(add(cross(along_u, tangent_v), cross(tangent_u, along_v)), scale(normal, sum.distance));
        let columns = [grad_tangent_u, grad_tangent_v, grad_normal].map(|g| apply_transposed(&camera.rotation, g));
        let grad_rotation: M3<f64> = std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]));
        (apply_transposed(&camera.rotation, grad_centre), rotation_backward(quaternion, &grad_rotation), sum.log_scales)
    }

    /// A depth that no point of the surfel is before, out to a squared radius in σ².
    pub fn nearest(&self, squared_radius: f64) -> f64 {
        let [along_u, along_v] = [0, 1].map(|j| self.scales[j] * column(&self.axes, j)[2]);
        // an ellipse reaches towards a plane by the root of what its half-axes do, squared and added
        let reach = squared_radius.max(0.0).sqrt() * along_u.hypot(along_v);
        // through a wide lens depths are distances, which are no smaller; in f32 they are rounded
        self.centre[2] - reach - 1e-5 * (reach + self.centre[2].abs())
    }

    /// Pixels that the footprint of the surfel can reach, out to a squared radius in σ², exactly (the bound of 2DGS, cut by the
    /// near plane); through a lens a bound of them. None for a negative one.
    pub fn reach(&self, camera: &CameraOf<f64>, squared_radius: f64) -> PixelRect {
        if squared_radius < 0.0 {
            return PixelRect::EMPTY;
        }
        let (c, radius) = (self.centre, squared_radius.sqrt());
        let [a, b] = [0, 1].map(|j| scale(column(&self.axes, j), radius * self.scales[j]));
        let along = |i: usize| slope_range([c[i], c[2]], [a[i], a[2]], [b[i], b[2]], camera.near);
        let bounds = match &camera.lens {
            Some(lens) => lens_reach::bounds(lens, c, [a, b]),
            None => along(0).zip(along(1)).map(|([x0, x1], [y0, y1])| [x0, x1, y0, y1]),
        };
        let Some([x0, x1, y0, y1]) = bounds else { return PixelRect::EMPTY };
        let (across, down) = (|x: f64| x * camera.fx + camera.cx, |y: f64| y * camera.fy + camera.cy);
        PixelRect::covering([across(x0), across(x1), down(y0), down(y1)], camera.width, camera.height)
    }
}

/// Raw parameters of one surfel.
#[derive(Clone, Copy, Debug)]
pub struct Parameters {
    pub position: V3<f64>,
    pub quaternion: [f64; 4],
    pub log_scales: [f64; 2],
}

/// Range of x / z over the part of the disc `centre + a cos θ + b sin θ` (boundary) with z > near,
/// from the x and z components; `None` if no part is.
///
/// The extremes are the two lines through the eye tangent to the ellipse, as far as they touch it
/// in front of the near plane, and the ends of the chord in which the near plane cuts it.
pub fn slope_range([cx, cz]: [f64; 2], [ax, az]: [f64; 2], [bx, bz]: [f64; 2], near: f64) -> Option<[f64; 2]> {
    let reach = az.hypot(bz);
    if cz + reach <= near {
        return None;
    }
    let quadratic = cz * cz - reach * reach;
    let half_linear = cx * cz - (ax * az + bx * bz);
    // as a sum of minors: no cancellation for a small disc
    let (m_ca, m_cb, m_ab) = (cx * az - cz * ax, cx * bz - cz * bx, ax * bz - az * bx);
    // below 0 by rounding, or where the eye lies within the ellipse, which has no tangents then
    let root = (m_ca * m_ca + m_cb * m_cb - m_ab * m_ab).max(0.0).sqrt();
    let tangents = [(half_linear - root) / quadratic, (half_linear + root) / quadratic];
    if cz - reach > near {
        return Some(tangents);
    }
    let mut range = [f64::INFINITY, f64::NEG_INFINITY];
    let mut include = |slope: f64| range = [range[0].min(slope), range[1].max(slope)];
    for slope in tangents {
        let value = cx - slope * cz;
        let (cosine, sine) = (-(ax - slope * az) / value, -(bx - slope * bz) / value);
        // NaN, of a tangent at infinity, fails the comparison, and the chord bounds the disc instead
        if cz + az * cosine + bz * sine > near {
            include(slope);
        }
    }
    let (towards, half) = (bz.atan2(az), ((near - cz) / reach).clamp(-1.0, 1.0).acos());
    for angle in [towards - half, towards + half] {
        include((cx + ax * angle.cos() + bx * angle.sin()) / near);
    }
    Some(range)
}

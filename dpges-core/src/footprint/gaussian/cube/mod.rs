//! One Gaussian seen by one camera, on the device; the CPU's twin is [`super::cpu`].

pub(crate) mod along_ray;
pub(crate) mod regions;
pub(crate) mod student;
pub(crate) mod whitened;

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::cpu as splat;
use super::cpu::MIN_COMPENSATION_SQUARED;
use super::tensors::GaussianTensors;
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::moments::MOMENTS;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::lens::{LensKind, look, look_backward};
use crate::gpu::record::{Record, record};
use crate::gpu::rect::{RECT, Rect};
use crate::gpu::tile::TILE;
use crate::gpu::vector::{
    Mat3, Quaternion, Vec3, add, apply, cross, dot, rotation, rotation_backward, row3, row4, scale, transpose, vec3,
    write3, write4,
};
use crate::gpu::view::{CameraUniforms, pixel_range, to_camera, view_depth, view_rotation};
use crate::scene::ScreenFilter;

const MIN_RATIO: f32 = MIN_COMPENSATION_SQUARED as f32;
pub const CUTOFF_F32: f32 = CUTOFF as f32;
pub const INVERSE_CUTOFF: f32 = (1.0 / CUTOFF) as f32;
const JACOBIAN_MARGIN: f32 = splat::JACOBIAN_MARGIN as f32;

/// Number of values in a [`Splat`].
pub const SPLAT: usize = Splat::LEN;

record! {
    /// Footprint: `strength · exp(−½ (u² + v²))` at offset (dx, dy) px from the mean, `u = p dx + q dy`, `v = r dy`.
    pub struct Splat {
        pub mean_x: f32,
        pub mean_y: f32,
        pub p: f32,
        pub q: f32,
        pub r: f32,
        /// Opacity times the compensation for the low-pass filter; 0 if the Gaussian is invisible.
        pub strength: f32,
        /// Depth of the centre, world units.
        pub depth: f32,
        /// Value of u² + v² at the cutoff.
        pub squared_radius: f32,
    }
}

#[cube]
impl Splat {
    /// u at an offset from the mean, px.
    pub fn u(&self, dx: f32, dy: f32) -> f32 {
        self.p * dx + self.q * dy
    }

    /// Value of u² + v² beyond which the weight is below the cutoff, whatever the rounding.
    fn beyond(&self) -> f32 {
        self.squared_radius * 1.001f32 + 0.01f32
    }

    /// Weight at an offset (u, v) in standard deviations, 0 below the cutoff.
    pub fn weight(&self, u: f32, v: f32) -> f32 {
        let squared = u * u + v * v;
        let mut weight = 0.0f32;
        if squared <= self.beyond() {
            let value = self.strength * f32::exp(-0.5f32 * squared);
            weight = select(value >= CUTOFF_F32, value, 0.0f32);
        }
        weight
    }

    /// Whether the ellipse can reach a pixel centre of the tile at a column and row of tiles.
    pub fn touches(&self, column: u32, row: u32) -> bool {
        self.reaches(column * TILE, row * TILE, TILE, TILE)
    }

    /// Whether the ellipse can reach a pixel centre of the rectangle at a column and row of pixels.
    pub fn reaches(&self, column: u32, row: u32, width: u32, height: u32) -> bool {
        let outside = self.nearest(column, row, width, height).squared > self.beyond();
        !outside
    }

    /// Where between the pixel centres of the rectangle at a column and row of pixels the weight is largest.
    pub fn nearest(&self, column: u32, row: u32, width: u32, height: u32) -> Nearest {
        let (p, q, r) = (self.p, self.q, self.r);
        let x0 = f32::cast_from(column) + 0.5f32 - self.mean_x;
        let y0 = f32::cast_from(row) + 0.5f32 - self.mean_y;
        let (x1, y1) = (x0 + f32::cast_from(width - 1u32), y0 + f32::cast_from(height - 1u32));
        let dx = clamp(0.0f32, x0, x1);
        let dy = clamp(0.0f32, y0, y1);
        // the convex form is smallest at the mean or on one of the two edges that face it
        let beside = clamp(-p * q * dx / (q * q + r * r), y0, y1);
        let below = clamp(-q * dy / p, x0, x1);
        let (vertical_u, vertical_v) = (p * dx + q * beside, r * beside);
        let (horizontal_u, horizontal_v) = (p * below + q * dy, r * dy);
        let on_vertical = vertical_u * vertical_u + vertical_v * vertical_v;
        let on_horizontal = horizontal_u * horizontal_u + horizontal_v * horizontal_v;
        let horizontal = on_horizontal < on_vertical;
        Nearest {
            dx: select(horizontal, below, dx),
            dy: select(horizontal, dy, beside),
            squared: min(on_vertical, on_horizontal),
        }
    }
}

/// A point of a rectangle.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Nearest {
    /// Offset from the mean, px.
    pub dx: f32,
    pub dy: f32,
    /// u² + v² there.
    pub squared: f32,
}

record! {
    /// Sums over the pixels of a Gaussian, [`MOMENTS`] numbers: Σ g, Σ g u, Σ g v, Σ g u², Σ g u v, Σ g v², where g is
    /// the gradient of the exponent.
    pub struct Moments {
        pub total: f32,
        pub u: f32,
        pub v: f32,
        pub uu: f32,
        pub uv: f32,
        pub vv: f32,
    }
}

#[cube]
impl Moments {
    /// Whether any pixel contributed.
    pub fn any(&self) -> bool {
        self.total != 0.0f32
            || self.u != 0.0f32
            || self.v != 0.0f32
            || self.uu != 0.0f32
            || self.uv != 0.0f32
            || self.vv != 0.0f32
    }
}

/// Adds a pixel at (u, v) to the first [`MOMENTS`] of a unit's sums.
#[cube]
pub fn add_moments(own: &mut Array<f32>, power: f32, u: f32, v: f32) {
    own[0] += power;
    own[1] += power * u;
    own[2] += power * v;
    own[3] += power * u * u;
    own[4] += power * u * v;
    own[5] += power * v * v;
}

/// The local linear map of a camera at the centre of a Gaussian.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Local {
    /// Without a lens x / z and y / z, clamped for the Jacobian, and 1 where they were not, else 0; through a lens the
    /// position, px, and 1 where the lens shows it well enough, else 0.
    x: f32,
    y: f32,
    free_x: f32,
    free_y: f32,
    /// Rows of J W.
    plane0: Vec3,
    plane1: Vec3,
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Projection {
    centre: Vec3,
    local: Local,
    rotation: Mat3,
    scales: Vec3,
    /// Rows of J W R S.
    half0: Vec3,
    half1: Vec3,
    /// A, B, C of the filtered covariance, px².
    cov_a: f32,
    cov_b: f32,
    cov_c: f32,
    /// The larger of A and C, px². Determinants are those of covariances divided by it, see the twin.
    size: f32,
    determinant: f32,
    minors: Vec3,
    /// Ratio of the determinants, and what it lacks to 1.
    ratio: f32,
    lack: f32,
}

#[cube]
fn pinhole_local(view: CameraUniforms, centre: Vec3) -> Local {
    let z = select(centre.z > view.near, centre.z, 1.0f32);
    let (width, height) = (f32::cast_from(view.width), f32::cast_from(view.height));
    let (margin_x, margin_y) = (JACOBIAN_MARGIN * width / view.fx, JACOBIAN_MARGIN * height / view.fy);
    let (raw_x, raw_y) = (centre.x / z, centre.y / z);
    let slope_x = min(max(raw_x, -view.cx / view.fx - margin_x), (width - view.cx) / view.fx + margin_x);
    let slope_y = min(max(raw_y, -view.cy / view.fy - margin_y), (height - view.cy) / view.fy + margin_y);
    let pose = view_rotation(view);
    Local {
        x: slope_x,
        y: slope_y,
        free_x: select(raw_x == slope_x, 1.0f32, 0.0f32),
        free_y: select(raw_y == slope_y, 1.0f32, 0.0f32),
        plane0: scale(add(pose.row0, scale(pose.row2, -slope_x)), view.fx / z),
        plane1: scale(add(pose.row1, scale(pose.row2, -slope_y)), view.fy / z),
    }
}

#[cube]
fn lens_local(view: CameraUniforms, centre: Vec3) -> Local {
    let seen = look(view.lens, centre);
    let back = transpose(view_rotation(view));
    let shown = select(seen.shown, 1.0f32, 0.0f32);
    Local {
        x: view.fx * seen.x + view.cx,
        y: view.fy * seen.y + view.cy,
        free_x: shown,
        free_y: shown,
        plane0: scale(apply(back, seen.row0), view.fx),
        plane1: scale(apply(back, seen.row1), view.fy),
    }
}

#[cube]
fn local(view: CameraUniforms, centre: Vec3) -> Local {
    if comptime!(view.lens.kind == LensKind::None) { pinhole_local(view, centre) } else { lens_local(view, centre) }
}

#[cube]
fn project(
    view: CameraUniforms,
    position: Vec3,
    quaternion: Quaternion,
    log_scales: Vec3,
    #[comptime] filter: ScreenFilter,
) -> Projection {
    let low_pass = comptime!(filter.variance() as f32);
    let centre = to_camera(view, position);
    let local = local(view, centre);
    let rotation = rotation(quaternion);
    let scales = vec3(f32::exp(log_scales.x), f32::exp(log_scales.y), f32::exp(log_scales.z));
    let axes = transpose(rotation);
    let turned0 = apply(axes, local.plane0);
    let turned1 = apply(axes, local.plane1);
    let half0 = vec3(turned0.x * scales.x, turned0.y * scales.y, turned0.z * scales.z);
    let half1 = vec3(turned1.x * scales.x, turned1.y * scales.y, turned1.z * scales.z);
    let cov_a = dot(half0, half0) + low_pass;
    let cov_b = dot(half0, half1);
    let cov_c = dot(half1, half1) + low_pass;
    let size = max(cov_a, cov_c);
    let per_length = 1.0f32 / f32::sqrt(size);
    let minors = cross(scale(half0, per_length), scale(half1, per_length));
    // det(Σ + εI) = det Σ + ε tr Σ + ε², every term non-negative: no cancellation for needles
    let unfiltered = dot(minors, minors);
    let added = low_pass / size * (cov_a / size + cov_c / size - low_pass / size);
    let determinant = unfiltered + added;
    Projection {
        centre,
        local,
        rotation,
        scales,
        half0,
        half1,
        cov_a,
        cov_b,
        cov_c,
        size,
        determinant,
        minors,
        ratio: unfiltered / determinant,
        lack: added / determinant,
    }
}

#[cube]
fn compensation(p: Projection, #[comptime] filter: ScreenFilter) -> f32 {
    let mut factor = 1.0f32;
    if comptime!(filter == ScreenFilter::Compensated) {
        factor = f32::sqrt(max(p.ratio, MIN_RATIO));
    }
    factor
}

/// p, q and r of a footprint whose projection does not overflow.
#[cube]
fn root(cov_b: f32, cov_c: f32, size: f32, determinant: f32) -> Vec3 {
    let across = f32::sqrt(cov_c / size / determinant / size);
    vec3(across, -across * (cov_b / cov_c), 1.0f32 / f32::sqrt(cov_c))
}

/// Position of the centre, px; `z` is its camera-space z where it is visible.
#[cube]
fn mean(view: CameraUniforms, p: Projection, z: f32) -> (f32, f32) {
    if comptime!(view.lens.kind == LensKind::None) {
        (view.fx * p.centre.x / z + view.cx, view.fy * p.centre.y / z + view.cy)
    } else {
        (p.local.x, p.local.y)
    }
}

/// Whether the camera shows the centre.
#[cube]
fn is_shown(view: CameraUniforms, p: Projection) -> bool {
    let mut shown = view_depth(view, p.centre) > view.near;
    if comptime!(view.lens.kind != LensKind::None) {
        shown = shown && p.local.free_x > 0.5f32;
    }
    shown
}

/// The footprint of a Gaussian and the pixels that it can reach. It reaches none behind the near plane, where a lens does
/// not see, where it stays below the cutoff, and where its projection overflows.
#[cube]
fn splat_of(view: CameraUniforms, p: Projection, opacity: f32, #[comptime] filter: ScreenFilter) -> (Splat, Rect) {
    let strength = max(opacity, 0.0f32) * compensation(p, filter);
    let d = p.determinant;
    let visible = is_shown(view, p) && strength >= CUTOFF_F32 && d > 0.0f32 && p.size < 3e38f32;
    let z = select(visible, p.centre.z, 1.0f32);
    let root = root(
        select(visible, p.cov_b, 0.0f32),
        select(visible, p.cov_c, 1.0f32),
        select(visible, p.size, 1.0f32),
        select(visible, d, 1.0f32),
    );
    let squared = 2.0f32 * f32::ln(max(strength * INVERSE_CUTOFF, 1.0f32));
    let (x, y) = mean(view, p, z);
    let reach = squared * 1.001f32 + 0.01f32;
    let (half_x, half_y) = (f32::sqrt(reach * p.cov_a), f32::sqrt(reach * p.cov_c));
    let slack = 0.01f32;
    let (x0, x1) = pixel_range(x - half_x - slack, x + half_x + slack, view.width);
    let (y0, y1) = pixel_range(y - half_y - slack, y + half_y + slack, view.height);
    let splat = Splat {
        mean_x: x,
        mean_y: y,
        p: root.x,
        q: root.y,
        r: root.z,
        strength: select(visible, strength, 0.0f32),
        depth: view_depth(view, p.centre),
        squared_radius: squared,
    };
    (splat, Rect { x0, x1: select(visible, x1, x0), y0, y1: select(visible, y1, y0) })
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct SplatGradient {
    position: Vec3,
    quaternion: Quaternion,
    log_scales: Vec3,
    opacity: f32,
}

/// Gradient with respect to the centre in camera axes from those with respect to the mean, px, and to the rows of J W.
#[cube]
fn pinhole_backward(
    view: CameraUniforms,
    p: Projection,
    grad_x: f32,
    grad_y: f32,
    grad_plane0: Vec3,
    grad_plane1: Vec3,
) -> Vec3 {
    // plane row 0 = fx / z (W₀ − s_x W₂), s_x = x / z unless clamped
    let z = p.centre.z;
    let pose = view_rotation(view);
    let grad_slope_x = -p.local.free_x * view.fx / z * dot(grad_plane0, pose.row2);
    let grad_slope_y = -p.local.free_y * view.fy / z * dot(grad_plane1, pose.row2);
    let centre_x = grad_slope_x / z + view.fx / z * grad_x;
    let centre_y = grad_slope_y / z + view.fy / z * grad_y;
    let centre_z = -dot(grad_plane0, p.local.plane0) / z
        - dot(grad_plane1, p.local.plane1) / z
        - grad_slope_x * p.local.x / z
        - grad_slope_y * p.local.y / z
        - view.fx * p.centre.x / (z * z) * grad_x
        - view.fy * p.centre.y / (z * z) * grad_y;
    vec3(centre_x, centre_y, centre_z)
}

/// [`pinhole_backward`] through a lens.
#[cube]
fn lens_backward(
    view: CameraUniforms,
    p: Projection,
    grad_x: f32,
    grad_y: f32,
    grad_plane0: Vec3,
    grad_plane1: Vec3,
) -> Vec3 {
    let pose = view_rotation(view);
    let (row0, row1) = (scale(apply(pose, grad_plane0), view.fx), scale(apply(pose, grad_plane1), view.fy));
    look_backward(view.lens, p.centre, view.fx * grad_x, view.fy * grad_y, row0, row1)
}

#[cube]
fn local_backward(
    view: CameraUniforms,
    p: Projection,
    grad_x: f32,
    grad_y: f32,
    grad_plane0: Vec3,
    grad_plane1: Vec3,
) -> Vec3 {
    if comptime!(view.lens.kind == LensKind::None) {
        pinhole_backward(view, p, grad_x, grad_y, grad_plane0, grad_plane1)
    } else {
        lens_backward(view, p, grad_x, grad_y, grad_plane0, grad_plane1)
    }
}

/// From the moments to the raw parameters.
#[cube]
fn splat_backward(
    view: CameraUniforms,
    p: Projection,
    raw_quaternion: Quaternion,
    raw_opacity: f32,
    moments: Moments,
    #[comptime] filter: ScreenFilter,
) -> SplatGradient {
    let total = moments.total;
    let root = root(p.cov_b, p.cov_c, p.size, p.determinant);
    let (grad_x, grad_y) = (root.x * moments.u, root.y * moments.u + root.z * moments.v);
    // ∂H = Rᵀ (M (R H)), see the twin
    let (w0, w1) = (add(scale(p.half0, root.x), scale(p.half1, root.y)), scale(p.half1, root.z));
    let n0 = add(scale(w0, moments.uu), scale(w1, moments.uv));
    let n1 = add(scale(w0, moments.uv), scale(w1, moments.vv));
    let direct0 = scale(n0, root.x);
    let direct1 = add(scale(n0, root.y), scale(n1, root.z));

    let dimming = compensation(p, filter);
    let opacity = max(raw_opacity, 0.0f32);
    let strength = opacity * dimming;
    let grad_strength = total / max(strength, 1e-30f32);
    let mut live = 0.0f32;
    if comptime!(filter == ScreenFilter::Compensated) {
        live = select(p.ratio > MIN_RATIO, 1.0f32, 0.0f32);
    }
    let low_pass = comptime!(filter.variance() as f32);
    let by_ratio = live * grad_strength * opacity / dimming / p.determinant / p.size;
    let (by_minors, by_half) = (by_ratio * p.lack, -by_ratio * p.ratio * (low_pass / p.size));
    let grad_half0 = add(direct0, add(scale(cross(p.half1, p.minors), by_minors), scale(p.half0, by_half)));
    let grad_half1 = add(direct1, add(scale(cross(p.minors, p.half0), by_minors), scale(p.half1, by_half)));

    // half = plane · R S
    let r = p.rotation;
    let s = p.scales;
    let factor = Mat3 {
        row0: vec3(r.row0.x * s.x, r.row0.y * s.y, r.row0.z * s.z),
        row1: vec3(r.row1.x * s.x, r.row1.y * s.y, r.row1.z * s.z),
        row2: vec3(r.row2.x * s.x, r.row2.y * s.y, r.row2.z * s.z),
    };
    let (plane0, plane1) = (p.local.plane0, p.local.plane1);
    let of0 = add(scale(grad_half0, plane0.x), scale(grad_half1, plane1.x));
    let of1 = add(scale(grad_half0, plane0.y), scale(grad_half1, plane1.y));
    let of2 = add(scale(grad_half0, plane0.z), scale(grad_half1, plane1.z));
    let log_scales = vec3(
        of0.x * factor.row0.x + of1.x * factor.row1.x + of2.x * factor.row2.x,
        of0.y * factor.row0.y + of1.y * factor.row1.y + of2.y * factor.row2.y,
        of0.z * factor.row0.z + of1.z * factor.row1.z + of2.z * factor.row2.z,
    );
    let grad_rotation = Mat3 {
        row0: vec3(of0.x * s.x, of0.y * s.y, of0.z * s.z),
        row1: vec3(of1.x * s.x, of1.y * s.y, of1.z * s.z),
        row2: vec3(of2.x * s.x, of2.y * s.y, of2.z * s.z),
    };

    let grad_centre = local_backward(view, p, grad_x, grad_y, apply(factor, grad_half0), apply(factor, grad_half1));
    SplatGradient {
        position: apply(transpose(view_rotation(view)), grad_centre),
        quaternion: rotation_backward(raw_quaternion, grad_rotation),
        log_scales,
        opacity: select(raw_opacity > 0.0f32, grad_strength * dimming, 0.0f32),
    }
}

#[cube(launch)]
fn splats_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    order: &[u32],
    splats: &mut [f32],
    rects: &mut [u32],
    view: CameraUniforms,
    count: u32,
    #[comptime] ordered: bool,
    #[comptime] filter: ScreenFilter,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let mut i = rank;
    if comptime!(ordered) {
        i = order[rank] as usize;
    }
    let projection = project(view, row3(positions, i), row4(quaternions, i), row3(log_scales, i), filter);
    let (splat, rect) = splat_of(view, projection, opacities[i], filter);
    Splat::store(splat, splats, rank * SPLAT);
    rect.store(rects, rank);
}

#[cube(launch)]
fn place_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: &[f32],
    grad_positions: &mut [f32],
    grad_opacities: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] filter: ScreenFilter,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let moments = Moments::load(moments, i * MOMENTS);
    // an invisible Gaussian has no projection to differentiate
    if moments.any() {
        let gradient = gradient(positions, quaternions, log_scales, opacities, moments, view, i, filter);
        write3(grad_positions, i, gradient.position);
        grad_opacities[i] = gradient.opacity;
    } else {
        write3(grad_positions, i, vec3(0.0f32, 0.0f32, 0.0f32));
        grad_opacities[i] = 0.0f32;
    }
}

#[cube(launch)]
fn shape_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: &[f32],
    grad_quaternions: &mut [f32],
    grad_log_scales: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] filter: ScreenFilter,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let moments = Moments::load(moments, i * MOMENTS);
    if moments.any() {
        let gradient = gradient(positions, quaternions, log_scales, opacities, moments, view, i, filter);
        write4(grad_quaternions, i, gradient.quaternion);
        write3(grad_log_scales, i, gradient.log_scales);
    } else {
        write4(grad_quaternions, i, Quaternion { w: 0.0f32, x: 0.0f32, y: 0.0f32, z: 0.0f32 });
        write3(grad_log_scales, i, vec3(0.0f32, 0.0f32, 0.0f32));
    }
}

/// Gradients of one Gaussian. Two kernels write them, because one kernel would need more buffers than
/// every device has.
#[cube]
fn gradient(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: Moments,
    view: CameraUniforms,
    i: usize,
    #[comptime] filter: ScreenFilter,
) -> SplatGradient {
    let quaternion = row4(quaternions, i);
    let projection = project(view, row3(positions, i), quaternion, row3(log_scales, i), filter);
    splat_backward(view, projection, quaternion, opacities[i], moments, filter)
}

/// Splats [M, [`SPLAT`]] and pixel rectangles [M, [`RECT`]] of `gaussians`. Row i is Gaussian i, or Gaussian
/// `order[i]` with an `order` [M].
pub fn splats(
    gaussians: &GaussianTensors<CubeBackend>,
    order: Option<&CubeTensor>,
    camera: &Camera,
    filter: ScreenFilter,
) -> (CubeTensor, CubeTensor) {
    let like = &gaussians.positions;
    let count = like.shape()[0];
    let (splats, rects) = (empty_f32(like, [count, SPLAT]), empty_u32(like, [count, RECT]));
    splats_kernel::launch(
        &like.client.clone(),
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(order.unwrap_or(&empty_u32(like, [1]))),
        buffer(&splats),
        buffer(&rects),
        CameraUniforms::launch(camera),
        count as u32,
        order.is_some(),
        filter,
    );
    (splats, rects)
}

/// Writes the gradients with respect to positions, quaternions, log-scales and opacities into `out`, from
/// the `moments` [M, [`MOMENTS`]].
pub fn backward(
    gaussians: &GaussianTensors<CubeBackend>,
    moments: &CubeTensor,
    camera: &Camera,
    filter: ScreenFilter,
    out: &GaussianTensors<CubeBackend>,
) {
    let (client, count) = (moments.client.clone(), moments.shape()[0]);
    place_backward_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(moments),
        buffer(&out.positions),
        buffer(&out.opacities),
        CameraUniforms::launch(camera),
        count as u32,
        filter,
    );
    shape_backward_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(moments),
        buffer(&out.quaternions),
        buffer(&out.log_scales),
        CameraUniforms::launch(camera),
        count as u32,
        filter,
    );
}

//! One Gaussian seen by one camera, on the device; the CPU's twin is [`super::cpu`].

pub(crate) mod along_ray;
mod gradients;
mod projection;
pub(crate) mod regions;
pub(crate) mod student;
pub(crate) mod whitened;

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use self::gradients::{SplatGradient, splat_backward};
use self::projection::{Projection, project, splat_of};
use super::tensors::GaussianTensors;
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::moments::MOMENTS;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::record::{Record, record};
use crate::gpu::rect::RECT;
use crate::gpu::tile::TILE;
use crate::gpu::vector::{Quaternion, row3, row4, vec3, write3, write4};
use crate::gpu::view::CameraUniforms;
use crate::scene::ScreenFilter;

pub const CUTOFF_F32: f32 = CUTOFF as f32;
pub const INVERSE_CUTOFF: f32 = (1.0 / CUTOFF) as f32;

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
        // wider than on the CPU: WGSL lets `exp` be off by 3 + 2 |x| units in the last place, and `log` by more near 1
        self.squared_radius * 1.001f32 + 0.01f32
    }

    /// Weight at an offset (u, v) in standard deviations, 0 below the cutoff.
    pub fn weight(&self, u: f32, v: f32) -> f32 {
        let squared = u * u + v * v;
        let mut weight = 0.0f32;
        // most pixels of a rectangle are outside: they do without the exponential
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

/// The parameters of Gaussians, as in [`GaussianTensors`].
#[derive(CubeType, CubeLaunch)]
pub struct GaussianBuffers {
    pub positions: Box<[f32]>,
    pub quaternions: Box<[f32]>,
    pub log_scales: Box<[f32]>,
    pub opacities: Box<[f32]>,
}

impl GaussianBuffers {
    pub fn launch(gaussians: &GaussianTensors<CubeBackend>) -> GaussianBuffersLaunch {
        GaussianBuffersLaunch::new(
            buffer(&gaussians.positions),
            buffer(&gaussians.quaternions),
            buffer(&gaussians.log_scales),
            buffer(&gaussians.opacities),
        )
    }
}

#[cube]
fn projection_of(
    gaussians: &GaussianBuffers,
    view: CameraUniforms,
    i: usize,
    #[comptime] filter: ScreenFilter,
) -> Projection {
    let position = row3(&gaussians.positions, i);
    project(view, position, row4(&gaussians.quaternions, i), row3(&gaussians.log_scales, i), filter)
}

#[cube(launch)]
fn splats_kernel(
    gaussians: &GaussianBuffers,
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
    let projection = projection_of(gaussians, view, i, filter);
    let (splat, rect) = splat_of(view, projection, gaussians.opacities[i], filter);
    Splat::store(splat, splats, rank * SPLAT);
    rect.store(rects, rank);
}

/// Writes the gradients of Gaussian `i`: those of the position and the opacity if `of_place`, else those of the quaternion
/// and the log-scales. Kernels are launched once for each, because one launch would need more buffers than every device has.
#[cube]
fn store_gradient(
    gradient: SplatGradient,
    first: &mut [f32],
    second: &mut [f32],
    i: usize,
    #[comptime] of_place: bool,
) {
    if comptime!(of_place) {
        write3(first, i, gradient.position);
        second[i] = gradient.opacity;
    } else {
        write4(first, i, gradient.quaternion);
        write3(second, i, gradient.log_scales);
    }
}

/// The launches of a kernel that ends with [`store_gradient`]: `of_place`, `first` and `second`.
fn parts(out: &GaussianTensors<CubeBackend>) -> [(bool, &CubeTensor, &CubeTensor); 2] {
    [(true, &out.positions, &out.opacities), (false, &out.quaternions, &out.log_scales)]
}

#[cube(launch)]
fn backward_kernel(
    gaussians: &GaussianBuffers,
    moments: &[f32],
    first: &mut [f32],
    second: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] filter: ScreenFilter,
    #[comptime] of_place: bool,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let moments = Moments::load(moments, i * MOMENTS);
    // an invisible Gaussian has no projection to differentiate
    if moments.any() {
        let projection = projection_of(gaussians, view, i, filter);
        let quaternion = row4(&gaussians.quaternions, i);
        let gradient = splat_backward(view, projection, quaternion, gaussians.opacities[i], moments, filter);
        store_gradient(gradient, first, second, i, of_place);
    } else {
        let none = vec3(0.0f32, 0.0f32, 0.0f32);
        let quaternion = Quaternion { w: 0.0f32, x: 0.0f32, y: 0.0f32, z: 0.0f32 };
        let gradient = SplatGradient { position: none, quaternion, log_scales: none, opacity: 0.0f32 };
        store_gradient(gradient, first, second, i, of_place);
    }
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
        GaussianBuffers::launch(gaussians),
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
    let count = moments.shape()[0];
    for (of_place, first, second) in parts(out) {
        backward_kernel::launch(
            &moments.client.clone(),
            units(count),
            cube_dim(),
            GaussianBuffers::launch(gaussians),
            buffer(moments),
            buffer(first),
            buffer(second),
            CameraUniforms::launch(camera),
            count as u32,
            filter,
            of_place,
        );
    }
}

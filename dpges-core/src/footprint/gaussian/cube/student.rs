//! The footprint of a Gaussian with a kernel of Student's t distribution, on the device; the CPU's twin is
//! [`super::super::cpu::student`].

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::{CUTOFF_F32, INVERSE_CUTOFF, SPLAT, Splat};
use crate::camera::Camera;
use crate::footprint::gaussian::{STUDENT_LEAST_REACH, STUDENT_LEAST_SPREAD, STUDENT_REACH};
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::record::{Record, record};
use crate::gpu::rect::RECT;
use crate::gpu::view::{CameraUniforms, pixels_within};

const LEAST_REACH: f32 = STUDENT_LEAST_REACH as f32;
const LEAST_SPREAD: f32 = STUDENT_LEAST_SPREAD as f32;

record! {
    /// The values of a Student's t kernel besides its [`Splat`].
    pub struct Tail {
        /// ν
        pub degrees: f32,
        /// Largest offset from the mean in x or y at which it is drawn, px.
        pub bound: f32,
    }
}

/// ln(1 + x) of x ≥ 0. The logarithm of a device has an absolute error near 1, which large ν would magnify.
#[cube]
fn ln_1p(x: f32) -> f32 {
    // 2 artanh(x / (2 + x)), whose argument is at most 1/3
    let z = x / (2.0f32 + x);
    let squared = z * z;
    let mut p = 0.153_846_15f32 + squared * 0.133_333_34f32;
    p = p * squared + 0.181_818_18f32;
    p = p * squared + 0.222_222_22f32;
    p = p * squared + 0.285_714_3f32;
    p = p * squared + 0.4f32;
    p = p * squared + 0.666_666_7f32;
    p = p * squared + 2.0f32;
    select(x <= 1.0f32, p * z, f32::ln(1.0f32 + x))
}

/// Standard deviations of the major axis up to which a kernel is drawn.
#[cube]
fn reach_of(degrees: f32) -> f32 {
    let mut reach = select(degrees >= 13.0f32, LEAST_REACH, 0.0f32);
    #[unroll]
    for at in 0..12usize {
        let own = comptime!(STUDENT_REACH[at] as f32);
        let next = comptime!(STUDENT_REACH[at + 1] as f32);
        let whole = comptime!((at + 1) as f32);
        let within = degrees >= whole && degrees < whole + 1.0f32;
        // unrolled: the table is no buffer, and its numbers are constants of the kernel
        reach = select(within, (own - next) * (degrees - whole) + next, reach);
    }
    reach
}

/// α of a Student's t kernel at an offset from the mean, px, before it is capped; 0 below the cutoff and out of bounds.
#[cube]
pub fn student_weight(splat: Splat, tail: Tail, dx: f32, dy: f32) -> f32 {
    let (u, v) = (splat.u(dx, dy), splat.r * dy);
    let squared = u * u + v * v;
    let mut weight = 0.0f32;
    if squared <= splat.beyond() && max(f32::abs(dx), f32::abs(dy)) <= tail.bound {
        let exponent = -0.5f32 * (tail.degrees + 2.0f32) * ln_1p(squared / tail.degrees);
        let value = splat.strength * f32::exp(exponent);
        weight = select(f32::abs(value) >= CUTOFF_F32, value, 0.0f32);
    }
    weight
}

/// −2 and 1 times the derivatives of the exponent of α with respect to r² and ν at `squared` r²: see the twin.
#[cube]
pub fn student_slopes(degrees: f32, squared: f32) -> (f32, f32) {
    let share = squared / (degrees + squared);
    let by_degrees = 0.5f32 * (share - ln_1p(squared / degrees)) + share / degrees;
    ((degrees + 2.0f32) / (degrees + squared), by_degrees)
}

#[cube(launch)]
fn students_kernel(
    opacities: &[f32],
    degrees: &[f32],
    order: &[u32],
    ellipses: &[f32],
    splats: &mut [f32],
    rects: &mut [u32],
    tails: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] stride: usize,
    #[comptime] place: usize,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let i = order[rank] as usize;
    let base = Splat::load(ellipses, rank * SPLAT);
    let given = degrees[i];
    let visible = base.strength > 0.0f32 && given >= 1.0f32;
    let degrees = select(visible, given, 1.0f32);
    // ν ((255 |o|)^(2 / (ν + 2)) − 1)
    let fall = f32::ln(max(base.strength * INVERSE_CUTOFF, 1.0f32));
    let squared = degrees * (f32::exp(2.0f32 / (degrees + 2.0f32) * fall) - 1.0f32);
    // the covariance, from the root of its inverse
    let variance_y = 1.0f32 / (base.r * base.r);
    let covariance = -base.q * variance_y / base.p;
    let variance_x = (1.0f32 + base.q * base.q * variance_y) / (base.p * base.p);
    let half_difference = 0.5f32 * (variance_x - variance_y);
    let spread = max(half_difference * half_difference + covariance * covariance, LEAST_SPREAD);
    let largest = 0.5f32 * (variance_x + variance_y) + f32::sqrt(spread);
    let bound = f32::ceil(reach_of(degrees) * f32::sqrt(largest));
    let reach = squared * 1.001f32 + 0.01f32;
    let slack = 0.01f32;
    let half_x = min(f32::sqrt(reach * variance_x), bound) + slack;
    let half_y = min(f32::sqrt(reach * variance_y), bound) + slack;
    let (x, y) = (base.mean_x, base.mean_y);
    pixels_within(view, visible, x - half_x, x + half_x, y - half_y, y + half_y).store(rects, rank);
    let splat = Splat {
        mean_x: base.mean_x,
        mean_y: base.mean_y,
        p: base.p,
        q: base.q,
        r: base.r,
        strength: select(visible, opacities[i], 0.0f32),
        depth: base.depth,
        squared_radius: squared,
    };
    Splat::store(splat, splats, rank * SPLAT);
    Tail::store(Tail { degrees, bound }, tails, rank * stride + place);
}

/// Splats [M, [`SPLAT`]] and pixel rectangles [M, [`RECT`]] of Student's t kernels with `opacities` `[M]` and `degrees` of
/// freedom `[M]`, from the splats `ellipses` of Gaussians with the opacities |o|. The [`Tail`] of each is written from number
/// `place` of a row of `tails` [M, stride] on. Row i is that of Gaussian `order[i]`.
pub fn students(
    [opacities, degrees, order]: [&CubeTensor; 3],
    ellipses: &CubeTensor,
    tails: &CubeTensor,
    place: usize,
    camera: &Camera,
) -> (CubeTensor, CubeTensor) {
    let (count, stride) = (order.shape()[0], tails.shape()[1]);
    let (splats, rects) = (empty_f32(ellipses, [count, SPLAT]), empty_u32(ellipses, [count, RECT]));
    students_kernel::launch(
        &ellipses.client.clone(),
        units(count),
        cube_dim(),
        buffer(opacities),
        buffer(degrees),
        buffer(order),
        buffer(ellipses),
        buffer(&splats),
        buffer(&rects),
        buffer(tails),
        CameraUniforms::launch(camera),
        count as u32,
        stride,
        place,
    );
    (splats, rects)
}

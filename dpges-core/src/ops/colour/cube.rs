//! GPU kernels: one unit per primitive.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::autodiff::ColourState;
use super::{ColourOps, DetailPart, LARGEST_BETA, SHARPNESS};
use crate::backend::tape::BackwardState;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, units};
use crate::gpu::vector::{Vec3, dot, row3, scale, sin_cos, vec3, write3};
use crate::scene::{ColourModel, SH_C0};

const SHARPNESS_F32: f32 = SHARPNESS as f32;
const LARGEST_BETA_F32: f32 = LARGEST_BETA as f32;
const C0: f32 = SH_C0 as f32;

#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Eye {
    x: f32,
    y: f32,
    z: f32,
    pub count: u32,
}

/// Unit vector from the camera to a primitive; zero at the camera itself.
#[cube]
pub fn direction(position: Vec3, eye: Eye) -> Vec3 {
    let offset = vec3(position.x - eye.x, position.y - eye.y, position.z - eye.z);
    scale(offset, 1.0f32 / max(f32::sqrt(dot(offset, offset)), 1e-12f32))
}

/// Stable softplus and its derivative.
#[cube]
fn softplus(raw: f32) -> (f32, f32) {
    let x = SHARPNESS_F32 * raw;
    let decay = f32::exp(-f32::abs(x));
    // ln(1 + d) without losing a small d
    let series = decay * (1.0f32 - decay * (0.5f32 - decay * 0.333_333_34f32));
    let log = select(decay < 1e-2f32, series, f32::ln(1.0f32 + decay));
    let sigmoid = select(x >= 0.0f32, 1.0f32, decay) / (1.0f32 + decay);
    ((max(x, 0.0f32) + log) / SHARPNESS_F32, sigmoid)
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Lobe {
    rgb: Vec3,
    /// Derivatives of the colour with respect to its raw values.
    slope: Vec3,
    /// max(0, d·μ)^exponent; exactly 0 on the unlit side.
    lit: f32,
    exponent: f32,
    cosine: f32,
    cosine_theta: f32,
    cosine_phi: f32,
}

/// The lobe whose six numbers start at `o`, seen in direction `d`.
#[cube]
fn lobe(detail: &[f32], o: usize, d: Vec3) -> Lobe {
    let (red, red_slope) = softplus(detail[o]);
    let (green, green_slope) = softplus(detail[o + 1]);
    let (blue, blue_slope) = softplus(detail[o + 2]);
    // WGSL promises 2⁻¹¹ of its own sine, and that only up to π
    let (sin_theta, cos_theta) = sin_cos(detail[o + 3]);
    let (sin_phi, cos_phi) = sin_cos(detail[o + 4]);
    let across = d.x * cos_phi + d.y * sin_phi;
    let cosine = sin_theta * across + cos_theta * d.z;
    let exponent = 4.0f32 * f32::exp(min(detail[o + 5], LARGEST_BETA_F32));
    // computed on the unlit side, too, where it must be a number
    let logarithm = f32::ln(max(cosine, 1e-30f32));
    let power = f32::exp(max(exponent * logarithm, -100.0f32));
    Lobe {
        rgb: vec3(red, green, blue),
        slope: vec3(red_slope, green_slope, blue_slope),
        // exactly 0 where it is too dark to be seen, so that forward and backward agree about that
        lit: select(cosine > 0.0f32 && exponent * logarithm > -100.0f32, power, 0.0f32),
        exponent,
        cosine,
        cosine_theta: cos_theta * across - sin_theta * d.z,
        cosine_phi: sin_theta * (d.y * cos_phi - d.x * sin_phi),
    }
}

/// Value of the spherical harmonic Y`index` (0 to 15) in direction `d` (3DGS).
#[cube]
pub fn harmonic(d: Vec3, #[comptime] index: usize) -> f32 {
    let (x, y, z) = (d.x, d.y, d.z);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    match index {
        0 => C0.runtime(),
        1 => -0.488_602_52f32 * y,
        2 => 0.488_602_52f32 * z,
        3 => -0.488_602_52f32 * x,
        4 => 1.092_548_5f32 * x * y,
        5 => -1.092_548_5f32 * y * z,
        6 => 0.315_391_57f32 * (2.0f32 * zz - xx - yy),
        7 => -1.092_548_5f32 * x * z,
        8 => 0.546_274_2f32 * (xx - yy),
        9 => -0.590_043_6f32 * y * (3.0f32 * xx - yy),
        10 => 2.890_611_4f32 * x * y * z,
        11 => -0.457_045_8f32 * y * (4.0f32 * zz - xx - yy),
        12 => 0.373_176_34f32 * z * (2.0f32 * zz - 3.0f32 * xx - 3.0f32 * yy),
        13 => -0.457_045_8f32 * x * (4.0f32 * zz - xx - yy),
        14 => 1.445_305_7f32 * z * (xx - yy),
        _ => -0.590_043_6f32 * x * (xx - 3.0f32 * yy),
    }
}

/// Lobes and higher harmonics of a part; one of the two is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct PartShape {
    lobes: usize,
    coefficients: usize,
    /// Lobes or harmonics of the parts before.
    before: usize,
}

impl PartShape {
    fn of(part: DetailPart) -> Self {
        let [own, before] = [part.width, part.before].map(|columns| columns / part.model.detail_unit());
        match part.model {
            ColourModel::SphericalBeta { .. } => Self { lobes: own, coefficients: 0, before },
            ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
                Self { lobes: 0, coefficients: own, before }
            }
        }
    }
}

#[cube(launch)]
fn colour_kernel(
    base: &[f32],
    detail: &[f32],
    positions: &[f32],
    out: &mut [f32],
    eye: Eye,
    #[comptime] shape: PartShape,
) {
    let i = ABSOLUTE_POS;
    if i >= eye.count as usize {
        terminate!();
    }
    let d = direction(row3(positions, i), eye);
    let constant = row3(base, i);
    let mut red = constant.x;
    let mut green = constant.y;
    let mut blue = constant.z;
    // details that exceed a buffer come in parts: only the first adds the base colour
    if comptime!(shape.before == 0) {
        red = 0.5f32 + C0 * constant.x;
        green = 0.5f32 + C0 * constant.y;
        blue = 0.5f32 + C0 * constant.z;
    }
    #[unroll]
    for l in 0..shape.lobes {
        let lobe = lobe(detail, (i * shape.lobes + l) * 6, d);
        red += lobe.rgb.x * lobe.lit;
        green += lobe.rgb.y * lobe.lit;
        blue += lobe.rgb.z * lobe.lit;
    }
    #[unroll]
    for c in 0..shape.coefficients {
        let value = harmonic(d, comptime!(shape.before + c + 1));
        let row = row3(detail, i * shape.coefficients + c);
        red += value * row.x;
        green += value * row.y;
        blue += value * row.z;
    }
    write3(out, i, vec3(red, green, blue));
}

#[cube(launch)]
fn colour_backward_kernel(
    detail: &[f32],
    positions: &[f32],
    grad: &[f32],
    grad_base: &mut [f32],
    grad_detail: &mut [f32],
    eye: Eye,
    #[comptime] shape: PartShape,
) {
    let i = ABSOLUTE_POS;
    if i >= eye.count as usize {
        terminate!();
    }
    let incoming = row3(grad, i);
    if comptime!(shape.before == 0) {
        write3(grad_base, i, scale(incoming, C0));
    } else {
        write3(grad_base, i, incoming);
    }
    let d = direction(row3(positions, i), eye);
    #[unroll]
    for l in 0..shape.lobes {
        let o = (i * shape.lobes + l) * 6;
        let lobe = lobe(detail, o, d);
        let brightness = dot(incoming, lobe.rgb);
        let lit = lobe.lit > 0.0f32;
        // a divisor, and the argument of a logarithm, on the unlit side, too
        let cosine = select(lit, lobe.cosine, 1.0f32);
        let powered = brightness * lobe.exponent * lobe.lit;
        grad_detail[o] = incoming.x * lobe.lit * lobe.slope.x;
        grad_detail[o + 1] = incoming.y * lobe.lit * lobe.slope.y;
        grad_detail[o + 2] = incoming.z * lobe.lit * lobe.slope.z;
        grad_detail[o + 3] = powered / cosine * lobe.cosine_theta;
        grad_detail[o + 4] = powered / cosine * lobe.cosine_phi;
        grad_detail[o + 5] = select(detail[o + 5] > LARGEST_BETA_F32, 0.0f32, powered * f32::ln(cosine));
    }
    #[unroll]
    for c in 0..shape.coefficients {
        let value = harmonic(d, comptime!(shape.before + c + 1));
        write3(grad_detail, i * shape.coefficients + c, scale(incoming, value));
    }
}

/// A camera at `centre`, world units, and the number of primitives that it sees.
pub fn eye(centre: [f64; 3], count: usize) -> EyeLaunch {
    let [x, y, z] = centre.map(|v| v as f32);
    EyeLaunch::new(x, y, z, count as u32)
}

impl ColourOps for CubeBackend {
    fn colour(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
        part: DetailPart,
    ) -> FloatTensor<Self> {
        let (base, detail, positions) = (floats(base), floats(detail), floats(positions));
        let count = base.shape()[0];
        let out = empty_f32(&base, [count, 3]);
        colour_kernel::launch(
            &base.client.clone(),
            units(count),
            cube_dim(),
            buffer(&base),
            buffer(&detail),
            buffer(&positions),
            buffer(&out),
            eye(centre, count),
            PartShape::of(part),
        );
        out
    }
}

impl BackwardState<CubeBackend, 2> for ColourState<CubeBackend> {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 2] {
        let [detail, positions, grad] = [self.detail, self.positions, grad].map(floats);
        let count = grad.shape()[0];
        let (base, out) = (empty_f32(&grad, [count, 3]), empty_f32(&grad, [count, self.part.width]));
        colour_backward_kernel::launch(
            &grad.client.clone(),
            units(count),
            cube_dim(),
            buffer(&detail),
            buffer(&positions),
            buffer(&grad),
            buffer(&base),
            buffer(&out),
            eye(self.centre, count),
            PartShape::of(self.part),
        );
        [Some(base), Some(out)]
    }
}

//! Three-vectors, rotations and elementary functions on the device; the CPU's are in [`crate::math`].

use cubecl::prelude::*;
use glam::{DMat3, DVec3};

use super::record::{Record, record};

record! {
    #[derive(CubeLaunch)]
    pub struct Vec3 {
        pub x: f32,
        pub y: f32,
        pub z: f32,
    }
}

impl Vec3Launch {
    pub fn of(v: DVec3) -> Self {
        Self::new(v.x as f32, v.y as f32, v.z as f32)
    }
}

/// A 3 × 3 matrix by rows.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Mat3 {
    pub row0: Vec3,
    pub row1: Vec3,
    pub row2: Vec3,
}

impl Mat3Launch {
    pub fn of(m: DMat3) -> Self {
        Self::new(Vec3Launch::of(m.row(0)), Vec3Launch::of(m.row(1)), Vec3Launch::of(m.row(2)))
    }
}

record! {
    pub struct Quaternion {
        pub w: f32,
        pub x: f32,
        pub y: f32,
        pub z: f32,
    }
}

#[cube]
pub fn vec3(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3 { x, y, z }
}

/// Reads row `i` of a [N, 3] buffer.
#[cube]
pub fn row3(values: &[f32], i: usize) -> Vec3 {
    Vec3::load(values, i * Vec3::LEN)
}

/// Adds to row `i` of a [N, 3] buffer.
#[cube]
pub fn add3(out: &mut [f32], i: usize, v: Vec3) {
    out[3 * i] += v.x;
    out[3 * i + 1] += v.y;
    out[3 * i + 2] += v.z;
}

/// Reads row `i` of a [N, 4] buffer.
#[cube]
pub fn row4(values: &[f32], i: usize) -> Quaternion {
    Quaternion::load(values, i * Quaternion::LEN)
}

/// Writes row `i` of a [N, 3] buffer.
#[cube]
pub fn write3(out: &mut [f32], i: usize, v: Vec3) {
    Vec3::store(v, out, i * Vec3::LEN);
}

/// −1, 0 or 1.
#[cube]
pub fn sign(value: f32) -> f32 {
    select(value > 0.0f32, 1.0f32, select(value < 0.0f32, -1.0f32, 0.0f32))
}

#[cube]
pub fn dot(a: Vec3, b: Vec3) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

#[cube]
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

#[cube]
pub fn add(a: Vec3, b: Vec3) -> Vec3 {
    vec3(a.x + b.x, a.y + b.y, a.z + b.z)
}

#[cube]
pub fn scale(a: Vec3, s: f32) -> Vec3 {
    vec3(a.x * s, a.y * s, a.z * s)
}

/// Element by element.
#[cube]
pub fn times(a: Vec3, b: Vec3) -> Vec3 {
    vec3(a.x * b.x, a.y * b.y, a.z * b.z)
}

/// m · v
#[cube]
pub fn apply(m: Mat3, v: Vec3) -> Vec3 {
    vec3(dot(m.row0, v), dot(m.row1, v), dot(m.row2, v))
}

#[cube]
pub fn transpose(m: Mat3) -> Mat3 {
    Mat3 {
        row0: vec3(m.row0.x, m.row1.x, m.row2.x),
        row1: vec3(m.row0.y, m.row1.y, m.row2.y),
        row2: vec3(m.row0.z, m.row1.z, m.row2.z),
    }
}

/// A power of two near the largest component, at least 2⁻¹²⁶, and its reciprocal.
#[cube]
fn magnitude(q: Quaternion) -> (f32, f32) {
    let largest = max(max(f32::abs(q.w), f32::abs(q.x)), max(f32::abs(q.y), f32::abs(q.z)));
    // squares of components beyond 10¹⁹ overflow and below 10⁻¹⁹ vanish: all are divided by a power of two first;
    // from 2⁻¹²⁶ to 2¹²⁶ it and its reciprocal are normal numbers, where devices may take subnormal ones for 0
    let exponent = clamp(u32::reinterpret(largest) & 0x7f80_0000u32, 0x0080_0000u32, 0x7e80_0000u32);
    (f32::reinterpret(exponent), f32::reinterpret(0x7f00_0000u32 - exponent))
}

/// Unit quaternion and reciprocal length; the identity and 0 for a zero quaternion.
#[cube]
pub fn unit(q: Quaternion) -> (Quaternion, f32) {
    let (power, inverse_power) = magnitude(q);
    let (w, x) = (q.w * inverse_power, q.x * inverse_power);
    let (y, z) = (q.y * inverse_power, q.z * inverse_power);
    let squared = w * w + x * x + y * y + z * z;
    // a length of 1e-12 or less counts as zero
    let is_zero = f32::sqrt(squared) * power <= 1e-12f32;
    let inverse = select(is_zero, 0.0f32, 1.0f32 / f32::sqrt(max(squared, 1e-30f32)));
    let normalised =
        Quaternion { w: select(is_zero, 1.0f32, w * inverse), x: x * inverse, y: y * inverse, z: z * inverse };
    (normalised, inverse * inverse_power)
}

/// The quaternion scaled exactly, by a power of two, so that its largest component lies in [1, 2). The
/// identity for a zero quaternion.
#[cube]
pub fn near_unit(q: Quaternion) -> Quaternion {
    let (power, inverse_power) = magnitude(q);
    let (w, x) = (q.w * inverse_power, q.x * inverse_power);
    let (y, z) = (q.y * inverse_power, q.z * inverse_power);
    let is_zero = f32::sqrt(w * w + x * x + y * y + z * z) * power <= 1e-12f32;
    Quaternion {
        w: select(is_zero, 1.0f32, w),
        x: select(is_zero, 0.0f32, x),
        y: select(is_zero, 0.0f32, y),
        z: select(is_zero, 0.0f32, z),
    }
}

#[cube]
pub fn rotation(q: Quaternion) -> Mat3 {
    let (q, _inverse_length) = unit(q);
    Mat3 {
        row0: vec3(
            1.0f32 - 2.0f32 * (q.y * q.y + q.z * q.z),
            2.0f32 * (q.x * q.y - q.w * q.z),
            2.0f32 * (q.x * q.z + q.w * q.y),
        ),
        row1: vec3(
            2.0f32 * (q.x * q.y + q.w * q.z),
            1.0f32 - 2.0f32 * (q.x * q.x + q.z * q.z),
            2.0f32 * (q.y * q.z - q.w * q.x),
        ),
        row2: vec3(
            2.0f32 * (q.x * q.z - q.w * q.y),
            2.0f32 * (q.y * q.z + q.w * q.x),
            1.0f32 - 2.0f32 * (q.x * q.x + q.y * q.y),
        ),
    }
}

/// [`crate::math::rotation_backward`]
#[cube]
pub fn rotation_backward(raw: Quaternion, d: Mat3) -> Quaternion {
    let (q, inverse_length) = unit(raw);
    let skew_x = d.row2.y - d.row1.z;
    let skew_y = d.row0.z - d.row2.x;
    let skew_z = d.row1.x - d.row0.y;
    let both_xy = d.row1.x + d.row0.y;
    let both_xz = d.row0.z + d.row2.x;
    let both_yz = d.row2.y + d.row1.z;
    let w = 2.0f32 * (q.x * skew_x + q.y * skew_y + q.z * skew_z);
    let x = 2.0f32 * (q.w * skew_x - 2.0f32 * q.x * (d.row1.y + d.row2.z) + q.y * both_xy + q.z * both_xz);
    let y = 2.0f32 * (q.w * skew_y + q.x * both_xy - 2.0f32 * q.y * (d.row0.x + d.row2.z) + q.z * both_yz);
    let z = 2.0f32 * (q.w * skew_z + q.x * both_xz + q.y * both_yz - 2.0f32 * q.z * (d.row0.x + d.row1.y));
    // a longer quaternion turns as far, so that the gradient is at right angles to it
    let along = w * q.w + x * q.x + y * q.y + z * q.z;
    Quaternion {
        w: (w - q.w * along) * inverse_length,
        x: (x - q.x * along) * inverse_length,
        y: (y - q.y * along) * inverse_length,
        z: (z - q.z * along) * inverse_length,
    }
}

/// [`crate::math::turn_backward`]
#[cube]
pub fn turn_backward(raw: Quaternion, turn: Vec3) -> Quaternion {
    let (q, inverse_length) = unit(raw);
    // a turn by ω moves the unit quaternion by ½ q ω, in three directions at right angles to it and to each other
    let along = vec3(
        q.w * turn.x + q.y * turn.z - q.z * turn.y,
        q.w * turn.y + q.z * turn.x - q.x * turn.z,
        q.w * turn.z + q.x * turn.y - q.y * turn.x,
    );
    Quaternion {
        w: 2.0f32 * (-q.x * turn.x - q.y * turn.y - q.z * turn.z) * inverse_length,
        x: 2.0f32 * along.x * inverse_length,
        y: 2.0f32 * along.y * inverse_length,
        z: 2.0f32 * along.z * inverse_length,
    }
}

/// Writes row `i` of a [N, 4] buffer.
#[cube]
pub fn write4(out: &mut [f32], i: usize, q: Quaternion) {
    Quaternion::store(q, out, i * Quaternion::LEN);
}

/// 2 / π
const PER_QUARTER: f32 = std::f32::consts::FRAC_2_PI;

/// Sine and cosine to f32 accuracy, which WGSL does not guarantee. Reduces by π/2 in three parts and
/// evaluates polynomials on [−π/4, π/4] (Cephes).
#[cube]
pub fn sin_cos(angle: f32) -> (f32, f32) {
    let quarter = f32::round(angle * PER_QUARTER);
    // products with the first part are exact, so that nothing is lost where the difference cancels
    let reduced = ((angle - quarter * 1.570_312_5f32) - quarter * 4.837_513e-4f32) - quarter * 7.549_79e-8f32;
    let s2 = reduced * reduced;
    let sine = reduced + reduced * s2 * (-0.166_666_55f32 + s2 * (8.332_161e-3f32 + s2 * -1.951_529_6e-4f32));
    let cosine =
        1.0f32 - 0.5f32 * s2 + s2 * s2 * (4.166_664_6e-2f32 + s2 * (-1.388_731_6e-3f32 + s2 * 2.443_315_7e-5f32));
    let turn = i32::cast_from(quarter) & 3i32;
    let swapped = (turn & 1i32) == 1i32;
    let first = select(swapped, cosine, sine);
    let second = select(swapped, sine, cosine);
    let sine_negative = turn >= 2i32;
    let cosine_negative = turn == 1i32 || turn == 2i32;
    (select(sine_negative, -first, first), select(cosine_negative, -second, second))
}

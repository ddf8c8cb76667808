//! 2 × 2 matrices on the device.

use cubecl::prelude::*;

/// A 2 × 2 matrix.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Mat2 {
    pub xx: f32,
    pub xy: f32,
    pub yx: f32,
    pub yy: f32,
}

#[cube]
pub fn product(a: Mat2, b: Mat2) -> Mat2 {
    Mat2 {
        xx: a.xx * b.xx + a.xy * b.yx,
        xy: a.xx * b.xy + a.xy * b.yy,
        yx: a.yx * b.xx + a.yy * b.yx,
        yy: a.yx * b.xy + a.yy * b.yy,
    }
}

#[cube]
pub fn sum(a: Mat2, b: Mat2) -> Mat2 {
    Mat2 { xx: a.xx + b.xx, xy: a.xy + b.xy, yx: a.yx + b.yx, yy: a.yy + b.yy }
}

#[cube]
pub fn transposed(a: Mat2) -> Mat2 {
    Mat2 { xx: a.xx, xy: a.yx, yx: a.xy, yy: a.yy }
}

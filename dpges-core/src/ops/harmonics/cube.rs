//! GPU kernels: one unit per primitive.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::HarmonicsOps;
use super::autodiff::HarmonicsState;
use crate::backend::tape::BackwardState;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, units};
use crate::gpu::vector::row3;
use crate::ops::colour::cube::{Eye, direction, eye, harmonic};

#[cube(launch)]
fn harmonics_kernel(
    base: &[f32],
    detail: &[f32],
    positions: &[f32],
    out: &mut [f32],
    eye: Eye,
    #[comptime] higher: usize,
) {
    let i = ABSOLUTE_POS;
    if i >= eye.count as usize {
        terminate!();
    }
    let d = direction(row3(positions, i), eye);
    let mut value = base[i] * harmonic(d, 0usize);
    // unrolled, since `harmonic` takes an index that the compiler knows
    #[unroll]
    for c in 0..higher {
        value += detail[i * higher + c] * harmonic(d, comptime!(c + 1));
    }
    out[i] = value;
}

#[cube(launch)]
fn harmonics_backward_kernel(
    positions: &[f32],
    grad: &[f32],
    grad_base: &mut [f32],
    grad_detail: &mut [f32],
    eye: Eye,
    #[comptime] higher: usize,
) {
    let i = ABSOLUTE_POS;
    if i >= eye.count as usize {
        terminate!();
    }
    let incoming = grad[i];
    let d = direction(row3(positions, i), eye);
    // no gradient to positions: directions carry none
    grad_base[i] = incoming * harmonic(d, 0usize);
    #[unroll]
    for c in 0..higher {
        grad_detail[i * higher + c] = incoming * harmonic(d, comptime!(c + 1));
    }
}

impl HarmonicsOps for CubeBackend {
    fn harmonics(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
    ) -> FloatTensor<Self> {
        let (base, detail, positions) = (floats(base), floats(detail), floats(positions));
        let [count, higher] = [detail.shape()[0], detail.shape()[1]];
        let out = empty_f32(&base, [count, 1]);
        harmonics_kernel::launch(
            &base.client.clone(),
            units(count),
            cube_dim(),
            buffer(&base),
            buffer(&detail),
            buffer(&positions),
            buffer(&out),
            eye(centre, count),
            higher,
        );
        out
    }
}

impl BackwardState<CubeBackend, 2> for HarmonicsState<CubeBackend> {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 2] {
        let [positions, grad] = [self.positions, grad].map(floats);
        let count = grad.shape()[0];
        let (base, detail) = (empty_f32(&grad, [count, 1]), empty_f32(&grad, [count, self.higher]));
        harmonics_backward_kernel::launch(
            &grad.client.clone(),
            units(count),
            cube_dim(),
            buffer(&positions),
            buffer(&grad),
            buffer(&base),
            buffer(&detail),
            eye(self.centre, count),
            self.higher,
        );
        [Some(base), Some(detail)]
    }
}

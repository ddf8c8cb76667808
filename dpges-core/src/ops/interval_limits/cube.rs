//! GPU kernel: one unit per pixel.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::LimitOps;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, integers, units};
use crate::ops::peel::PeelOutput;
use crate::scene::MarginLookup;

#[cube(launch)]
fn limits_kernel(
    ids: &[i32],
    alpha: &[f32],
    depth: &[f32],
    margins: &[f32],
    limits: &mut [f32],
    pixels: u32,
    infinity: f32,
    #[comptime] layers: usize,
    #[comptime] literal: bool,
) {
    let pixel = ABSOLUTE_POS;
    if pixel >= pixels as usize {
        terminate!();
    }
    let mut ends = Array::<f32>::new(layers);
    let mut closed = false;
    let mut last = infinity;
    let mut present = 0u32;
    #[unroll]
    for k in 0..layers {
        let at = k * pixels as usize + pixel;
        ends[k] = infinity;
        if ids[at] >= 0i32 {
            last = depth[at] + margins[ids[at] as usize];
            ends[k] = last;
            if comptime!(literal) {
                ends[k] = depth[at];
            }
            closed = closed || alpha[at] >= 1.0f32;
            present += 1u32;
        }
    }
    let cap = select(closed || present == layers as u32, last, infinity);
    if comptime!(literal) {
        // only the cap ends the last interval
        ends[layers - 1] = infinity;
    }
    let mut reached = -infinity;
    #[unroll]
    for k in 0..layers {
        reached = max(reached, ends[k]);
        limits[k * pixels as usize + pixel] = min(reached, cap);
    }
}

impl LimitOps for CubeBackend {
    fn interval_limits(
        layers: PeelOutput<Self>,
        margins: FloatTensor<Self>,
        lookup: MarginLookup,
    ) -> FloatTensor<Self> {
        let (ids, alpha, depth, margins) =
            (integers(layers.ids), floats(layers.alpha), floats(layers.depth), floats(margins));
        let shape: [usize; 3] = depth.shape().dims();
        let pixels = shape[1] * shape[2];
        let limits = empty_f32(&depth, shape);
        limits_kernel::launch(
            &depth.client.clone(),
            units(pixels),
            cube_dim(),
            buffer(&ids),
            buffer(&alpha),
            buffer(&depth),
            buffer(&margins),
            buffer(&limits),
            pixels as u32,
            f32::INFINITY,
            shape[0],
            lookup == MarginLookup::Literal,
        );
        limits
    }
}

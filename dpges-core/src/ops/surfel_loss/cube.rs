//! GPU kernels: cubes leave sums over their pixels, and one cube adds these up; backward one unit per pixel.

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::autodiff::SurfelLossState;
use super::{FEWEST_LAYERS, SurfelLossInput, SurfelLossOps, SurfelLossOutput, SurfelLossWeights};
use crate::backend::tape::BackwardState;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty_f32, floats, integers, units};
use crate::gpu::mask::counts;
use crate::gpu::reduce::{parts, sum_parts, sum_units};
use crate::gpu::vector::sign;

/// Sums of a cube: absolute differences and squares of opacities.
const SUMS: usize = 2;

#[cube(launch)]
fn sums_kernel(
    image: &[f32],
    transmittance: &[f32],
    ids: &[i32],
    target: &[f32],
    ignored: &[f32],
    sums: &mut [f32],
    pixels: u32,
    parts: u32,
    #[comptime] layers: usize,
    #[comptime] masked: bool,
) {
    if CUBE_POS >= parts as usize {
        terminate!();
    }
    let plane = pixels as usize;
    let mut own = zeros(SUMS);
    let mut at = CUBE_POS as u32 * UNITS + UNIT_POS;
    while at < pixels {
        let pixel = at as usize;
        // masked or not is known when the kernel is compiled: without a mask nothing is read
        if counts(ignored, pixel, masked) {
            #[unroll]
            for channel in 0..3usize {
                own[0] += f32::abs(image[channel * plane + pixel] - target[channel * plane + pixel]);
            }
            if comptime!(layers >= FEWEST_LAYERS) {
                let covered = ids[plane + pixel] >= 0i32;
                if covered {
                    let opaque = 1.0f32 - transmittance[layers * plane + pixel];
                    own[1] += opaque * opaque;
                }
            }
        }
        at += parts * UNITS;
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(SUMS * UNITS as usize));
    sum_units(&own, &mut memory, SUMS);
    if UNIT_POS == 0u32 {
        #[unroll]
        for sum in 0..SUMS {
            sums[CUBE_POS * SUMS + sum] = memory[sum];
        }
    }
}

/// Shares of a pixel in the two terms, and the weights of these in their sum.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Shares {
    image: f32,
    transmittance: f32,
    image_weight: f32,
    transmittance_weight: f32,
}

#[cube(launch)]
fn terms_kernel(
    sums: &[f32],
    weighted: &mut [f32],
    image: &mut [f32],
    transmittance: &mut [f32],
    shares: Shares,
    parts: u32,
) {
    if CUBE_POS > 0usize {
        terminate!();
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(SUMS * UNITS as usize));
    // one cube, always in the same order: the same bits in every run
    sum_parts(sums, parts, &mut memory, SUMS);
    if UNIT_POS == 0u32 {
        let (of_image, of_transmittance) = (shares.image * memory[0], shares.transmittance * memory[1]);
        let mut total = 0.0f32;
        // 0 times what is not finite is NaN
        if shares.image_weight != 0.0f32 {
            total += shares.image_weight * of_image;
        }
        if shares.transmittance_weight != 0.0f32 {
            total += shares.transmittance_weight * of_transmittance;
        }
        weighted[0] = total;
        image[0] = of_image;
        transmittance[0] = of_transmittance;
    }
}

#[cube(launch)]
fn image_backward_kernel(
    image: &[f32],
    target: &[f32],
    ignored: &[f32],
    grad: &[f32],
    grad_image: &mut [f32],
    pixels: u32,
    share: f32,
    #[comptime] masked: bool,
) {
    let pixel = ABSOLUTE_POS;
    let plane = pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    let step = select(counts(ignored, pixel, masked), grad[0] * share, 0.0f32);
    #[unroll]
    for channel in 0..3usize {
        let at = channel * plane + pixel;
        grad_image[at] = step * sign(image[at] - target[at]);
    }
}

#[cube(launch)]
fn transmittance_backward_kernel(
    transmittance: &[f32],
    ids: &[i32],
    ignored: &[f32],
    grad: &[f32],
    grad_transmittance: &mut [f32],
    pixels: u32,
    share: f32,
    #[comptime] layers: usize,
    #[comptime] masked: bool,
) {
    let pixel = ABSOLUTE_POS;
    let plane = pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    #[unroll]
    for k in 0..layers {
        // only the last plane has a gradient, and a new buffer has any contents
        grad_transmittance[k * plane + pixel] = 0.0f32;
    }
    let last = layers * plane + pixel;
    let mut gradient = 0.0f32;
    if comptime!(layers >= FEWEST_LAYERS) {
        let covered = ids[plane + pixel] >= 0i32 && counts(ignored, pixel, masked);
        if covered {
            gradient = -2.0f32 * share * grad[0] * (1.0f32 - transmittance[last]);
        }
    }
    grad_transmittance[last] = gradient;
}

fn contiguous(input: SurfelLossInput<CubeBackend>) -> SurfelLossInput<CubeBackend> {
    SurfelLossInput {
        image: floats(input.image),
        transmittance: floats(input.transmittance),
        ids: integers(input.ids),
        target: floats(input.target),
        ignored: floats(input.ignored),
    }
}

impl SurfelLossOps for CubeBackend {
    fn surfel_loss(input: SurfelLossInput<Self>, weights: SurfelLossWeights, masked: bool) -> SurfelLossOutput<Self> {
        let input = contiguous(input);
        let [layers, height, width] = input.ids.shape().dims();
        let (like, client, pixels) = (&input.image, input.image.client.clone(), height * width);
        // at most as many as a cube has units, whatever the size of the picture
        let parts = parts(pixels);
        let sums = empty_f32(like, [parts, SUMS]);
        sums_kernel::launch(
            &client,
            cubes(parts),
            cube_dim(),
            buffer(&input.image),
            buffer(&input.transmittance),
            buffer(&input.ids),
            buffer(&input.target),
            buffer(&input.ignored),
            buffer(&sums),
            pixels as u32,
            parts as u32,
            layers,
            masked,
        );
        let [weighted, image, transmittance] = [(); 3].map(|()| empty_f32(like, [1]));
        let pixel = weights.pixels_per_counted / pixels as f64;
        terms_kernel::launch(
            &client,
            cubes(1),
            cube_dim(),
            buffer(&sums),
            buffer(&weighted),
            buffer(&image),
            buffer(&transmittance),
            SharesLaunch::new((pixel / 3.0) as f32, pixel as f32, weights.image as f32, weights.transmittance as f32),
            parts as u32,
        );
        SurfelLossOutput { weighted, image, transmittance }
    }
}

impl BackwardState<CubeBackend, 2> for SurfelLossState<CubeBackend> {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 2] {
        let Self { input, weights, masked } = self;
        let (input, grad) = (contiguous(input), floats(grad));
        let [layers, height, width] = input.ids.shape().dims();
        let (client, pixels) = (grad.client.clone(), height * width);
        let pixel = weights.pixels_per_counted / pixels as f64;
        // a term of weight 0 costs no launch and no tensor
        let image = (weights.image != 0.0).then(|| {
            let image = empty_f32(&grad, [3, height, width]);
            image_backward_kernel::launch(
                &client,
                units(pixels),
                cube_dim(),
                buffer(&input.image),
                buffer(&input.target),
                buffer(&input.ignored),
                buffer(&grad),
                buffer(&image),
                pixels as u32,
                (weights.image * pixel / 3.0) as f32,
                masked,
            );
            image
        });
        let transmittance = (weights.transmittance != 0.0).then(|| {
            let transmittance = empty_f32(&grad, [layers + 1, height, width]);
            transmittance_backward_kernel::launch(
                &client,
                units(pixels),
                cube_dim(),
                buffer(&input.transmittance),
                buffer(&input.ids),
                buffer(&input.ignored),
                buffer(&grad),
                buffer(&transmittance),
                pixels as u32,
                (weights.transmittance * pixel) as f32,
                layers,
                masked,
            );
            transmittance
        });
        [image, transmittance]
    }
}

//! GPU kernels: one unit per pixel. The gradient of the colours is gathered over the pixels in which each
//! surfel is a layer.

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::{CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, CompositeState, Grads, Reached};
use crate::backend::tape::BackwardOfAll;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, integers, units};
use crate::gpu::vector::{Vec3, add, dot, row3, scale, vec3};
use crate::gpu::work_split::{Piece, WORKERS, cube_has_pieces, store_gathered};
use crate::tiles::binning::boxes::visible_pieces;

#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Blend {
    red: f32,
    green: f32,
    blue: f32,
    pixels: u32,
    width: u32,
}

/// [3, H, W] at a pixel.
#[cube]
fn rgb(image: &[f32], pixel: usize, plane: usize) -> Vec3 {
    vec3(image[pixel], image[plane + pixel], image[2 * plane + pixel])
}

#[cube]
fn write_rgb(image: &mut [f32], pixel: usize, plane: usize, colour: Vec3) {
    image[pixel] = colour.x;
    image[plane + pixel] = colour.y;
    image[2 * plane + pixel] = colour.z;
}

/// Colour of the surfel `id`; black if it is −1.
#[cube]
fn layer_colour(colours: &[f32], id: i32) -> Vec3 {
    let present = id >= 0i32;
    let colour = row3(colours, max(id, 0i32) as usize);
    // selected and not multiplied by 0, because without surfels the buffer is uninitialised
    vec3(select(present, colour.x, 0.0f32), select(present, colour.y, 0.0f32), select(present, colour.z, 0.0f32))
}

#[cube(launch)]
fn surfels_kernel(
    weights: &[f32],
    transmittance: &[f32],
    colours: &[f32],
    ids: &[i32],
    surfel_image: &mut [f32],
    blend: Blend,
    #[comptime] layers: usize,
) {
    let pixel = ABSOLUTE_POS;
    let plane = blend.pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    let open = transmittance[layers * plane + pixel];
    let mut red = open * blend.red;
    let mut green = open * blend.green;
    let mut blue = open * blend.blue;
    #[unroll]
    for k in 0..layers {
        let at = k * plane + pixel;
        let (weight, colour) = (weights[at], layer_colour(colours, ids[at]));
        red += weight * colour.x;
        green += weight * colour.y;
        blue += weight * colour.z;
    }
    write_rgb(surfel_image, pixel, plane, vec3(red, green, blue));
}

#[cube(launch)]
fn gaussians_kernel(
    transmittance: &[f32],
    sums: &[f32],
    surfel_image: &[f32],
    gaussian_colour: &mut [f32],
    gaussian_weight: &mut [f32],
    image: &mut [f32],
    blend: Blend,
    #[comptime] layers: usize,
) {
    let pixel = ABSOLUTE_POS;
    let plane = blend.pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    let mut weight = 0.0f32;
    #[unroll]
    for k in 0..layers {
        let through = transmittance[k * plane + pixel];
        let at = 4 * k * plane + pixel;
        red += through * sums[at];
        green += through * sums[at + plane];
        blue += through * sums[at + 2 * plane];
        weight += through * sums[at + 3 * plane];
    }
    let own = vec3(red, green, blue);
    write_rgb(gaussian_colour, pixel, plane, own);
    gaussian_weight[pixel] = weight;
    write_rgb(image, pixel, plane, scale(add(rgb(surfel_image, pixel, plane), own), 1.0f32 / (1.0f32 + weight)));
}

/// Planes of the gradients with respect to the parts of a pixel: the surfels' colour, the Gaussians' and their weight.
const OF_GAUSSIANS: usize = 3;
const OF_WEIGHT: usize = 6;
const PARTS: usize = 7;

/// Gradients with respect to the parts of a pixel [[`PARTS`], H, W], from those of the outputs that have arrived.
#[cube(launch)]
fn parts_backward_kernel(
    grad_image: &[f32],
    grad_surfel_image: &[f32],
    grad_colour: &[f32],
    grad_weight: &[f32],
    image: &[f32],
    gaussian_weight: &[f32],
    grad_parts: &mut [f32],
    pixels: u32,
    #[comptime] reached: Reached,
) {
    let pixel = ABSOLUTE_POS;
    let plane = pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    // compiled for the outputs that a loss looks at: gradients of the others are empty buffers
    let mut inverse = 0.0f32;
    let mut weight = 0.0f32;
    if comptime!(reached.image) {
        inverse = 1.0f32 / (1.0f32 + gaussian_weight[pixel]);
    }
    #[unroll]
    for channel in 0..3usize {
        let at = channel * plane + pixel;
        let mut surfel = 0.0f32;
        let mut gaussian = 0.0f32;
        if comptime!(reached.image) {
            let shared = grad_image[at] * inverse;
            surfel += shared;
            gaussian += shared;
            // ∂C / ∂W = −C / (1 + W)
            weight -= shared * image[at];
        }
        if comptime!(reached.surfel_image) {
            surfel += grad_surfel_image[at];
        }
        if comptime!(reached.gaussian_colour) {
            gaussian += grad_colour[at];
        }
        grad_parts[at] = surfel;
        grad_parts[OF_GAUSSIANS * plane + at] = gaussian;
    }
    if comptime!(reached.gaussian_weight) {
        weight += grad_weight[pixel];
    }
    grad_parts[OF_WEIGHT * plane + pixel] = weight;
}

/// Gradients with respect to weights and transmittances, from those of the parts of a pixel.
#[cube(launch)]
fn layers_backward_kernel(
    colours: &[f32],
    ids: &[i32],
    sums: &[f32],
    grad_parts: &[f32],
    grad_weights: &mut [f32],
    grad_transmittance: &mut [f32],
    blend: Blend,
    #[comptime] layers: usize,
    #[comptime] gated: bool,
) {
    let pixel = ABSOLUTE_POS;
    let plane = blend.pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    let surfel = rgb(grad_parts, pixel, plane);
    let gaussian = rgb(grad_parts, OF_GAUSSIANS * plane + pixel, plane);
    let weight = grad_parts[OF_WEIGHT * plane + pixel];
    #[unroll]
    for k in 0..layers {
        let at = k * plane + pixel;
        grad_weights[at] = dot(surfel, layer_colour(colours, ids[at]));
        let mut of_gate = 0.0f32;
        // an ablation leaves this out: Gaussians then teach the surfels before them nothing
        if comptime!(gated) {
            let sum = 4 * k * plane + pixel;
            let payload = vec3(sums[sum], sums[sum + plane], sums[sum + 2 * plane]);
            of_gate = dot(gaussian, payload) + weight * sums[sum + 3 * plane];
        }
        grad_transmittance[at] = of_gate;
    }
    grad_transmittance[layers * plane + pixel] = dot(surfel, vec3(blend.red, blend.green, blend.blue));
}

/// Gradients with respect to the sums, from those of the parts of a pixel.
#[cube(launch)]
fn sums_backward_kernel(
    transmittance: &[f32],
    grad_parts: &[f32],
    grad_sums: &mut [f32],
    blend: Blend,
    #[comptime] layers: usize,
) {
    let pixel = ABSOLUTE_POS;
    let plane = blend.pixels as usize;
    if pixel >= plane {
        terminate!();
    }
    let gaussian = rgb(grad_parts, OF_GAUSSIANS * plane + pixel, plane);
    let weight = grad_parts[OF_WEIGHT * plane + pixel];
    #[unroll]
    for k in 0..layers {
        let through = transmittance[k * plane + pixel];
        let at = 4 * k * plane + pixel;
        grad_sums[at] = through * gaussian.x;
        grad_sums[at + plane] = through * gaussian.y;
        grad_sums[at + 2 * plane] = through * gaussian.z;
        grad_sums[at + 3 * plane] = through * weight;
    }
}

/// Gathers the gradients with respect to the surfels' colours over the pixels of each piece of their boxes.
#[cube(launch)]
fn colours_backward_kernel(
    weights: &[f32],
    ids: &[i32],
    pieces: &[u32],
    grad_parts: &[f32],
    gathered: &mut [f32],
    blend: Blend,
    most: u32,
    #[comptime] layers: usize,
) {
    if !cube_has_pieces(pieces, most) {
        terminate!();
    }
    let mut own = zeros(3usize);
    let piece = Piece::own(pieces);
    let mut p = piece.first();
    if p < piece.end {
        let surfel = piece.primitive as i32;
        let plane = blend.pixels as usize;
        let stride = piece.stride();
        let (first_column, first_row) = piece.pixel(p);
        let mut column = first_column;
        let mut row = first_row;
        while p < piece.end {
            let pixel = (row * blend.width + column) as usize;
            let mut share = 0.0f32;
            #[unroll]
            for k in 0..layers {
                let at = k * plane + pixel;
                // a surfel is one layer of a pixel at most: the sum finds it without a branch
                share += select(ids[at] == surfel, weights[at], 0.0f32);
            }
            // a rectangle around a surfel holds many pixels of others, for which nothing is loaded
            if share != 0.0f32 {
                let incoming = rgb(grad_parts, pixel, plane);
                own[0] += share * incoming.x;
                own[1] += share * incoming.y;
                own[2] += share * incoming.z;
            }
            let (next_column, next_row) = piece.next(stride, column, row);
            column = next_column;
            row = next_row;
            p += WORKERS;
        }
    }
    store_gathered(&own, gathered, most, 3usize, true);
}

fn contiguous(input: CompositeInput<CubeBackend>) -> CompositeInput<CubeBackend> {
    CompositeInput {
        weights: floats(input.weights),
        transmittance: floats(input.transmittance),
        colours: floats(input.colours),
        sums: floats(input.sums),
        ids: integers(input.ids),
    }
}

fn blend(shape: [usize; 3], options: &CompositeOptions) -> BlendLaunch {
    let [_, height, width] = shape;
    let [red, green, blue] = options.background.map(|c| c as f32);
    BlendLaunch::new(red, green, blue, (height * width) as u32, width as u32)
}

impl CompositeOps for CubeBackend {
    fn composite(input: CompositeInput<Self>, options: CompositeOptions) -> CompositeOutput<Self> {
        let input = contiguous(input);
        let shape: [usize; 3] = input.weights.shape().dims();
        let [layers, height, width] = shape;
        let (like, client) = (&input.weights, input.weights.client.clone());
        let image = |planes: usize| empty_f32(like, [planes, height, width]);
        let out = CompositeOutput {
            image: image(3),
            surfel_image: image(3),
            gaussian_colour: image(3),
            gaussian_weight: image(1),
        };
        // two launches, since one would bind ten buffers, and WebGPU has eight
        surfels_kernel::launch(
            &client,
            units(height * width),
            cube_dim(),
            buffer(&input.weights),
            buffer(&input.transmittance),
            buffer(&input.colours),
            buffer(&input.ids),
            buffer(&out.surfel_image),
            blend(shape, &options),
            layers,
        );
        gaussians_kernel::launch(
            &client,
            units(height * width),
            cube_dim(),
            buffer(&input.transmittance),
            buffer(&input.sums),
            buffer(&out.surfel_image),
            buffer(&out.gaussian_colour),
            buffer(&out.gaussian_weight),
            buffer(&out.image),
            blend(shape, &options),
            layers,
        );
        out
    }
}

impl BackwardOfAll<CubeBackend, 4, 4> for CompositeState<CubeBackend> {
    fn parents(&self) -> [&CubeTensor; 4] {
        let CompositeInput { weights, transmittance, colours, sums, .. } = &self.input;
        [weights, transmittance, colours, sums]
    }

    fn backward_from(self, grads: Grads<CubeBackend>) -> [Option<CubeTensor>; 4] {
        let Self { input, image, gaussian_weight, options } = self;
        let (input, image, gaussian_weight) = (contiguous(input), floats(image), floats(gaussian_weight));
        let shape: [usize; 3] = input.weights.shape().dims();
        let [layers, height, width] = shape;
        let (like, client, count) = (&input.weights, image.client.clone(), input.colours.shape()[0]);
        let reached = Reached::new::<CubeBackend>(&grads);
        let [of_image, of_surfel_image, of_colour, of_weight] =
            grads.map(|grad| grad.map_or_else(|| empty_f32(like, [0]), floats));
        // once for three kernels, each of which binds this in place of up to six buffers
        let parts = empty_f32(like, [PARTS, height, width]);
        parts_backward_kernel::launch(
            &client,
            units(height * width),
            cube_dim(),
            buffer(&of_image),
            buffer(&of_surfel_image),
            buffer(&of_colour),
            buffer(&of_weight),
            buffer(&image),
            buffer(&gaussian_weight),
            buffer(&parts),
            (height * width) as u32,
            reached,
        );
        let weights = empty_f32(like, shape);
        let transmittance = empty_f32(like, [layers + 1, height, width]);
        layers_backward_kernel::launch(
            &client,
            units(height * width),
            cube_dim(),
            buffer(&input.colours),
            buffer(&input.ids),
            buffer(&input.sums),
            buffer(&parts),
            buffer(&weights),
            buffer(&transmittance),
            blend(shape, &options),
            layers,
            reached.sums() && !options.detach_transmittance,
        );
        let sums = reached.sums().then(|| {
            let sums = empty_f32(like, [layers, 4, height, width]);
            sums_backward_kernel::launch(
                &client,
                units(height * width),
                cube_dim(),
                buffer(&input.transmittance),
                buffer(&parts),
                buffer(&sums),
                blend(shape, &options),
                layers,
            );
            sums
        });
        let colours = reached.surfels().then(|| {
            let pieces = visible_pieces(&input.ids, count);
            let gathered = empty_f32(like, [pieces.most, 3]);
            colours_backward_kernel::launch(
                &client,
                pieces.gatherers(),
                cube_dim(),
                buffer(&input.weights),
                buffer(&input.ids),
                buffer(&pieces.pieces),
                buffer(&parts),
                buffer(&gathered),
                blend(shape, &options),
                pieces.most as u32,
                layers,
            );
            pieces.collect(&gathered, 0, 3)
        });
        [Some(weights), Some(transmittance), colours, sums]
    }
}

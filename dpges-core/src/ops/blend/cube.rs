//! GPU kernels. Primitives are sorted by depth, so that ascending lists run front to back. Forward, one unit handles
//! one pixel; backward, one cube handles one tile and then several units one primitive.

mod fragments;
mod gather;
mod order;
mod parameters;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use self::fragments::{FEATURES, Fragments, Payload, fragment};
use self::gather::{Layout, gather};
use super::{BlendBackwardOps, BlendInput, BlendLists, BlendOps, BlendOptions, BlendOutput, Form, far};
use crate::binning::cube::TileList;
use crate::camera::Camera;
use crate::gpu::launch::{buffer, cube_dim, cubes, empty_f32, floats};
use crate::gpu::record::Record;
use crate::gpu::tile::{own_pixel, plane_of};
use crate::gpu::view::CameraUniforms;
use crate::tiles::TileGrid;

#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Thresholds {
    max_alpha: f32,
    min_transmittance: f32,
    /// d m / d(−1 / z) of the m of distortion, world units.
    slope: f32,
}

impl Thresholds {
    fn launch(camera: &Camera, options: &BlendOptions) -> ThresholdsLaunch {
        let (near, far) = (camera.near, far(camera.near));
        let slope = far * near / (far - near);
        ThresholdsLaunch::new(options.max_alpha as f32, options.min_transmittance as f32, slope as f32)
    }
}

#[cube(launch)]
fn blend_kernel(
    shapes: &[f32],
    features: &[f32],
    offsets: &[u32],
    ids: &[u32],
    planes: &mut [f32],
    median_depth: &mut [f32],
    view: CameraUniforms,
    thresholds: Thresholds,
    capacity: u32,
    count: u32,
    #[comptime] form: Form,
    #[comptime] maps: bool,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let list = TileList::own(offsets, capacity, count);
    let own = own_pixel(view, CUBE_POS as u32);
    if own.inside {
        let mut through = 1.0f32;
        let mut red = 0.0f32;
        let mut green = 0.0f32;
        let mut blue = 0.0f32;
        let mut depth = 0.0f32;
        let mut normal_x = 0.0f32;
        let mut normal_y = 0.0f32;
        let mut normal_z = 0.0f32;
        let mut median = 0.0f32;
        // of distortion: 1 / z of the first fragment, sums of αT, αT m, αT m² with m relative to that
        let mut reference = 0.0f32;
        let mut total = 0.0f32;
        let mut first_moment = 0.0f32;
        let mut second_moment = 0.0f32;
        let mut distortion = 0.0f32;
        let mut position = 0u32;
        let mut end = list.length;
        while position < end {
            let i = list.entry(ids, position) as usize;
            let found = fragment(shapes, features, i, own.x, own.y, view.near, form);
            if found.weight > 0.0f32 {
                let alpha = min(found.weight, thresholds.max_alpha);
                let behind = through * (1.0f32 - alpha);
                if behind >= thresholds.min_transmittance {
                    let payload = Payload::load(features, i * FEATURES);
                    let covered = alpha * through;
                    red += covered * payload.colour.x;
                    green += covered * payload.colour.y;
                    blue += covered * payload.colour.z;
                    if comptime!(maps) {
                        depth += covered * found.depth;
                        normal_x += covered * payload.normal.x;
                        normal_y += covered * payload.normal.y;
                        normal_z += covered * payload.normal.z;
                        median = select(behind <= 0.5f32 && median == 0.0f32, found.depth, median);
                        let inverse = 1.0f32 / found.depth;
                        reference = select(reference == 0.0f32, inverse, reference);
                        let mapped = thresholds.slope * (reference - inverse);
                        let spread = mapped * mapped * total + second_moment - 2.0f32 * mapped * first_moment;
                        distortion += covered * spread;
                        total += covered;
                        first_moment += covered * mapped;
                        second_moment += covered * mapped * mapped;
                    }
                    through = behind;
                } else {
                    end = position;
                }
            }
            position += 1u32;
        }
        let (plane, pixel) = (plane_of(view), own.at);
        planes[pixel] = red;
        planes[pixel + plane] = green;
        planes[pixel + 2 * plane] = blue;
        planes[pixel + 3 * plane] = 1.0f32 - through;
        if comptime!(maps) {
            planes[pixel + 4 * plane] = depth;
            planes[pixel + 5 * plane] = normal_x;
            planes[pixel + 6 * plane] = normal_y;
            planes[pixel + 7 * plane] = normal_z;
            planes[pixel + 8 * plane] = distortion;
            median_depth[pixel] = median;
        }
    }
}

impl BlendOps for CubeBackend {
    fn blend(input: BlendInput<Self>, camera: Camera, options: BlendOptions) -> BlendOutput<Self> {
        let gaussians = input.gaussians.contiguous();
        let (like, count) = (&gaussians.positions, gaussians.positions.shape()[0]);
        let (height, width) = (camera.height, camera.width);
        let (fragments, lists) = Fragments::new(&gaussians, &camera, &options);
        let planes = empty_f32(like, [options.planes(), height, width]);
        let median_depth = empty_f32(like, [usize::from(options.maps), height, width]);
        blend_kernel::launch(
            &like.client.clone(),
            cubes(TileGrid::new(width, height).len()),
            cube_dim(),
            buffer(&fragments.shapes),
            buffer(&fragments.features),
            buffer(&lists.offsets),
            buffer(&lists.primitives),
            buffer(&planes),
            buffer(&median_depth),
            CameraUniforms::launch(&camera),
            Thresholds::launch(&camera, &options),
            lists.primitives.shape()[0] as u32,
            count as u32,
            options.form,
            options.maps,
        );
        BlendOutput { planes, median_depth, lists }
    }
}

impl BlendBackwardOps for CubeBackend {
    fn blend_backward(
        input: BlendInput<Self>,
        lists: BlendLists<Self>,
        grad: FloatTensor<Self>,
        camera: Camera,
        options: BlendOptions,
    ) -> BlendInput<Self> {
        let (gaussians, grad) = (input.gaussians.contiguous(), floats(grad));
        let layout = Layout { form: options.form, maps: options.maps, probe: input.probe.shape()[0] > 0 };
        let (fragments, _) = Fragments::in_order(&gaussians, &lists.order, &camera, &options);
        let [sums, rest] = gather(&fragments, &lists, &grad, &camera, &options, layout);
        parameters::backward(&gaussians, &sums, &rest, &camera, options.filter, layout)
    }
}

//! Each pixel's own order (StopThePop): the forward pass, and the way back.

mod replay;
mod walk;

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

pub use self::replay::{Said, replay};
use self::walk::{PIXEL_STATE, walk_rays};
pub use self::walk::{said_at, said_numbers};
use super::fragments::Fragments;
use super::{Thresholds, write_pixel};
use crate::camera::Camera;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{buffer, cube_dim, cubes};
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::{BlendLists, BlendOptions};
use crate::tiles::TileGrid;
use crate::tiles::binning::cube::TileList;

#[cube(launch)]
fn blend_by_rays_kernel(
    table: &[f32],
    features: &[f32],
    offsets: &[u32],
    ids: &[u32],
    planes: &mut [f32],
    median_depth: &mut [f32],
    view: CameraUniforms,
    thresholds: Thresholds,
    capacity: u32,
    count: u32,
    #[comptime] maps: bool,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let list = TileList::own(offsets, capacity, count);
    let mut state = zeros(PIXEL_STATE);
    walk_rays(&mut state, table, features, list, ids, planes, 0u32, CUBE_POS as u32, view, thresholds, maps, false);
    write_pixel(&state, planes, median_depth, view, CUBE_POS as u32, maps);
}

/// The forward pass into `planes` and median depth.
pub fn blend(
    fragments: &Fragments,
    lists: &BlendLists<CubeBackend>,
    [planes, median_depth]: [&CubeTensor; 2],
    camera: &Camera,
    options: &BlendOptions,
) {
    blend_by_rays_kernel::launch(
        &planes.client.clone(),
        cubes(TileGrid::new(camera.width, camera.height).len()),
        cube_dim(),
        buffer(fragments.by_rays()),
        buffer(&fragments.features),
        buffer(&lists.offsets),
        buffer(&lists.primitives),
        buffer(planes),
        buffer(median_depth),
        CameraUniforms::launch(camera),
        Thresholds::launch(camera, options),
        lists.primitives.shape()[0] as u32,
        lists.order.shape()[0] as u32,
        options.maps,
    );
}

//! GPU kernels. Primitives are sorted by depth, so that ascending lists run front to back. Forward, one unit handles
//! one pixel; backward, one cube handles one tile, in `sorted` where its pixels share an order, and then several units one
//! primitive. In the order of rays lists are sorted for each tile, and `rays` resorts them for each pixel.

mod back;
mod contributing;
mod fold;
mod fragments;
mod gather;
mod hybrid;
mod order;
mod parameters;
mod rays;
mod sorted;

use burn::backend::TensorMetadata;
use burn::backend::tensor::IntTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use self::fold::Layout;
use self::fragments::{FEATURES, Fragment, Fragments, Payload, Shape, on_projected};
use self::gather::gather;
use self::hybrid::blend_pixel;
use self::rays::{PIXEL_STATE, walk_rays};
use self::sorted::{end_planes, write_end};
use super::autodiff::BlendState;
use super::{BlendInput, BlendLists, BlendOps, BlendOptions, BlendOutput, ContributionOps, Form, far};
use crate::backend::kept::Kept;
use crate::backend::tape::BackwardState;
use crate::camera::Camera;
use crate::footprint::gaussian::cube::regions::{WORDS, list_regions, mark_regions};
use crate::footprint::gaussian::cube::{SPLAT, Splat};
use crate::gpu::gather::zeros;
use crate::gpu::launch::{LANES, UNITS, buffer, cube_dim, cubes, empty_f32, floats};
use crate::gpu::record::Record;
use crate::gpu::tile::{REGIONS, own_pixel, plane_of};
use crate::gpu::view::CameraUniforms;
use crate::scene::{BlendOrder, Transparency};
use crate::tiles::TileGrid;
use crate::tiles::binning::cube::TileList;

#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Thresholds {
    max_alpha: f32,
    min_transmittance: f32,
    /// 1 if a pixel ends behind the fragment that takes T below that, 0 if before it.
    ends_behind: u32,
    /// d m / d(−1 / z) of the m of distortion, world units.
    slope: f32,
}

impl Thresholds {
    fn launch(camera: &Camera, options: &BlendOptions) -> ThresholdsLaunch {
        let (near, far) = (camera.near, far(camera.near));
        let slope = far * near / (far - near);
        let ends_behind = u32::from(options.form.ends_behind());
        ThresholdsLaunch::new(options.max_alpha as f32, options.min_transmittance as f32, ends_behind, slope as f32)
    }
}

/// Sums of a pixel, by place in an array: transmittance behind the last fragment, then the planes but for alpha.
const THROUGH: usize = 0;
const COLOUR: usize = 1;
const DEPTH: usize = 4;
const NORMAL: usize = 5;
const DISTORTION: usize = 8;
const MEDIAN: usize = 9;
/// For distortion: 1 / z of the first fragment; sums of αT, αT m, αT m² with m relative to that.
const REFERENCE: usize = 10;
const TOTAL: usize = 11;
const FIRST_MOMENT: usize = 12;
const SECOND_MOMENT: usize = 13;
const STATE: usize = 14;

/// Blends a fragment of primitive `i` behind those before it. Returns whether the pixel goes on; if not, it ended before
/// this fragment, or behind it.
#[cube]
fn add_fragment(
    state: &mut Array<f32>,
    found: Fragment,
    features: &[f32],
    i: usize,
    thresholds: Thresholds,
    #[comptime] maps: bool,
) -> bool {
    // on both sides: negative α takes colour away (SSS); below 1 in size, since the backward pass divides by 1 − α
    let alpha = max(min(found.weight, thresholds.max_alpha), -thresholds.max_alpha);
    let behind = state[THROUGH] * (1.0f32 - alpha);
    let goes_on = behind >= thresholds.min_transmittance;
    if goes_on || thresholds.ends_behind == 1u32 {
        let payload = Payload::load(features, i * FEATURES);
        let covered = alpha * state[THROUGH];
        state[COLOUR] += covered * payload.colour.x;
        state[COLOUR + 1] += covered * payload.colour.y;
        state[COLOUR + 2] += covered * payload.colour.z;
        if comptime!(maps) {
            state[DEPTH] += covered * found.depth;
            state[NORMAL] += covered * payload.normal.x;
            state[NORMAL + 1] += covered * payload.normal.y;
            state[NORMAL + 2] += covered * payload.normal.z;
            // 0 is no depth of a fragment, since all are beyond the near plane: it stands for none so far
            state[MEDIAN] = select(behind <= 0.5f32 && state[MEDIAN] == 0.0f32, found.depth, state[MEDIAN]);
            let inverse = 1.0f32 / found.depth;
            state[REFERENCE] = select(state[REFERENCE] == 0.0f32, inverse, state[REFERENCE]);
            // counted from the first fragment: where z ≫ near, f32 loses differences of m itself
            let mapped = thresholds.slope * (state[REFERENCE] - inverse);
            let spread = mapped * mapped * state[TOTAL] + state[SECOND_MOMENT] - 2.0f32 * mapped * state[FIRST_MOMENT];
            state[DISTORTION] += covered * spread;
            state[TOTAL] += covered;
            state[FIRST_MOMENT] += covered * mapped;
            state[SECOND_MOMENT] += covered * mapped * mapped;
        }
        state[THROUGH] = behind;
    }
    goes_on
}

/// Blends the list of a tile, of ellipsoids or students, into the state of the pixel of this unit. Returns the position in the list
/// before which the pixel ends. All units of the cube must call this together, with workgroup memory of [[`UNITS`] ×
/// [`SPLAT`]] and [[`UNITS`]] numbers.
#[cube]
fn blend_projected(
    state: &mut Array<f32>,
    staged: &mut [f32],
    masks: &mut [u32],
    shapes: &[f32],
    features: &[f32],
    list: TileList,
    ids: &[u32],
    tile: u32,
    view: CameraUniforms,
    thresholds: Thresholds,
    #[comptime] form: Form,
    #[comptime] maps: bool,
) -> u32 {
    let own = own_pixel(view, tile);
    let mut visits = Shared::<[u32]>::new_slice(comptime!(REGIONS * WORDS));
    let mut depths = Shared::<[f32]>::new_slice(REGIONS);
    if UNIT_POS < comptime!(REGIONS as u32) {
        // a sorted pixel ends by its own T, at no depth that is known before
        depths[UNIT_POS as usize] = view.infinity;
    }
    let mut end = select(own.inside, list.length, 0u32);
    let mut open = own.inside;
    let batches = list.batches();
    for batch in 0..batches {
        let entries = list.stage(ids, batch, shapes, shapes, staged, (SPLAT, 0));
        mark_regions(&*staged, entries, &depths, masks, tile, view, SPLAT);
        list_regions(&*masks, &mut visits);
        for word in 0..WORDS {
            let mut bits = visits[(UNIT_POS / LANES) as usize * WORDS + word];
            while bits != 0u32 && open {
                let entry = word as u32 * 32u32 + bits.trailing_zeros();
                // clears the lowest bit, so that entries come front to back
                bits &= bits - 1u32;
                let position = batch * UNITS + entry;
                let splat = Splat::load(&*staged, entry as usize * SPLAT);
                let found = on_projected(splat, features, list, ids, position, own.x, own.y, form);
                if found.weight != 0.0f32 {
                    let i = list.entry(ids, position) as usize;
                    open = add_fragment(state, found, features, i, thresholds, maps);
                    // forms on the screen end before the fragment; `blend_met` has one that ends behind it
                    end = select(open, end, position);
                }
            }
        }
    }
    end
}

/// [`blend_projected`] for forms that are met by rays. Units need not call it together.
#[cube]
fn blend_met(
    state: &mut Array<f32>,
    shapes: &[f32],
    features: &[f32],
    list: TileList,
    ids: &[u32],
    tile: u32,
    view: CameraUniforms,
    thresholds: Thresholds,
    #[comptime] form: Form,
    #[comptime] maps: bool,
) -> u32 {
    let own = own_pixel(view, tile);
    let mut end = select(own.inside, list.length, 0u32);
    let mut position = 0u32;
    while position < end {
        let i = list.entry(ids, position) as usize;
        let found = Shape::load(shapes, features, i, form).at(own.x, own.y, view);
        if found.weight > 0.0f32 {
            let goes_on = add_fragment(state, found, features, i, thresholds, maps);
            end = select(goes_on, end, position + thresholds.ends_behind);
        }
        position += 1u32;
    }
    end
}

/// The forward pass; in the order of rays with the table of these in the place of the shapes.
#[cube(launch)]
fn blend_kernel(
    shapes: &[f32],
    features: &[f32],
    offsets: &[u32],
    ids: &[u32],
    planes: &mut [f32],
    median_depth: &mut [f32],
    ends: &mut [f32],
    view: CameraUniforms,
    thresholds: Thresholds,
    capacity: u32,
    count: u32,
    #[comptime] form: Form,
    #[comptime] order: BlendOrder,
    #[comptime] maps: bool,
) {
    if CUBE_POS >= (view.columns * view.rows) as usize {
        terminate!();
    }
    let list = TileList::own(offsets, capacity, count);
    let tile = CUBE_POS as u32;
    // compiled for one order each: a branch would hold the registers of all of them
    let transparency = comptime!(order.transparency().unwrap_or(Transparency::Sorted));
    if comptime!(transparency != Transparency::Sorted) {
        blend_pixel(planes, median_depth, shapes, features, list, ids, tile, view, thresholds, transparency, maps);
    } else {
        let mut state = zeros(PIXEL_STATE);
        state[THROUGH] = 1.0f32;
        if comptime!(order == BlendOrder::Rays) {
            walk_rays(&mut state, shapes, features, list, ids, planes, 0u32, tile, view, thresholds, maps, false);
        } else if comptime!(form.is_projected()) {
            let mut staged = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * SPLAT));
            let mut masks = Shared::<[u32]>::new_slice(comptime!(UNITS as usize));
            let end = blend_projected(
                &mut state,
                &mut staged,
                &mut masks,
                shapes,
                features,
                list,
                ids,
                tile,
                view,
                thresholds,
                form,
                maps,
            );
            write_end(ends, &state, end, view, tile, maps);
        } else {
            let end = blend_met(&mut state, shapes, features, list, ids, tile, view, thresholds, form, maps);
            write_end(ends, &state, end, view, tile, maps);
        }
        write_pixel(&state, planes, median_depth, view, tile, maps);
    }
}

/// Writes the sums of the pixel of this unit in `tile`.
#[cube]
fn write_pixel(
    state: &Array<f32>,
    planes: &mut [f32],
    median_depth: &mut [f32],
    view: CameraUniforms,
    tile: u32,
    #[comptime] maps: bool,
) {
    let own = own_pixel(view, tile);
    if own.inside {
        let (plane, pixel) = (plane_of(view), own.at);
        #[unroll]
        for channel in 0..3usize {
            planes[pixel + channel * plane] = state[COLOUR + channel];
        }
        planes[pixel + 3 * plane] = 1.0f32 - state[THROUGH];
        if comptime!(maps) {
            #[unroll]
            for channel in 4..9usize {
                planes[pixel + channel * plane] = state[channel];
            }
            median_depth[pixel] = state[MEDIAN];
        }
    }
}

/// Whether all pixels of a tile blend its list in one order.
fn is_shared(order: BlendOrder) -> bool {
    matches!(order, BlendOrder::Centres | BlendOrder::Whitened(Transparency::Sorted))
}

/// Where the pixels of a view end [[`end_planes`], H, W], kept for the backward pass; nothing in orders that are not shared.
struct Ends(CubeTensor);

/// The planes, median depth, and where pixels end.
fn blend_fragments(
    fragments: &Fragments,
    lists: &BlendLists<CubeBackend>,
    camera: &Camera,
    options: &BlendOptions,
) -> (CubeTensor, CubeTensor, Ends) {
    let (like, count) = (&fragments.features, lists.order.shape()[0]);
    let (height, width) = (camera.height, camera.width);
    let planes = empty_f32(like, [options.planes(), height, width]);
    let median_depth = empty_f32(like, [usize::from(options.maps), height, width]);
    let kept_planes = if is_shared(options.order) { end_planes(options.maps) } else { 0 };
    let ends = empty_f32(like, [kept_planes, height, width]);
    let shapes = if options.order == BlendOrder::Rays { fragments.by_rays() } else { &fragments.shapes };
    blend_kernel::launch(
        &like.client,
        cubes(TileGrid::new(width, height).len()),
        cube_dim(),
        buffer(shapes),
        buffer(&fragments.features),
        buffer(&lists.offsets),
        buffer(&lists.primitives),
        buffer(&planes),
        buffer(&median_depth),
        buffer(&ends),
        CameraUniforms::launch(camera),
        Thresholds::launch(camera, options),
        lists.primitives.shape()[0] as u32,
        count as u32,
        options.form,
        options.order,
        options.maps,
    );
    (planes, median_depth, Ends(ends))
}

impl BlendOps for CubeBackend {
    fn blend(input: BlendInput<Self>, camera: Camera, options: BlendOptions, kept: Kept) -> BlendOutput<Self> {
        let gaussians = input.gaussians.contiguous();
        let degrees_of_freedom = floats(input.degrees_of_freedom);
        let (fragments, lists) = Fragments::new(&gaussians, &degrees_of_freedom, &camera, &options);
        let (planes, median_depth, ends) = blend_fragments(&fragments, &lists, &camera, &options);
        kept.put(ends);
        BlendOutput { planes, median_depth, lists }
    }
}

impl ContributionOps for CubeBackend {
    fn contributing(input: BlendInput<Self>, camera: Camera, options: BlendOptions, least: f64) -> IntTensor<Self> {
        let gaussians = input.gaussians.contiguous();
        let (fragments, lists) = Fragments::new(&gaussians, &floats(input.degrees_of_freedom), &camera, &options);
        contributing::contributing(&fragments, &lists, &camera, &options, least)
    }
}

impl BackwardState<CubeBackend, 7> for BlendState<CubeBackend> {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 7] {
        let Self { input, lists, camera, options, kept } = self;
        let (gaussians, grad) = (input.gaussians.contiguous(), floats(grad));
        let layout = Layout { form: options.form, maps: options.maps, probe: input.probe.shape()[0] > 0 };
        let degrees_of_freedom = floats(input.degrees_of_freedom);
        // footprints are made again, but not the order: depths are sorted once
        let (fragments, _) = Fragments::in_order(&gaussians, &degrees_of_freedom, &lists.order, &camera, &options);
        let ends = kept.get_or(|| blend_fragments(&fragments, &lists, &camera, &options).2);
        let [sums, rest] = gather(&fragments, &lists, &ends.0, &grad, &camera, &options, layout);
        parameters::backward(&gaussians, &sums, &rest, &camera, options.filter, layout).into_array().map(Some)
    }
}

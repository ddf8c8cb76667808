//! Primitives that float in empty space. A camera that saw a point saw it through empty space: what is opaque there floats.
//!
//! Datasets of structure from motion say which points each photograph shows. A primitive *blocks* a view if it hides a
//! pixel that shows a point and is well before the point, and *supports* it if it is about where the point is. Nor is there
//! anything close around a camera that saw only what is far: what no view supports there is seen large by cameras nearby.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::ops::peel::{Layers, PeelOptions, peel};
use dpges_core::ops::splat::contributions;
use dpges_core::scene::peeling::STEP;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{Gaussians, Surfels};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::dataset::{Dataset, EmptySpace, PointCloud};

/// Depths relative to that of a point from which, and up to which, a primitive is where the point is.
const AT_THE_POINT: [f32; 2] = [0.9, 1.1];
/// Least α with which a primitive hides a pixel.
const HIDES: f32 = 0.1;
/// Least number of views that a floating primitive blocks.
const BLOCKED_VIEWS: u32 = 2;

/// How many views every primitive blocks and supports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Visibility {
    pub surfels: Vec<Votes>,
    pub gaussians: Vec<Votes>,
}

/// The votes of the views on one primitive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Votes {
    pub blocked: u32,
    pub supported: u32,
    /// Whether it is in the empty space around a camera.
    pub is_close: bool,
}

/// Numbers of primitives that float.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Floaters {
    pub surfels: usize,
    pub gaussians: usize,
}

impl Votes {
    /// Whether it is in the way of several views and of more than it is of use to, or close to a camera and of use to none.
    pub fn floats(self) -> bool {
        (self.blocked >= BLOCKED_VIEWS && self.blocked > self.supported) || (self.is_close && self.supported == 0)
    }
}

impl Visibility {
    /// Votes of the training views on `surfels` and `gaussians`; `None` if the dataset does not say which view saw
    /// what.
    ///
    /// # Errors
    /// [`dpges_core::Error`] if the primitives cannot be rendered.
    pub fn measure(
        surfels: &Surfels,
        gaussians: &Gaussians,
        options: &PeelOptions,
        dataset: &Dataset,
    ) -> Result<Option<Self>> {
        let counts = [surfels.positions.dims()[0], gaussians.positions.dims()[0]];
        let [mut of_surfels, mut of_gaussians] = counts.map(|count| vec![Votes::default(); count]);
        let device = surfels.positions.device();
        let white = Tensor::ones([counts[1], 3], (&device, DType::F32));
        let mut is_known = false;
        for (index, view) in dataset.train.iter().enumerate() {
            let depths = seen_depths(&dataset.points, index as u32, &view.camera);
            if depths.iter().all(|&depth| depth == 0.0) {
                continue;
            }
            let camera = &view.camera;
            is_known = true;
            let layers = peel(surfels, camera, options)?;
            observe_surfels(&mut of_surfels, &layers, &depths);
            if counts[1] > 0 {
                let [blocks, supports] = alphas(gaussians, &white, &depths, camera, &device)?;
                for ((votes, blocks), supports) in of_gaussians.iter_mut().zip(blocks).zip(supports) {
                    votes.blocked += u32::from(blocks >= HIDES);
                    votes.supported += u32::from(supports >= HIDES);
                }
            }
        }
        let empty = EmptySpace::of(dataset);
        for (all_votes, positions) in [(&mut of_surfels, &surfels.positions), (&mut of_gaussians, &gaussians.positions)]
        {
            observe_closeness(all_votes, &tensor_to_rows(positions), &empty);
        }
        Ok(is_known.then_some(Self { surfels: of_surfels, gaussians: of_gaussians }))
    }

    pub fn floaters(&self) -> Floaters {
        let count = |all_votes: &[Votes]| all_votes.iter().filter(|votes| votes.floats()).count();
        Floaters { surfels: count(&self.surfels), gaussians: count(&self.gaussians) }
    }
}

/// [H × W] depths of the points that the training view `view` saw, world units; 0 where it saw none.
fn seen_depths(points: &PointCloud, view: u32, camera: &Camera) -> Vec<f32> {
    let mut depths = vec![0.0f32; camera.width * camera.height];
    for (position, seen_by) in points.positions.iter().zip(points.seen_by.iter()) {
        if seen_by.binary_search(&view).is_err() {
            continue;
        }
        let Some((pixel, depth)) = camera.pixel(Vec3::from_array(*position).as_dvec3()) else { continue };
        // of two points in a pixel, the farther may be seen past the nearer
        let at = &mut depths[pixel];
        *at = if *at == 0.0 { depth as f32 } else { at.min(depth as f32) };
    }
    depths
}

/// Adds which of the primitives at `positions` [N × 3] are in the `empty` space.
fn observe_closeness(all_votes: &mut [Votes], positions: &[f32], empty: &EmptySpace) {
    let (positions, _) = positions.as_chunks::<3>();
    all_votes.par_iter_mut().zip(positions).for_each(|(votes, position)| votes.is_close = empty.contains(*position));
}

/// Largest α of each Gaussian at a pixel that shows a point: `[M]` before it, and `[M]` where it is.
fn alphas(
    gaussians: &Gaussians,
    white: &Tensor<2>,
    depths: &[f32],
    camera: &Camera,
    device: &Device,
) -> Result<[Vec<f32>; 2]> {
    let shape = [2, camera.height, camera.width];
    let planes = |factors: [f32; 2]| {
        let values: Vec<f32> = factors.iter().flat_map(|factor| depths.iter().map(move |z| factor * z)).collect();
        Tensor::<3>::from_data(TensorData::new(values, shape), (device, DType::F32))
    };
    let ends = planes(AT_THE_POINT);
    let shown = ends.clone().greater_elem(0.0).float();
    let steps = Tensor::full([1, camera.height, camera.width], STEP, (device, DType::F32));
    let limits = Tensor::cat(vec![ends, steps], 0);
    let found = |interval: usize| {
        let only = planes([0, 1].map(|plane| f32::from(u8::from(plane == interval)))).greater_elem(0.0).float();
        let gates = shown.clone() * only;
        Ok(tensor_to_rows(&contributions(gaussians, white, &limits, &gates, camera)?.unsqueeze_dim::<2>(1)))
    };
    Ok([found(0)?, found(1)?])
}

/// Adds a view with `layers` whose pixels show points at `depths`.
fn observe_surfels(all_votes: &mut [Votes], layers: &Layers, depths: &[f32]) {
    let area = depths.len();
    let ids: Vec<i32> = layers.ids.clone().into_data().iter::<i32>().take(area).collect();
    let (found, alpha) = (tensor_to_rows(&layers.depth), tensor_to_rows(&layers.alpha));
    let mut seen = vec![[false; 2]; all_votes.len()];
    for (pixel, &depth) in depths.iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
        let Ok(surfel) = usize::try_from(ids[pixel]) else { continue };
        if alpha[pixel] >= HIDES {
            let [near, far] = AT_THE_POINT.map(|factor| factor * depth);
            seen[surfel][0] |= found[pixel] < near;
            seen[surfel][1] |= (near..far).contains(&found[pixel]);
        }
    }
    for (votes, [blocks, supports]) in all_votes.iter_mut().zip(seen) {
        votes.blocked += u32::from(blocks);
        votes.supported += u32::from(supports);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{BuiltinOptions, Tracks, View, builtin};
    use crate::run::fixtures::device;
    use dpges_core::camera::CameraFromWorld;
    use dpges_core::scene::{ColourModel, GaussianData, SurfelData};
    use glam::DVec3;

    /// Three cameras before the origin that look at it, all of which saw one point there, or only the first.
    fn dataset(all_saw: bool) -> Dataset {
        let mut dataset = builtin(&BuiltinOptions { width: 16, height: 16, train_views: 3, ..Default::default() });
        for (index, view) in dataset.train.iter_mut().enumerate() {
            let centre = DVec3::new(0.5 * (index as f64 - 1.0), 0.0, -4.0);
            let camera_from_world = CameraFromWorld::look_at(centre, DVec3::ZERO, -DVec3::Y);
            let camera = Camera { camera_from_world, fx: 16.0, fy: 16.0, cx: 8.5, cy: 8.5, near: 0.01, ..view.camera };
            *view = View { camera, ..view.clone() };
        }
        let seen_by = if all_saw { vec![0, 1, 2] } else { vec![0] };
        dataset.points =
            PointCloud { positions: vec![[0.0; 3]], colours: vec![[0.5; 3]], seen_by: [seen_by].into_iter().collect() };
        dataset
    }

    /// At depths from the point towards the cameras, of a size of about a pixel.
    const TOWARDS_CAMERAS: [f32; 4] = [0.0, -0.3, -1.9, 1.0];

    fn all_votes(dataset: &Dataset) -> Option<Visibility> {
        let device = device();
        let positions: Vec<f32> = TOWARDS_CAMERAS.iter().flat_map(|&z| [0.0, 0.0, z]).collect();
        let (count, model) = (TOWARDS_CAMERAS.len(), ColourModel::SphericalBeta { lobes: 0 });
        let mut gaussians = GaussianData::neutral(model, count);
        gaussians.positions = positions.clone();
        gaussians.log_scales.fill(0.4f32.ln());
        gaussians.opacities.fill(0.8);
        let mut surfels = SurfelData::neutral(model, count);
        surfels.positions = positions;
        surfels.log_scales.fill(0.2f32.ln());
        surfels.margins.fill(0.1);
        let surfels = Surfels::from_data(&surfels, &device, DType::F32);
        let gaussians = Gaussians::from_data(&gaussians, &device, DType::F32);
        Visibility::measure(&surfels, &gaussians, &PeelOptions::default(), dataset).unwrap()
    }

    #[test]
    fn what_is_well_before_a_point_blocks_and_what_is_near_it_supports() {
        let found = all_votes(&dataset(true)).unwrap();
        let votes = |blocked, supported| Votes { blocked, supported, is_close: false };
        assert_eq!(found.gaussians, [votes(0, 3), votes(0, 3), votes(3, 0), votes(0, 0)]);
        // only the nearest surfel of a pixel is seen; those behind it are not asked
        assert_eq!(found.surfels[2], votes(3, 0));
        assert_eq!(found.floaters(), Floaters { surfels: 1, gaussians: 1 });
    }

    #[test]
    fn one_view_convicts_nothing_and_no_view_has_no_say() {
        let found = all_votes(&dataset(false)).unwrap();
        assert_eq!(found.gaussians[2], Votes { blocked: 1, supported: 0, is_close: false });
        assert_eq!(found.floaters(), Floaters { surfels: 0, gaussians: 0 });
        let mut unknown = dataset(true);
        unknown.points.seen_by = Tracks::default();
        assert!(all_votes(&unknown).is_none());
    }

    #[test]
    fn what_supports_as_many_views_as_it_blocks_stays() {
        let floats = |blocked, supported| Votes { blocked, supported, is_close: false }.floats();
        assert!(floats(2, 1) && floats(5, 4) && !floats(2, 2) && !floats(1, 0) && !floats(0, 0));
    }

    #[test]
    fn what_is_close_to_a_camera_floats_unless_a_view_supports_it() {
        let close = |supported| Votes { blocked: 0, supported, is_close: true };
        assert!(close(0).floats() && !close(1).floats());
        let mut data = dataset(true);
        // the cameras are 4 and more before the points
        let many = 100;
        data.points.positions = vec![[0.0; 3]; many];
        data.points.colours = vec![[0.5; 3]; many];
        data.points.seen_by = vec![vec![1]; many].into_iter().collect();
        let mut all_votes = vec![Votes::default(); 3];
        observe_closeness(&mut all_votes, &[0.0, 0.0, -1.9, 0.0, 0.0, -2.2, 0.0, 0.0, -5.5], &EmptySpace::of(&data));
        assert_eq!(all_votes.iter().map(|votes| votes.is_close).collect::<Vec<_>>(), [false, true, true]);
    }
}

//! Targets of the geometry losses: depths and normals of the discs that the surfels come from (DP-GES, geometry).

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::camera::Camera;
use dpges_core::counters::transfers::upload;
use dpges_core::losses::Losses;
use dpges_core::losses::geometry::{self, GeometryWeights, Supervision, expected_depth};
use dpges_core::ops::blend::Maps;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Rendering};

use super::super::{Context, TrainError};
use super::RenderedView;
use super::blended_depth::BlendedMaps;
use crate::dataset::View;
use crate::optimizer::unit_of;

/// Numbers per pixel: a depth and a normal.
const NUMBERS: usize = 4;

/// Depth and normal of every training view: in host memory as far as there is room, and rendered when they are needed
/// otherwise.
pub struct Supervisions {
    pub data: GaussianData,
    discs: BlendedMaps,
    /// `None` for views that are rendered again.
    views: Vec<Option<DepthAndNormal>>,
}

/// Depth [H × W], world units, and unit normal [3 × H × W].
type DepthAndNormal = [Vec<f32>; 2];

impl Supervisions {
    /// Supervision by `discs`, which are rendered in the training views that there is room for.
    pub fn new(discs: &GaussianData, context: &Context) -> Result<Self, TrainError> {
        let dataset = &context.dataset;
        let on_device = BlendedMaps::new(discs, &context.scene_info(Rendering::Discs), &context.device)?;
        // those that are kept are of cameras that stay where they are
        let mut room = if context.poses.is_on() { 0 } else { dataset.spare_memory };
        let mut views = Vec::with_capacity(dataset.train.len());
        for view in &dataset.train {
            let bytes = NUMBERS * size_of::<f32>() * view.camera.width * view.camera.height;
            // a view that does not fit leaves its room to smaller ones after it
            let left = room.checked_sub(bytes);
            views.push(left.map(|_| depth_and_normal(&on_device, &view.camera)).transpose()?);
            room = left.unwrap_or(room);
        }
        let again = views.iter().filter(|view| view.is_none()).count();
        if again > 0 && !context.poses.is_on() {
            tracing::info!(
                "depths and normals of {again} of {} views are rendered when they are needed, since they do not fit into \
                 memory (data.memory)",
                views.len()
            );
        }
        Ok(Self { data: discs.clone(), discs: on_device, views })
    }

    /// The target of the training `view` with this `index`, on `device`.
    fn of(&self, index: usize, view: &View, device: &Device) -> dpges_core::Result<Supervision> {
        let Camera { width, height, .. } = view.camera;
        let [depth, normal] = match &self.views[index] {
            Some(maps) => maps.clone(),
            None => depth_and_normal(&self.discs, &view.camera)?,
        };
        let tensor = |values: Vec<f32>, planes: usize| -> Tensor<3> {
            Tensor::from_data(upload(TensorData::new(values, [planes, height, width])), (device, DType::F32))
        };
        Ok(Supervision { depth: tensor(depth, 1), normal: tensor(normal, 3) })
    }
}

/// The difference to depths and normals of discs. It has its weights already.
pub fn geometry(view: &RenderedView<'_>, losses: &mut Losses) -> dpges_core::Result<()> {
    let Some(supervisions) = &view.stage.supervisions else { return Ok(()) };
    let (input, train) = (view.input, &view.context.config.train);
    let supervision = supervisions.of(input.index, input.view, &view.context.tape())?;
    let supervision = input.target.mask.iter().fold(supervision, Supervision::within);
    let weights = GeometryWeights {
        // published in world units, of which a fifth of the extent is one here
        depth: train.lambda_disc_depth / unit_of(view.stage.info.extent),
        normal: train.lambda_disc_normal,
        depth_normal: train.lambda_disc_depth_normal,
    };
    let seen = input.pose.map(|probe| probe.surfels(view.surfels));
    let surfels = seen.as_ref().unwrap_or(view.surfels);
    let value = geometry::geometry(view.rendered, surfels, &input.view.camera, &supervision, &weights)?;
    let value = view.of_counted(value);
    losses.total = losses.total.clone() + value.clone();
    losses.terms.push(("geometry", value));
    Ok(())
}

fn depth_and_normal(discs: &BlendedMaps, camera: &Camera) -> dpges_core::Result<DepthAndNormal> {
    let (Maps { depth, normal, .. }, alpha) = discs.seen_by(camera)?;
    // where no disc is the normal stays 0, and is not NaN
    let length = (normal.clone() * normal.clone()).sum_dim(0).sqrt().clamp_min(1e-6);
    Ok([tensor_to_rows(&expected_depth(depth, alpha)), tensor_to_rows(&(normal / length))])
}

//! Targets of the geometry losses: depths and normals of the discs that the surfels come from (DP-GES, geometry).

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::counters::transfers::upload;
use dpges_core::losses::geometry::{Supervision, expected_depth};
use dpges_core::ops::blend::Maps;
use dpges_core::render::Values;
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Gaussians, Rendering};

use super::super::{Context, TrainError};

/// Depth and normal of every training view, in host memory.
pub struct Supervisions {
    discs: GaussianData,
    /// Depth [H × W], world units, and unit normal [3 × H × W].
    views: Vec<[Vec<f32>; 2]>,
    /// Height and width of every view, px.
    sizes: Vec<[usize; 2]>,
}

impl Supervisions {
    /// Renders `discs` in every training view.
    ///
    /// # Errors
    /// [`TrainError::Core`] if they cannot be rendered.
    pub fn new(discs: &GaussianData, context: &Context) -> Result<Self, TrainError> {
        let (dataset, info) = (&context.dataset, context.scene_info(Rendering::Discs));
        let gaussians = Gaussians::from_data(discs, &context.device, DType::F32);
        let mut options = BlendedOptions::new(&info)?;
        options.blend.maps = true;
        let mut views = Vec::with_capacity(dataset.train.len());
        let mut sizes = Vec::with_capacity(dataset.train.len());
        for view in &dataset.train {
            let rendered = render_blended(&gaussians, None, &view.camera, &options, Values::KnownFinite)?;
            let Some(Maps { depth, normal, .. }) = rendered.blend.maps else { unreachable!("maps were asked for") };
            let depth = expected_depth(depth, rendered.blend.alpha);
            let length = (normal.clone() * normal.clone()).sum_dim(0).sqrt().clamp_min(1e-6);
            views.push([tensor_to_rows(&depth), tensor_to_rows(&(normal / length))]);
            sizes.push([view.camera.height, view.camera.width]);
        }
        Ok(Self { discs: discs.clone(), views, sizes })
    }

    /// The discs that were rendered.
    pub fn discs(&self) -> &GaussianData {
        &self.discs
    }

    /// The target of the training view with index `view`, on `device`.
    pub fn of(&self, view: usize, device: &Device) -> Supervision {
        let [height, width] = self.sizes[view];
        let [depth, normal] = &self.views[view];
        let tensor = |values: &Vec<f32>, planes: usize| -> Tensor<3> {
            Tensor::from_data(upload(TensorData::new(values.clone(), [planes, height, width])), (device, DType::F32))
        };
        Supervision { depth: tensor(depth, 1), normal: tensor(normal, 3) }
    }
}

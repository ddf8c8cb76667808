//! Statistics of the views since the last refinement, by which primitives are pruned and copied. They stay on the device.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use dpges_core::losses::Target;
use dpges_core::ops::coverage::coverage;
use dpges_core::ops::splat::contributions;
use dpges_core::render::Render;
use dpges_core::scene::schema::Columns;
use dpges_core::scene::tensors::tensor_to_rows;

use super::RenderedView;

/// Most views whose errors are observed before new Gaussians are made.
const MOST_ERRORS: usize = 60;

/// Running maxima and sums over views.
#[derive(Clone, Debug)]
pub struct Statistics {
    /// [N] largest number of pixels of one view at which a surfel was the nearest.
    max_pixels: Tensor<1, Int>,
    /// [M] largest contribution of a Gaussian to a pixel, in units of colour.
    max_contributions: Tensor<1>,
    /// [M] sum over views of the largest product of a Gaussian's share of a pixel and the absolute error there, summed over
    /// channels: the error that the Gaussian answers for.
    errors: Tensor<1>,
}

impl Statistics {
    pub fn new(surfels: usize, gaussians: usize, device: &Device) -> Self {
        Self::from_rows(&vec![0; surfels], [&vec![0.0; gaussians]; 2], device)
    }

    /// From what [`max_pixels`](Self::max_pixels), and [`max_contributions`](Self::max_contributions) and
    /// [`errors`](Self::errors), returned.
    pub fn from_rows(max_pixels: &[u32], of_gaussians: [&Vec<f32>; 2], device: &Device) -> Self {
        let pixels: Vec<i32> = max_pixels.iter().map(|&count| i32::try_from(count).unwrap_or(i32::MAX)).collect();
        let pixels = TensorData::new(pixels, [max_pixels.len()]);
        let [max_contributions, errors] = of_gaussians
            .map(|rows| Tensor::from_data(TensorData::new(rows.clone(), [rows.len()]), (device, DType::F32)));
        Self { max_pixels: Tensor::from_data(pixels, (device, DType::I32)), max_contributions, errors }
    }

    pub fn max_pixels(&self) -> Vec<u32> {
        self.max_pixels.clone().into_data().iter::<i64>().map(|count| u32::try_from(count).unwrap_or(0)).collect()
    }

    pub fn max_contributions(&self) -> Vec<f32> {
        tensor_to_rows(&self.max_contributions)
    }

    pub fn errors(&self) -> Vec<f32> {
        tensor_to_rows(&self.errors)
    }

    /// Forgets what was observed of surfels; from now on there are `count`.
    pub fn reset_surfels(&mut self, count: usize) {
        self.max_pixels = Self::new(count, 0, &self.max_pixels.device()).max_pixels;
    }

    /// Keeps what was observed of the Gaussians that stay; the `added` ones begin with nothing.
    pub fn edit_gaussians(&mut self, keep: &[usize], added: usize) {
        let edited = |values: Vec<f32>| {
            keep.iter().map(|&row| values[row]).chain(std::iter::repeat_n(0.0, added)).collect::<Vec<f32>>()
        };
        let (contributions, errors) = (edited(self.max_contributions()), edited(self.errors()));
        let edited = Self::from_rows(&[], [&contributions, &errors], &self.errors.device());
        *self = Self { max_pixels: self.max_pixels.clone(), ..edited };
    }

    /// Forgets what was observed of Gaussians; from now on there are `count`.
    pub fn reset_gaussians(&mut self, count: usize) {
        *self = Self { max_pixels: self.max_pixels.clone(), ..Self::new(0, count, &self.errors.device()) };
    }

    /// Adds one view and its photograph, as far as the schedule needs it.
    pub fn observe(&mut self, view: &RenderedView<'_>) -> dpges_core::Result<()> {
        let (render, schedule, completed_steps) = (view.rendered, &view.stage.schedule, view.input.completed);
        let (camera, target, surfels) = (&view.input.view.camera, &view.input.target, view.surfels.len());
        // once nothing more will be pruned, views need not be observed for it
        let later = |steps: &[usize]| steps.last().is_some_and(|&last| completed_steps < last);
        let [own] = self.max_pixels.dims();
        if own > 0 && later(&schedule.surfel_prune) {
            let mut found = coverage(&render.layers, surfels);
            if surfels > own {
                found = found.narrow(0, 0, own);
            }
            self.max_pixels = self.max_pixels.clone().max_pair(found);
        }
        let [count] = self.errors.dims();
        let prunes = later(&schedule.gaussian_prune);
        let copies = schedule.next_copies(completed_steps).is_some_and(|next| next - completed_steps <= MOST_ERRORS);
        if count == 0 || !(prunes || copies) {
            return Ok(());
        }
        let gaussians = view.own_gaussians.map_ref(|_, values| values.clone().inner());
        let (limits, gates) = (render.seen.limits.clone().inner(), gates(render));
        if prunes {
            let mut colours = render.gaussian_colours.clone().inner();
            if colours.dims()[0] > count {
                colours = colours.slice([0..count, 0..3]);
            }
            let found = contributions(&gaussians, &colours, &limits, &gates, camera)?;
            self.max_contributions = self.max_contributions.clone().max_pair(found);
        }
        if copies {
            // white: a Gaussian answers for an error by its share of the pixel, whatever its colour
            let white = Tensor::ones([count, 3], (&self.errors.device(), DType::F32));
            let found = contributions(&gaussians, &white, &limits, &(gates * error(render, target)), camera)?;
            self.errors = self.errors.clone() + found;
        }
        Ok(())
    }
}

/// [1, H, W] absolute error summed over channels; 0 where pixels do not count.
fn error(render: &Render, target: &Target) -> Tensor<3> {
    let image = render.composite.image.clone().inner();
    let error = (image - target.image.clone().inner()).abs().sum_dim(0);
    match &target.mask {
        Some(mask) => mask.clone().inner().filled(error, 0.0),
        None => error,
    }
}

/// [K, H, W] weight of each depth interval in a pixel: T_{k−1} / (1 + W_G).
fn gates(render: &Render) -> Tensor<3> {
    let layers = render.layers.ids.dims()[0];
    // what the last layer lets through gates no interval
    let transmittance = render.seen.transmittance.clone().inner().slice_dim(0, 0..layers);
    transmittance / (render.composite.gaussian_weight.clone().inner() + 1.0)
}

//! Measured points that surfels keep their distance to: a laser knows better than photographs where a bare wall is.

use std::sync::Arc;

use burn::tensor::{DType, Device, Tensor};
use dpges_core::losses::Losses;
use dpges_core::losses::points::point_distance;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};
use rayon::prelude::*;

use super::super::Context;
use super::RenderedView;
use crate::dataset::Dataset;
use crate::dataset::neighbours::{Sites, as_points};
use crate::optimizer::unit_of;

/// Steps from one search for nearest points to the next.
const EVERY: usize = 100;
/// Points that say how far apart points are, and how many times as far a surfel may be from the nearest: farther ones are surfaces of
/// which nothing was measured.
const NEIGHBOURS: usize = 4;
const REACH: f32 = 3.0;

/// The points of the dataset, and which of them each surfel is held to.
pub struct MeasuredPoints {
    dataset: Arc<Dataset>,
    sites: Sites,
    /// [N, 4] as in [`point_distance`].
    targets: Tensor<2>,
    /// Weight of the loss, per world unit.
    weight: f64,
}

impl MeasuredPoints {
    /// For surfels at `positions` [N, 3]; `None` if the run holds them to no points.
    pub fn new(positions: &Tensor<2>, context: &Context) -> Option<Self> {
        let (dataset, lambda) = (&context.whole, context.config.train.lambda_points);
        if lambda == 0.0 {
            return None;
        }
        let sites = Sites::new(&dataset.points.positions);
        let mut measured = Self {
            sites,
            targets: Tensor::zeros([0, 4], (&context.device, DType::F32)),
            weight: lambda / unit_of(dataset.extent),
            dataset: Arc::clone(dataset),
        };
        measured.measure(positions);
        Some(measured)
    }

    /// Looks for the nearest points anew, for surfels at `positions` [N, 3].
    pub fn measure(&mut self, positions: &Tensor<2>) {
        let positions = tensor_to_rows(positions);
        let target = |&position: &[f32; 3]| self.target(position).map_or([0.0; 4], |[x, y, z]| [x, y, z, 1.0]);
        let targets: Vec<[f32; 4]> = as_points(&positions).par_iter().map(target).collect();
        self.restore(targets.as_flattened(), &self.targets.device());
    }

    /// The point next to a surfel, if that is not farther than a few spacings of the points there.
    fn target(&self, position: [f32; 3]) -> Option<[f32; 3]> {
        let near = self.sites.nearest(position, NEIGHBOURS, None);
        let point = |row: u32| self.dataset.points.positions[row as usize];
        let &(nearest, squared) = near.first()?;
        let apart = |&(other, _): &(u32, f32)| {
            point(nearest).iter().zip(point(other)).map(|(a, b)| (a - b).powi(2)).sum::<f32>()
        };
        let spacing = near[1..].iter().map(apart).sum::<f32>() / (near.len() - 1).max(1) as f32;
        (squared <= REACH * REACH * spacing).then(|| point(nearest))
    }

    /// Whether it is time to look anew after the step that follows `completed` ones.
    pub fn is_due(completed: usize) -> bool {
        (completed + 1).is_multiple_of(EVERY)
    }

    /// Takes what [`column`](Self::column) returned.
    pub fn restore(&mut self, column: &[f32], device: &Device) {
        self.targets = rows_to_tensor(column, 4, device, DType::F32);
    }

    pub fn column(&self) -> Vec<f32> {
        tensor_to_rows(&self.targets)
    }
}

/// The distance of surfels to measured points.
pub fn points(view: &RenderedView<'_>, losses: &mut Losses) -> dpges_core::Result<()> {
    if let Some(MeasuredPoints { targets, weight, .. }) = &view.stage.measured {
        losses.add("points", point_distance(view.own_surfels, targets.clone().autodiff())?, *weight);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::builtin;
    use crate::run::fixtures::{config, device, options};

    #[test]
    fn surfels_are_held_to_the_nearest_point_within_a_few_spacings() {
        let mut data = builtin(&options(8, [2, 1], 0));
        // a plane of points a tenth apart
        let plane = |at: usize| [(at % 20) as f32 * 0.1, (at / 20) as f32 * 0.1, 0.0];
        data.points.positions = (0..400).map(plane).collect();
        let context = Context::new(config(&["train.lambda_points=0.5"]), Arc::new(data), device().into());
        let at = [0.52, 0.93, 0.1, 0.5, 0.9, 0.35, f32::NAN, 0.0, 0.0];
        let measured = MeasuredPoints::new(&rows_to_tensor(&at, 3, &device(), DType::F32), &context).unwrap();
        let expected = [[0.5, 0.9, 0.0, 1.0], [0.0; 4], [0.0; 4]];
        let found = measured.column();
        assert!(found.iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?}");
        assert_eq!(found.len(), 12);
        let off = Context::new(config(&[]), Arc::clone(&context.whole), device().into());
        assert!(MeasuredPoints::new(&rows_to_tensor(&at, 3, &device(), DType::F32), &off).is_none());
    }
}

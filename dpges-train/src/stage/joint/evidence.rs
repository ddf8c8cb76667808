//! Surfels have to earn their place: they enter where trained Gaussians agree about a surface, and leave where pictures are
//! better without them.

use std::sync::Arc;

use burn::tensor::{DType, Tensor};
use dpges_core::losses::Target;
use dpges_core::losses::geometry::expected_depth;
use dpges_core::ops::blend::Maps;
use dpges_core::ops::environment::environment;
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::render::{Render, RenderOptions, Values, render_values};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Gaussians, Rendering, SceneInfo, ScreenFilter, SurfelData, Surfels};

use super::super::{Context, TrainError};
use super::JointStage;
use super::refine::squared_error;
use crate::dataset::image::cache::Cache;
use crate::dataset::{Masked, Picture, View, pictures};
use crate::init::fusion::{CHECKED_VIEWS, DepthViews, FusionRule, surface_points};
use crate::init::surfels_at;
use crate::refine::RowEdit;
use crate::refine::worth::{Worths, members};
use crate::views::exposure::{Correction, Seen};

/// Least alpha of a pixel that may show a surface.
const OPAQUE: f32 = 0.9;
/// Largest difference between the mean and the median depth of a pixel that shows one surface, relative to the median.
const OF_ONE_DEPTH: f32 = 0.03;
/// Depths that differ by less agree.
const RULE: FusionRule = FusionRule { tolerance: 0.015, min_views: 3 };
/// Distances between surface points that are tried, px: the first that fits the share of surfels is taken.
const STRIDES_PX: [usize; 7] = [3, 4, 6, 8, 12, 16, 24];
/// Views that judge surfels: enough to see most of them several times.
const JUDGING_VIEWS: usize = 24;
/// Surfels are judged in as many groups. The fewer neighbours a surfel is left out with, the better its own effect shows.
const GROUPS: usize = 3;

impl Context {
    /// Whether there are enough views to agree about a surface. Otherwise surfels start as `[init]` says.
    pub fn has_views_to_agree(&self) -> bool {
        self.dataset.train.len() > RULE.min_views
    }

    /// Surfels on the surfaces that blended `gaussians` show to several training views. Margins are zero.
    ///
    /// # Errors
    /// [`TrainError::Core`] if the Gaussians cannot be rendered, or a photograph not be read again.
    pub fn surfels_of_depth(
        &mut self,
        gaussians: &GaussianData,
        filter: ScreenFilter,
    ) -> Result<SurfelData, TrainError> {
        let dataset = self.dataset.clone();
        let most = self.most_primitives(self.config.stages.depth_surfels);
        let info = SceneInfo { screen_filter: filter, ..self.scene_info(Rendering::Ellipsoids) };
        let gaussians = Gaussians::from_data(gaussians, &self.device, DType::F32);
        let mut options = BlendedOptions::new(&info)?;
        options.blend.maps = true;
        // those that are checked beside one stay, whatever the room
        let maps = Cache::new(dataset.spare_memory, CHECKED_VIEWS + 1);
        let depth = |index: usize| -> dpges_core::Result<Arc<Vec<f32>>> {
            let view = &dataset.train[index];
            maps.get(index, size_of::<f32>() * view.camera.width * view.camera.height, || {
                let rendered = render_blended(&gaussians, None, &view.camera, &options, Values::KnownFinite)?;
                let alpha = rendered.blend.alpha;
                let Some(Maps { depth, median_depth, .. }) = rendered.blend.maps else {
                    unreachable!("maps were asked for")
                };
                let mean = tensor_to_rows(&expected_depth(depth, alpha.clone()));
                let mut depth = certain(&tensor_to_rows(&alpha), &mean, tensor_to_rows(&median_depth));
                view.picture()?.clear_ignored(&mut depth);
                Ok(depth)
            })
        };
        let corrections = self.exposure.corrections();
        let photograph = |index: usize| Seen::by(&dataset.train[index], corrections.of(index));
        let cameras = dataset.train.iter().map(|view| &view.camera).collect();
        let views = DepthViews { cameras, depth: &depth, photograph: &photograph };
        let mut points = surface_points(&views, STRIDES_PX[0], RULE)?;
        let mut stride_px = STRIDES_PX[0];
        for stride in &STRIDES_PX[1..] {
            if points.positions.len() <= most {
                break;
            }
            stride_px = *stride;
            points = surface_points(&views, stride_px, RULE)?;
        }
        let found = points.positions.len();
        let points = crate::init::sfm::usable_points(&points, most, &mut self.rng);
        tracing::info!(
            "{found} points on surfaces that at least {} views agree about, about {stride_px} px from one another: {} \
             surfels",
            RULE.min_views + 1,
            points.positions.len()
        );
        Ok(surfels_at(points, &dataset, &self.config, &mut self.rng))
    }
}

/// [H × W] `median` depths where a pixel is opaque and of one depth, else 0.
fn certain(alpha: &[f32], mean: &[f32], mut median: Vec<f32>) -> Vec<f32> {
    for (pixel, median) in median.iter_mut().enumerate() {
        let of_one_depth = (mean[pixel] - *median).abs() <= OF_ONE_DEPTH * *median;
        if !(alpha[pixel] >= OPAQUE && of_one_depth) {
            *median = 0.0;
        }
    }
    median
}

impl JointStage {
    /// Removes surfels without which the judging views are better. Returns what it did, if there are surfels.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a view cannot be rendered.
    pub fn judge_surfels(&mut self, context: &Context) -> Result<Option<String>, TrainError> {
        if self.surfels.is_empty() {
            return Ok(None);
        }
        let (surfels, gaussians) = (self.drawn_surfel_data(), self.drawn_values().1);
        let options = self.render_options(&context.config);
        let behind = self.environment.value();
        let worths = judged(&surfels, &gaussians, behind.as_ref(), &options, context)?;
        let rows = RowEdit { keep: worths.worthy() };
        let removed = surfels.len() - rows.keep.len();
        let lost: f64 = worths.saved.iter().filter(|&&saved| saved < 0.0).sum();
        let saved: f64 = worths.saved.iter().filter(|&&saved| saved > 0.0).sum();
        self.surfels.keep(&rows);
        self.measure_surfel_limit(context);
        self.statistics.keep_surfels(&rows);
        let judging = Masked::of(judging_views(context));
        let pixels = 3 * (judging.pixels - judging.ignored_pixels);
        let mean = |squares: f64| squares / pixels.max(1) as f64;
        Ok(Some(format!(
            "{removed} of {} surfels removed that cost a squared error of {:.2e} per value of {} views; the others save {:.2e}",
            surfels.len(),
            mean(-lost),
            judging.views,
            mean(saved)
        )))
    }
}

/// The views that judge surfels: validation views, or else training views, evenly spread.
pub fn judging_views(context: &Context) -> impl Iterator<Item = &View> {
    let (validation, train) = (&context.dataset.validation, &context.dataset.train);
    let views = if validation.is_empty() { train } else { validation };
    views.iter().step_by(views.len().div_ceil(JUDGING_VIEWS).max(1))
}

/// The photograph of a judging view on the device. In a run that corrects exposures, without what the exposure that fits
/// best explains of its difference from the rendered `image` [3, H, W]: validation views have no correction of their own.
pub fn judging_target(picture: &Picture, image: &Tensor<3>, context: &Context) -> Target {
    let Target { image: photograph, mask } = picture.target(&context.device);
    if !context.exposure.is_on() {
        return Target { image: photograph, mask };
    }
    let correction = Correction::fitted(image, &photograph, picture.counted.as_deref());
    Target { image: correction.undone(photograph), mask }
}

fn judged(
    surfels: &SurfelData,
    gaussians: &Gaussians,
    behind: Option<&Tensor<2>>,
    options: &RenderOptions,
    context: &Context,
) -> Result<Worths, TrainError> {
    let device = &context.device;
    let mut worths = Worths::new(surfels.len());
    let on_device = |surfels: &SurfelData| Surfels::from_data(surfels, device, DType::F32);
    let render = |surfels: &Surfels, view: &View| -> Result<Render, TrainError> {
        let rendered = render_values(surfels, gaussians, &view.camera, options, Values::KnownFinite)?;
        Ok(match behind {
            Some(coefficients) => rendered.in_front_of(environment(coefficients, &view.camera)?),
            None => rendered,
        })
    };
    let all = on_device(surfels);
    let groups = (0..GROUPS).map(|group| {
        let left_out = members(surfels.len(), group, GROUPS);
        let others: Vec<usize> = (0..surfels.len()).filter(|&row| !left_out[row]).collect();
        (on_device(&surfels.select(&others)), left_out)
    });
    let groups: Vec<_> = groups.collect();
    for (view, picture) in pictures(judging_views(context)) {
        let picture = picture?;
        let with = render(&all, view)?;
        let target = judging_target(&picture, &with.composite.image, context);
        let area = view.camera.width * view.camera.height;
        let nearest: Vec<i32> = with.layers.ids.clone().into_data().iter::<i32>().take(area).collect();
        let with = squared_error(&with, &target);
        for (others, left_out) in &groups {
            let without = squared_error(&render(others, view)?, &target);
            worths.add(&nearest, &with, &without, left_out);
        }
    }
    Ok(worths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_are_certain_where_a_pixel_is_opaque_and_of_one_depth() {
        let (alpha, mean) = ([1.0, 0.5, 0.95, 0.95, 1.0], [2.0, 2.0, 2.05, 2.1, f32::NAN]);
        assert_eq!(certain(&alpha, &mean, vec![2.0, 2.0, 2.0, 2.0, 2.0]), [2.0, 0.0, 2.0, 0.0, 0.0]);
    }
}

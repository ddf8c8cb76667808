//! Applies the decisions of [`crate::refine`] to surfels and Gaussians.

use std::collections::HashSet;

use burn::tensor::{DType, Tensor};
use dpges_core::camera::Camera;
use dpges_core::losses::Target;
use dpges_core::ops::environment::environment;
use dpges_core::ops::splat::splat;
use dpges_core::render::{Render, Values, render_values};
use dpges_core::scene::Gaussians;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};
use glam::DVec3;

use super::super::context::mean_pixels;
use super::super::{Context, TrainError};
use super::JointStage;
use crate::config::{AddAs, Budget, Due, PixelsOf};
use crate::dataset::{View, pictures};
use crate::exposure::Seen;
use crate::refine::add::{batch_size, draw_in_proportion, gaussians_of_pixels, new_gaussians};
use crate::refine::agreement::{agreed_depth, nearest_views};
use crate::refine::margins::margins;
use crate::refine::prune::{drawn, gaussians_to_keep, surfels_to_keep};
use crate::refine::split::split;
use crate::refine::{GaussianEdit, RowEdit};
use crate::sight::{Floaters, Sights};

/// Pixels that are drawn for each that other views shall confirm.
const UNCONFIRMED: usize = 3;
/// Largest scale of an added Gaussian, as a fraction of the extent.
const MAX_ADDED_SCALE: f64 = 0.01;

impl JointStage {
    /// Does what is `due` in the order prune, margins, split, add. Returns a sentence for each thing it did.
    pub fn refine_due(&mut self, due: Due, context: &mut Context) -> Result<Vec<String>, TrainError> {
        let mut events = Vec::new();
        let ends_interval = due.batches_left.is_some() || due.replace;
        let measured = if ends_interval { self.end_interval(context, &mut events)? } else { None };
        let told = events.len();
        if due.surfel_prune {
            events.push(self.prune_surfels(context));
        }
        if due.gaussian_prune {
            events.push(self.prune_gaussians(context));
        }
        if due.judge_surfels {
            events.extend(self.judge_surfels(context)?);
        }
        if due.margins || (due.surfel_prune && context.config.refine.margins_with_pruning) {
            let surfels = self.drawn_surfel_data();
            let margins = margins(&surfels.positions, &surfels.log_scales, context.config.model.margin);
            self.surfels.columns.margins.set(&margins);
            events.push(format!("margins of {} surfels computed", surfels.len()));
        }
        if due.margins {
            let begun = context.completed_steps > self.plan.begin;
            if begun && context.config.refine.budget == Budget::Auto {
                events.push(self.choose_layer_count(context)?);
            }
        }
        if due.drop_lobes {
            events.extend(self.drop_lobes(context)?);
        }
        if due.split {
            events.push(self.split_gaussians(context));
        }
        if context.config.refine.clear_sight && (due.batches_left.is_some() || due.replace) {
            events.extend(self.clear_sight(context)?);
        }
        if due.control {
            self.begin_control(context)?;
        }
        if due.batches_left.is_some() || due.replace {
            let removed = self.remove_undrawn(context);
            if context.config.refine.budget == Budget::Auto {
                // what else was due may have changed the views
                let measured = measured.filter(|_| events.len() == told);
                events.extend(self.grow(context, due.batches_left, removed, measured)?);
            } else {
                let primitives = self.surfels.len() + self.gaussians.len();
                let count = batch_size(context.budget, primitives, due.batches_left.unwrap_or(1));
                events.push(self.add_gaussians(context, count, removed)?);
            }
        }
        Ok(events)
    }

    fn prune_surfels(&mut self, context: &Context) -> String {
        let refine = &context.config.refine;
        let log_scales = tensor_to_rows(&self.surfels.columns.log_scales.raw());
        let edit = surfels_to_keep(
            &self.statistics.max_pixels(),
            &log_scales,
            self.info.extent,
            match refine.surfel_pixels_of {
                PixelsOf::Picture => refine.surfel_min_pixels,
                PixelsOf::Megapixel => min_pixels(refine.surfel_min_pixels, mean_pixels(&context.dataset)),
            },
            refine.surfel_max_scale,
        );
        let before = self.surfels.len();
        self.surfels.keep(&edit);
        self.measure_surfel_limit(context);
        self.statistics.reset_surfels(self.surfels.len());
        format!("{} of {before} surfels pruned", before - self.surfels.len())
    }

    fn prune_gaussians(&mut self, context: &Context) -> String {
        let rows =
            gaussians_to_keep(&self.statistics.max_contributions(), context.config.refine.gaussian_min_contribution);
        let before = self.gaussians.len();
        self.edit_gaussians(&GaussianEdit { rows, ..GaussianEdit::default() }, context);
        format!("{} of {before} Gaussians pruned", before - self.gaussians.len())
    }

    /// Removes what hides points from views that saw them; `None` if the dataset does not say which view saw what.
    fn clear_sight(&mut self, context: &Context) -> Result<Option<String>, TrainError> {
        let (surfels, gaussians) = self.drawn_values();
        let options = self.render_options(&context.config).peel;
        let Some(sights) = Sights::measure(&surfels, &gaussians, &options, &context.dataset)? else { return Ok(None) };
        let Floaters { surfels, gaussians } = sights.floaters();
        if surfels > 0 && !context.config.train.freeze_surfels {
            let rows = RowEdit::retain(self.surfels.len(), |&row| !sights.surfels[row].floats());
            self.surfels.keep(&rows);
            self.measure_surfel_limit(context);
            self.statistics.keep_surfels(&rows);
        }
        if gaussians > 0 {
            let rows = RowEdit::retain(self.gaussians.len(), |&row| !sights.gaussians[row].floats());
            self.edit_gaussians(&GaussianEdit { rows, ..GaussianEdit::default() }, context);
        }
        Ok(Some(format!(
            "{surfels} surfels and {gaussians} Gaussians removed that hide points from views that saw them, or float \
             close to a camera"
        )))
    }

    fn split_gaussians(&mut self, context: &mut Context) -> String {
        self.remove_undrawn(context);
        let surfels = self.surfels.to_data();
        let room = context.budget.saturating_sub(self.surfels.len() + self.gaussians.len());
        let before = self.gaussians.len();
        let factor = context.config.refine.split_factor;
        let gaussians = self.gaussians.to_data();
        let (edit, too_large) = split(&gaussians, &surfels.positions, &surfels.margins, factor, room, &mut context.rng);
        self.edit_gaussians(&edit, context);
        format!("{} of {too_large} Gaussians split that are too large, of {before}", self.gaussians.len() - before)
    }

    /// Removes Gaussians that draw nothing. Returns how many.
    fn remove_undrawn(&mut self, context: &Context) -> usize {
        let before = self.gaussians.len();
        let rows = drawn(&self.gaussians.opacities());
        self.edit_gaussians(&GaussianEdit { rows, ..GaussianEdit::default() }, context);
        before - self.gaussians.len()
    }

    /// Adds a batch of `count` Gaussians after as many as were `removed` have left. Their pixels are drawn with a
    /// probability in proportion to the squared error, none where a view shows nothing but sky or pixels do not count. They
    /// take the depth of the nearest layer (GES, DP-GES), or the mean depth of existing Gaussians where there is no layer
    /// and `refine.add_everywhere` asks for it.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a view cannot be rendered, or a photograph not be read again.
    pub fn add_gaussians(&mut self, context: &mut Context, count: usize, removed: usize) -> Result<String, TrainError> {
        let everywhere = context.config.refine.add_everywhere;
        let views = context.dataset.train.len();
        let dataset = context.dataset.clone();
        let least = context.config.refine.add_agreement;
        let neighbours = if least > 0 { nearest_views(&context.dataset.train) } else { Vec::new() };
        let corrections = context.exposure.corrections();
        let mut spots = Spots::default();
        let share = |index: usize| count / views + usize::from(index < count % views);
        // the others have no share
        for (index, (view, picture)) in pictures(dataset.train.iter().take(count)).enumerate() {
            let own = Seen { camera: &view.camera, picture: picture?, correction: corrections.of(index) };
            let share = share(index);
            let rendered = self.render_view(context, view)?;
            let mut error = squared_error(&rendered, &own.target(&context.device));
            if let Some(sky) = &self.sky {
                sky.clear(index, &own.picture, &mut error);
            }
            let drawn = if least > 0 { UNCONFIRMED * share } else { share };
            let pixels = draw_in_proportion(&error, drawn, &mut context.rng);
            let mut depths = tensor_to_rows(&rendered.layers.depth);
            if everywhere && pixels.iter().any(|&pixel| !depths[pixel].is_finite()) {
                let behind = gaussian_depth(&self.drawn_values().1, &rendered.limits, &view.camera)?;
                depths.iter_mut().zip(behind).filter(|(depth, _)| !depth.is_finite()).for_each(|(d, z)| *d = z);
            }
            let others: Vec<Seen> = match neighbours.get(index) {
                Some(others) => {
                    let seen = |&other: &usize| Seen::by(&dataset.train[other], corrections.of(other));
                    others.iter().map(seen).collect::<Result<_, _>>()?
                }
                None => Vec::new(),
            };
            let agreed = |pixel: usize| {
                let assumed = f64::from(depths[pixel]);
                if least == 0 { Some(assumed) } else { agreed_depth(&own, &others, pixel, assumed, least) }
            };
            let mut taken = HashSet::new();
            let known = pixels.iter().filter(|&&pixel| depths[pixel].is_finite());
            let known = known.filter(|&&pixel| least == 0 || taken.insert(pixel));
            let found = known.filter_map(|&pixel| Some((pixel, agreed(pixel)?)));
            spots.add(&own, found.take(share));
        }
        let (model, rng) = (self.info.colour_model, &mut context.rng);
        let added = match context.config.refine.add_as {
            AddAs::Picture => gaussians_of_pixels(&spots.positions, &spots.pixel_sizes, &spots.colours, model, rng),
            AddAs::Black => new_gaussians(&spots.positions, (MAX_ADDED_SCALE * self.info.extent) as f32, model, rng),
        };
        let rows = RowEdit::keep_all(self.gaussians.len());
        let event = format!("{removed} Gaussians that draw nothing removed, {} added of {count} wanted", added.len());
        self.edit_gaussians(&GaussianEdit { rows, added }, context);
        Ok(event)
    }

    /// Edits the set of Gaussians and restarts what was measured of them.
    fn edit_gaussians(&mut self, edit: &GaussianEdit, context: &Context) {
        self.gaussians.edit(edit);
        self.measure_gaussian_limit(context);
        self.statistics.reset_gaussians(self.gaussians.len());
    }

    /// Renders a view of the scene as it stands, without a tape.
    ///
    /// # Errors
    /// [`TrainError::Core`] if it cannot be rendered.
    pub fn render_view(&self, context: &Context, view: &View) -> Result<Render, TrainError> {
        let (surfels, gaussians) = self.drawn_values();
        let options = self.render_options(&context.config);
        let rendered = render_values(&surfels, &gaussians, &view.camera, &options, Values::KnownFinite)?;
        Ok(match self.environment.value() {
            Some(coefficients) => rendered.in_front_of(environment(&coefficients, &view.camera)?),
            None => rendered,
        })
    }
}

/// The threshold that is the same share of a view of `pixels` px as `per_megapixel` of 10⁶ px, rounded up: in small views,
/// too, a threshold removes something.
fn min_pixels(per_megapixel: usize, pixels: usize) -> usize {
    (per_megapixel as f64 * pixels as f64 / 1e6).ceil() as usize
}

/// [H × W] squared error summed over channels; 0 where pixels do not count.
pub fn squared_error(rendered: &Render, target: &Target) -> Vec<f32> {
    let difference = rendered.composite.image.clone() - target.image.clone();
    let error = (difference.clone() * difference).sum_dim(0);
    tensor_to_rows(&match &target.mask {
        Some(mask) => mask.filled(error, 0.0),
        None => error,
    })
}

/// [H × W] mean depth at each pixel of the Gaussians in front of the last of `limits` [K, H, W], weighted by their α, in
/// world units. It is not finite where there are none.
fn gaussian_depth(gaussians: &Gaussians, limits: &Tensor<3>, camera: &Camera) -> Result<Vec<f32>, TrainError> {
    let positions = tensor_to_rows(&gaussians.positions);
    let depth = |position: &[f32; 3]| camera.depth(DVec3::from_array(position.map(f64::from))) as f32;
    let depths: Vec<f32> = positions.as_chunks::<3>().0.iter().flat_map(|position| [depth(position); 3]).collect();
    let depths = rows_to_tensor(&depths, 3, &gaussians.positions.device(), DType::F32);
    let sums = tensor_to_rows(&splat(gaussians, &depths, limits, camera)?.sum_dim(0));
    let area = camera.width * camera.height;
    Ok((0..area).map(|pixel| sums[pixel] / sums[3 * area + pixel]).collect())
}

/// Where Gaussians are added.
#[derive(Default)]
struct Spots {
    /// World units.
    positions: Vec<[f32; 3]>,
    /// World units per px.
    pixel_sizes: Vec<f32>,
    /// Of the photograph, without what its exposure has changed.
    colours: Vec<[f32; 3]>,
}

impl Spots {
    /// Adds pixels of a view at their depths, world units.
    fn add(&mut self, seen: &Seen<'_>, pixels: impl Iterator<Item = (usize, f64)>) {
        let camera = seen.camera;
        for (pixel, depth) in pixels {
            let (x, y) = ((pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5);
            self.positions.push(camera.unproject(x, y, depth).as_vec3().to_array());
            self.pixel_sizes.push((depth / camera.fx.max(camera.fy)) as f32);
            self.colours.push(seen.colour(pixel));
        }
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use dpges_core::scene::{ColourData, GaussianData};

    use super::*;
    use crate::device::DeviceName;

    #[test]
    fn thresholds_per_megapixel_remain_thresholds_in_small_views() {
        let found = [1_000_000, 500_000, 62_500, 62_501, 250 * 250 / 4, 1].map(|pixels| min_pixels(16, pixels));
        assert_eq!(found, [16, 8, 1, 2, 1, 1]);
        assert_eq!((min_pixels(0, 250), min_pixels(1, 400 * 400)), (0, 1));
    }

    #[test]
    fn the_depth_of_gaussians_is_their_mean_where_they_are() {
        let camera_from_world = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -1.0), DVec3::ZERO, -DVec3::Y);
        let (width, height) = (16, 8);
        let camera =
            Camera { camera_from_world, fx: 16.0, fy: 16.0, cx: 8.0, cy: 4.0, width, height, near: 0.01, lens: None };
        // in the middle at depths 1 and 3, as wide on the screen and as opaque; on the right behind the limit
        let scales = [0.1f32, 0.1, 1e-4, 0.3, 0.3, 1e-4, 0.1, 0.1, 1e-4];
        let gaussians = GaussianData {
            positions: vec![0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 1.6, 0.0, 4.0],
            quaternions: [1.0, 0.0, 0.0, 0.0].repeat(3),
            log_scales: scales.iter().map(|scale| scale.ln()).collect(),
            opacities: vec![0.5; 3],
            colour: ColourData { base: vec![0.0; 9], ..ColourData::default() },
        };
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let gaussians = Gaussians::from_data(&gaussians, &device, DType::F32);
        let limits = Tensor::full([1, height, width], 4.5, (&device, DType::F32));
        let depth = gaussian_depth(&gaussians, &limits, &camera).unwrap();
        assert!((depth[4 * width + 8] - 2.0).abs() < 1e-3, "{}", depth[4 * width + 8]);
        assert!(!depth[0].is_finite() && !depth[4 * width + 13].is_finite());
    }
}

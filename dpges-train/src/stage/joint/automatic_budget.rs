//! The decisions of an automatic budget, by validation views: how long the scene grows, how many layers it peels, and which
//! lobes it does without.

use std::sync::Arc;

use dpges_core::losses::Target;
use dpges_core::ops::peel::MAX_LAYERS;
use dpges_core::render::{Values, render_on_ranks};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{ColourData, ColourModel};

use super::super::{Context, TrainError};
use super::JointStage;
use super::judging::{judging_target, judging_views};
use crate::config::HARD_RIM;
use crate::dataset::{Picture, View, pictures};
use crate::eval::LARGEST_PSNR;
use crate::metrics::{psnr, quantised};
use crate::refine::add::geometric_batch_size;
use crate::refine::growth::{Growth, Mean, Next, batches_within};
use crate::refine::layer_count::{MOST_OPEN, choose, open_share};
use crate::refine::lobes::{drop_lobes, spare_lobes};

/// A lobe is dropped if its absence changes no colour by more than this: half a step of an 8-bit picture.
const UNSEEN: f64 = 0.5 / 255.0;
/// dB that validation views may lose by all lobes dropped at once. Many invisible changes may add up.
const MOST_LOST: f64 = 0.01;

impl JointStage {
    /// Ends the interval of growth that is running, and tells `events` what it has shown. Returns the PSNR of the judging
    /// views, dB; `None` if no interval was running.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a view cannot be rendered.
    pub fn end_interval(
        &mut self,
        context: &Context,
        events: &mut Vec<String>,
    ) -> Result<Option<Vec<f64>>, TrainError> {
        if !self.growth.as_ref().is_some_and(Growth::is_running) {
            return Ok(None);
        }
        let psnr = self.psnr_of_views(context)?;
        let completed = context.completed_in(self.plan);
        let found = self.growth.as_mut().and_then(|growth| growth.end(completed, &psnr));
        events.extend(found.map(|found| found.to_string()));
        Ok(Some(psnr))
    }

    /// Begins the first interval of growth, which shows what training does alone.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a view cannot be rendered.
    pub fn begin_control(&mut self, context: &Context) -> Result<(), TrainError> {
        let psnr = self.psnr_of_views(context)?;
        let (completed, primitives) = (context.completed_in(self.plan), self.primitives());
        self.growth.get_or_insert_default().begin(completed, psnr, primitives, 0);
        Ok(())
    }

    /// Begins the next interval of growth, the first of `intervals_left`, after Gaussians were `removed`: with a batch or, as
    /// a control, without one. Once growth has ended, and if none is left, it adds as many as were removed. `measured` is
    /// the PSNR of the judging views, dB, if it is known. Returns a sentence for each thing it did.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a view cannot be rendered.
    pub fn grow(
        &mut self,
        context: &mut Context,
        intervals_left: Option<usize>,
        removed: usize,
        measured: Option<Vec<f64>>,
    ) -> Result<Vec<String>, TrainError> {
        let (primitives, budget) = (self.primitives(), context.budget);
        let mut events = Vec::new();
        let growth = self.growth.get_or_insert_default();
        let next = growth.next();
        let is_full = next == Next::Batch && primitives >= budget;
        let count = match intervals_left {
            Some(intervals_left) if next == Next::Batch && !is_full => {
                geometric_batch_size(budget, primitives, batches_within(intervals_left))
            }
            Some(_) if next == Next::Control => 0,
            _ => {
                if next != Next::Nothing {
                    growth.finish();
                    let why = if is_full { "at its limit" } else { "with the schedule" };
                    events.push(format!("growth stops {why}, at {primitives} of {budget} primitives"));
                }
                removed.min(budget.saturating_sub(primitives))
            }
        };
        if growth.next() == Next::Nothing {
            events.push(self.add_gaussians(context, count, removed)?);
            return Ok(events);
        }
        let psnr = measured.map_or_else(|| self.psnr_of_views(context), Ok)?;
        let before = self.dealt.len();
        events.push(self.add_gaussians(context, count, removed)?);
        let (completed, added) = (context.completed_in(self.plan), self.dealt.len() - before);
        self.growth.get_or_insert_default().begin(completed, psnr, primitives, added);
        Ok(events)
    }

    /// PSNR of the judging views, dB, as evaluations measure it.
    fn psnr_of_views(&self, context: &Context) -> Result<Vec<f64>, TrainError> {
        let of_view = |(view, picture): (&View, dpges_core::Result<Arc<Picture>>)| -> Result<f64, TrainError> {
            let picture = picture?;
            let rendered = self.render_view(context, view)?;
            let image = rendered.composite.image;
            let Target { image: target, mask } = judging_target(&picture, &image, context);
            let target = Target { image: quantised(target), mask };
            Ok(psnr(quantised(image), target).clamp(0.0, LARGEST_PSNR))
        };
        let psnr = pictures(judging_views(context)).map(of_view).collect::<Result<_, _>>()?;
        Ok(self.dealt.ranks.of_first(psnr))
    }

    /// Chooses the smallest number of layers that leaves hardly any pixel of the validation views open; soft rims need two.
    pub fn choose_layer_count(&mut self, context: &Context) -> Result<String, TrainError> {
        let psnr_before = self.psnr_of_views(context)?;
        let mut options = self.render_options(&context.config);
        options.peel.layer_count = MAX_LAYERS;
        let (surfels, gaussians) = self.drawn_values();
        let mut shares = vec![0.0; MAX_LAYERS];
        let views = &context.dataset.validation;
        for view in views {
            let (camera, ranks) = (&view.camera, &*self.dealt.ranks);
            let rendered = render_on_ranks(&surfels, &gaussians, camera, None, &options, Values::KnownFinite, ranks)?;
            let pixels = view.camera.width * view.camera.height;
            let open = open_share(&tensor_to_rows(&rendered.composite.transmittance), pixels);
            shares.iter_mut().zip(open).for_each(|(sum, share)| *sum += share / views.len() as f64);
        }
        let fewest = if self.info.modulation < HARD_RIM { 2 } else { 1 };
        let (before, after) = (self.info.layer_count, choose(&shares, MOST_OPEN, fewest));
        self.info.layer_count = after;
        let change = Mean::of_changes(&psnr_before, &self.psnr_of_views(context)?);
        let percents: Vec<String> = shares.iter().map(|share| format!("{:.2}", 100.0 * share)).collect();
        Ok(format!(
            "{after} layers instead of {before}: behind 1, 2, … layers {} % of the covered pixels let more than 1/255 \
             through; up to {} % more than behind the last may do so; validation PSNR {change} by that",
            percents.join(", "),
            100.0 * MOST_OPEN
        ))
    }

    /// Drops the lobes whose absence no camera would show, unless validation views lose clearly by all of them together.
    /// `None` if colours have no lobes.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a view cannot be rendered.
    pub fn drop_lobes(&mut self, context: &Context) -> Result<Option<String>, TrainError> {
        let ColourModel::SphericalBeta { lobes } = self.info.colour_model else { return Ok(None) };
        let psnr_before = self.psnr_of_views(context)?;
        let dataset = &context.dataset;
        let views = dataset.train.iter().chain(&dataset.validation);
        let centres: Vec<[f64; 3]> = views.map(|view| view.camera.centre().to_array()).collect();
        let (surfels, gaussians) = (self.surfels.columns.positions.raw(), self.gaussians.columns.positions.raw());
        let all = [self.surfels.colour(), self.gaussians.colour()];
        let [mut surfel_colour, mut gaussian_colour] = all.clone();
        let drop = |positions: &[f32], colour: &mut ColourData| {
            let spare = spare_lobes(positions, colour, lobes, &centres, UNSEEN);
            let found = drop_lobes(colour, lobes, &spare);
            [found.idle as f64, found.folded as f64]
        };
        let of_surfels = drop(&tensor_to_rows(&surfels), &mut surfel_colour);
        let mut of_gaussians = drop(&tensor_to_rows(&gaussians), &mut gaussian_colour);
        self.dealt.ranks.add_up(&mut of_gaussians);
        self.surfels.set_colour(&surfel_colour);
        self.gaussians.set_colour(&gaussian_colour);
        let count = lobes * self.primitives();
        let [idle, folded] = [0, 1].map(|why| (of_surfels[why] + of_gaussians[why]) as usize);
        let change = Mean::of_changes(&psnr_before, &self.psnr_of_views(context)?);
        if change.is_clearly_below(-MOST_LOST) {
            let [surfel_colour, gaussian_colour] = all;
            self.surfels.set_colour(&surfel_colour);
            self.gaussians.set_colour(&gaussian_colour);
            return Ok(Some(format!(
                "all of {count} lobes stay: without {} that hardly show, validation PSNR changes by {change}",
                idle + folded
            )));
        }
        Ok(Some(format!(
            "of {count} lobes {idle} dropped that add less than half of 1/255 in any camera, {folded} that do not change: \
             validation PSNR {change}"
        )))
    }
}

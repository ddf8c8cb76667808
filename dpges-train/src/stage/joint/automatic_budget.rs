//! The decisions of an automatic budget, by validation views or, without any, by training views: how long the scene grows, how many layers it peels, and which
//! lobes it does without.

use std::sync::Arc;

use dpges_core::losses::Target;
use dpges_core::ops::peel::MAX_LAYERS;
use dpges_core::render::{Values, ViewRequest, render};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{ColourData, ColourModel};

use super::super::{Context, TrainError};
use super::JointStage;
use crate::config::HARD_RIM;
use crate::dataset::{Picture, View, pictures};
use crate::eval::LARGEST_PSNR;
use crate::metrics::{psnr, quantised};
use crate::refine::growth::Growth;
use crate::refine::layer_count::{MOST_OPEN, choose, open_share};
use crate::refine::lobes::{drop_lobes, redundant_lobes};
use crate::views::exposure::Correction;
use crate::views::target::ToTarget;

/// Enough to see most primitives several times.
const JUDGING_VIEWS: usize = 24;
/// A lobe is dropped if its absence changes no colour by more than this: half a step of an 8-bit picture.
const UNSEEN: f64 = 0.5 / 255.0;
/// dB that the judging views may lose by all lobes dropped at once. Many invisible changes may add up.
const MOST_LOST: f64 = 0.01;

impl JointStage {
    /// The number of primitives that the scene is to have from now on, before the first of `batches_left` batches or, with
    /// `None`, when there are no more; and a sentence, if that is decided now.
    pub fn grow(
        &mut self,
        context: &Context,
        batches_left: Option<usize>,
    ) -> Result<(usize, Option<String>), TrainError> {
        let primitives = self.primitives();
        let mut growth = self.growth.unwrap_or_else(|| Growth::of(primitives));
        let told = match batches_left {
            Some(batches_left) if !growth.has_ended() => {
                let psnr = self.mean_psnr(context)?;
                let told = growth.judge(psnr, primitives, context.budget, batches_left);
                Some(format!("{} {told}", judges(context)))
            }
            _ => None,
        };
        self.growth = Some(growth);
        Ok((growth.wanted(), told))
    }

    /// Mean PSNR of the judging views, dB, as evaluations measure it. In a run that corrects exposures, photographs are
    /// compared without what the exposure that fits best explains: validation views have no correction of their own.
    fn mean_psnr(&self, context: &Context) -> Result<f64, TrainError> {
        let of_view = |(view, picture): (&View, dpges_core::Result<Arc<Picture>>)| -> Result<f64, TrainError> {
            let picture = picture?;
            let image = self.render_view(context, view)?.composite.image;
            let Target { image: mut photograph, mask } = picture.target(&context.device);
            if context.exposure.is_some() {
                let fitted = Correction::fitted(&image, &photograph, picture.counted.as_deref());
                photograph = fitted.undone(photograph);
            }
            let target = Target { image: quantised(photograph), mask };
            // an exact picture has an infinite PSNR, which would be the mean of all
            Ok(psnr(quantised(image), target).clamp(0.0, LARGEST_PSNR))
        };
        let views = judging_views(context);
        let psnr: Vec<f64> = pictures(views).map(of_view).collect::<Result<_, _>>()?;
        let mean = psnr.iter().sum::<f64>() / psnr.len() as f64;
        // the first rank decides for all, which must change the scene alike
        Ok(self.sharding.ranks.of_first(vec![mean])[0])
    }

    /// Chooses the smallest number of layers that leaves hardly any pixel of the judging views open; soft rims need two.
    pub fn choose_layer_count(&mut self, context: &Context) -> Result<String, TrainError> {
        let psnr_before = self.mean_psnr(context)?;
        let mut options = self.render_options(&context.config);
        // one picture with the most layers shows what any smaller number leaves open
        options.peel.layer_count = MAX_LAYERS;
        let (surfels, gaussians) = self.drawn_values();
        let mut shares = vec![0.0; MAX_LAYERS];
        let views: Vec<&View> = judging_views(context).collect();
        for view in &views {
            let request =
                ViewRequest { values: Values::KnownFinite, ranks: &*self.sharding.ranks, ..(&view.camera).into() };
            let rendered = render(&surfels, &gaussians, request, &options)?;
            let pixels = view.camera.width * view.camera.height;
            let open = open_share(&tensor_to_rows(&rendered.seen.transmittance), pixels);
            shares.iter_mut().zip(open).for_each(|(sum, share)| *sum += share / views.len() as f64);
        }
        // soft rims with nothing behind them fade into the background, and surfels may grow over the picture
        let fewest = if self.info.modulation < HARD_RIM { 2 } else { 1 };
        let (before, after) = (self.info.layer_count, choose(&shares, MOST_OPEN, fewest));
        self.info.layer_count = after;
        let change = self.mean_psnr(context)? - psnr_before;
        let percents: Vec<String> = shares.iter().map(|share| format!("{:.2}", 100.0 * share)).collect();
        Ok(format!(
            "{after} layers instead of {before}: behind 1, 2, … layers {} % of the covered pixels let more than 1/255 \
             through; up to {} % more than behind the last may do so; {} PSNR {change:+.3} dB by that",
            percents.join(", "),
            100.0 * MOST_OPEN,
            judges(context)
        ))
    }

    /// Drops the lobes whose absence no camera would show, unless the judging views lose by all of them together.
    /// `None` if colours have no lobes.
    pub fn drop_lobes(&mut self, context: &Context) -> Result<Option<String>, TrainError> {
        let ColourModel::SphericalBeta { lobes } = self.info.colour_model else { return Ok(None) };
        let psnr_before = self.mean_psnr(context)?;
        let dataset = &context.dataset;
        let views = dataset.train.iter().chain(&dataset.validation);
        let centres: Vec<[f64; 3]> = views.map(|view| view.camera.centre().to_array()).collect();
        let (surfels, gaussians) = (self.surfels.columns.positions.raw(), self.gaussians.columns.positions.raw());
        // kept, in case that all of them together cost too much
        let all = [self.surfels.colour(), self.gaussians.colour()];
        let [mut surfel_colour, mut gaussian_colour] = all.clone();
        let drop = |positions: &[f32], colour: &mut ColourData| {
            let redundant = redundant_lobes(positions, colour, lobes, &centres, UNSEEN);
            let found = drop_lobes(colour, lobes, &redundant);
            [found.idle as f64, found.folded as f64]
        };
        // every rank has all surfels, and only its own Gaussians, whose counts are therefore added up
        let of_surfels = drop(&tensor_to_rows(&surfels), &mut surfel_colour);
        let mut of_gaussians = drop(&tensor_to_rows(&gaussians), &mut gaussian_colour);
        self.sharding.ranks.add_up(&mut of_gaussians);
        self.surfels.set_colour(&surfel_colour);
        self.gaussians.set_colour(&gaussian_colour);
        let count = lobes * self.primitives();
        let [idle, folded] = [0, 1].map(|why| (of_surfels[why] + of_gaussians[why]) as usize);
        let change = self.mean_psnr(context)? - psnr_before;
        if change < -MOST_LOST {
            let [surfel_colour, gaussian_colour] = all;
            self.surfels.set_colour(&surfel_colour);
            self.gaussians.set_colour(&gaussian_colour);
            return Ok(Some(format!(
                "all of {count} lobes stay: without {} that hardly show, {} PSNR changes by {change:+.3} dB",
                idle + folded,
                judges(context)
            )));
        }
        Ok(Some(format!(
            "of {count} lobes {idle} dropped that add less than half of 1/255 in any camera, {folded} that do not change: \
             {} PSNR {change:+.3} dB",
            judges(context)
        )))
    }
}

/// The kind of the [judging views](judging_views), for messages.
fn judges(context: &Context) -> &'static str {
    if context.dataset.validation.is_empty() { "training" } else { "validation" }
}

/// The views that decide: validation views, or else training views, evenly spread.
fn judging_views(context: &Context) -> impl Iterator<Item = &View> {
    let (validation, train) = (&context.dataset.validation, &context.dataset.train);
    let views = if validation.is_empty() { train } else { validation };
    views.iter().step_by(views.len().div_ceil(JUDGING_VIEWS).max(1))
}

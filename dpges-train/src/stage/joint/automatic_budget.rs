//! The decisions of an automatic budget: the scene grows, and peels layers, as long as validation views improve.

use dpges_core::ops::peel::MAX_LAYERS;
use dpges_core::render::{Values, render_values};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{ColourData, ColourModel};

use super::super::{Context, Stage, TrainError};
use super::JointStage;
use crate::config::Budget;
use crate::eval::{Measures, evaluate_each};
use crate::refine::growth::{Decision, Growth};
use crate::refine::layer_count::{MOST_OPEN, choose, open_share};
use crate::refine::lobes::{drop_lobes, spare_lobes};
use crate::rendered::{Rendered, Renderer};

/// A lobe is dropped if its absence changes no colour by more than this: half a step of an 8-bit picture.
const UNSEEN: f64 = 0.5 / 255.0;

impl JointStage {
    /// Why no more Gaussians are added; `None` while they are, and with a fixed budget.
    pub fn end_of_growth(&mut self, context: &Context) -> Result<Option<String>, TrainError> {
        if context.config.refine.budget != Budget::Auto {
            return Ok(None);
        }
        let growth = self.growth.get_or_insert_with(Growth::default);
        if let Decision::Stop(reason) = growth.decision() {
            return Ok(Some(reason.to_string()));
        }
        let scene = self.scene();
        let device = &context.device;
        let renderer = Renderer::new(&scene, device).deterministic(context.config.train.deterministic);
        let (views, nothing) = (&context.dataset.validation, |_: usize, _: &Rendered| Ok::<_, TrainError>(()));
        let psnr = evaluate_each(&renderer, &scene, views, device, Measures::Basic, nothing)?.psnr;
        let growth = self.growth.get_or_insert_with(Growth::default);
        let primitives = scene.surfels.len() + scene.gaussians.len();
        Ok(match growth.observe(primitives, psnr) {
            Decision::Grow => None,
            Decision::Stop(reason) => Some(reason.to_string()),
        })
    }

    /// Chooses the smallest number of layers that leaves hardly any pixel of the validation views open.
    pub fn choose_layer_count(&mut self, context: &Context) -> Result<String, TrainError> {
        let mut options = self.render_options(&context.config);
        options.peel.layer_count = MAX_LAYERS;
        let (surfels, gaussians) = self.drawn_values();
        let mut shares = vec![0.0; MAX_LAYERS];
        let views = &context.dataset.validation;
        for view in views {
            let rendered = render_values(&surfels, &gaussians, &view.camera, &options, Values::KnownFinite)?;
            let pixels = view.camera.width * view.camera.height;
            let open = open_share(&tensor_to_rows(&rendered.composite.transmittance), pixels);
            shares.iter_mut().zip(open).for_each(|(sum, share)| *sum += share / views.len() as f64);
        }
        let (before, after) = (self.info.layer_count, choose(&shares, MOST_OPEN));
        self.info.layer_count = after;
        let percents: Vec<String> = shares.iter().map(|share| format!("{:.2}", 100.0 * share)).collect();
        Ok(format!(
            "{after} layers instead of {before}: behind 1, 2, … layers {} % of the covered pixels let more than 1/255 \
             through; up to {} % more than behind the last may do so",
            percents.join(", "),
            100.0 * MOST_OPEN
        ))
    }

    /// Drops the lobes whose absence no camera would show; `None` if colours have no lobes.
    pub fn drop_lobes(&mut self, context: &Context) -> Option<String> {
        let ColourModel::SphericalBeta { lobes } = self.info.colour_model else { return None };
        let dataset = &context.dataset;
        let views = dataset.train.iter().chain(&dataset.validation);
        let centres: Vec<[f64; 3]> = views.map(|view| view.camera.centre().to_array()).collect();
        let (surfels, gaussians) = (self.surfels.columns.positions.raw(), self.gaussians.columns.positions.raw());
        let (mut surfel_colour, mut gaussian_colour) = (self.surfels.colour(), self.gaussians.colour());
        let mut dropped = [0; 2];
        let mut drop = |positions: &[f32], colour: &mut ColourData| {
            let spare = spare_lobes(positions, colour, lobes, &centres, UNSEEN);
            let found = drop_lobes(colour, lobes, &spare);
            dropped[0] += found.idle;
            dropped[1] += found.folded;
        };
        drop(&tensor_to_rows(&surfels), &mut surfel_colour);
        drop(&tensor_to_rows(&gaussians), &mut gaussian_colour);
        self.surfels.set_colour(&surfel_colour);
        self.gaussians.set_colour(&gaussian_colour);
        let all = lobes * (self.surfels.len() + self.gaussians.len());
        let [idle, folded] = dropped;
        Some(format!(
            "of {all} lobes {idle} dropped that add less than half of 1/255 in any camera, {folded} that do not change"
        ))
    }
}

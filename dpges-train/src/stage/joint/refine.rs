//! Applies the decisions of [`crate::refine`] to surfels and Gaussians.

use dpges_core::losses::Target;
use dpges_core::ops::environment::environment;
use dpges_core::render::{Render, Values, ViewRequest, render};
use dpges_core::scene::GaussianData;
use dpges_core::scene::tensors::tensor_to_rows;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::super::context::mean_pixels;
use super::super::{Context, TrainError};
use super::JointStage;
use super::schedule::Due;
use crate::config::{Budget, NewGaussians};
use crate::dataset::block::Bounds;
use crate::dataset::{EmptySpace, View};
use crate::refine::GaussianEdit;
use crate::refine::add::{batch_size, draw_in_proportion, new_gaussians};
use crate::refine::exact_relocation::{Renewal, renew};
use crate::refine::floaters::without_floaters;
use crate::refine::margins::margins;
use crate::refine::prune::{drawn, gaussians_to_keep, surfels_to_keep};
use crate::refine::split::split;
use crate::views::exposure::Seen;
use crate::views::exposure::state::corrections;

/// Scale of an added Gaussian that is the only one of its batch, as a fraction of the extent.
const SCALE_ALONE: f64 = 0.01;

impl JointStage {
    /// Does what is `due` in the order prune, margins, split, add. Returns a sentence for each thing it did.
    pub fn refine_due(&mut self, due: Due, context: &mut Context) -> Result<Vec<String>, TrainError> {
        let mut events = Vec::new();
        let makes_new = due.batches_left.is_some() || due.replace;
        let is_automatic = context.config.refine.budget == Budget::Auto && !self.plan.is_coarse;
        // views judge what has learnt since the last batch, before anything else is changed
        let grown = if makes_new && is_automatic {
            let (wanted, told) = self.grow(context, due.batches_left)?;
            events.extend(told);
            Some(wanted)
        } else {
            None
        };
        if due.surfel_prune {
            events.push(self.prune_surfels(context));
        }
        if due.gaussian_prune {
            events.push(self.prune_gaussians(context));
        }
        // after pruning, since a margin is a median over neighbours, and those that left must not count
        if due.margins {
            let surfels = self.drawn_surfel_data();
            let margins = margins(&surfels.positions, &surfels.log_scales, context.config.model.margin);
            self.surfels.columns.margins.set(&margins);
            events.push(format!("margins of {} surfels computed", surfels.len()));
            let begun = context.completed_steps > self.plan.begin;
            if begun && is_automatic {
                events.push(self.choose_layer_count(context)?);
            }
        }
        if due.drop_lobes {
            events.extend(self.drop_lobes(context)?);
        }
        // after the margins, which say what is too large
        if due.split {
            events.push(self.split_gaussians(context));
        }
        if makes_new {
            let removed = self.remove_useless(context);
            let primitives = self.primitives();
            let (target, batches) =
                grown.map_or((context.budget_before_growth(), due.batches_left.unwrap_or(1)), |wanted| (wanted, 1));
            let replaced = match context.config.refine.new_gaussians {
                NewGaussians::Copies => removed.min(target.saturating_sub(primitives)),
                NewGaussians::Black => 0,
            };
            // up to a number, not by a number: a sixth of the Gaussians fade between two batches, and are made up for
            let count = replaced + batch_size(target, primitives + replaced, batches);
            events.push(self.add_gaussians(context, count, removed)?);
        }
        Ok(events)
    }

    fn prune_surfels(&mut self, context: &Context) -> String {
        let log_scales = tensor_to_rows(&self.surfels.columns.log_scales.raw());
        let edit = surfels_to_keep(
            &self.statistics.max_pixels(),
            &log_scales,
            self.info.extent,
            context.config.refine.surfel_pixels.of(mean_pixels(&context.dataset)),
        );
        let before = self.surfels.len();
        self.surfels.keep(&edit);
        if let Some(limits) = &mut self.limits {
            limits.surfels.measure(&self.surfels.columns.positions.raw(), context);
        }
        if let Some(measured) = &mut self.measured {
            measured.measure(&self.surfels.columns.positions.raw());
        }
        self.statistics.reset_surfels(self.surfels.len());
        format!("{} of {before} surfels pruned", before - self.surfels.len())
    }

    fn prune_gaussians(&mut self, context: &Context) -> String {
        let contributions = self.sharding.all_of(self.statistics.max_contributions(), 1);
        let keep = gaussians_to_keep(&contributions, context.config.refine.gaussian_min_contribution);
        let before = self.sharding.len();
        self.edit_gaussians(&GaussianEdit { keep, ..GaussianEdit::default() }, context);
        self.statistics.reset_gaussians(self.gaussians.len());
        format!("{} of {before} Gaussians pruned", before - self.sharding.len())
    }

    fn split_gaussians(&mut self, context: &mut Context) -> String {
        // what draws nothing leaves its room to children
        self.remove_useless(context);
        let surfels = self.surfels.to_data();
        let room = context.budget.saturating_sub(self.primitives());
        let before = self.sharding.len();
        let factor = context.config.refine.split_factor;
        let gaussians = self.sharding.all_data(self.gaussians.to_data());
        let (positions, margins, bounds) = (&surfels.positions, &surfels.margins, self.bounds());
        let (edit, too_large) = split(&gaussians, positions, margins, factor, room, bounds, &mut context.rng);
        self.edit_gaussians(&edit, context);
        format!("{} of {too_large} Gaussians split that are too large, of {before}", self.sharding.len() - before)
    }

    /// Removes Gaussians that draw nothing, and those before cameras if copies take their place. Returns how many.
    fn remove_useless(&mut self, context: &Context) -> usize {
        let before = self.sharding.len();
        let mut keep = drawn(&self.sharding.all_of(self.gaussians.opacities(), 1));
        if self.schedule.copies {
            let positions = self.sharding.all_of(self.gaussians.columns.positions.raw_rows(), 3);
            keep = without_floaters(&EmptySpace::of(&context.dataset), keep, &positions);
        }
        self.edit_gaussians(&GaussianEdit { keep, ..GaussianEdit::default() }, context);
        before - self.sharding.len()
    }

    /// Makes `count` new Gaussians after as many as were `removed` have left: copies of those that answer for the most error, or
    /// black ones where the error is largest, as the configuration says. Within the budget.
    pub fn add_gaussians(&mut self, context: &mut Context, count: usize, removed: usize) -> Result<String, TrainError> {
        let before = self.sharding.len();
        match context.config.refine.new_gaussians {
            NewGaussians::Copies => self.copy_gaussians(context, before + count),
            NewGaussians::Black => {
                let added = self.black_gaussians(context, count)?;
                self.edit_gaussians(&GaussianEdit { keep: (0..before).collect(), added }, context);
            }
        }
        // what was observed is of a scene without the new ones
        self.statistics.reset_gaussians(self.gaussians.len());
        let gone = removed + before.saturating_sub(self.sharding.len());
        let added = self.sharding.len().saturating_sub(before);
        Ok(format!(
            "{gone} Gaussians removed that draw nothing, float before a camera or exceed the budget, \
             {added} added of {count} wanted"
        ))
    }

    /// Copies Gaussians until there are `wanted`, or as many as the budget allows.
    fn copy_gaussians(&mut self, context: &mut Context, wanted: usize) {
        let target = wanted.min(context.budget.saturating_sub(self.surfels.len()));
        let gaussians = self.sharding.all_data(self.gaussians.to_data());
        let errors = self.sharding.all_of(self.statistics.errors(), 1);
        let Renewal { rows: keep, opacities, copies } =
            renew(&gaussians, &errors, target, self.bounds(), true, &mut context.rng);
        // in two edits, because the shared opacities are those of the rows that stay
        self.edit_gaussians(&GaussianEdit { keep, added: GaussianData::neutral(self.info.colour_model, 0) }, context);
        self.gaussians.set_opacities(&self.sharding.own_of(&opacities, 1));
        let keep = (0..self.sharding.len()).collect();
        self.edit_gaussians(&GaussianEdit { keep, added: copies }, context);
    }

    /// `count` Gaussians on the nearest surfels, at pixels drawn in proportion to their squared error, none where a view shows
    /// nothing but sky, or pixels do not count, or no surfel is (GES, DP-GES). Views have equal shares; which of them have
    /// one more is chance.
    fn black_gaussians(&self, context: &mut Context, count: usize) -> Result<GaussianData, TrainError> {
        let views = context.dataset.train.len();
        let dataset = context.dataset.clone();
        let corrections = corrections(&context.exposure);
        let mut positions = Vec::new();
        for (index, share) in
            shares(count, views, &mut context.rng).into_iter().enumerate().filter(|(_, share)| *share > 0)
        {
            let view = &dataset.train[index];
            let own = Seen::by(view, corrections.get(index))?;
            let rendered = self.render_view(context, view)?;
            let mut error = squared_error(&rendered, &own.target(&context.device));
            // the environment shows the sky, which a Gaussian there would hide
            if let Some(sky) = &self.sky {
                sky.clear(index, &own.picture, &mut error);
            }
            let depths = tensor_to_rows(&rendered.layers.depth);
            let pixels = draw_in_proportion(&error, share, &mut context.rng);
            let camera = &view.camera;
            positions.extend(pixels.into_iter().filter(|&pixel| depths[pixel].is_finite()).map(|pixel| {
                let (x, y) = ((pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5);
                camera.unproject(x, y, f64::from(depths[pixel])).as_vec3().to_array()
            }));
        }
        positions.retain(|&position| self.bounds().contains(position));
        let alone = (SCALE_ALONE * self.info.extent) as f32;
        Ok(new_gaussians(&positions, alone, self.info.colour_model, &mut context.rng))
    }

    /// Where Gaussians may be added.
    fn bounds(&self) -> Bounds {
        self.surroundings.as_ref().map_or(Bounds::ALL, |around| around.bounds)
    }

    /// Number of primitives of all ranks.
    pub fn primitives(&self) -> usize {
        self.surfels.len() + self.sharding.len()
    }

    /// Edits the set of all Gaussians. Gaussians that stay keep their observations.
    fn edit_gaussians(&mut self, edit: &GaussianEdit, context: &Context) {
        let edit = self.sharding.edit(edit);
        self.gaussians.edit(&edit);
        // limits depend on positions, and rows have changed
        if let Some(limits) = &mut self.limits {
            limits.gaussians.measure(&self.gaussians.columns.positions.raw(), context);
        }
        self.statistics.edit_gaussians(&edit.keep, edit.added.len());
    }

    /// Renders a view of the scene as it stands, without a tape.
    pub fn render_view(&self, context: &Context, view: &View) -> Result<Render, TrainError> {
        let mut drawn = self.drawn_values();
        if let Some(around) = &self.surroundings {
            drawn = around.values(&drawn.0, &drawn.1);
        }
        let request =
            ViewRequest { values: Values::KnownFinite, ranks: &*self.sharding.ranks, ..(&view.camera).into() };
        let rendered = render(&drawn.0, &drawn.1, request, &self.render_options(&context.config))?;
        Ok(match &self.environment {
            Some(coefficients) => rendered.in_front_of(environment(&coefficients.raw(), &view.camera)?),
            None => rendered,
        })
    }
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

/// Shares of `count` for `views`: equal numbers, and the remainder for views in a row from a random one on.
fn shares(count: usize, views: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let first = rng.random_range(0..views);
    (0..views).map(|view| count / views + usize::from((view + views - first) % views < count % views)).collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn every_view_gets_its_share_and_the_remainder_begins_anywhere() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut totals = [0; 7];
        for _ in 0..7000 {
            let shares = shares(3, 7, &mut rng);
            assert_eq!(shares.iter().sum::<usize>(), 3);
            totals.iter_mut().zip(shares).for_each(|(total, share)| *total += share);
        }
        assert!(totals.iter().all(|total| (2800..3200).contains(total)), "{totals:?}");
        assert_eq!(shares(7, 7, &mut rng), [1; 7]);
    }
}

//! Where surfels start: on the surfaces that trained Gaussians show to several views.

use std::ops::RangeInclusive;
use std::sync::Arc;

use dpges_core::scene::{GaussianData, Rendering, SceneInfo, ScreenFilter, SurfelData};

use super::super::{Context, TrainError};
use super::blended_depth::{BlendedMaps, ShownDepth};
use crate::dataset::{PointCloud, View, least_recently_used};
use crate::init::flatten::flatten;
use crate::init::fusion::{CHECKED_VIEWS, DepthViews, FusionRule, surface_points};
use crate::init::sfm::usable_points;
use crate::init::surfels_at;
use crate::views::exposure::Seen;
use crate::views::exposure::state::corrections;

/// Least alpha of a pixel that may show a surface.
const OPAQUE: f32 = 0.9;
/// Largest difference between the mean and the median depth of a pixel that shows one surface, relative to the median.
const OF_ONE_DEPTH: f32 = 0.03;
/// When depths agree: the first rule that finds enough surfels is taken.
// the strictest first: points that fewer views agree about, or less closely, are less certain
const RULES: [FusionRule; 3] = [
    FusionRule { tolerance: 0.015, min_views: 3 },
    FusionRule { tolerance: 0.03, min_views: 2 },
    FusionRule { tolerance: 0.06, min_views: 1 },
];
/// Distance between surface points, px. Closer surfels take primitives from Gaussians that draw more.
const STRIDE_PX: usize = 6;
/// The same where there are too few points.
const CLOSER_PX: [usize; 2] = [4, 3];
/// The same where there are too many.
// in steps: a distance that uses up the room was worse on captures than the first of these that fits
const FARTHER_PX: [usize; 4] = [8, 12, 16, 24];
/// Enough surfels, as a share of the most. With fewer, next to nothing hides what lies behind, and steps are slow.
const ENOUGH: f64 = 0.03;
/// Most of the budget for surfels where depths agree nowhere: such surfels are less certain.
const MOST_UNCERTAIN: f64 = 0.25;

impl Context {
    /// Surfels on the surfaces that blended `gaussians` show to several training views, none of which covers what views show
    /// behind it; or else at the points of the dataset, or in the planes of the most opaque Gaussians. Margins are zero.
    pub fn surfels_of_depth(
        &mut self,
        gaussians: &GaussianData,
        filter: ScreenFilter,
    ) -> Result<SurfelData, TrainError> {
        let most = self.most_primitives(self.config.stages.depth_surfels);
        let enough = (ENOUGH * most as f64).ceil() as usize;
        let dataset = self.dataset.clone();
        let info = SceneInfo { screen_filter: filter, ..self.scene_info(Rendering::Ellipsoids) };
        let depths = BlendedMaps::new(gaussians, &info, &self.device)?;
        for rule in RULES {
            let (points, stride_px) = self.surface_points(&depths, rule, enough..=most)?;
            let found = points.positions.len();
            tracing::info!(
                "{found} points on surfaces that at least {} views agree about to {} %, about {stride_px} px from one another",
                rule.min_views + 1,
                100.0 * rule.tolerance
            );
            if found >= enough {
                let points = usable_points(&points, most, &mut self.rng);
                let surfels = surfels_at(points, &dataset, &self.config, &mut self.rng);
                // surfels from points of one depth may still reach across silhouettes and holes
                return self.without_wrong_cover(surfels, &depths);
            }
        }
        let most = most.min(self.most_primitives(MOST_UNCERTAIN));
        let points = usable_points(&dataset.points, most, &mut self.rng);
        if points.positions.len() >= enough {
            tracing::warn!(
                "depths of views agree hardly anywhere: surfels start at {} points of the dataset",
                points.positions.len()
            );
            return Ok(surfels_at(points, &dataset, &self.config, &mut self.rng));
        }
        let surfels = flatten(gaussians, most, self.config.stages.surfel_scale);
        tracing::warn!(
            "depths of views agree hardly anywhere, and there are hardly any points: surfels start as the {} most opaque \
             Gaussians",
            surfels.len()
        );
        Ok(surfels)
    }

    /// Points by a rule, as many as are `wanted` if a distance between them has so many, and that distance in px.
    fn surface_points(
        &self,
        depths: &BlendedMaps,
        rule: FusionRule,
        wanted: RangeInclusive<usize>,
    ) -> Result<(PointCloud, usize), TrainError> {
        let dataset = &self.dataset;
        // those that are checked beside one stay, whatever the room
        let bytes = |view: &View| size_of::<f32>() * view.camera.width * view.camera.height;
        let largest_bytes = dataset.train.iter().map(bytes).max().unwrap_or(0);
        let most_bytes = dataset.spare_memory.max((CHECKED_VIEWS + 1) * largest_bytes);
        let maps = least_recently_used(most_bytes, |map: &Vec<f32>| size_of_val(map.as_slice()));
        let depth = |index: usize| -> dpges_core::Result<Arc<Vec<f32>>> {
            if let Some(depth) = maps.get(&index) {
                return Ok(depth);
            }
            let view = &dataset.train[index];
            let mut depth = certain(depths.depths(&view.camera)?);
            view.picture()?.clear_ignored(&mut depth);
            let depth = Arc::new(depth);
            maps.insert(index, Arc::clone(&depth));
            // evicts now, so that maps beyond the bound are not held beside the next one
            maps.run_pending_tasks();
            Ok(depth)
        };
        let corrections = corrections(&self.exposure);
        let photograph = |index: usize| Seen::by(&dataset.train[index], corrections.get(index));
        let cameras = dataset.train.iter().map(|view| &view.camera).collect();
        let views = DepthViews { cameras, depth: &depth, photograph: &photograph };
        Ok(as_wanted(wanted, |stride_px| surface_points(&views, stride_px, rule))?)
    }
}

/// The points that `at` finds at a distance in px, as many as are `wanted` if a distance has so many, and that distance.
fn as_wanted(
    wanted: RangeInclusive<usize>,
    at: impl Fn(usize) -> dpges_core::Result<PointCloud>,
) -> dpges_core::Result<(PointCloud, usize)> {
    let (mut points, mut stride_px) = (at(STRIDE_PX)?, STRIDE_PX);
    let others: &[usize] = if points.positions.len() < *wanted.start() { &CLOSER_PX } else { &FARTHER_PX };
    for &stride in others {
        if wanted.contains(&points.positions.len()) {
            break;
        }
        (points, stride_px) = (at(stride)?, stride);
    }
    Ok((points, stride_px))
}

/// [H × W] median depths where a pixel is opaque and of one depth, else 0; world units.
fn certain(ShownDepth { alpha, mean, mut median }: ShownDepth) -> Vec<f32> {
    for (pixel, median) in median.iter_mut().enumerate() {
        let of_one_depth = (mean[pixel] - *median).abs() <= OF_ONE_DEPTH * *median;
        // NaN is not certain
        if !(alpha[pixel] >= OPAQUE && of_one_depth) {
            *median = 0.0;
        }
    }
    median
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_points_move_closer_and_too_many_apart() {
        let found = |wanted, area: usize| {
            let positions = |stride: usize| vec![[0.0; 3]; area / (stride * stride)];
            let at = |stride| Ok(PointCloud { positions: positions(stride), ..PointCloud::default() });
            let (points, stride_px) = as_wanted(wanted, at).unwrap();
            (points.positions.len(), stride_px)
        };
        assert_eq!(found(5..=100, 3600), (100, 6));
        assert_eq!(found(5..=99, 3600), (56, 8));
        assert_eq!(found(1..=3, 3600), (6, 24));
        assert_eq!(found(101..=900, 3600), (225, 4));
        assert_eq!(found(300..=900, 3600), (400, 3));
        assert_eq!(found(500..=900, 3600), (400, 3));
    }

    #[test]
    fn depths_are_certain_where_a_pixel_is_opaque_and_of_one_depth() {
        let (alpha, mean) = (vec![1.0, 0.5, 0.95, 0.95, 1.0], vec![2.0, 2.0, 2.05, 2.1, f32::NAN]);
        assert_eq!(certain(ShownDepth { alpha, mean, median: vec![2.0; 5] }), [2.0, 0.0, 2.0, 0.0, 0.0]);
    }
}

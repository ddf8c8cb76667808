//! Which cameras belong to which block: those whose picture the grown block fills to a share.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_train::dataset::View;
use dpges_train::device::place::Place;
use dpges_train::eval::rendered::TrainingRenderer;
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Result;
use super::split::Part;

/// Share of the picture of a camera that a block to which it belongs fills (CityGaussianV2, `content_threshold`).
pub const LEAST_SHARE: f64 = 0.05;
/// Points that are looked up in all cameras, at most.
const SAMPLED_POINTS: usize = 100_000;
/// Longest side of the pictures that are rendered for their shares, px.
const LONGEST_PX: usize = 96;

/// Measure of the share of a picture that a block fills.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MeasuredBy {
    /// Points of the dataset that lie in the picture, hidden ones too.
    Points,
    /// Pixels that show a surface of the coarse scene.
    CoarseScene,
}

/// `[views][parts]` shares of what each of `cameras` has of `points` in its picture, hidden or not.
pub fn shares_of_points(cameras: &[&Camera], points: &[[f32; 3]], parts: &[Part]) -> Vec<Vec<f64>> {
    let sample: Vec<[f32; 3]> = points.iter().step_by(points.len().div_ceil(SAMPLED_POINTS).max(1)).copied().collect();
    let within: Vec<Vec<u32>> = sample.par_iter().map(|&point| parts_at(point, parts)).collect();
    let of_camera = |camera: &&Camera| {
        let seen = |(point, _): &(&[f32; 3], _)| camera.pixel(Vec3::from_array(**point).as_dvec3()).is_some();
        shares(sample.iter().zip(&within).filter(seen).map(|(_, within)| within), None, parts.len())
    };
    cameras.par_iter().map(of_camera).collect()
}

/// `[views][parts]` shares of the pixels of each of `cameras` at which `scene` shows a surface in a part, by their median depth.
///
/// # Errors
/// [`dpges_core::Error`] if a view cannot be rendered.
pub fn shares_of_scene(cameras: &[&Camera], scene: &SceneData, parts: &[Part], place: &Place) -> Result<Vec<Vec<f64>>> {
    let renderer = TrainingRenderer::on_ranks(scene, place);
    let of_camera = |camera: &&Camera| {
        let smaller = LONGEST_PX as f64 / camera.width.max(camera.height) as f64;
        let [width, height] =
            [camera.width, camera.height].map(|side| ((side as f64 * smaller.min(1.0)).round() as usize).max(1));
        let camera = camera.resized(width, height);
        let (_, depth) = renderer.render_with_depth(&camera)?;
        let position = |pixel: usize| {
            let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            camera.unproject(x, y, f64::from(depth[pixel])).as_vec3().to_array()
        };
        let shown = (0..width * height).filter(|&pixel| depth[pixel] > 0.0 && depth[pixel].is_finite());
        let within: Vec<Vec<u32>> = shown.map(|pixel| parts_at(position(pixel), parts)).collect();
        Ok(shares(within.iter(), Some(width * height), parts.len()))
    };
    cameras.iter().map(of_camera).collect()
}

/// Numbers of the grown parts that a point lies in.
fn parts_at(point: [f32; 3], parts: &[Part]) -> Vec<u32> {
    (0..parts.len() as u32).filter(|&at| parts[at as usize].grown.contains(point)).collect()
}

/// The share of each part in `all`, or in those that there are.
fn shares<'a>(found: impl Iterator<Item = &'a Vec<u32>>, all: Option<usize>, parts: usize) -> Vec<f64> {
    let (mut counts, mut count) = (vec![0usize; parts], 0);
    for within in found {
        count += 1;
        within.iter().for_each(|&part| counts[part as usize] += 1);
    }
    let all = all.unwrap_or(count).max(1);
    counts.into_iter().map(|count| count as f64 / all as f64).collect()
}

/// For each part the indices of its `views`, the first `train` of which are trained on, by their `shares` `[views][parts]`: a
/// view belongs to every part with [`LEAST_SHARE`], or to the one that it shows most of, or in which it stands. A part that no
/// training view would belong to has the one that shows most of it.
pub fn assign(views: &[&View], train: usize, parts: &[Part], shares: &[Vec<f64>]) -> Vec<Vec<usize>> {
    let mut of_parts = vec![Vec::new(); parts.len()];
    for (index, (view, shares)) in views.iter().zip(shares).enumerate() {
        let before = of_parts.iter().map(Vec::len).sum::<usize>();
        for (part, _) in shares.iter().enumerate().filter(|(_, share)| **share >= LEAST_SHARE) {
            of_parts[part].push(index);
        }
        if of_parts.iter().map(Vec::len).sum::<usize>() == before {
            let centre = view.camera.centre().as_vec3().to_array();
            let stands_in = |part: usize| parts[part].core.contains(centre);
            let most = (0..parts.len())
                .max_by(|&a, &b| shares[a].total_cmp(&shares[b]).then(stands_in(a).cmp(&stands_in(b))).then(b.cmp(&a)));
            of_parts[most.expect("a plan has blocks")].push(index);
        }
    }
    for (part, of_part) in of_parts.iter_mut().enumerate().filter(|(_, of_part)| of_part.iter().all(|&i| i >= train)) {
        let most = (0..train).max_by(|&a, &b| shares[a][part].total_cmp(&shares[b][part]).then(b.cmp(&a)));
        of_part.extend(most);
        of_part.sort_unstable();
    }
    of_parts
}

#[cfg(test)]
mod tests {
    use dpges_train::dataset::{BuiltinOptions, builtin};

    use super::*;
    use crate::blocks::split::{Limit, split};

    #[test]
    fn views_belong_to_all_blocks_that_fill_a_twentieth_or_else_to_the_fullest() {
        let dataset =
            builtin(&BuiltinOptions { width: 8, height: 8, train_views: 4, test_views: 1, ..Default::default() });
        let views: Vec<&View> = dataset.train.iter().chain(&dataset.test).collect();
        let parts = split(&dataset.points.positions, Limit::Blocks(3));
        let shares = [[0.05, 0.5, 0.0], [0.01, 0.04, 0.02], [0.2, 0.0499, 0.0], [0.0; 3], [0.0, 0.0, 0.9]];
        let found = assign(&views, 4, &parts, &shares.map(|shares| shares.to_vec()));
        let nothing =
            (0..3).find(|&part| parts[part].core.contains(views[3].camera.centre().as_vec3().to_array())).unwrap();
        let mut expected = vec![vec![0, 2], vec![0, 1], vec![4]];
        expected[nothing].push(3);
        expected[nothing].sort_unstable();
        if nothing != 2 {
            // only a held-out view shows it: the training view that shows most of it joins
            expected[2].insert(0, 1);
        }
        assert_eq!(found, expected);
    }

    #[test]
    fn shares_by_points_are_those_of_the_points_in_the_picture() {
        let dataset =
            builtin(&BuiltinOptions { width: 8, height: 8, train_views: 3, test_views: 0, ..Default::default() });
        let cameras: Vec<&Camera> = dataset.train.iter().map(|view| &view.camera).collect();
        let whole = split(&dataset.points.positions, Limit::Blocks(1));
        assert_eq!(shares_of_points(&cameras, &dataset.points.positions, &whole), vec![vec![1.0]; 3]);
        let halves = split(&dataset.points.positions, Limit::Blocks(2));
        for shares in shares_of_points(&cameras, &dataset.points.positions, &halves) {
            assert!(shares.iter().sum::<f64>() >= 1.0 && shares.iter().all(|&share| share > 0.2), "{shares:?}");
        }
        assert_eq!(shares_of_points(&cameras, &[[0.0, 900.0, 0.0]], &halves), vec![vec![0.0; 2]; 3]);
    }
}

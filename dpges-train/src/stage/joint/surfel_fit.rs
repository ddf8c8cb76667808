//! Sizes of surfels before the joint stage: none may cover what trained Gaussians show behind it.
//!
//! A surfel that starts at a point is as large as its neighbours are far away. At silhouettes, at holes and where points are
//! isolated that is too large: it hides the background, and nothing in front of it can correct that.

use burn::tensor::DType;
use dpges_core::ops::peel::{PeelOptions, peel};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{Peeling, Rendering, SurfelData, Surfels};

use super::super::{Context, TrainError};
use super::blended_depth::BlendedMaps;

/// Training views in which surfels are looked at.
const VIEWS: usize = 24;
// a smaller surfel uncovers those behind it, which the next round looks at
const ROUNDS: usize = 5;
/// A surfel covers a pixel if its fragment is the nearest and at least as opaque.
const COVERS: f32 = 0.5;
/// Alpha of the Gaussians below which a pixel shows nothing.
const SHOWS: f32 = 0.5;
/// How far behind a surfel, relative to its depth, a pixel shows something else.
const BEHIND: f32 = 0.04;
/// Share of the pixels of a surfel that may be covered wrongly.
const FEW: f32 = 0.05;
/// Share from which on a surfel is removed, after all rounds.
const MOST: f32 = 0.5;
/// Smallest factor on the scales of a round.
const LEAST_FACTOR: f32 = 0.6;

/// Pixels of all views that a surfel covers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Cover {
    pixels: u32,
    /// Pixels among them at which Gaussians show nothing, or something behind the surfel.
    wrong: u32,
}

impl Cover {
    fn wrong_share(self) -> f32 {
        self.wrong as f32 / self.pixels.max(1) as f32
    }

    /// Factor on both scales that leaves the area that is covered rightly.
    fn factor(self) -> f32 {
        let share = self.wrong_share();
        if share > FEW { (1.0 - share).sqrt().max(LEAST_FACTOR) } else { 1.0 }
    }
}

impl Context {
    /// `surfels` without those that cover what `depths` show behind them for the most part, even after they were shrunk. Pixels
    /// that do not count say nothing of them.
    pub fn without_wrong_cover(&self, mut surfels: SurfelData, depths: &BlendedMaps) -> Result<SurfelData, TrainError> {
        let seen = self.seen_depths(depths)?;
        let before = surfels.len();
        let mut shrunk = vec![false; before];
        for _ in 0..ROUNDS {
            let covers = self.covers(&surfels, &seen)?;
            for (row, factor) in covers.iter().map(|cover| cover.factor()).enumerate() {
                surfels.log_scales[2 * row..][..2].iter_mut().for_each(|log_scale| *log_scale += factor.ln());
                shrunk[row] |= factor < 1.0;
            }
        }
        let covers = self.covers(&surfels, &seen)?;
        let keep: Vec<usize> = (0..before).filter(|&row| covers[row].wrong_share() <= MOST).collect();
        let shrunk = shrunk.iter().filter(|shrunk| **shrunk).count();
        tracing::info!(
            "{shrunk} of {before} surfels made smaller, {} removed that cover what views show behind them",
            before - keep.len()
        );
        Ok(surfels.select(&keep))
    }

    /// For some views, by their index, [H × W] the depth that is seen, world units: +∞ where nothing is, 0 where pixels do not
    /// count.
    fn seen_depths(&self, depths: &BlendedMaps) -> Result<Vec<(usize, Vec<f32>)>, TrainError> {
        let views = &self.dataset.train;
        let of_view = |index: usize| -> Result<(usize, Vec<f32>), TrainError> {
            let shown = depths.depths(&views[index].camera)?;
            let seen = |(depth, alpha): (f32, f32)| if alpha < SHOWS { f32::INFINITY } else { depth };
            let mut seen: Vec<f32> = shown.median.into_iter().zip(shown.alpha).map(seen).collect();
            views[index].picture()?.clear_ignored(&mut seen);
            Ok((index, seen))
        };
        (0..views.len()).step_by(views.len().div_ceil(VIEWS).max(1)).map(of_view).collect()
    }

    fn covers(&self, surfels: &SurfelData, seen: &[(usize, Vec<f32>)]) -> Result<Vec<Cover>, TrainError> {
        let options =
            // the nearest surfel alone can cover a pixel
            PeelOptions { layer_count: 1, peeling: Peeling::Nearest, ..(&self.scene_info(Rendering::Peeled)).into() };
        let mut covers = vec![Cover::default(); surfels.len()];
        let surfels = Surfels::from_data(surfels, &self.device, DType::F32);
        for (index, seen) in seen {
            let camera = &self.dataset.train[*index].camera;
            let layers = peel(&surfels, camera, &options)?;
            let ids: Vec<i32> = layers.ids.into_data().iter::<i32>().collect();
            add_view(&mut covers, &ids, &tensor_to_rows(&layers.alpha), &tensor_to_rows(&layers.depth), seen);
        }
        Ok(covers)
    }
}

/// Adds the pixels of a view, [H × W] each: the nearest surfel (−1: none), its alpha and depth, and the depth that is `seen`
/// (0: the pixel does not count).
fn add_view(covers: &mut [Cover], ids: &[i32], alpha: &[f32], depth: &[f32], seen: &[f32]) {
    for (pixel, &id) in ids.iter().enumerate() {
        let Ok(id) = usize::try_from(id) else { continue };
        if alpha[pixel] >= COVERS && seen[pixel] > 0.0 {
            covers[id].pixels += 1;
            covers[id].wrong += u32::from(seen[pixel] > depth[pixel] * (1.0 + BEHIND));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_wrong_where_something_else_is_seen_behind() {
        let mut covers = vec![Cover::default(); 3];
        let seen = [2.0, 2.05, 2.2, f32::INFINITY, 1.0, f32::INFINITY, 0.0];
        add_view(&mut covers, &[0, 0, 0, 0, 1, -1, 0], &[1.0, 1.0, 1.0, 0.4, 0.6, 0.0, 1.0], &[2.0; 7], &seen);
        assert_eq!(covers[..2], [Cover { pixels: 3, wrong: 1 }, Cover { pixels: 1, wrong: 0 }]);
        assert_eq!((covers[1].factor(), covers[2].factor()), (1.0, 1.0));
        assert!((covers[0].factor() - (2f32 / 3.0).sqrt()).abs() < 1e-6);
        assert_eq!(Cover { pixels: 9, wrong: 9 }.factor(), LEAST_FACTOR);
    }
}

//! Opacities with which Gaussians that were blended have the same shares of pictures without an order.
//!
//! A blended Gaussian hides those behind it, and most of what it is depends on that. In the joint stage all Gaussians before
//! the same surfel count, in proportion to their opacities. The odds α / (1 − α) are right for one Gaussian alone before a
//! surfel. Where several overlap, or lie within the margin behind a surface, opacities are fitted: each is multiplied by the
//! ratio of the share of all pictures that its Gaussian had to the one that it has, a few times over.

use burn::tensor::{DType, Tensor};
use dpges_core::ops::blend::blend;
use dpges_core::ops::composite::{CompositeOptions, composite};
use dpges_core::ops::limits::interval_limits;
use dpges_core::ops::peel::peel;
use dpges_core::ops::splat::splat;
use dpges_core::render::RenderOptions;
use dpges_core::render::blended::BlendedOptions;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{GaussianData, Gaussians, Rendering, SceneInfo, ScreenFilter, SurfelData, Surfels};

use super::super::{Context, TrainError};
use crate::dataset::View;

/// Views that shares are summed over.
const VIEWS: usize = 24;
const ROUNDS: usize = 4;
/// Smallest and largest factor of a round.
const FACTORS: [f32; 2] = [0.1, 3.0];
/// Largest opacity that is fitted: more would not be seen, and take long to unlearn.
const MOST_OPAQUE: f32 = 9.0;
/// Share of a picture, in px, from which on it is known.
const LEAST_SHARE_PX: f32 = 0.05;

impl Context {
    /// `[M]` the sums over views of the shares αT that `gaussians` have of pixels, px, blended with `filter`.
    ///
    /// # Errors
    /// [`TrainError::Core`] if they cannot be rendered.
    pub fn blended_shares(&self, gaussians: &GaussianData, filter: ScreenFilter) -> Result<Vec<f32>, TrainError> {
        let info = SceneInfo { screen_filter: filter, ..self.scene_info(Rendering::Ellipsoids) };
        let options = BlendedOptions::new(&info)?.blend;
        let gaussians = Gaussians::from_data(gaussians, &self.tape(), DType::F32);
        let picture =
            |view: &View, white: &Tensor<2>| Ok(blend(&gaussians, white, None, &view.camera, &options)?.colour);
        self.shares(gaussians.positions.dims()[0], &picture)
    }

    /// Sets the opacities of `gaussians`, which begin with guesses, such that their shares of pictures with `surfels`, which
    /// have margins, are `shares`, px. Those that are hardly seen stay.
    ///
    /// # Errors
    /// [`TrainError::Core`] if they cannot be rendered.
    pub fn fit_opacities(
        &self,
        surfels: &SurfelData,
        gaussians: &mut GaussianData,
        shares: &[f32],
    ) -> Result<(), TrainError> {
        let options = RenderOptions::from(&self.scene_info(Rendering::Peeled));
        let surfels = Surfels::from_data(surfels, &self.tape(), DType::F32);
        let black = Tensor::zeros([surfels.positions.dims()[0], 3], (&self.tape(), DType::F32));
        for _ in 0..ROUNDS {
            let on_device = Gaussians::from_data(gaussians, &self.tape(), DType::F32);
            let picture = |view: &View, white: &Tensor<2>| -> Result<Tensor<3>, TrainError> {
                let Surfels { positions, quaternions, log_scales, margins, .. } = &surfels;
                let layers = peel(positions, quaternions, log_scales, &view.camera, &options.peel)?;
                let limits = interval_limits(&layers, margins, options.margin_lookup)?;
                let sums = splat(&on_device, white, &limits, &view.camera)?;
                let blending = CompositeOptions { background: [0.0; 3], detach_transmittance: true };
                Ok(composite(&layers, &black, &sums, &blending)?.image)
            };
            let found = self.shares(gaussians.len(), &picture)?;
            let opacities = gaussians.opacities.iter_mut().zip(shares.iter().zip(&found));
            for (opacity, (&wanted, &found)) in opacities.filter(|(_, (_, found))| **found > LEAST_SHARE_PX) {
                let factor = (wanted / found).clamp(FACTORS[0], FACTORS[1]);
                *opacity = (*opacity * factor).min(MOST_OPAQUE);
            }
        }
        Ok(())
    }

    /// `[count]` the sums over views of what each Gaussian contributes to a `picture` [3, H, W] in which it has the colours of
    /// the second argument [count, 3].
    fn shares(
        &self,
        count: usize,
        picture: &dyn Fn(&View, &Tensor<2>) -> Result<Tensor<3>, TrainError>,
    ) -> Result<Vec<f32>, TrainError> {
        let views = &self.dataset.train;
        let mut sums = vec![0.0; count];
        for view in views.iter().step_by(views.len().div_ceil(VIEWS).max(1)) {
            let white = Tensor::ones([count, 3], (&self.tape(), DType::F32)).require_grad();
            let gradients = picture(view, &white)?.sum().backward();
            let Some(gradient) = white.grad(&gradients) else { continue };
            let rows = tensor_to_rows(&gradient);
            sums.iter_mut().zip(rows.as_chunks::<3>().0).for_each(|(sum, [share, ..])| *sum += share);
        }
        Ok(sums)
    }
}

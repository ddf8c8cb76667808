//! Splats that are trained a little further, so that sorted blending shows more of what the scene they were made of
//! shows.
//!
//! A scene flattened to splats loses what only peeling can draw. Nothing is added or removed here: positions, shapes,
//! opacities and colours of the splats learn from photographs, at the rates of the configuration's defaults.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::losses::rgb;
use dpges_core::ops::environment::environment;
use dpges_core::ops::finite::{FiniteChecks, check_finite};
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::render::{Values, ViewRequest};
use dpges_core::scene::tensors::rows_to_tensor;
use dpges_core::scene::{Rendering, SceneData};
use dpges_core::{Error, Result};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::config::{Config, OpacityActivation};
use crate::dataset::{MOST_PREFETCHED, View, prefetch};
use crate::optimizer::LOGIT_RATE;
use crate::optimizer::scene_state::{GaussianState, Rates};
use crate::views::target::ToTarget;

/// Trains the ellipsoids of `scene`, in front of its environment, for `steps` steps on `views`, whose cameras are in the coordinates of the scene.
/// Calls `report` with the number of steps that are done.
///
/// # Errors
/// [`Error::Option`] if the scene is not one of ellipsoids or there are no views, [`Error::NonFinite`] if a gradient is
/// not finite, [`Error::Io`] if a photograph cannot be read again, and those of [`render_blended`].
pub fn fit(
    scene: &SceneData,
    views: &[View],
    steps: usize,
    device: &Device,
    mut report: impl FnMut(usize),
) -> Result<SceneData> {
    if views.is_empty() {
        return Err(Error::Option { option: "views", expected: "at least one".to_owned(), found: "none".to_owned() });
    }
    if scene.info.rendering == Rendering::Students {
        let expected = "ellipsoids or discs".to_owned();
        return Err(Error::Option { option: "rendering", expected, found: scene.info.rendering.to_string() });
    }
    let config = Config::default();
    let options = BlendedOptions::new(&scene.info)?;
    let mut state = GaussianState::new(&scene.gaussians, OpacityActivation::Sigmoid, device);
    let behind = scene.environment.as_ref();
    let behind = behind.map(|e| rows_to_tensor(&e.coefficients, 3, device, DType::F32).autodiff());
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut remaining = Vec::new();
    for completed in 0..steps {
        if remaining.is_empty() {
            remaining = views.iter().collect();
            remaining.shuffle(&mut rng);
        }
        let Some(view) = remaining.pop() else { break };
        prefetch(remaining.iter().rev().take(MOST_PREFETCHED).map(|view| &view.photograph));
        let leaves = state.leaves();
        let values = if completed == 0 { Values::Unknown } else { Values::KnownFinite };
        let rendered = render_blended(&leaves.values, ViewRequest { values, ..(&view.camera).into() }, &options)?;
        let image = match &behind {
            Some(coefficients) => rendered.in_front_of(environment(coefficients, &view.camera)?),
            None => rendered,
        }
        .image;
        let target = view.picture()?.target(&device.clone().autodiff());
        let loss = rgb(&image, target, config.train.lambda_dssim)?.total;
        let mut gradients = loss.backward();
        let found = state.gradients(&leaves.raw, &mut gradients);
        let mut checks = FiniteChecks::default();
        for (attribute, gradient) in &found {
            if let Some(gradient) = gradient {
                checks.add(format!("gradient of {}", attribute.raw_name), gradient);
            }
        }
        check_finite(checks)?;
        // the tape shares the parameters: without it the optimiser can work in place
        drop(leaves);
        let rates = rates(&config, completed as f64 / steps as f64, scene.info.extent);
        state.step(found, &Tensor::ones([1], device), &rates, config.optimizer.adam(completed, 1))?;
        report(completed + 1);
    }
    Ok(SceneData { gaussians: state.to_data(), ..scene.clone() })
}

fn rates(config: &Config, progress: f64, extent: f64) -> Rates {
    let (optimizer, decay) = (&config.optimizer, config.optimizer.decay_at(progress));
    Rates {
        positions: optimizer.position_rate(progress, extent),
        quaternions: decay * optimizer.quaternions,
        log_scales: decay * optimizer.log_scales,
        opacities: decay * LOGIT_RATE,
        degrees_of_freedom: 0.0,
        opacity_base: 0.0,
        opacity_detail: 0.0,
        base: decay * optimizer.base,
        detail: decay * optimizer.detail,
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, GaussianData, SceneInfo, SurfelData};

    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};
    use crate::eval::evaluate;
    use crate::run::fixtures::device;

    /// Grey balls on the points of the built-in scene.
    fn start(points: &[[f32; 3]], rendering: Rendering) -> SceneData {
        let model = ColourModel::SphericalHarmonics { degree: 1 };
        let mut gaussians = GaussianData::neutral(model, points.len());
        gaussians.positions = points.as_flattened().to_vec();
        gaussians.log_scales.fill(-2.5);
        gaussians.opacities.fill(0.5);
        let info = SceneInfo { colour_model: model, rendering, ..SceneInfo::default() };
        SceneData { info, surfels: SurfelData::neutral(model, 0), gaussians, environment: None }
    }

    #[test]
    fn splats_learn_what_photographs_show() {
        let options = BuiltinOptions { width: 24, height: 24, train_views: 4, points: 300, ..Default::default() };
        let data = builtin(&options);
        let device = device();
        let scene = start(&data.points.positions, Rendering::Ellipsoids);
        let mut reported = 0;
        let fitted = fit(&scene, &data.train, 60, &device, |completed| reported = completed).unwrap();
        assert_eq!((reported, fitted.gaussians.len(), &fitted.info), (60, 300, &scene.info));
        let psnr = |scene: &SceneData| evaluate(scene, &data.train, &device).unwrap().psnr;
        let (before, after) = (psnr(&scene), psnr(&fitted));
        assert!(after > before + 2.0, "{before} {after}");
    }

    #[test]
    fn what_cannot_be_fitted_is_named() {
        let device = device();
        let none = fit(&start(&[[0.0; 3]], Rendering::Ellipsoids), &[], 1, &device, |_| ()).unwrap_err();
        assert!(none.to_string().contains("views"), "{none}");
        let options = BuiltinOptions { width: 4, height: 4, train_views: 1, points: 0, ..Default::default() };
        let peeled = start(&[[0.0; 3]], Rendering::Peeled);
        let error = fit(&peeled, &builtin(&options).train, 1, &device, |_| ()).unwrap_err();
        assert!(error.to_string().contains("rendering"), "{error}");
    }
}

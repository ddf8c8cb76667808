//! Measures how well a scene shows views that it was not trained on.
//!
//! PSNR, SSIM and FLIP compare renders and photographs after both are quantised to 8 bits. PSNR is taken over all pixels
//! and channels of a view, then averaged over views (the protocol of 3DGS).

use std::time::Instant;

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::metrics::{mean_ssim, psnr, quantised};
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::{Error, Result};
use dpges_render::Rgb8Image;
use serde::{Deserialize, Serialize};

use crate::dataset::{Picture, View};
use crate::metrics::flip;
use crate::rendered::{Rendered, Renderer};
use crate::sight::Floaters;

/// PSNR of a picture that is equal to its photograph, dB. The true value, infinity, has no place in JSON or in a mean.
pub const LARGEST_PSNR: f64 = 100.0;

/// The scores of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScore {
    pub name: String,
    /// dB, at most [`LARGEST_PSNR`].
    pub psnr: f64,
    pub ssim: f64,
    /// An error, from 0 to 1.
    pub flip: f64,
    /// Time to render it.
    pub seconds: f64,
    /// px
    pub width: usize,
    /// px
    pub height: usize,
}

/// The scores of all views, and their means.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    pub views: Vec<ViewScore>,
    /// dB, mean over the views.
    pub psnr: f64,
    /// Mean over the views.
    pub ssim: f64,
    /// Mean over the views, an error from 0 to 1.
    pub flip: f64,
    pub surfels: usize,
    pub gaussians: usize,
    /// Time to render a view, mean over the views.
    pub seconds_per_view: f64,
}

/// An evaluation and what was evaluated: the content of `eval.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    /// Path of the scene file.
    pub scene: String,
    /// Folder of the dataset, or `builtin`.
    pub dataset: String,
    /// `test`, `train` or `validation`.
    pub split: String,
    #[serde(flatten)]
    pub evaluation: Evaluation,
    /// Size of the scene file.
    pub bytes: u64,
    /// Primitives that float, see [`sight`](crate::sight); absent if the dataset does not say which view saw what.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub floaters: Option<Floaters>,
    /// What the run was to reach; absent without a target.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<TargetReport>,
}

/// What a run was to reach, what was expected of it before, and what it has come to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetReport {
    /// As it was asked for, such as `10MB`.
    pub asked: String,
    /// `bytes` of the scene file, `seconds` of training up to the last step, or `frames_per_second`.
    pub unit: String,
    pub expected: f64,
    pub got: f64,
}

/// Renders every view and compares it with its photograph.
///
/// # Errors
/// Those of [`Renderer::render`]; [`Error::Option`] if there are no views.
pub fn evaluate(scene: &SceneData, views: &[View], device: &Device) -> Result<Evaluation> {
    evaluate_each(&Renderer::new(scene, device), scene, views, device, |_, _| Ok(()))
}

/// Like [`evaluate`], with a scene that is on its device already. Calls `visit` with the index and the render of every
/// view.
///
/// # Errors
/// Those of [`evaluate`] and of `visit`.
pub fn evaluate_each<E: From<Error>>(
    renderer: &Renderer,
    scene: &SceneData,
    views: &[View],
    device: &Device,
    mut visit: impl FnMut(usize, &Rendered) -> Result<(), E>,
) -> Result<Evaluation, E> {
    if views.is_empty() {
        return Err(Error::Option { option: "views", expected: "at least one".to_owned(), found: "none".into() }.into());
    }
    let mut scores = Vec::with_capacity(views.len());
    for (index, view) in views.iter().enumerate() {
        let start = Instant::now();
        let render = renderer.render(&view.camera)?;
        // a GPU may have only begun
        device.sync().map_err(|error| Error::Device { reason: error.to_string() })?;
        let seconds = start.elapsed().as_secs_f64();
        scores.push(score(view, render.image().clone(), seconds, device)?);
        visit(index, &render)?;
    }
    let mean = |of: fn(&ViewScore) -> f64| scores.iter().map(of).sum::<f64>() / scores.len() as f64;
    Ok(Evaluation {
        psnr: mean(|view| view.psnr),
        ssim: mean(|view| view.ssim),
        flip: mean(|view| view.flip),
        seconds_per_view: mean(|view| view.seconds),
        surfels: scene.surfels.len(),
        gaussians: scene.gaussians.len(),
        views: scores,
    })
}

/// The scores of a finished `picture` of `view`, which took `seconds` to render.
///
/// # Errors
/// [`Error::Shape`] if the picture has another size than the photograph.
pub fn score_picture(view: &View, picture: &Rgb8Image, seconds: f64, device: &Device) -> Result<ViewScore> {
    let (width, height) = (view.picture.width, view.picture.height);
    if (picture.width, picture.height) != (width, height) {
        let found = vec![picture.height, picture.width, 3];
        return Err(Error::Shape { tensor: "picture".to_owned(), expected: format!("[{height}, {width}, 3]"), found });
    }
    let channel = |channel: usize| picture.bytes.iter().skip(channel).step_by(3).map(|&byte| f32::from(byte) / 255.0);
    let planes: Vec<f32> = (0..3).flat_map(channel).collect();
    let image = Tensor::from_data(TensorData::new(planes, [3, height, width]), (device, DType::F32));
    score(view, image, seconds, device)
}

fn score(view: &View, image: Tensor<3>, seconds: f64, device: &Device) -> Result<ViewScore> {
    let Picture { width, height, .. } = view.picture;
    let picture = quantised(view.target(device));
    let image = quantised(image);
    let flip = flip(&tensor_to_rows(&picture), &tensor_to_rows(&image), width, height);
    let (psnr, ssim) = (psnr(image.clone(), picture.clone()), mean_ssim(image, picture)?);
    Ok(ViewScore { name: view.name.clone(), psnr: psnr.min(LARGEST_PSNR), ssim, flip, seconds, width, height })
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{
        ColourModel, Footprint, GaussianData, MarginLookup, Rendering, SceneInfo, ScreenFilter, SurfelData,
    };

    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};
    use crate::device::DeviceName;

    fn nothing(background: [f64; 3]) -> SceneData {
        let info = SceneInfo {
            colour_model: ColourModel::SphericalBeta { lobes: 0 },
            modulation: 30.0,
            layer_count: 2,
            footprint: Footprint::Kernel,
            margin_lookup: MarginLookup::Shifted,
            rendering: Rendering::Peeled,
            screen_filter: ScreenFilter::Compensated,
            background,
            offset: [0.0; 3],
            extent: 1.0,
            near: 0.01,
        };
        SceneData { info, surfels: SurfelData::default(), gaussians: GaussianData::default(), environment: None }
    }

    #[test]
    fn scores_are_those_of_eight_bit_pictures() {
        let options = BuiltinOptions { width: 12, height: 12, train_views: 2, test_views: 2, ..Default::default() };
        let mut views = builtin(&options).test;
        views[0].picture.planes.fill(0.5009);
        views[1].picture.planes.fill(0.25);
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let evaluation = evaluate(&nothing([0.5; 3]), &views, &device).unwrap();
        assert_eq!(evaluation.views[0].psnr, LARGEST_PSNR, "0.5 and 0.5009 are the same of 256 steps");
        let error = (128.0 - 64.0) / 255.0f64;
        assert!((evaluation.views[1].psnr + 20.0 * error.log10()).abs() < 1e-3);
        assert!((evaluation.views[0].ssim - 1.0).abs() < 1e-6 && evaluation.views[1].ssim < 1.0);
        assert_eq!(evaluation.psnr, (evaluation.views[0].psnr + evaluation.views[1].psnr) / 2.0);
        assert!(evaluate(&nothing([0.0; 3]), &[], &device).unwrap_err().to_string().contains("views"));

        let picture = |value: u8| Rgb8Image { width: 12, height: 12, bytes: vec![value; 3 * 12 * 12] };
        let scored = |index: usize, value: u8| score_picture(&views[index], &picture(value), 0.0, &device).unwrap();
        assert_eq!(scored(0, 128).psnr, LARGEST_PSNR);
        for (found, expected) in [(scored(1, 128), &evaluation.views[1]), (scored(0, 128), &evaluation.views[0])] {
            assert!((found.psnr - expected.psnr).abs() < 1e-4 && (found.ssim - expected.ssim).abs() < 1e-6);
            assert!((found.flip - expected.flip).abs() < 1e-6);
        }
        let narrow = Rgb8Image { width: 11, height: 12, bytes: vec![0; 3 * 11 * 12] };
        assert!(score_picture(&views[0], &narrow, 0.0, &device).unwrap_err().to_string().contains("picture"));
    }
}

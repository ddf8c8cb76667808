//! Measures how well a scene shows views that it was not trained on.
//!
//! All metrics compare renders and photographs after both are quantised to 8 bits. PSNR is taken over all pixels and
//! channels of a view, then averaged over views (the protocol of 3DGS). `docs/metrics.md` defines the others, and what
//! masks do to all of them.

use std::ops::Range;
use std::time::Instant;

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::camera::Camera;
use dpges_core::losses::{Mask, Target};
use dpges_core::metrics::{OF_IGNORED_PIXELS, mean_ssim, psnr, quantised};
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::{Error, Result};
use dpges_render::Rgb8Image;
use serde::{Deserialize, Serialize};

use crate::dataset::{Picture, View, pictures};
use crate::exposure::Correction;
use crate::metrics::lpips::{Lpips, Network};
use crate::metrics::{Fitted, Perceptual, Scores, flip, flip_map};
use crate::popping::Popping;
use crate::pose_fit::fitted_pose;
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
    #[serde(flatten)]
    pub perceptual: Perceptual,
    #[serde(flatten)]
    pub fitted: Fitted,
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
    /// Means over the views, of what all of them have.
    #[serde(flatten)]
    pub perceptual: Perceptual,
    /// Likewise.
    #[serde(flatten)]
    pub fitted: Fitted,
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
    /// Wall-clock time of the run up to its last step, see [`MetricsLog::seconds_of_steps`]; absent if the scene is not that
    /// of a run.
    ///
    /// [`MetricsLog::seconds_of_steps`]: crate::run::metrics_log::MetricsLog::seconds_of_steps
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub training_seconds: Option<f64>,
    /// The most memory that the process which wrote the report has had in use; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_memory_bytes: Option<u64>,
    /// What the run was to reach; absent without a target.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<TargetReport>,
    /// How much the scene pops along [an arc](fn@crate::popping::arc); absent unless it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub popping: Option<Popping>,
    /// Absent unless they were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_ms: Option<FrameMs>,
}

/// Times of the frames of a renderer, and what they were measured on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameMs {
    /// Median, ms.
    pub p50: f64,
    /// The time that 99 % of the frames do not exceed, ms.
    pub p99: f64,
    /// Name and interface of the adapter.
    pub device: String,
    /// px
    pub width: usize,
    /// px
    pub height: usize,
    /// `raster`, the real-time one.
    pub renderer: String,
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

/// What is measured besides PSNR, SSIM and FLIP.
#[derive(Clone, Copy, Debug)]
pub struct Measures<'a> {
    /// MS-SSIM, SSIMULACRA2, and LPIPS by these networks, which are on the device that renders; `None`: none of them.
    pub perceptual: Option<&'a [Lpips]>,
    /// Whether PSNR and SSIM are also measured after a fit of exposure, see [`Fitted`].
    pub fitted: bool,
    /// Whether they are also measured after a fit of the camera, which renders every view many times.
    pub posed: bool,
}

impl<'a> Measures<'a> {
    /// Nothing: what a run needs to go on.
    pub const BASIC: Self = Self { perceptual: None, fitted: false, posed: false };

    /// MS-SSIM, SSIMULACRA2, and LPIPS by `networks`.
    pub fn perceptual(networks: &'a [Lpips]) -> Self {
        Self { perceptual: Some(networks), ..Self::BASIC }
    }

    /// The same, and a fit of exposure if it is wanted.
    #[must_use]
    pub fn fitted(self, fitted: bool) -> Self {
        Self { fitted, ..self }
    }

    /// The same, and a fit of cameras if it is wanted.
    #[must_use]
    pub fn posed(self, posed: bool) -> Self {
        Self { posed, ..self }
    }
}

impl ViewScore {
    pub fn scores(&self) -> Scores {
        let Self { psnr, ssim, flip, perceptual, fitted, .. } = *self;
        Scores { psnr, ssim, flip, perceptual, fitted }
    }
}

impl Evaluation {
    /// The means over the views.
    pub fn scores(&self) -> Scores {
        let Self { psnr, ssim, flip, perceptual, fitted, .. } = *self;
        Scores { psnr, ssim, flip, perceptual, fitted }
    }

    /// The PSNR that a run decides by, dB: after a fit of exposure if that was measured.
    pub fn deciding_psnr(&self) -> f64 {
        self.fitted.psnr_fitted.unwrap_or(self.psnr)
    }
}

/// Renders every view and compares it with its photograph, by PSNR, SSIM and FLIP.
///
/// # Errors
/// Those of [`Renderer::render`]; [`Error::Option`] if there are no views.
pub fn evaluate(scene: &SceneData, views: &[View], device: &Device) -> Result<Evaluation> {
    evaluate_each(&Renderer::new(scene, device), scene, views, device, Measures::BASIC, |_, _| Ok(()))
}

/// Like [`evaluate`], with a scene that is on its device already, by all `measures`. Calls `visit` with the index and the
/// render of every view.
///
/// # Errors
/// Those of [`evaluate`] and of `visit`.
pub fn evaluate_each<E: From<Error>>(
    renderer: &Renderer,
    scene: &SceneData,
    views: &[View],
    device: &Device,
    measures: Measures<'_>,
    mut visit: impl FnMut(usize, &Rendered) -> Result<(), E>,
) -> Result<Evaluation, E> {
    if views.is_empty() {
        return Err(Error::Option { option: "views", expected: "at least one".to_owned(), found: "none".into() }.into());
    }
    let mut scores = Vec::with_capacity(views.len());
    for (index, (view, picture)) in pictures(views).enumerate() {
        let picture = picture?;
        let start = Instant::now();
        let render = renderer.render(&view.camera)?;
        // a GPU may have only begun
        device.sync().map_err(|error| Error::Device { reason: error.to_string() })?;
        let seconds = start.elapsed().as_secs_f64();
        let mut score = score(&view.name, &picture, render.image().clone(), seconds, device, measures)?;
        if measures.posed {
            [score.fitted.psnr_posed, score.fitted.ssim_posed] =
                posed(renderer, view, &picture, scene.info.extent, device, measures.fitted)?;
        }
        scores.push(score);
        visit(index, &render)?;
    }
    let mean = |of: fn(&ViewScore) -> f64| scores.iter().map(of).sum::<f64>() / scores.len() as f64;
    Ok(Evaluation {
        psnr: mean(|view| view.psnr),
        ssim: mean(|view| view.ssim),
        flip: mean(|view| view.flip),
        perceptual: Perceptual::mean(&scores.iter().map(|view| view.perceptual).collect::<Vec<_>>()),
        fitted: Fitted::mean(&scores.iter().map(|view| view.fitted).collect::<Vec<_>>()),
        seconds_per_view: mean(|view| view.seconds),
        surfels: scene.surfels.len(),
        gaussians: scene.gaussians.len(),
        views: scores,
    })
}

/// The scores of a finished `picture` of `view`, which took `seconds` to render.
///
/// # Errors
/// [`Error::Shape`] if the picture has another size than the photograph, [`Error::Io`] if that cannot be read again.
pub fn score_picture(view: &View, picture: &Rgb8Image, seconds: f64, device: &Device) -> Result<ViewScore> {
    let (width, height) = (view.camera.width, view.camera.height);
    if (picture.width, picture.height) != (width, height) {
        let found = vec![picture.height, picture.width, 3];
        return Err(Error::Shape { tensor: "picture".to_owned(), expected: format!("[{height}, {width}, 3]"), found });
    }
    let channel = |channel: usize| picture.bytes.iter().skip(channel).step_by(3).map(|&byte| f32::from(byte) / 255.0);
    let planes: Vec<f32> = (0..3).flat_map(channel).collect();
    let image = Tensor::from_data(TensorData::new(planes, [3, height, width]), (device, DType::F32));
    let photograph = view.picture()?;
    score(&view.name, &photograph, image, seconds, device, Measures::BASIC)
}

fn score(
    name: &str,
    photograph: &Picture,
    image: Tensor<3>,
    seconds: f64,
    device: &Device,
    measures: Measures<'_>,
) -> Result<ViewScore> {
    let Picture { width, height, counted, .. } = photograph;
    let (width, height) = (*width, *height);
    let Target { image: picture, mask } = photograph.target(device);
    let picture = quantised(picture);
    let fitted = if measures.fitted { fitted(&picture, counted.as_deref(), &image)? } else { Fitted::default() };
    let [image, picture] = [quantised(image), picture].map(|picture| match &mask {
        Some(mask) => mask.filled(picture, OF_IGNORED_PIXELS),
        None => picture,
    });
    let (reference, test) = (tensor_to_rows(&picture), tensor_to_rows(&image));
    let perceptual = match measures.perceptual {
        None => Perceptual::default(),
        Some(networks) => {
            let mut perceptual = Perceptual::without_networks(&reference, &test, width, height);
            for lpips in networks {
                let distance = lpips.distance(&picture, &image)?;
                match lpips.network {
                    Network::Alex => perceptual.lpips_alex = distance,
                    Network::Vgg => perceptual.lpips_vgg = distance,
                }
            }
            perceptual
        }
    };
    let flip = match counted {
        Some(counted) => mean_where(&flip_map(&reference, &test, width, height), counted),
        None => flip(&reference, &test, width, height),
    };
    let target = Target { image: picture, mask };
    let (psnr, ssim) = (psnr(image.clone(), target.clone()).min(LARGEST_PSNR), mean_ssim(image, target)?);
    Ok(ViewScore { name: name.to_owned(), psnr, ssim, flip, perceptual, fitted, seconds, width, height })
}

/// Mean of the `values` of pixels that count; at least one does.
fn mean_where(values: &[f64], counted: &[bool]) -> f64 {
    let of_counted = || values.iter().zip(counted).filter(|(_, counts)| **counts).map(|(value, _)| value);
    of_counted().sum::<f64>() / of_counted().count() as f64
}

/// How well the right half of `image` shows that of `picture`, both [3, H, W], with the exposure that fits their left halves.
/// Only pixels that count are in either, of `counted` [H × W] or all of them.
fn fitted(picture: &Tensor<3>, counted: Option<&[bool]>, image: &Tensor<3>) -> Result<Fitted> {
    let [psnr_fitted, ssim_fitted] = of_right_half(picture, counted, image, true)?;
    Ok(Fitted { psnr_fitted, ssim_fitted, ..Fitted::default() })
}

/// PSNR and SSIM of the right half of `view` from the camera that fits the left half of its `picture`, and with the
/// `exposure` that does, in every step of the fit too, if that is wanted; `None` if either half has no pixel that counts.
fn posed(
    renderer: &Renderer,
    view: &View,
    picture: &Picture,
    extent: f64,
    device: &Device,
    exposure: bool,
) -> Result<[Option<f64>; 2]> {
    let (width, counted) = (picture.width, picture.counted.as_deref());
    let is_left = |pixel: usize| pixel % width < width / 2 && counted.is_none_or(|counted| counted[pixel]);
    let left: Vec<bool> = (0..picture.area()).map(is_left).collect();
    if !left.contains(&true) {
        return Ok([None; 2]);
    }
    let target = |device: &Device| -> Result<Target> {
        let mask = Some(Mask::new(&left, width, picture.height, device)?);
        Ok(Target { mask, ..picture.target(device) })
    };
    let photograph = quantised(picture.target(device).image);
    let exposed = |image: Tensor<3>| {
        if !exposure {
            return image;
        }
        Correction::fitted(&image.clone().inner(), &photograph, Some(&left)).applied(image)
    };
    let correction = fitted_pose(renderer, &view.camera, target, exposed, extent, device)?;
    let pose = correction.applied(&view.camera.camera_from_world);
    let rendered = renderer.render(&Camera { camera_from_world: pose, ..view.camera })?;
    of_right_half(&photograph, counted, rendered.image(), exposure)
}

/// PSNR and SSIM of the right half of `image`, as [`fitted`] has them, with or without the `exposure` that fits the left half;
/// `None` if either half has no pixel that counts.
fn of_right_half(
    picture: &Tensor<3>,
    counted: Option<&[bool]>,
    image: &Tensor<3>,
    exposure: bool,
) -> Result<[Option<f64>; 2]> {
    let [_, height, width] = picture.dims();
    let (left, right) = (0..width / 2, width / 2..width);
    let part = |of: &Tensor<3>, columns: &Range<usize>| of.clone().slice([0..3, 0..height, columns.clone()]);
    let counted_in = |columns: &Range<usize>| -> Vec<bool> {
        let counts = |pixel: usize| counted.is_none_or(|counted| counted[pixel]);
        (0..height).flat_map(|row| columns.clone().map(move |column| row * width + column)).map(counts).collect()
    };
    let (fitted_to, judged_by) = (counted_in(&left), counted_in(&right));
    if !fitted_to.contains(&true) || !judged_by.contains(&true) {
        return Ok([None; 2]);
    }
    let shown = part(image, &right);
    let image = quantised(if exposure {
        Correction::fitted(&part(image, &left), &part(picture, &left), Some(&fitted_to)).applied(shown)
    } else {
        shown
    });
    let mask = counted.map(|_| Mask::new(&judged_by, right.len(), height, &image.device())).transpose()?;
    let target = Target { image: part(picture, &right), mask };
    let psnr = psnr(image.clone(), target.clone()).min(LARGEST_PSNR);
    Ok([Some(psnr), Some(mean_ssim(image, target)?)])
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{
        ColourModel, Footprint, GaussianData, MarginLookup, Rendering, SceneInfo, ScreenFilter, SurfelData,
    };

    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};
    use crate::device::DeviceName;
    use crate::metrics::lpips::Weights;

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
        views[0].repaint(|picture| picture.bytes.fill(128)).unwrap();
        views[1].repaint(|picture| picture.bytes.fill(64)).unwrap();
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let evaluation = evaluate(&nothing([0.5; 3]), &views, &device).unwrap();
        assert_eq!(evaluation.views[0].psnr, LARGEST_PSNR, "0.5 and 128/255 are the same of 256 steps");
        let error = (128.0 - 64.0) / 255.0f64;
        assert!((evaluation.views[1].psnr + 20.0 * error.log10()).abs() < 1e-3);
        assert!((evaluation.views[0].ssim - 1.0).abs() < 1e-6 && evaluation.views[1].ssim < 1.0);
        assert_eq!(evaluation.psnr, (evaluation.views[0].psnr + evaluation.views[1].psnr) / 2.0);
        assert_eq!(evaluation.perceptual, Perceptual::default());
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

    #[test]
    fn what_does_not_count_is_in_no_score() {
        let options = BuiltinOptions { width: 32, height: 32, train_views: 2, test_views: 2, ..Default::default() };
        let mut views = builtin(&options).test;
        let counted: Vec<bool> = (0..32 * 32).map(|pixel| pixel % 32 < 20).collect();
        for (index, view) in views.iter_mut().enumerate() {
            let garbage = 255 * index as u8;
            let paint = |picture: &mut Picture| {
                picture.bytes = counted.iter().flat_map(|&counts| [if counts { 128 } else { garbage }; 3]).collect();
                picture.counted = Some(counted.clone());
            };
            view.repaint(paint).unwrap();
        }
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let scored = |value: f64| {
            let scene = nothing([value; 3]);
            let (renderer, measures) = (Renderer::new(&scene, &device), Measures::perceptual(&[]).fitted(true));
            let evaluation: Result<Evaluation> =
                evaluate_each(&renderer, &scene, &views, &device, measures, |_, _| Ok(()));
            evaluation.unwrap().views.iter().map(ViewScore::scores).collect::<Vec<_>>()
        };
        let [equal, darker] = [scored(0.5), scored(0.25)].map(|scores| [scores[0], scores[1]]);
        assert!(equal[0] == equal[1] && darker[0] == darker[1], "{equal:?} {darker:?}");
        assert_eq!((equal[0].psnr, equal[0].flip, equal[0].perceptual.ssimulacra2), (LARGEST_PSNR, 0.0, Some(100.0)));
        assert!((equal[0].ssim - 1.0).abs() < 1e-6 && darker[0].ssim < 1.0 && darker[0].flip > 0.0);
        assert!((darker[0].psnr + 20.0 * (64.0 / 255.0f64).log10()).abs() < 1e-3, "{darker:?}");
        assert_eq!(darker[0].fitted.psnr_fitted, Some(LARGEST_PSNR));
    }

    #[test]
    fn perceptual_measures_are_those_of_the_same_pictures() {
        let options = BuiltinOptions { width: 32, height: 32, train_views: 2, test_views: 2, ..Default::default() };
        let mut views = builtin(&options).test;
        views[0].repaint(|picture| picture.bytes.fill(128)).unwrap();
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let weights = Weights::new(Network::Alex, |tensor| {
            (0..tensor.shape.iter().product::<usize>()).map(|i| (i * 37 % 101) as f32 / 1000.0).collect()
        });
        let networks = [Lpips::new(&weights, &device)];
        let scene = nothing([0.5; 3]);
        let renderer = Renderer::new(&scene, &device);
        let measures = Measures::perceptual(&networks);
        let evaluation: Result<Evaluation> = evaluate_each(&renderer, &scene, &views, &device, measures, |_, _| Ok(()));
        let evaluation = evaluation.unwrap();
        let equal = evaluation.views[0].perceptual;
        assert_eq!((equal.ms_ssim, equal.lpips_vgg), (None, None), "too small, and not asked for");
        assert_eq!((equal.ssimulacra2, equal.lpips_alex), (Some(100.0), Some(0.0)));
        let other = evaluation.views[1].perceptual;
        assert!(other.ssimulacra2.unwrap() < 100.0 && other.lpips_alex.unwrap() > 0.0);
        assert_eq!(evaluation.perceptual, Perceptual::mean(&[equal, other]));
        assert_eq!(evaluation.scores().perceptual, evaluation.perceptual);
    }

    #[test]
    fn an_exposure_that_fits_the_left_half_is_applied_to_the_right() {
        let (width, height) = (17, 12);
        let change = Correction { gain: [0.5, 0.75, 1.25], offset: [0.25, 0.0, -0.125] };
        let shape = |values: Vec<f32>| {
            Tensor::<3>::from_data(TensorData::new(values, [3, height, width]), (&Device::flex(), DType::F32))
        };
        let values = (0..3 * height * width).map(|i| 0.2 + 0.6 * (i * 37 % 101) as f32 / 101.0).collect();
        let image = shape(values);
        let photograph = change.applied(image.clone());
        let both = fitted(&quantised(photograph.clone()), None, &image).unwrap();
        assert!(both.psnr_fitted.unwrap() > 50.0 && both.ssim_fitted.unwrap() > 0.999, "{both:?}");
        // the right half of another photograph: what the left half says of it is wrong
        let half = width / 2;
        let [left, right] = [0..half, half..width].map(|columns| [0..3, 0..height, columns]);
        let mixed = Tensor::cat(vec![photograph.slice(left), image.clone().slice(right)], 2);
        let wrong = fitted(&quantised(mixed), None, &image).unwrap();
        assert!(wrong.psnr_fitted.unwrap() < 25.0, "{wrong:?}");
        let narrow = image.slice([0..3, 0..height, 0..1]);
        assert_eq!(fitted(&narrow, None, &narrow).unwrap(), Fitted::default());
    }

    #[test]
    fn pixels_that_do_not_count_are_neither_fitted_nor_judged() {
        let (width, height) = (17, 12);
        let change = Correction { gain: [0.5, 0.75, 1.25], offset: [0.25, 0.0, -0.125] };
        let shape = |values: Vec<f32>| {
            Tensor::<3>::from_data(TensorData::new(values, [3, height, width]), (&Device::flex(), DType::F32))
        };
        let values = (0..3 * height * width).map(|i| 0.2 + 0.6 * (i * 37 % 101) as f32 / 101.0).collect();
        let image = shape(values);
        // a column of each half is black
        let counted: Vec<bool> = (0..height * width).map(|pixel| ![3, 12].contains(&(pixel % width))).collect();
        let mut painted = tensor_to_rows(&change.applied(image.clone()));
        let planes = painted.iter_mut().zip(counted.iter().cycle());
        planes.filter(|(_, counts)| !**counts).for_each(|(value, _)| *value = 0.0);
        let photograph = quantised(shape(painted));
        let with_mask = fitted(&photograph, Some(&counted), &image).unwrap();
        assert!(with_mask.psnr_fitted.unwrap() > 50.0 && with_mask.ssim_fitted.unwrap() > 0.999, "{with_mask:?}");
        let without = fitted(&photograph, None, &image).unwrap();
        assert!(without.psnr_fitted.unwrap() < 25.0, "{without:?}");
        // nothing counts in one half
        for half in [0..width / 2, width / 2..width] {
            let counted: Vec<bool> = (0..height * width).map(|pixel| half.contains(&(pixel % width))).collect();
            assert_eq!(fitted(&photograph, Some(&counted), &image).unwrap(), Fitted::default());
        }
    }

    #[test]
    fn fits_are_part_of_an_evaluation_if_they_are_wanted() {
        let options = BuiltinOptions { width: 12, height: 12, train_views: 2, test_views: 2, ..Default::default() };
        let mut views = builtin(&options).test;
        views[0].repaint(|picture| picture.bytes.fill(191)).unwrap();
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let scene = nothing([0.5; 3]);
        let renderer = Renderer::new(&scene, &device);
        let measured = |measures| -> Evaluation {
            let found: Result<Evaluation> = evaluate_each(&renderer, &scene, &views, &device, measures, |_, _| Ok(()));
            found.unwrap()
        };
        let plain = measured(Measures::BASIC);
        assert_eq!((plain.fitted, plain.deciding_psnr()), (Fitted::default(), plain.psnr));
        assert!(!serde_json::to_string(&plain).unwrap().contains("fitted"));
        let with = measured(Measures::BASIC.fitted(true));
        // a plain picture differs from a plain photograph by an offset
        assert!(with.views[0].psnr < 13.0 && with.views[0].fitted.psnr_fitted.unwrap() > 50.0);
        let mean = (0..2).map(|view| with.views[view].fitted.psnr_fitted.unwrap()).sum::<f64>() / 2.0;
        assert_eq!((with.fitted.psnr_fitted, with.deciding_psnr()), (Some(mean), mean));
        let json = serde_json::to_value(&with).unwrap();
        assert_eq!(json["psnr_fitted"].as_f64(), Some(mean));
        assert_eq!(serde_json::from_value::<Evaluation>(json).unwrap(), with);
    }

    #[test]
    fn cameras_are_fitted_to_the_left_half_and_judged_by_the_right() {
        let options = BuiltinOptions { width: 16, height: 16, train_views: 2, test_views: 2, ..Default::default() };
        let mut views = builtin(&options).test;
        // nothing on the right counts
        views[1].repaint(|picture| picture.counted = Some((0..16 * 16).map(|pixel| pixel % 16 < 8).collect())).unwrap();
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let mut scene = nothing([0.5; 3]);
        let model = scene.info.colour_model;
        scene.gaussians = GaussianData::neutral(model, 1);
        let renderer = Renderer::new(&scene, &device);
        let measured = |views: &[View], measures| -> Evaluation {
            let found: Result<Evaluation> = evaluate_each(&renderer, &scene, views, &device, measures, |_, _| Ok(()));
            found.unwrap()
        };
        let found = measured(&views, Measures::BASIC.posed(true));
        let of = |view: usize| found.views[view].fitted;
        assert!(of(0).psnr_posed.is_some() && of(0).ssim_posed.is_some() && of(0).psnr_fitted.is_none());
        assert_eq!((of(1), found.fitted), (Fitted::default(), Fitted::default()));
        let json = serde_json::to_value(&found).unwrap();
        assert_eq!(json["views"][0]["psnr_posed"].as_f64(), of(0).psnr_posed);
        let both = measured(&views[..1], Measures::BASIC.fitted(true).posed(true)).fitted;
        assert!(both.psnr_posed.is_some() && both.psnr_posed != of(0).psnr_posed, "{both:?}");
    }

    #[test]
    fn reports_of_earlier_versions_are_read() {
        let view = r#"{"name":"a","psnr":20.0,"ssim":0.5,"flip":0.25,"seconds":0.5,"width":8,"height":4}"#;
        let text = format!(
            r#"{{"scene":"a","dataset":"builtin","split":"test","views":[{view}],"psnr":20.0,"ssim":0.5,"flip":0.25,
            "surfels":1,"gaussians":2,"seconds_per_view":0.5,"bytes":3}}"#
        );
        let report: EvalReport = serde_json::from_str(&text).unwrap();
        assert_eq!((report.training_seconds, report.peak_memory_bytes), (None, None));
        assert_eq!(report.evaluation.views[0].perceptual, Perceptual::default());
        let mut written = serde_json::to_value(&report).unwrap();
        assert_eq!(written, serde_json::from_str::<serde_json::Value>(&text).unwrap(), "nothing is added");
        written["lpips_vgg"] = 0.125.into();
        written["views"][0]["ssimulacra2"] = 60.5.into();
        let report: EvalReport = serde_json::from_value(written).unwrap();
        assert_eq!(report.evaluation.perceptual.lpips_vgg, Some(0.125));
        assert_eq!(report.evaluation.views[0].scores().perceptual.ssimulacra2, Some(60.5));
    }
}

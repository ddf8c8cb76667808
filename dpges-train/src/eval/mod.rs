//! Measures how well a scene shows views that it was not trained on.
//!
//! All metrics compare renders and photographs after both are quantised to 8 bits. PSNR is taken over all pixels and
//! channels of a view, then averaged over views (the protocol of 3DGS). `docs/guide/measure.md` defines the others, and what
//! masks do to all of them.

pub mod compress;
pub mod export;
mod fits;
pub mod floaters;
pub mod frame_ms;
pub mod frame_rates;
pub mod painted;
pub mod pictures;
pub mod plan;
pub mod popping;
mod pose_fit;
pub mod rendered;
pub mod rendering_preset;
pub mod simplify;
pub mod splat_fit;
pub mod stitched;
pub mod table;
#[cfg(test)]
mod tests;
pub mod video;
pub mod worst;

use std::time::Instant;

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::losses::Target;
use dpges_core::ranks::Ranks;
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::{Error, Result};
use dpges_render::Rgb8Image;
use serde::{Deserialize, Serialize};

use crate::dataset::{Picture, View, pictures};
use crate::eval::floaters::Floaters;
use crate::eval::popping::Popping;
use crate::eval::rendered::{Rendered, TrainingRenderer};
use crate::metrics::lpips::Lpips;
use crate::metrics::{
    Fitted, OF_IGNORED_PIXELS, Perceptual, Scores, flip, flip_map, mean_ssim, ms_ssim, psnr, quantised, ssimulacra2,
};
use crate::views::target::ToTarget;
use fits::{fitted, posed};
pub use frame_ms::FrameMs;

/// PSNR of a picture that is equal to its photograph, dB. The true value, infinity, has no place in JSON or in a mean.
pub const LARGEST_PSNR: f64 = 100.0;

/// The scores of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScore {
    pub name: String,
    /// PSNR is at most [`LARGEST_PSNR`].
    #[serde(flatten)]
    pub scores: Scores,
    /// Time to render it.
    pub seconds: f64,
    /// Share of the picture that surfels cover; absent of scenes without layers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<f64>,
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
    /// Mean over the views of those shares that surfels cover; absent of scenes without layers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<f64>,
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
    pub bytes: u64,
    /// Primitives that float, see [`floaters`]; absent if the dataset does not say which view saw what.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub floaters: Option<Floaters>,
    /// Wall-clock time of the run [up to its last step](crate::run::metrics_log::MetricsLog::seconds_of_steps); absent if the
    /// scene is not that of a run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub training_seconds: Option<f64>,
    /// The most memory of the process that wrote the report, bytes: [since the run began](crate::device::memory::PeakMemory) if one did,
    /// else so far. Absent where it is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peak_memory_bytes: Option<u64>,
    /// The target of the run, if it had one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<TargetReport>,
    /// How much the scene pops along [an arc](fn@crate::eval::popping::arc); absent unless it was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub popping: Option<Popping>,
    /// Absent unless they were measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_ms: Option<FrameMs>,
}

/// The target of a run, the expectation before it, and its result.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetReport {
    /// As it was asked for, such as `5min`.
    pub asked: String,
    /// `seconds` of training up to the last step, or `frames_per_second`.
    pub unit: String,
    pub expected: f64,
    pub got: f64,
}

/// Optional measurements besides PSNR, SSIM and FLIP.
#[derive(Clone, Copy, Debug)]
pub struct Measures<'a> {
    /// Whether MS-SSIM and SSIMULACRA2 are measured.
    pub perceptual: bool,
    /// LPIPS is measured by these networks, which are on the device that renders.
    pub networks: &'a [Lpips],
    /// Whether PSNR and SSIM are also measured after a fit of exposure, see [`Fitted`].
    pub fitted: bool,
    /// Whether they are also measured after a fit of the camera, which renders every view many times.
    pub posed: bool,
}

impl<'a> Measures<'a> {
    /// Nothing: what a run needs to go on.
    pub const BASIC: Self = Self { perceptual: false, networks: &[], fitted: false, posed: false };

    /// MS-SSIM, SSIMULACRA2, and LPIPS by `networks`.
    pub fn perceptual(networks: &'a [Lpips]) -> Self {
        Self { perceptual: true, ..Self::lpips(networks) }
    }

    /// LPIPS by `networks`.
    pub fn lpips(networks: &'a [Lpips]) -> Self {
        Self { networks, ..Self::BASIC }
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
/// The errors of [`TrainingRenderer::render`]; [`Error::Option`] if there are no views.
pub fn evaluate(scene: &SceneData, views: &[View], device: &Device) -> Result<Evaluation> {
    evaluate_each(&TrainingRenderer::new(scene, device), scene, views, Measures::BASIC, |_, _| Ok(()))
}

/// Like [`evaluate`], with a scene that is on its device already, by all `measures`. Views are shared out among the ranks, which all
/// get the result. Calls `visit` with the index and the render of every view of this rank.
pub fn evaluate_each<E: From<Error>>(
    renderer: &TrainingRenderer,
    scene: &SceneData,
    views: &[View],
    measures: Measures<'_>,
    mut visit: impl FnMut(usize, &Rendered) -> Result<(), E>,
) -> Result<Evaluation, E> {
    if views.is_empty() {
        return Err(Error::Option { option: "views", expected: "at least one".to_owned(), found: "none".into() }.into());
    }
    let (job, device) = (renderer.job(), renderer.device());
    let mut own_pictures = pictures(views.iter().skip(job.rank()).step_by(job.count()));
    let mut own = Vec::with_capacity(views.len());
    for (index, view) in views.iter().enumerate() {
        let is_own = index % job.count() == job.rank();
        if !is_own && !renderer.is_sharded() {
            continue;
        }
        let start = Instant::now();
        let render = renderer.render(&view.camera)?;
        // a GPU may have only begun
        device.sync().map_err(|error| Error::Device { reason: error.to_string() })?;
        let seconds = start.elapsed().as_secs_f64();
        let Some((_, picture)) = is_own.then(|| own_pictures.next()).flatten() else { continue };
        let picture = picture?;
        let mut score = score(&view.name, &picture, render.image().clone(), seconds, device, measures)?;
        if measures.posed {
            [score.scores.fitted.psnr_posed, score.scores.fitted.ssim_posed] =
                posed(renderer, view, &picture, scene.info.extent, measures.fitted)?;
        }
        score.coverage = render.coverage();
        own.push(score);
        visit(index, &render)?;
    }
    let views = of_all_ranks(own, views.len(), job)?;
    let Scores { psnr, ssim, flip, perceptual, fitted } = mean_scores(&views);
    Ok(Evaluation {
        psnr,
        ssim,
        flip,
        perceptual,
        fitted,
        coverage: views.iter().map(|view| view.coverage).sum::<Option<f64>>().map(|sum| sum / views.len() as f64),
        seconds_per_view: views.iter().map(|view| view.seconds).sum::<f64>() / views.len() as f64,
        surfels: scene.surfels.len(),
        gaussians: scene.gaussians.len(),
        views,
    })
}

pub fn mean_scores(views: &[ViewScore]) -> Scores {
    Scores::mean(&views.iter().map(|view| view.scores).collect::<Vec<_>>())
}

/// The scores of all `views`, which were shared out one by one.
fn of_all_ranks(own: Vec<ViewScore>, views: usize, ranks: &dyn Ranks) -> Result<Vec<ViewScore>> {
    if ranks.is_alone() {
        return Ok(own);
    }
    let text = serde_json::to_vec(&own).expect("scores are numbers");
    let mut of_ranks = Vec::with_capacity(ranks.count());
    for (rank, text) in ranks.gather(&text).iter().enumerate() {
        // what is no number has no text
        let scores = serde_json::from_slice::<Vec<ViewScore>>(text);
        let not_finite = |_| Error::NonFinite { tensor: format!("a score of rank {rank}"), row: 0 };
        of_ranks.push(scores.map_err(not_finite)?.into_iter());
    }
    Ok((0..views).filter_map(|index| of_ranks[index % ranks.count()].next()).collect())
}

/// The scores of a finished `picture` of `view`, which took `seconds` to render, by `measures` but those that render.
///
/// # Errors
/// [`Error::Shape`] if the picture has another size than the photograph, [`Error::Io`] if that cannot be read again.
pub fn score_picture(
    view: &View,
    picture: &Rgb8Image,
    seconds: f64,
    device: &Device,
    measures: Measures<'_>,
) -> Result<ViewScore> {
    let (width, height) = (view.camera.width, view.camera.height);
    if (picture.width, picture.height) != (width, height) {
        let found = vec![picture.height, picture.width, 3];
        return Err(Error::Shape { tensor: "picture".to_owned(), expected: format!("[{height}, {width}, 3]"), found });
    }
    let planes = pictures::planes(picture);
    let image = Tensor::from_data(TensorData::new(planes, [3, height, width]), (device, DType::F32));
    let photograph = view.picture()?;
    score(&view.name, &photograph, image, seconds, device, measures)
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
    let mut perceptual = Perceptual::default();
    if measures.perceptual {
        perceptual.ms_ssim = ms_ssim(&reference, &test, width, height);
        perceptual.ssimulacra2 = ssimulacra2(&reference, &test, width, height);
    }
    for lpips in measures.networks {
        *perceptual.lpips_mut(lpips.network) = lpips.distance(&picture, &image)?;
    }
    let flip = match counted {
        Some(counted) => mean_where(&flip_map(&reference, &test, width, height), counted),
        None => flip(&reference, &test, width, height),
    };
    let target = Target { image: picture, mask };
    let (psnr, ssim) = (psnr(image.clone(), target.clone()).min(LARGEST_PSNR), mean_ssim(image, target)?);
    let scores = Scores { psnr, ssim, flip, perceptual, fitted };
    Ok(ViewScore { name: name.to_owned(), scores, seconds, coverage: None, width, height })
}

/// Mean of the `values` of pixels that count; at least one does.
fn mean_where(values: &[f64], counted: &[bool]) -> f64 {
    let of_counted = || values.iter().zip(counted).filter(|(_, counts)| **counts).map(|(value, _)| value);
    of_counted().sum::<f64>() / of_counted().count() as f64
}

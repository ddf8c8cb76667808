//! A scene without primitives that are waste: outside of a box, oversized, floating, seen by no camera.

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use clap::Args;
use dpges_core::camera::Camera;
use dpges_core::scene::{Rendering, SceneData};
use serde::Serialize;

use super::TrainError;
use super::consolidate::{consolidate, share};
use crate::dataset::block::Bounds;
use crate::dataset::source::Source;
use crate::dataset::{Dataset, Split, View};
use crate::eval::compress::report::Psnr;
use crate::eval::floaters::Votes;
use crate::eval::pictures::save_png;
use crate::eval::rendered::{TrainingRenderer, to_picture};
use crate::eval::simplify::Contributions;
use crate::eval::{Evaluation, evaluate};

const UNSEEN: &str = "unseen";
/// Steps by which fewer primitives learn to look like all.
const CONSOLIDATION_STEPS: usize = 400;
/// Weights over the pixels of a view which together are less change none by a hundredth of one of 256 levels: thousands of such
/// primitives together do not show, either.
const UNSEEN_PX: f64 = 0.01 / 255.0;

/// Why there is no clean scene.
#[derive(Debug, thiserror::Error)]
pub enum CleanError {
    #[error("nothing would be left of the scene: is the box in its coordinates, and the size in its units?")]
    Nothing,
    #[error("--floaters: the dataset does not say which view saw which point, and so nobody knows what floats")]
    NoTracks,
    #[error("--consolidate trains surfels with order-free sums of Gaussians alone, and this scene is rendered as {0}")]
    NotPeeled(Rendering),
    #[error("--consolidate needs training views, and the dataset has none")]
    NoViews,
    #[error("consolidation: {0}")]
    Fit(#[from] TrainError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}

type Result<T, E = dpges_core::Error> = std::result::Result<T, E>;

/// Rules besides that of primitives that no camera sees.
#[derive(Args, Clone, Copy, Debug)]
pub struct Rules {
    /// Remove all whose centres are outside, in coordinates of the scene, world units
    #[arg(long = "box", value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    pub bounds: Option<Bounds>,
    /// Remove all of which a scale (standard deviation) is larger, world units; `dpges info` prints percentiles
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true, value_parser = size)]
    pub largest: Option<f64>,
    /// Remove what floats, by a dataset whose points say which view saw them. It was trained to help: views like the photographs
    /// lose, by about 1 dB where it was measured
    #[arg(long)]
    pub floaters: bool,
    /// Then keep this share of the primitives, as in 50%, those that contribute most to the training views, and train them for
    /// 400 steps to look there like all of them
    #[arg(long, value_name = "N%", allow_hyphen_values = true, value_parser = share)]
    pub consolidate: Option<f64>,
}

impl Rules {
    /// Whether nothing is left to do without a dataset, or not all that is asked for.
    pub fn need_dataset(&self) -> bool {
        self.floaters || self.consolidate.is_some() || (self.bounds.is_none() && self.largest.is_none())
    }
}

/// Primitives that a rule removed, of those that the rules before it left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Removed {
    pub rule: &'static str,
    pub surfels: usize,
    pub gaussians: usize,
}

/// A scene and what was removed from it, rule by rule.
#[derive(Clone, Debug)]
pub struct Cleaned {
    pub scene: SceneData,
    pub removed: Vec<Removed>,
}

impl Cleaned {
    /// `scene` by `rules` except consolidation, and where its `dataset`, in the coordinates of the scene, and a device are known
    /// also without what adds next to nothing to all pixels of each training view. This comes last, since floaters hide what is
    /// behind them.
    ///
    /// # Errors
    /// [`CleanError::NoTracks`] if floaters are to go and the dataset does not say which view saw what; [`dpges_core::Error`] if
    /// the scene cannot be rendered.
    pub fn new(scene: SceneData, rules: &Rules, known: Option<(&Dataset, &Device)>) -> Result<Self, CleanError> {
        let mut cleaned = Self { scene, removed: Vec::new() };
        if let Some(bounds) = rules.bounds {
            let scene = &cleaned.scene;
            let within = [&scene.surfels.positions, &scene.gaussians.positions].map(|at| bounds.rows_within(at));
            cleaned.keep("outside", within);
        }
        if let Some(largest) = rules.largest {
            let fits = |scale: &f32| f64::from(scale.exp()) <= largest;
            let small = |log_scales: &[f32], width: usize| kept(log_scales, width, |scales| scales.iter().all(fits));
            let scene = &cleaned.scene;
            cleaned.keep("oversized", [small(&scene.surfels.log_scales, 2), small(&scene.gaussians.log_scales, 3)]);
        }
        let Some((dataset, device)) = known else { return Ok(cleaned) };
        if rules.floaters {
            let votes =
                TrainingRenderer::new(&cleaned.scene, device).visibility(dataset)?.ok_or(CleanError::NoTracks)?;
            let stay = |votes: &[Votes]| kept(votes, 1, |votes| !votes[0].floats());
            cleaned.keep("floaters", [stay(&votes.surfels), stay(&votes.gaussians)]);
        }
        if !dataset.train.is_empty() {
            let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
            let seen = Contributions::largest(&cleaned.scene, &cameras, device)?;
            let counts = |weights: &[f64]| kept(weights, 1, |weight| weight[0] >= UNSEEN_PX);
            cleaned.keep(UNSEEN, [counts(&seen.surfels), counts(&seen.gaussians)]);
        }
        Ok(cleaned)
    }

    fn keep(&mut self, rule: &'static str, [surfels, gaussians]: [Vec<usize>; 2]) {
        let SceneData { info, surfels: of_surfels, gaussians: of_gaussians, environment } = &self.scene;
        let (surfels, gaussians) = (of_surfels.select(&surfels), of_gaussians.select(&gaussians));
        self.take(rule, SceneData { info: info.clone(), surfels, gaussians, environment: environment.clone() });
    }

    fn take(&mut self, rule: &'static str, left: SceneData) {
        let before = std::mem::replace(&mut self.scene, left);
        let surfels = before.surfels.len() - self.scene.surfels.len();
        let gaussians = before.gaussians.len() - self.scene.gaussians.len();
        self.removed.push(Removed { rule, surfels, gaussians });
    }
}

/// The rows of `width` numbers that stay.
fn kept<T>(numbers: &[T], width: usize, stays: impl Fn(&[T]) -> bool) -> Vec<usize> {
    let rows = numbers.chunks_exact(width).enumerate();
    rows.filter(|(_, numbers)| stays(numbers)).map(|(row, _)| row).collect()
}

/// The result in numbers: content of the file of `--json`.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    pub scene: PathBuf,
    /// Absent if nothing was written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub out: Option<PathBuf>,
    pub surfels_before: usize,
    pub gaussians_before: usize,
    pub surfels: usize,
    pub gaussians: usize,
    pub removed: Vec<Removed>,
    /// Absent if nothing was written, or there are no views.
    #[serde(flatten)]
    pub psnr: Option<Psnr>,
    /// Of the view that changes most, before and after; likewise.
    pub pictures: Vec<PathBuf>,
    /// Why the dataset is not known.
    #[serde(skip)]
    pub unknown: Option<String>,
}

/// The dataset, its source and a device, or why there is none.
pub type Known<'a> = Result<(&'a Source, &'a Dataset, &'a Device), String>;

/// Cleans `scene`, which comes from the file `path`, by `rules` and its dataset, and writes it to `out` if that is named, with
/// pictures beside it. `known` has views of the `split` that measures the loss.
///
/// # Errors
/// [`CleanError`]; then nothing was written but pictures.
pub fn clean(
    scene: &SceneData,
    path: &Path,
    rules: &Rules,
    known: Known,
    split: Split,
    out: Option<&Path>,
) -> Result<Report, CleanError> {
    let at_hand = known.as_ref().ok().map(|(_, dataset, device)| (*dataset, *device));
    let mut cleaned = Cleaned::new(scene.clone(), rules, at_hand)?;
    if let (Some(share), Some((dataset, device))) = (rules.consolidate, at_hand) {
        let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
        match scene.info.rendering {
            Rendering::Peeled if cameras.is_empty() => return Err(CleanError::NoViews),
            Rendering::Peeled => {}
            other => return Err(CleanError::NotPeeled(other)),
        }
        let steps = if out.is_some() { CONSOLIDATION_STEPS } else { 0 };
        cleaned.take("consolidated", consolidate(&cleaned.scene, share, &cameras, steps, device)?);
    }
    let Cleaned { scene: after, removed } = cleaned;
    let (surfels, gaussians) = (after.surfels.len(), after.gaussians.len());
    let (mut psnr, mut pictures) = (None, Vec::new());
    if let Some(out) = out {
        if surfels + gaussians == 0 {
            return Err(CleanError::Nothing);
        }
        let measured = known.as_ref().ok().filter(|(_, dataset, _)| !split.of(dataset).is_empty());
        if let Some((source, dataset, device)) = measured {
            let views = split.of(dataset);
            let ([psnr_before, psnr_after], files) = compare([scene, &after], views, device, out)?;
            let (dataset, split, views) = (source.to_string(), split.to_string(), views.len());
            psnr = Some(Psnr { dataset, split, views, psnr_before, psnr_after });
            pictures.extend(files);
        }
        after.save(out)?;
    }
    Ok(Report {
        scene: path.to_owned(),
        out: out.map(Path::to_owned),
        surfels_before: scene.surfels.len(),
        gaussians_before: scene.gaussians.len(),
        surfels,
        gaussians,
        removed,
        psnr,
        pictures,
        unknown: known.err(),
    })
}

impl Report {
    /// For people.
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let mut rows = vec![("scene", self.scene.display().to_string())];
        let text = |surfels: usize, gaussians: usize| format!("{surfels} surfels, {gaussians} Gaussians");
        rows.extend(self.removed.iter().map(|removed| (removed.rule, text(removed.surfels, removed.gaussians))));
        if !self.removed.iter().any(|removed| removed.rule == UNSEEN) {
            let why = self.unknown.as_deref().unwrap_or("the dataset has no training views");
            rows.push((UNSEEN, format!("not looked for: {why}")));
        }
        let before = text(self.surfels_before, self.gaussians_before);
        rows.push(("left", format!("{} of {before}", text(self.surfels, self.gaussians))));
        let Some(out) = &self.out else { return rows };
        let not_measured = || "not measured: there are no views".to_owned();
        rows.push(("PSNR", self.psnr.as_ref().map_or_else(not_measured, Psnr::to_string)));
        rows.extend(self.pictures.iter().map(|file| ("picture", file.display().to_string())));
        rows.push(("file", out.display().to_string()));
        rows
    }
}

/// A positive, finite number of world units.
///
/// # Errors
/// A sentence.
fn size(text: &str) -> Result<f64, String> {
    let size = text.parse::<f64>().ok().filter(|size| size.is_finite() && *size > 0.0);
    size.ok_or_else(|| "this is no size: write a positive number of world units".to_owned())
}

/// Both scenes against the photographs of `views`, and files beside `out` with pictures of the view whose PSNR changes most.
///
/// # Errors
/// [`dpges_core::Error`] if they cannot be rendered, or a file not be written.
fn compare(scenes: [&SceneData; 2], views: &[View], device: &Device, out: &Path) -> Result<([f64; 2], [PathBuf; 2])> {
    let [before, after] = [evaluate(scenes[0], views, device)?, evaluate(scenes[1], views, device)?];
    let change = |at: &usize| {
        let psnr = |evaluation: &Evaluation| evaluation.views[*at].scores.psnr;
        (psnr(&after) - psnr(&before)).abs()
    };
    let most = (0..views.len()).max_by(|a, b| change(a).total_cmp(&change(b))).unwrap_or(0);
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let files = ["before", "after"].map(|name| out.with_file_name(format!("{stem}_{name}.png")));
    for (scene, file) in scenes.into_iter().zip(&files) {
        save_png(&to_picture(TrainingRenderer::new(scene, device).render(&views[most].camera)?.image()), file)?;
    }
    Ok(([before.psnr, after.psnr], files))
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use dpges_core::scene::{ColourModel, GaussianData, Rendering, SceneInfo, SurfelData};
    use glam::DVec3;

    use super::*;
    use crate::dataset::{PointCloud, builtin};
    use crate::run::fixtures::{device, options};

    const MODEL: ColourModel = ColourModel::SphericalBeta { lobes: 0 };
    const UNSEEN_ALONE: Rules = Rules { bounds: None, largest: None, floaters: false, consolidate: None };

    /// Opaque ones of this size at these places, Gaussians of a third of it behind or beside.
    fn scene(surfels: &[([f32; 3], f32)], gaussians: &[([f32; 3], f32)]) -> SceneData {
        let column = |all: &[([f32; 3], f32)]| all.iter().flat_map(|(at, _)| *at).collect::<Vec<f32>>();
        let scales = |all: &[([f32; 3], f32)], width: usize| -> Vec<f32> {
            all.iter().flat_map(|(_, size)| vec![size.ln(); width]).collect()
        };
        let mut of_surfels = SurfelData::neutral(MODEL, surfels.len());
        (of_surfels.positions, of_surfels.log_scales) = (column(surfels), scales(surfels, 2));
        let mut of_gaussians = GaussianData::neutral(MODEL, gaussians.len());
        (of_gaussians.positions, of_gaussians.log_scales) = (column(gaussians), scales(gaussians, 3));
        let info = SceneInfo { colour_model: MODEL, metres_per_unit: Some(0.5), ..SceneInfo::default() };
        SceneData { info, surfels: of_surfels, gaussians: of_gaussians, environment: None }
    }

    /// Three cameras before the origin, which saw a point there.
    fn dataset() -> Dataset {
        let mut dataset = builtin(&options(16, [3, 1], 10));
        for (index, view) in dataset.train.iter_mut().enumerate() {
            let centre = DVec3::new(0.5 * (index as f64 - 1.0), 0.0, -4.0);
            let camera_from_world = CameraFromWorld::look_at(centre, DVec3::ZERO, DVec3::NEG_Y);
            view.camera = Camera { camera_from_world, fx: 16.0, fy: 16.0, cx: 8.5, cy: 8.5, near: 0.01, ..view.camera };
        }
        let seen_by = [vec![0, 1, 2]].into_iter().collect();
        dataset.points = PointCloud { positions: vec![[0.0; 3]], colours: vec![[0.5; 3]], seen_by };
        dataset
    }

    fn removed(rule: &'static str, surfels: usize, gaussians: usize) -> Removed {
        Removed { rule, surfels, gaussians }
    }

    #[test]
    fn a_box_and_a_size_need_no_dataset() {
        let all = [([0.0, 0.0, 0.0], 0.1), ([2.0, 0.0, 0.0], 0.1), ([0.5, 0.5, 0.5], 3.0)];
        let bounds = Some("-1,-1,-1,1,1,1".parse().unwrap());
        let cleaned =
            Cleaned::new(scene(&all, &all[1..]), &Rules { bounds, largest: Some(1.0), ..UNSEEN_ALONE }, None).unwrap();
        assert_eq!(cleaned.removed, [removed("outside", 1, 1), removed("oversized", 1, 1)]);
        assert_eq!(cleaned.scene, scene(&all[..1], &[]), "the rest is as it was, and so is the scale");
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let tiny = Rules { bounds, largest: Some(0.01), ..UNSEEN_ALONE };
        let nothing = clean(&scene(&[], &all), "a".as_ref(), &tiny, Err("none".to_owned()), Split::Test, Some(&out));
        assert!(matches!(nothing, Err(CleanError::Nothing)) && !out.exists());
        for wrong in ["1,1,1,0,2,2", "0,0,0,1,1", "0,0,0,1,1,nan", "a", ""] {
            assert!(wrong.parse::<Bounds>().unwrap_err().contains("no box"), "{wrong}");
        }
        for wrong in ["0", "-1", "nan", "inf", "1m"] {
            assert!(size(wrong).unwrap_err().contains("no size"), "{wrong}");
        }
        assert!(Cleaned::new(scene(&all, &all), &UNSEEN_ALONE, None).unwrap().removed.is_empty());
    }

    #[test]
    fn floaters_and_what_no_camera_sees_go_and_what_floaters_hid_stays() {
        // a wall at the point; one that hides it from all cameras; one behind the cameras
        let surfels = [([0.0, 0.0, 0.0], 0.6), ([0.0, 0.0, -2.0], 0.6), ([0.0, 0.0, -9.0], 0.6)];
        // before the wall, and behind it
        let gaussians = [([0.1, 0.0, -0.3], 0.1), ([0.0, 0.0, 2.0], 0.05)];
        let (device, dataset) = (device(), dataset());
        let rules = Rules { floaters: true, ..UNSEEN_ALONE };
        let cleaned = Cleaned::new(scene(&surfels, &gaussians), &rules, Some((&dataset, &device))).unwrap();
        assert_eq!(cleaned.removed, [removed("floaters", 1, 0), removed("unseen", 1, 1)]);
        assert_eq!(cleaned.scene, scene(&surfels[..1], &gaussians[..1]));

        let cleaned = Cleaned::new(scene(&surfels, &gaussians), &UNSEEN_ALONE, Some((&dataset, &device))).unwrap();
        assert_eq!(cleaned.removed, [removed("unseen", 2, 2)], "floaters stay where nobody asks for them");
        assert_eq!(cleaned.scene.surfels.positions, [0.0, 0.0, -2.0], "it hides all that is behind it");

        let mut unknown = dataset.clone();
        unknown.points = PointCloud::default();
        let refused = Cleaned::new(scene(&surfels, &gaussians), &rules, Some((&unknown, &device)));
        assert!(matches!(refused, Err(CleanError::NoTracks)), "without tracks nothing floats");
    }

    #[test]
    fn blended_scenes_are_cleaned_too() {
        let mut blended = scene(&[], &[([0.0; 3], 0.3), ([0.0, 0.0, -9.0], 0.3)]);
        blended.info.rendering = Rendering::Ellipsoids;
        let rules = Rules { floaters: true, ..UNSEEN_ALONE };
        let (device, dataset) = (device(), dataset());
        let cleaned = Cleaned::new(blended.clone(), &rules, Some((&dataset, &device))).unwrap();
        assert_eq!(cleaned.removed, [removed("floaters", 0, 0), removed("unseen", 0, 1)]);
        assert_eq!(cleaned.scene.gaussians, blended.gaussians.select(&[0]));
    }

    #[test]
    fn a_share_is_counted_without_training() {
        let (device, dataset, source) = (device(), dataset(), Source::Builtin);
        let wall = scene(&[([0.0, 0.0, 0.0], 0.6), ([0.0, 0.0, -9.0], 0.6)], &[([0.1, 0.0, -0.3], 0.1)]);
        let rules = Rules { consolidate: Some(0.5), ..UNSEEN_ALONE };
        let of =
            |scene: &SceneData| clean(scene, "a".as_ref(), &rules, Ok((&source, &dataset, &device)), Split::Test, None);
        let report = of(&wall).unwrap();
        assert_eq!(report.removed, [removed("unseen", 1, 0), removed("consolidated", 0, 1)]);
        assert_eq!((report.surfels, report.gaussians), (1, 0));
        let mut blended = wall;
        (blended.info.rendering, blended.surfels) = (Rendering::Ellipsoids, blended.surfels.select(&[]));
        assert!(matches!(of(&blended), Err(CleanError::NotPeeled(Rendering::Ellipsoids))));
    }

    #[test]
    fn the_view_that_changes_most_is_shown() {
        let folder = tempfile::tempdir().unwrap();
        let (device, dataset) = (device(), dataset());
        let [large, small] = [0.6, 0.1].map(|size| scene(&[([0.0; 3], size)], &[]));
        let out = folder.path().join("clean.safetensors");
        let (psnr, files) = compare([&large, &small], &dataset.train, &device, &out).unwrap();
        assert!(psnr[0] != psnr[1], "{psnr:?}");
        assert_eq!(files, ["clean_before.png", "clean_after.png"].map(|name| folder.path().join(name)));
        let [before, after] = files.map(|file| std::fs::read(file).unwrap());
        assert!(before != after);
    }
}

//! Properties of each view: the only place that looks at pixels.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use dpges_core::camera::Camera;
use glam::DVec3;
use rayon::prelude::*;
use serde::{Serialize, Serializer};

use super::luma::Luma;
use super::points::Cells;
use super::statistics::median;
use super::{Effort, MOST_POINTS, QUICK_PIXELS};
use crate::image::picture::linear;
use crate::{Dataset, Picture, PointCloud, Split, View, pictures};

/// Points of a view that are compared in brightness: at least, at most.
const FEWEST_POINTS: usize = 20;
const MOST_COMPARED: usize = 2000;
/// Points of a view that are compared in colour, at least; and the standard deviation of their grey values below which they say
/// little, of 1.
const FEWEST_COLOURS: usize = 30;
const LEAST_CONTRAST: f64 = 0.05;
/// Correlation of grey values below which a photograph is not that of its view, relative to the median of the views; and the least
/// median of views with the right photographs, below which it is this limit that counts. The medians of real captures at 512 px
/// are over 0.91, and the least are over 0.65 of them; at 128 px 0.76 and 0.50. With all photographs moved by one the median is
/// 0.58; of two that are exchanged, taken near each other, one has 0.31 and one 0.45 of the median.
const OTHER_PHOTOGRAPH: f64 = 0.47;
const RIGHT_PHOTOGRAPHS: f64 = 0.65;
/// Values that may be clipped, and luminances that are little more than noise.
const CLIPPED: f32 = 0.98;
const DARK: f64 = 0.005;

/// Properties of one view. Numbers are `None` where the dataset does not say, or where they were not measured.
#[derive(Clone, Debug, Serialize)]
pub struct ViewFacts {
    pub name: String,
    pub role: Split,
    /// Its pose, size and focal lengths; in JSON the camera centre, width, height and focal lengths.
    #[serde(flatten, serialize_with = "in_short")]
    pub camera: Camera,
    /// Share of the picture that does not count, because of a mask or of where its lens shows nothing.
    pub ignored: Option<f64>,
    /// Number of points of the dataset that it saw; of training views only.
    pub points_seen: Option<usize>,
    /// Share of the picture that shows such points, in squares of a twelfth of the longer side. Squares of which less than half
    /// counts are left out, if pixels are looked at.
    pub coverage: Option<f64>,
    /// Share of the picture in which there is no point, seen or hidden, likewise.
    pub unexplained: Option<f64>,
    /// How much detail of the size of a pixel it has, compared with detail twice as large, in the direction in which it has
    /// least; relative to the median of the views.
    pub sharpness: Option<f64>,
    /// How much of the former there is, relative to the median of the views.
    pub detail: Option<f64>,
    /// Correlation of the grey values of the points that it saw with those of its pixels that show them, -1 to 1.
    pub correlation: Option<f64>,
    /// How much brighter it is than others that saw the same points, stops; relative to the median of the views. `None` where
    /// it does not show these points.
    pub exposure: Option<f64>,
    /// Whether the photograph does not show the points that the view saw.
    #[serde(skip)]
    pub(super) is_of_another: bool,
    #[serde(skip)]
    pub(super) thumbnail: Option<Vec<f32>>,
    /// Whether all pixels that count have one colour.
    #[serde(skip)]
    pub(super) is_plain: bool,
    /// A hash of all pixels.
    #[serde(skip)]
    pub(super) fingerprint: Option<u64>,
}

/// Camera centre, world units; size and focal lengths, px.
#[derive(Serialize)]
struct Short {
    centre: [f64; 3],
    width: usize,
    height: usize,
    focal_lengths: [f64; 2],
}

fn in_short<S: Serializer>(camera: &Camera, serializer: S) -> Result<S::Ok, S::Error> {
    let Camera { width, height, fx, fy, .. } = *camera;
    Short { centre: camera.centre().to_array(), width, height, focal_lengths: [fx, fy] }.serialize(serializer)
}

/// Detail of the size of a pixel and of two, along rows and along columns.
type Detail = [[f64; 2]; 2];

/// Properties of training, held-out and validation views.
pub(super) fn facts(dataset: &Dataset, effort: Effort) -> dpges_core::Result<Vec<ViewFacts>> {
    let sets = [(Split::Train, &dataset.train), (Split::Test, &dataset.test), (Split::Validation, &dataset.validation)];
    let views: Vec<(Split, &View)> =
        sets.into_iter().flat_map(|(role, views)| views.iter().map(move |view| (role, view))).collect();
    let area: usize = views.iter().map(|(_, view)| view.camera.width * view.camera.height).sum();
    let looks = effort == Effort::Full || area <= QUICK_PIXELS;
    let seen_by = &dataset.points.seen_by;
    let seen = if seen_by.are_unknown() { Vec::new() } else { seen_by.by_view(dataset.train.len()) };
    let some: Vec<DVec3> = dataset
        .points
        .positions
        .iter()
        .step_by(dataset.points.positions.len().div_ceil(MOST_POINTS).max(1))
        .map(|position| DVec3::from_array(position.map(f64::from)))
        .collect();
    let facts_of = |index: usize, picture: Option<Arc<Picture>>| {
        let (role, view) = views[index];
        measure(dataset, role, view, picture.as_deref(), seen.get(index).map(Vec::as_slice), &some)
    };
    let mut measured: Vec<(usize, _)> = if looks {
        // one after another, and the next ahead: no more are in memory than the dataset allows
        let pictures = pictures(views.iter().map(|(_, view)| *view)).enumerate().par_bridge();
        let measured = pictures.map(|(index, (_, picture))| Ok((index, facts_of(index, Some(picture?)))));
        measured.collect::<dpges_core::Result<_>>()?
    } else {
        (0..views.len()).into_par_iter().map(|index| (index, facts_of(index, None))).collect()
    };
    measured.sort_by_key(|(index, _)| *index);
    let measured = measured.into_iter().map(|(_, measured)| measured);
    let (mut facts, details): (Vec<ViewFacts>, Vec<Option<Detail>>) = measured.unzip();
    relate(&mut facts, &details);
    Ok(facts)
}

/// Properties of a view by itself; its `picture` if that is looked at, the points that it has `seen` if that is known, `some`
/// points of all. Its exposure is not yet related to that of others.
fn measure(
    dataset: &Dataset,
    role: Split,
    view: &View,
    picture: Option<&Picture>,
    seen: Option<&[u32]>,
    some: &[DVec3],
) -> (ViewFacts, Option<Detail>) {
    let View { name, camera, photograph, .. } = view;
    let position = |&point: &u32| DVec3::from_array(dataset.points.positions[point as usize].map(f64::from));
    let cells = Cells::of(camera, picture);
    let luma = picture.map(Luma::of);
    let shown = picture.map(|picture| shown_colours(camera, picture, &dataset.points, seen.unwrap_or_default()));
    let unexplained = || Some(1.0 - cells.share_with(some.iter().copied())?);
    let facts = ViewFacts {
        name: name.clone(),
        role,
        camera: *camera,
        ignored: photograph.ignored_pixels().map(|pixels| pixels as f64 / (camera.width * camera.height) as f64),
        points_seen: seen.map(<[u32]>::len),
        coverage: seen.and_then(|seen| cells.share_with(seen.iter().map(position))),
        unexplained: if some.is_empty() { None } else { unexplained() },
        sharpness: None,
        detail: None,
        correlation: shown.as_deref().and_then(correlation),
        exposure: shown.as_deref().and_then(relative_exposure),
        is_of_another: false,
        thumbnail: luma.as_ref().map(Luma::thumbnail),
        is_plain: picture.is_some_and(is_plain),
        fingerprint: picture.map(fingerprint),
    };
    (facts, luma.map(|luma| [luma.detail(), luma.halved().detail()]))
}

/// Lossy files may vary by one step.
fn is_plain(picture: &Picture) -> bool {
    let mut colours =
        (0..picture.area()).filter(|&pixel| picture.counts(pixel)).map(|pixel| &picture.bytes[3 * pixel..][..3]);
    let Some(first) = colours.next() else { return true };
    colours.all(|colour| colour.iter().zip(first).all(|(a, b)| a.abs_diff(*b) <= 1))
}

fn fingerprint(picture: &Picture) -> u64 {
    let mut hasher = DefaultHasher::new();
    (picture.width, &picture.bytes).hash(&mut hasher);
    hasher.finish()
}

/// The colour in which a picture shows a point, and that of the point.
type Shown = [[f32; 3]; 2];

/// Of some of the points that the picture saw, where it counts and neither colour is clipped.
fn shown_colours(camera: &Camera, picture: &Picture, points: &PointCloud, seen: &[u32]) -> Vec<Shown> {
    let shown = seen.iter().step_by(seen.len().div_ceil(MOST_COMPARED).max(1)).filter_map(|&point| {
        let (position, usual) = (points.positions[point as usize], points.colours[point as usize]);
        let (pixel, _) = camera.pixel(DVec3::from_array(position.map(f64::from)))?;
        let colours = [picture.colour(pixel), usual];
        let is_clipped = colours.as_flattened().iter().any(|&value| value > CLIPPED);
        (picture.counts(pixel) && !is_clipped).then_some(colours)
    });
    shown.collect()
}

/// How much brighter the picture shows the points than they are on average, stops: views shall show the same points in the same
/// brightness, whatever else they show. `None` if they are few.
fn relative_exposure(shown: &[Shown]) -> Option<f64> {
    let stops = shown.iter().filter_map(|colours| {
        let [shown, usual] = colours.map(luminance);
        (shown > DARK && usual > DARK).then(|| (shown / usual).log2())
    });
    let stops: Vec<f64> = stops.collect();
    if stops.len() < FEWEST_POINTS { None } else { median(stops) }
}

/// Correlation of the grey values of points, -1 to 1, with those of the picture. `None` if points are few or alike, or if they
/// alone are grey: the intensities of a laser are no colours.
fn correlation(shown: &[Shown]) -> Option<f64> {
    let is_grey = |&[r, g, b]: &[f32; 3]| r == g && g == b;
    let [picture_is_grey, points_are_grey] = [0, 1].map(|of| shown.iter().all(|colours| is_grey(&colours[of])));
    if shown.len() < FEWEST_COLOURS || (points_are_grey && !picture_is_grey) {
        return None;
    }
    let count = shown.len() as f64;
    let grey =
        |of: usize| shown.iter().map(move |colours| colours[of].iter().map(|&v| f64::from(v)).sum::<f64>() / 3.0);
    let means = [0, 1].map(|of| grey(of).sum::<f64>() / count);
    let covariance =
        |a: usize, b: usize| grey(a).zip(grey(b)).map(|(x, y)| (x - means[a]) * (y - means[b])).sum::<f64>() / count;
    let deviations = [0, 1].map(|of| covariance(of, of).sqrt());
    (deviations[0] > 0.0 && deviations[1] > LEAST_CONTRAST).then(|| covariance(0, 1) / (deviations[0] * deviations[1]))
}

fn luminance(rgb: [f32; 3]) -> f64 {
    let [r, g, b] = rgb.map(|value| linear(f64::from(value)));
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// Finds the views whose photographs are not theirs, the brightness of which says nothing.
fn find_other_photographs(facts: &mut [ViewFacts]) {
    let Some(usual) = median(facts.iter().filter_map(|view| view.correlation)) else { return };
    let limit = if usual < RIGHT_PHOTOGRAPHS { RIGHT_PHOTOGRAPHS } else { OTHER_PHOTOGRAPH * usual };
    for view in facts.iter_mut().filter(|view| view.correlation.is_some_and(|correlation| correlation < limit)) {
        (view.is_of_another, view.exposure) = (true, None);
    }
}

/// Compares each view with the median of all.
fn relate(facts: &mut [ViewFacts], details: &[Option<Detail>]) {
    find_other_photographs(facts);
    let of = |number: &dyn Fn(&Detail) -> Option<f64>| median(details.iter().flatten().filter_map(number));
    let axes = [0, 1];
    // of a picture without any detail there is nothing to say
    let fineness = |[fine, coarse]: &Detail, axis: usize| (coarse[axis] > 0.0).then(|| fine[axis] / coarse[axis]);
    let median_fineness = axes.map(|axis| of(&|detail| fineness(detail, axis)));
    let median_detail = axes.map(|axis| of(&|[fine, _]| Some(fine[axis])));
    let median_exposure = median(facts.iter().filter_map(|view| view.exposure));
    for (facts, detail) in facts.iter_mut().zip(details) {
        facts.exposure = facts.exposure.zip(median_exposure).map(|(exposure, median)| exposure - median);
        let relative = |axis: usize| {
            let detail = detail.as_ref()?;
            let fineness = fineness(detail, axis)? / median_fineness[axis].filter(|&median| median > 0.0)?;
            let detail = detail[0][axis] / median_detail[axis].filter(|&median| median > 0.0)?;
            Some((fineness, detail))
        };
        let least = axes.into_iter().filter_map(relative).min_by(|a, b| a.0.total_cmp(&b.0));
        (facts.sharpness, facts.detail) = least.unzip();
    }
}

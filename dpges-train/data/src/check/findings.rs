//! Problems of a dataset, in words. Each judgement compares views with the rest of the set, so that it needs no
//! knowledge of cameras or scenes.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::MOST_POINTS;
use super::facts::ViewFacts;
use super::luma::difference;
use super::statistics::{Range, median};
use crate::names::list;
use crate::{Dataset, Finding, Kind, Split};

/// Distances, relative to the spread of the cameras, beyond which a camera is far: from their middle, and from the next.
const FAR_FROM_THE_MIDDLE: f64 = 5.0;
const FAR_FROM_THE_NEXT: f64 = 2.0;
/// Relative to the median of the views: the ratio of detail of one pixel to detail of two below which, together with that
/// much detail or less, a photograph is blurred. A blur takes the finest detail away first. One of a pixel gives 0.15 to 0.4
/// and 0.03 to 0.15; sharp photographs have more than 0.6 or 0.5.
const BLURRED_SHARPNESS: f64 = 0.6;
const BLURRED_DETAIL: f64 = 0.35;
/// Difference of brightness from the median that is named: at least, stops, and in standard deviations of the views.
const LEAST_STOPS: f64 = 0.5;
const EXPOSURE_DEVIATIONS: f64 = 4.0;
/// From the median absolute deviation, which outliers do not change, to the standard deviation of normally distributed
/// numbers.
const DEVIATION_PER_MAD: f64 = 1.4826;
/// Range of brightness from the 5th to the 95th percentile that is named, stops.
const STOPS_SPREAD: f64 = 1.0;
/// Points below which a view has few: of all views, and relative to the median of the set.
const FEW_POINTS: f64 = 20.0;
const FEW_OF_MEDIAN: f64 = 0.03;
/// Limits for the same pose: distance relative to the spread of the cameras, angle between the directions, rad; and the
/// root mean square difference of thumbnails that show the same.
const SAME_DISTANCE: f64 = 0.005;
const SAME_ANGLE: f64 = 0.01;
const SAME_PICTURE: f64 = 0.02;
/// Distance of all cameras from their middle below which they stand at one point: over the median distance of the points, where
/// nothing moves by a pixel, and over the coordinates where there are no points.
const NO_PARALLAX: f64 = 1e-4;
const ROUNDING: f64 = 1e-7;
/// Longer side of a picture, relative to the median, below which it is small.
const SMALL: f64 = 0.25;
/// Mean share of pictures without points that is named.
const UNEXPLAINED: f64 = 0.5;
/// Fewest training views that are no reason to say so.
const FEW_VIEWS: usize = 10;

fn overall(kind: Kind, message: String, advice: &'static str) -> Finding {
    Finding { kind, views: Vec::new(), message, advice }
}

/// About views, whose names follow the words for one or for several, each with its note; they begin with those of the lowest
/// `rank`. `None` without views.
fn named(
    kind: Kind,
    [one, several]: [&str; 2],
    mut views: Vec<(f64, &ViewFacts, String)>,
    advice: &'static str,
) -> Option<Finding> {
    views.sort_by(|(a, ..), (b, ..)| a.total_cmp(b));
    let notes: Vec<String> = views.iter().map(|(_, view, note)| format!("{}{note}", view.name)).collect();
    let count = match views.len() {
        0 => return None,
        1 => one.to_owned(),
        more => format!("{more} {several}"),
    };
    let message = format!("{count}: {}", list(&notes));
    Some(Finding { kind, views: views.iter().map(|(_, view, _)| view.name.clone()).collect(), message, advice })
}

/// Judges all views; `None` if nothing is wrong with them.
type Judgement = fn(&[ViewFacts]) -> Option<Finding>;

/// All that is wrong, from most to least important.
pub(super) fn findings(views: &[ViewFacts], dataset: &Dataset) -> Vec<Finding> {
    let judged = |judgements: &[Judgement]| -> Vec<Finding> {
        judgements.iter().filter_map(|judgement| judgement(views)).collect()
    };
    let mut found: Vec<Finding> = one_place(views, dataset).into_iter().collect();
    found.extend(judged(&[plain, far_poses, unseen, copies]));
    let known = dataset.notices.0.iter().chain(&found).flat_map(|finding| &finding.views).map(String::as_str).collect();
    found.extend(other_photographs(views, &known));
    found.extend(judged(&[small, blurred, exposures, exposure_spread, few_points, duplicates, unexplained, few_views]));
    found
}

/// The middle of the cameras: of each coordinate the median.
pub(super) fn middle<'a>(views: impl IntoIterator<Item = &'a ViewFacts> + Clone) -> DVec3 {
    let axis = |axis: usize| median(views.clone().into_iter().map(|view| view.camera.centre()[axis])).unwrap_or(0.0);
    DVec3::new(axis(0), axis(1), axis(2))
}

/// The median distance of a camera from their middle, world units.
fn spread(views: &[ViewFacts]) -> f64 {
    let middle = middle(views);
    median(views.iter().map(|view| view.camera.centre().distance(middle))).unwrap_or(0.0)
}

fn one_place(views: &[ViewFacts], dataset: &Dataset) -> Option<Finding> {
    let train: Vec<&ViewFacts> = views.iter().filter(|view| view.role == Split::Train).collect();
    let middle = middle(train.iter().copied());
    let farthest = train.iter().map(|view| view.camera.centre().distance(middle)).fold(0.0, f64::max);
    let positions = &dataset.points.positions;
    let some = positions.iter().step_by(positions.len().div_ceil(MOST_POINTS).max(1));
    let depth = median(some.map(|position| DVec3::from_array(position.map(f64::from)).distance(middle)));
    let reach = depth.map_or_else(|| ROUNDING * (dataset.offset + middle).length(), |depth| NO_PARALLAX * depth);
    let message = "all cameras stand at one point: no depth can be found".to_owned();
    let advice = "photograph from many places, or find the cameras again if the photographs were";
    (train.len() > 1 && farthest <= reach).then(|| overall(Kind::OnePlace, message, advice))
}

fn far_poses(views: &[ViewFacts]) -> Option<Finding> {
    let (middle, spread) = (middle(views), spread(views));
    let far = views.iter().filter(|_| spread > 0.0).filter_map(|view| {
        let distance = |point: DVec3| view.camera.centre().distance(point) / spread;
        let others = views.iter().filter(|other| !std::ptr::eq(*other, view));
        let next = others.map(|other| distance(other.camera.centre())).fold(f64::INFINITY, f64::min);
        let from_middle = distance(middle);
        let note = format!(" ({from_middle:.0} times as far from the middle as usual)");
        (from_middle > FAR_FROM_THE_MIDDLE && next > FAR_FROM_THE_NEXT).then_some((-from_middle, view, note))
    });
    named(
        Kind::FarPose,
        ["a camera is far from all others", "cameras are far from all others"],
        far.collect(),
        "their places are probably wrong: leave them out, or find the cameras again",
    )
}

fn sees_nothing(view: &ViewFacts) -> bool {
    view.points_seen == Some(0) || view.unexplained == Some(1.0)
}

fn unseen(views: &[ViewFacts]) -> Option<Finding> {
    let unseen: Vec<_> =
        views.iter().filter(|view| sees_nothing(view)).map(|view| (0.0, view, String::new())).collect();
    if 2 * unseen.len() > views.len() {
        let count = unseen.len();
        let message =
            format!("{count} of {} views see no points: cameras and points do not belong together", views.len());
        let advice = "give the cameras the axes of their format (OpenGL in transforms.json, OpenCV in COLMAP) and its direction \
                      (camera-to-world, or world-to-camera), and cameras and points the same unit and `applied_transform`";
        return Some(overall(Kind::NoPoints, message, advice));
    }
    named(
        Kind::NoPoints,
        ["a view sees no point", "views see no points"],
        unseen,
        "nothing says that their cameras are in the right place: leave them out",
    )
}

fn plain(views: &[ViewFacts]) -> Option<Finding> {
    let plain = views.iter().filter(|view| view.is_plain).map(|view| (0.0, view, String::new()));
    let plain: Vec<_> = plain.collect();
    if !plain.is_empty() && plain.len() == views.len() {
        let message = "all pictures are of one colour or transparent: they show nothing".to_owned();
        return Some(overall(Kind::Plain, message, "export them again; transparent pixels show the background"));
    }
    let words = [
        "a picture is of one colour or transparent throughout",
        "pictures are of one colour or transparent throughout",
    ];
    named(Kind::Plain, words, plain, "they show nothing: leave them out, or restore them")
}

fn small(views: &[ViewFacts]) -> Option<Finding> {
    let longer = |view: &ViewFacts| view.camera.width.max(view.camera.height) as f64;
    let usual = median(views.iter().map(longer))?;
    let note = |view: &ViewFacts| format!(" ({} x {} px)", view.camera.width, view.camera.height);
    let small = views.iter().filter(|view| longer(view) < SMALL * usual);
    let (one, several) = (
        format!("a picture is far smaller than the others, of {usual:.0} px"),
        format!("pictures are far smaller than the others, of {usual:.0} px"),
    );
    named(
        Kind::Small,
        [&one, &several],
        small.map(|view| (longer(view), view, note(view))).collect(),
        "put the photographs in the place of their previews, or leave them out",
    )
}

/// The photographs that are there again, with another camera.
fn copies(views: &[ViewFacts]) -> Option<Finding> {
    let advice = "all cameras but one are wrong: put the right photographs in their places, or leave them out";
    let mut originals: HashMap<u64, &ViewFacts> = HashMap::new();
    let reach = SAME_DISTANCE * spread(views);
    let repeated = views.iter().filter(|view| !view.is_plain).filter_map(|view| {
        let original = *originals.entry(view.fingerprint?).or_insert(view);
        (!is_same_pose(original, view, reach)).then(|| (0.0, view, format!(" (like {})", original.name)))
    });
    let repeated: Vec<_> = repeated.collect();
    if repeated.len() > 1
        && originals.len() == 1
        && views.iter().all(|view| !view.is_plain && view.fingerprint.is_some())
    {
        let message = format!("all {} photographs are the same", views.len());
        return Some(overall(Kind::Duplicate, message, advice));
    }
    let words =
        ["a photograph is there twice, with different cameras", "photographs are there twice, with different cameras"];
    named(Kind::Duplicate, words, repeated, advice)
}

/// The photographs that are not those of their views, except for views that are `known` to be wrong in another way.
fn other_photographs(views: &[ViewFacts], known: &HashSet<&str>) -> Option<Finding> {
    let others = views.iter().filter(|view| view.is_of_another && !known.contains(view.name.as_str()));
    let words = [
        "a photograph does not show what the points of its view say (turned, renumbered or exchanged?)",
        "photographs do not show what the points of their views say (turned, renumbered or exchanged?)",
    ];
    let others = others.map(|view| (view.correlation.unwrap_or(0.0), view, String::new()));
    let advice = "put back the photographs whose cameras were found, as they were then, or find the cameras again";
    named(Kind::OtherPhotograph, words, others.collect(), advice)
}

fn is_same_pose(a: &ViewFacts, b: &ViewFacts, reach: f64) -> bool {
    let [forward, forward_of_other] = [a, b].map(|view| view.camera.camera_from_world.rotation.row(2));
    a.camera.centre().distance(b.camera.centre()) <= reach && forward.angle_between(forward_of_other) < SAME_ANGLE
}

fn blurred(views: &[ViewFacts]) -> Option<Finding> {
    let blurred = views.iter().filter_map(|view| {
        let (sharpness, detail) = view.sharpness.zip(view.detail)?;
        let note = format!(" ({:.0} % of the usual sharpness)", 100.0 * sharpness);
        (sharpness < BLURRED_SHARPNESS && detail < BLURRED_DETAIL).then_some((sharpness, view, note))
    });
    named(
        Kind::Blurred,
        ["a photograph is blurred", "photographs are blurred"],
        blurred.collect(),
        "leave them out, or train on smaller pictures (--max-resolution)",
    )
}

fn exposures(views: &[ViewFacts]) -> Option<Finding> {
    let usual = median(views.iter().filter_map(|view| view.exposure).map(f64::abs)).unwrap_or(0.0);
    let limit = LEAST_STOPS.max(EXPOSURE_DEVIATIONS * (DEVIATION_PER_MAD * usual));
    let different = views.iter().filter_map(|view| {
        let stops = view.exposure.filter(|stops| stops.abs() > limit)?;
        Some((-stops.abs(), view, format!(" ({stops:+.1} stops)")))
    });
    named(
        Kind::Exposure,
        ["a photograph is brighter or darker than the rest", "photographs are brighter or darker than the rest"],
        different.collect(),
        "have it corrected while training (train.exposure=on), or leave them out: views that disagree make haze",
    )
}

fn exposure_spread(views: &[ViewFacts]) -> Option<Finding> {
    let Range { low, high, .. } = Range::of(views.iter().filter_map(|view| view.exposure))?;
    let difference = high - low;
    let message =
        format!("the photographs differ in brightness by {difference:.1} stops, between {low:+.1} and {high:+.1}");
    let advice =
        "have it corrected while training (train.exposure=on), or photograph with one exposure and one white balance";
    (difference > STOPS_SPREAD).then(|| overall(Kind::ExposureSpread, message, advice))
}

fn few_points(views: &[ViewFacts]) -> Option<Finding> {
    let count = |view: &ViewFacts| view.points_seen.map(|count| count as f64);
    let limit = (FEW_OF_MEDIAN * median(views.iter().filter_map(count))?).max(FEW_POINTS);
    let few = views.iter().filter(|view| !sees_nothing(view)).filter_map(|view| {
        let count = count(view).filter(|&count| count < limit)?;
        Some((count, view, format!(" ({count})")))
    });
    named(
        Kind::FewPoints,
        ["a view sees few points", "views see few points"],
        few.collect(),
        "their cameras may be slightly off; photographs with more in common with others place them better",
    )
}

/// The views that show what one before them shows.
fn duplicates(views: &[ViewFacts]) -> Option<Finding> {
    let reach = SAME_DISTANCE * spread(views);
    let is_same = |a: &ViewFacts, b: &ViewFacts| {
        let difference = || difference(a.thumbnail.as_ref()?, b.thumbnail.as_ref()?);
        is_same_pose(a, b, reach) && difference().is_some_and(|difference| difference < SAME_PICTURE)
    };
    let repeated = views.iter().enumerate().filter_map(|(index, view)| {
        let original = views[..index].iter().find(|before| is_same(before, view))?;
        Some((0.0, view, format!(" (like {})", original.name)))
    });
    named(
        Kind::Duplicate,
        ["a photograph is there twice", "photographs are there twice"],
        repeated.collect(),
        "leave one of each out: a held-out view that is trained on as well makes scores look better than they are",
    )
}

fn unexplained(views: &[ViewFacts]) -> Option<Finding> {
    let train = views.iter().filter(|view| view.role == Split::Train && !sees_nothing(view));
    let shares: Vec<f64> = train.filter_map(|view| view.unexplained).collect();
    let mean = shares.iter().sum::<f64>() / shares.len().max(1) as f64;
    let message = format!("{:.0} % of what the pictures show has no points", 100.0 * mean);
    let advice = "sky is no problem; walls, water and glass without texture are: expect floating surfaces there";
    (mean > UNEXPLAINED).then(|| overall(Kind::Unexplained, message, advice))
}

fn few_views(views: &[ViewFacts]) -> Option<Finding> {
    let count = views.iter().filter(|view| view.role == Split::Train).count();
    let message = format!("there are only {count} training views");
    let advice = "expect good pictures near them only; more photographs help, and holding out fewer (--test-every)";
    (count < FEW_VIEWS).then(|| overall(Kind::FewViews, message, advice))
}

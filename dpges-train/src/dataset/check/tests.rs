//! Each fault is named and nothing else is; a dataset without faults has no findings.

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::DVec3;

use super::*;
use crate::dataset::{BuiltinOptions, Picture, Tracks, View, builtin};

/// Width and height of the photographs, px.
const SIZE: [usize; 2] = [96; 2];

fn clean() -> Dataset {
    builtin(&BuiltinOptions::default())
}

fn full(dataset: &Dataset) -> Report {
    Report::of(dataset, Effort::Full).unwrap()
}

/// Changes the planes [3, H, W] of a photograph.
fn repaint(view: &mut View, change: impl FnOnce(&mut [f32])) {
    view.repaint(|picture| {
        let mut planes = picture.planes();
        change(&mut planes);
        *picture = Picture::from_planes(&planes, picture.width, picture.height);
    })
    .unwrap();
}

/// Masks the pixels from column `from` on, and paints them with what does not count.
fn mask(view: &mut View, from: usize, paint: impl Fn(usize) -> u8) {
    view.repaint(|picture| {
        let (width, area) = (picture.width, picture.area());
        let counts = |pixel: usize| pixel % width < from;
        picture.counted = Some((0..area).map(counts).collect());
        for pixel in (0..area).filter(|&pixel| !counts(pixel)) {
            picture.bytes[3 * pixel..][..3].fill(paint(pixel));
        }
    })
    .unwrap();
}

/// No two neighbours are alike.
fn noise(pixel: usize) -> u8 {
    ((pixel * 2_654_435_761) >> 7) as u8
}

/// Kinds and views of all findings.
fn found(dataset: &Dataset) -> Vec<(Kind, Vec<String>)> {
    full(dataset).findings.into_iter().map(|finding| (finding.kind, finding.views)).collect()
}

/// The mean of each pixel and its neighbours in both directions, or along rows alone.
fn blur(planes: &mut [f32], [width, height]: [usize; 2], along_rows_only: bool) {
    for channel in planes.chunks_exact_mut(width * height) {
        let original = channel.to_vec();
        let reach = if along_rows_only { 0 } else { 1 };
        for y in 0..height {
            for x in 0..width {
                let rows = y.saturating_sub(reach)..=(y + reach).min(height - 1);
                let columns = x.saturating_sub(1)..=(x + 1).min(width - 1);
                let (mut sum, mut count) = (0.0, 0.0);
                for row in rows {
                    for column in columns.clone() {
                        sum += original[row * width + column];
                        count += 1.0;
                    }
                }
                channel[y * width + x] = sum / count;
            }
        }
    }
}

#[test]
fn a_clean_dataset_has_no_findings() {
    let dataset = clean();
    let report = full(&dataset);
    assert_eq!(report.findings, []);
    assert_eq!((report.views.len(), report.points), (30, 2000));
    assert!(report.views_per_point.unwrap() > 2.0);
    let train = &report.views[0];
    assert_eq!((train.name.as_str(), train.role), ("train_000", Role::Train));
    assert!(train.points_seen.unwrap() > 100 && train.coverage.unwrap() > 0.5, "{train:?}");
    let test = report.views.last().unwrap();
    assert_eq!((test.role, test.points_seen, test.coverage, test.exposure), (Role::Test, None, None, None));
    assert!(test.unexplained.unwrap() < 0.5 && test.sharpness.is_some(), "{test:?}");
    assert_eq!(Report::of(&dataset, Effort::Quick).unwrap().findings, []);
}

#[test]
fn a_blurred_photograph_is_named() {
    for along_rows_only in [false, true] {
        let mut dataset = clean();
        for _ in 0..3 {
            repaint(&mut dataset.train[5], |planes| blur(planes, SIZE, along_rows_only));
        }
        let report = full(&dataset);
        assert_eq!(found(&dataset), [(Kind::Blurred, vec!["train_005".to_owned()])], "{report:?}");
        assert!(report.findings[0].to_string().starts_with("a photograph is blurred: train_005 ("));
        assert!(report.is_flagged("train_005") && !report.is_flagged("train_004"));
    }
}

#[test]
fn what_is_masked_has_no_part_in_sharpness() {
    let mut dataset = clean();
    // a third of it is white, which takes away detail, or noise, which adds some
    mask(&mut dataset.train[3], 64, |_| 255);
    repaint(&mut dataset.train[5], |planes| (0..3).for_each(|_| blur(planes, SIZE, false)));
    mask(&mut dataset.train[5], 64, noise);
    let report = full(&dataset);
    assert_eq!(found(&dataset), [(Kind::Blurred, vec!["train_005".to_owned()])], "{report:?}");
    assert_eq!((report.views[3].ignored, report.views[4].ignored), (Some(1.0 / 3.0), None));
    mask(&mut dataset.train[3], 64, noise);
    assert_eq!(full(&dataset).views[3].sharpness, report.views[3].sharpness);
}

#[test]
fn what_is_masked_has_no_part_in_brightness() {
    let mut dataset = clean();
    for view in dataset.train.iter_mut().step_by(2) {
        mask(view, 40, |_| 20);
    }
    let report = full(&dataset);
    let is_of_exposure = |finding: &Finding| matches!(finding.kind, Kind::Exposure | Kind::ExposureSpread);
    assert!(!report.findings.iter().any(is_of_exposure), "{:?}", report.findings);
    let exposures: Vec<f64> = report.views.iter().filter_map(|view| view.exposure).collect();
    assert!(exposures.len() > 16 && exposures.iter().all(|stops| stops.abs() < 0.5), "{exposures:?}");
}

#[test]
fn what_is_masked_needs_no_points() {
    let mut dataset = clean();
    let shows_little = |dataset: &Dataset| {
        let views = full(dataset).views;
        let [coverage, unexplained] =
            [|view: &ViewFacts| view.coverage, |view: &ViewFacts| view.unexplained].map(|of| of(&views[0]).unwrap());
        (coverage, unexplained)
    };
    // points are where view 0 has its left 40 of 96 columns, or outside of it
    let camera = dataset.train[0].camera;
    let points = std::mem::take(&mut dataset.points);
    for (index, position) in points.positions.iter().enumerate() {
        let pixel = camera.pixel(DVec3::from_array(position.map(f64::from)));
        if pixel.is_none_or(|(pixel, _)| pixel % 96 < 40) {
            dataset.points.positions.push(*position);
            dataset.points.colours.push(points.colours[index]);
            dataset.points.seen_by.push(points.seen_by.of(index).iter().copied());
        }
    }
    let (coverage, unexplained) = shows_little(&dataset);
    assert!(coverage < 5.0 / 12.0 + 1e-9 && unexplained > 7.0 / 12.0 - 1e-9, "{coverage} {unexplained}");
    mask(&mut dataset.train[0], 40, noise);
    let masked = shows_little(&dataset);
    assert!(masked.0 > 2.0 * coverage && masked.1 < 0.45, "{masked:?}");
}

#[test]
fn of_a_view_with_few_pixels_that_count_nothing_is_said_about_points() {
    let mut dataset = clean();
    mask(&mut dataset.train[0], 1, noise);
    let report = full(&dataset);
    assert_eq!((report.views[0].coverage, report.views[0].unexplained), (None, None));
    assert!(report.views[1].coverage.is_some() && report.views[1].unexplained.is_some());
}

#[test]
fn a_darker_photograph_is_named() {
    let mut dataset = clean();
    repaint(&mut dataset.train[4], |planes| planes.iter_mut().for_each(|value| *value *= 0.5));
    assert_eq!(found(&dataset), [(Kind::Exposure, vec!["train_004".to_owned()])]);
    let message = full(&dataset).findings[0].to_string();
    assert!(message.contains("train_004 (-") && message.contains(" stops)"), "{message}");
}

#[test]
fn brightness_that_varies_throughout_is_said_once() {
    let mut dataset = clean();
    for view in dataset.train.iter_mut().step_by(2) {
        repaint(view, |planes| planes.iter_mut().for_each(|value| *value *= 0.6));
    }
    assert_eq!(found(&dataset), [(Kind::ExposureSpread, Vec::new())]);
}

#[test]
fn a_photograph_that_is_there_twice_is_named() {
    let mut dataset = clean();
    let copy = View { name: "train_003 copy".to_owned(), ..dataset.train[3].clone() };
    dataset.train.push(copy);
    let seen_by = dataset.points.seen_by.iter().map(|views| {
        let twin = views.contains(&3).then_some(24);
        views.iter().copied().chain(twin)
    });
    dataset.points.seen_by = seen_by.collect();
    assert_eq!(found(&dataset), [(Kind::Duplicate, vec!["train_003 copy".to_owned()])]);
    assert!(full(&dataset).findings[0].message.ends_with("train_003 copy (like train_003)"));
    mask(&mut dataset.train[24], 60, |_| 255);
    assert_eq!(found(&dataset), [(Kind::Duplicate, vec!["train_003 copy".to_owned()])], "masked or not");
    let other = View { camera: dataset.train[3].camera, name: "other".to_owned(), ..dataset.train[9].clone() };
    dataset.train[24] = other;
    let duplicates = full(&dataset).findings.into_iter().filter(|finding| finding.kind == Kind::Duplicate);
    assert_eq!(duplicates.count(), 0, "another picture from the same place is none");
}

#[test]
fn a_camera_far_from_the_rest_is_named() {
    let mut dataset = clean();
    let camera = &mut dataset.train[7].camera;
    camera.camera_from_world = CameraFromWorld::look_at(DVec3::new(40.0, 0.0, 2.0), DVec3::ZERO, DVec3::Z);
    let report = full(&dataset);
    assert_eq!(report.findings[0].kind, Kind::FarPose);
    assert_eq!(report.findings[0].views, ["train_007"]);
    assert_eq!(report.findings.iter().filter(|finding| finding.kind == Kind::FarPose).count(), 1);
}

#[test]
fn views_without_points_and_with_few_are_named() {
    let mut dataset = clean();
    let mut left = 5;
    let mut stays = |view: u32| match view {
        2 => false,
        6 if left == 0 => false,
        6 => {
            left -= 1;
            true
        }
        _ => true,
    };
    let kept = |views: &[u32]| views.iter().copied().filter(|&view| stays(view)).collect::<Vec<u32>>();
    dataset.points.seen_by = dataset.points.seen_by.iter().map(kept).collect();
    let expected = [(Kind::NoPoints, vec!["train_002".to_owned()]), (Kind::FewPoints, vec!["train_006".to_owned()])];
    assert_eq!(found(&dataset), expected);

    dataset = clean();
    dataset.points.seen_by = Tracks::default();
    let camera = &mut dataset.test[1].camera;
    let away = CameraFromWorld::look_at(camera.centre(), 2.0 * camera.centre(), DVec3::Z);
    *camera = Camera { camera_from_world: away, ..*camera };
    dataset.points.positions.retain(|point| DVec3::from_array(point.map(f64::from)).length() < 1.0);
    dataset.points.colours.truncate(dataset.points.positions.len());
    let named = found(&dataset).into_iter().find(|(kind, _)| *kind == Kind::NoPoints);
    assert_eq!(named, Some((Kind::NoPoints, vec!["test_001".to_owned()])), "it looks away from all points");
}

#[test]
fn few_views_and_pictures_without_points_are_said() {
    let mut dataset = builtin(&BuiltinOptions { train_views: 4, ..BuiltinOptions::default() });
    assert_eq!(found(&dataset), [(Kind::FewViews, Vec::new())]);
    dataset.points.positions.truncate(10);
    dataset.points.colours.truncate(10);
    dataset.points.seen_by = dataset.points.seen_by.iter().take(10).map(<[u32]>::to_vec).collect();
    let kinds: Vec<Kind> = found(&dataset).into_iter().map(|(kind, _)| kind).collect();
    assert!(kinds.contains(&Kind::Unexplained) && kinds.contains(&Kind::FewViews), "{kinds:?}");
}

#[test]
fn a_dataset_without_points_is_judged_by_its_pictures_and_poses() {
    let mut dataset = clean();
    dataset.points = Default::default();
    repaint(&mut dataset.train[5], |planes| (0..3).for_each(|_| blur(planes, SIZE, false)));
    let report = full(&dataset);
    assert_eq!((report.points, report.views_per_point, report.range(|view| view.coverage)), (0, None, None));
    assert_eq!(found(&dataset), [(Kind::Blurred, vec!["train_005".to_owned()])]);
}

#[test]
fn json_has_what_there_is() {
    let dataset = clean();
    let json = serde_json::to_value(full(&dataset)).unwrap();
    let view = &json["views"][0];
    assert_eq!((&view["name"], &view["role"]), (&"train_000".into(), &"train".into()));
    assert_eq!((&view["width"], view["centre"].as_array().map(Vec::len)), (&96.into(), Some(3)));
    assert!(view["sharpness"].is_f64() && view.get("thumbnail").is_none(), "{view}");
    assert_eq!((&json["points"], &json["findings"]), (&2000.into(), &serde_json::json!([])));
}

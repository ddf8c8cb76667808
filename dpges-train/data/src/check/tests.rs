//! Each fault is named and nothing else is; a dataset without faults has no findings.

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::DVec3;

use super::*;
use crate::fixtures::assert_says;
use crate::{BuiltinOptions, Picture, Split, Tracks, View, builtin};

/// Width and height of the photographs, px.
const SIZE: usize = 96;

fn clean() -> Dataset {
    builtin(&BuiltinOptions::default())
}

fn full(dataset: &Dataset) -> Report {
    Report::of(dataset, Effort::Full).unwrap()
}

/// Something that is wrong with a view.
pub(super) fn finding(view: &str) -> Finding {
    Finding { kind: Kind::Blurred, views: vec![view.to_owned()], message: String::new(), advice: "" }
}

/// Changes the planes [3, H, W] of a photograph.
fn repaint(view: &mut View, change: impl FnOnce(&mut [f32])) {
    view.repaint(|picture| {
        let mut planes = picture.planes();
        change(&mut planes);
        *picture = Picture::from_planes(&planes, SIZE, SIZE);
    })
    .unwrap();
}

fn darken(view: &mut View, factor: f32) {
    repaint(view, |planes| planes.iter_mut().for_each(|value| *value *= factor));
}

/// Makes each pixel the mean of itself and its neighbours along rows, and along columns unless it is `along_rows_only`, three
/// times.
fn blur(view: &mut View, along_rows_only: bool) {
    let steps = if along_rows_only { &[1; 3][..] } else { &[1, SIZE, 1, SIZE, 1, SIZE] };
    repaint(view, |planes| {
        for channel in planes.chunks_exact_mut(SIZE * SIZE) {
            for step in steps {
                let original = channel.to_vec();
                for (at, value) in channel.iter_mut().enumerate() {
                    let along = at / step % SIZE;
                    let before = if along > 0 { at - step } else { at };
                    let after = if along + 1 < SIZE { at + step } else { at };
                    *value = (original[before] + original[at] + original[after]) / 3.0;
                }
            }
        }
    });
}

/// Masks the pixels from column `from` on, and paints them with what does not count.
fn mask(view: &mut View, from: usize, paint: impl Fn(usize) -> u8) {
    view.repaint(|picture| {
        let counts = |pixel: usize| pixel % SIZE < from;
        picture.counted = Some((0..SIZE * SIZE).map(counts).collect());
        for pixel in (0..SIZE * SIZE).filter(|&pixel| !counts(pixel)) {
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
fn found(dataset: &Dataset) -> Vec<String> {
    let findings = full(dataset).findings.into_iter();
    findings.map(|finding| format!("{:?} {}", finding.kind, finding.views.join(" ")).trim_end().to_owned()).collect()
}

#[test]
fn a_clean_dataset_has_no_findings() {
    let dataset = clean();
    let report = full(&dataset);
    assert_eq!(report.findings, []);
    assert_eq!((report.views.len(), report.points), (30, 2000));
    assert!(report.views_per_point.unwrap() > 2.0);
    let train = &report.views[0];
    assert_eq!((train.name.as_str(), train.role), ("train_000", Split::Train));
    assert!(train.points_seen.unwrap() > 100 && train.coverage.unwrap() > 0.5, "{train:?}");
    let test = report.views.last().unwrap();
    assert_eq!((test.role, test.points_seen, test.coverage, test.exposure), (Split::Test, None, None, None));
    assert!(test.unexplained.unwrap() < 0.5 && test.sharpness.is_some(), "{test:?}");
    assert_eq!(Report::of(&dataset, Effort::Quick).unwrap().findings, []);
}

#[test]
fn a_blurred_photograph_is_named() {
    for along_rows_only in [false, true] {
        let mut dataset = clean();
        blur(&mut dataset.train[5], along_rows_only);
        assert_eq!(found(&dataset), ["Blurred train_005"]);
        let report = full(&dataset);
        assert!(report.findings[0].to_string().starts_with("a photograph is blurred: train_005 ("));
        assert!(report.is_flagged("train_005") && !report.is_flagged("train_004"));
    }
}

#[test]
fn what_is_masked_has_no_part_in_sharpness() {
    let mut dataset = clean();
    // a third of it is white, which takes away detail, or noise, which adds some
    mask(&mut dataset.train[3], 64, |_| 255);
    blur(&mut dataset.train[5], false);
    mask(&mut dataset.train[5], 64, noise);
    assert_eq!(found(&dataset), ["Blurred train_005"]);
    let report = full(&dataset);
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
    darken(&mut dataset.train[4], 0.5);
    assert_eq!(found(&dataset), ["Exposure train_004"]);
    assert_says(&full(&dataset).findings[0], &["train_004 (-", " stops)"]);
}

/// Turns a photograph by 180 degrees.
fn turn(view: &mut View) {
    repaint(view, |planes| planes.chunks_exact_mut(SIZE * SIZE).for_each(<[f32]>::reverse));
}

#[test]
fn photographs_of_other_cameras_are_named() {
    let mut dataset = clean();
    turn(&mut dataset.train[4]);
    let [a, b] = [9, 17].map(|view| dataset.train[view].photograph.clone());
    (dataset.train[9].photograph, dataset.train[17].photograph) = (b, a);
    let report = full(&dataset);
    let [finding] = report.findings.as_slice() else { panic!("{:?}", report.findings) };
    assert_eq!(finding.kind, Kind::OtherPhotograph);
    let mut views = finding.views.clone();
    views.sort();
    assert_eq!(views, ["train_004", "train_009", "train_017"]);
    assert_says(finding, &["3 photographs do not show what the points of their views say (turned, renumbered or"]);
    assert_eq!(report.views[4].exposure, None);
    let correlations: Vec<f64> = report.views.iter().filter_map(|view| view.correlation).collect();
    assert_eq!(correlations.len(), 24, "{correlations:?}");
    let least = report.views.iter().filter(|view| !views.contains(&view.name)).filter_map(|view| view.correlation);
    assert!(least.fold(1.0, f64::min) > 0.8, "{correlations:?}");
}

#[test]
fn points_without_colours_say_nothing_about_photographs() {
    for grey in [[0.5; 2], [0.2, 0.8]] {
        let mut dataset = clean();
        turn(&mut dataset.train[4]);
        dataset.points.colours.iter_mut().enumerate().for_each(|(at, colour)| *colour = [grey[at % 2]; 3]);
        assert!(full(&dataset).views.iter().all(|view| view.correlation.is_none()));
    }
}

#[test]
fn brightness_that_varies_throughout_is_said_once() {
    let mut dataset = clean();
    dataset.train.iter_mut().step_by(2).for_each(|view| darken(view, 0.6));
    assert_eq!(found(&dataset), ["ExposureSpread"]);
}

#[test]
fn a_photograph_that_is_there_twice_is_named() {
    let mut dataset = clean();
    let copy = View { name: "copy".to_owned(), ..dataset.train[3].clone() };
    dataset.train.push(copy);
    let seen_by = dataset.points.seen_by.iter().map(|views| {
        let twin = views.contains(&3).then_some(24);
        views.iter().copied().chain(twin)
    });
    dataset.points.seen_by = seen_by.collect();
    assert_eq!(found(&dataset), ["Duplicate copy"]);
    assert!(full(&dataset).findings[0].message.ends_with("copy (like train_003)"));
    mask(&mut dataset.train[24], 60, |_| 255);
    assert_eq!(found(&dataset), ["Duplicate copy"], "masked or not");
    let mut other = View { camera: dataset.train[3].camera, name: "other".to_owned(), ..dataset.train[9].clone() };
    darken(&mut other, 0.98);
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
    let mut seen_by_6 = 0;
    let mut stays = |view: u32| {
        seen_by_6 += u32::from(view == 6);
        view != 2 && (view != 6 || seen_by_6 <= 5)
    };
    let kept = |views: &[u32]| views.iter().copied().filter(|&view| stays(view)).collect::<Vec<u32>>();
    dataset.points.seen_by = dataset.points.seen_by.iter().map(kept).collect();
    assert_eq!(found(&dataset), ["NoPoints train_002", "FewPoints train_006"]);

    dataset = clean();
    dataset.points.seen_by = Tracks::default();
    let camera = &mut dataset.test[1].camera;
    let away = CameraFromWorld::look_at(camera.centre(), 2.0 * camera.centre(), DVec3::Z);
    *camera = Camera { camera_from_world: away, ..*camera };
    dataset.points.positions.retain(|point| DVec3::from_array(point.map(f64::from)).length() < 1.0);
    dataset.points.colours.truncate(dataset.points.positions.len());
    assert!(found(&dataset).contains(&"NoPoints test_001".to_owned()), "it looks away from all points");
}

#[test]
fn cameras_at_one_point_are_said() {
    let mut dataset = clean();
    for (turns, points) in [(true, true), (true, false), (false, true), (false, false)] {
        for (index, view) in dataset.train.iter_mut().enumerate() {
            let angle = if turns { 0.05 * index as f64 } else { 0.0 };
            let [centre, towards] = [DVec3::new(3.0, 0.3, 1.0), DVec3::new(angle.cos(), angle.sin(), 0.0)];
            view.camera.camera_from_world = CameraFromWorld::look_at(centre, centre - towards, DVec3::Z);
        }
        if !points {
            dataset.points = Default::default();
        }
        let said = full(&dataset).findings;
        assert_says(&said[0], &["all cameras stand at one point: no depth can be found"]);
        dataset.points = clean().points;
    }
}

#[test]
fn cameras_that_do_not_belong_to_the_points_are_not_to_be_left_out() {
    let mut dataset = clean();
    dataset.points.seen_by = Tracks::default();
    for view in dataset.train.iter_mut().chain(&mut dataset.test).skip(10) {
        let centre = view.camera.centre();
        view.camera.camera_from_world = CameraFromWorld::look_at(centre, 2.0 * centre, DVec3::Z);
    }
    dataset.points.positions.retain(|point| DVec3::from_array(point.map(f64::from)).length() < 1.0);
    dataset.points.colours.truncate(dataset.points.positions.len());
    let findings = full(&dataset).findings;
    let unseen: Vec<&Finding> = findings.iter().filter(|finding| finding.kind == Kind::NoPoints).collect();
    assert_says(unseen[0], &["20 of 30 views see no points", "do not belong together", "OpenGL"]);
    assert_eq!(unseen.len(), 1);
    assert!(!unseen[0].to_string().contains("leave"), "{}", unseen[0]);
}

#[test]
fn pictures_of_one_colour_are_named() {
    let mut dataset = clean();
    repaint(&mut dataset.train[3], |planes| planes.fill(0.5));
    assert_says(&full(&dataset).findings[0], &["a picture is of one colour", "train_003"]);
    dataset.train.iter_mut().chain(&mut dataset.test).for_each(|view| repaint(view, |planes| planes.fill(0.0)));
    assert_eq!(found(&dataset).len(), 1);
    assert_says(&full(&dataset).findings[0], &["all pictures are of one colour"]);
}

#[test]
fn a_photograph_with_two_cameras_is_named() {
    let mut dataset = clean();
    dataset.train[5].photograph = dataset.train[3].photograph.clone();
    assert!(found(&dataset).contains(&"Duplicate train_005".to_owned()), "{:?}", found(&dataset));
    let finding = full(&dataset).findings.into_iter().find(|finding| finding.kind == Kind::Duplicate).unwrap();
    assert_says(finding, &["train_005 (like train_003)", "cameras"]);
    let photograph = dataset.train[3].photograph.clone();
    for view in dataset.train.iter_mut().chain(&mut dataset.test) {
        view.photograph = photograph.clone();
    }
    let findings = full(&dataset).findings;
    assert!(findings.iter().any(|finding| finding.message == "all 30 photographs are the same"), "{findings:?}");
}

#[test]
fn a_picture_far_smaller_than_the_others_is_named() {
    let mut dataset = clean();
    let view = &mut dataset.train[3];
    view.photograph = view.photograph.smaller(8, 8);
    view.camera = view.camera.resized(8, 8);
    assert_says(found(&dataset).join(", "), &["Small train_003"]);
    let finding = full(&dataset).findings.into_iter().find(|finding| finding.kind == Kind::Small).unwrap();
    assert_says(finding, &["train_003 (8 x 8 px)", "96"]);
}

#[test]
fn few_views_and_pictures_without_points_are_said() {
    let mut dataset = builtin(&BuiltinOptions { train_views: 4, ..BuiltinOptions::default() });
    assert_eq!(found(&dataset), ["FewViews"]);
    dataset.points.positions.truncate(10);
    dataset.points.colours.truncate(10);
    dataset.points.seen_by = dataset.points.seen_by.iter().take(10).map(<[u32]>::to_vec).collect();
    assert_says(found(&dataset).join(", "), &["Unexplained", "FewViews"]);
}

#[test]
fn a_dataset_without_points_is_judged_by_its_pictures_and_poses() {
    let mut dataset = clean();
    dataset.points = Default::default();
    blur(&mut dataset.train[5], false);
    let report = full(&dataset);
    assert_eq!((report.points, report.views_per_point, report.range(|view| view.coverage)), (0, None, None));
    assert_eq!(found(&dataset), ["Blurred train_005"]);
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

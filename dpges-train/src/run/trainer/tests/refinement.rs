//! What changes the set of primitives while a run trains.

use std::collections::BTreeSet;
use std::sync::Arc;

use dpges_core::scene::ScreenFilter;
use dpges_core::scene::tensors::tensor_to_rows;
use glam::DVec3;

use super::{gaussians, trainer};
use crate::config::StageKind;
use crate::dataset::{BuiltinOptions, builtin, builtin_geometry};
use crate::run::Trainer;
use crate::run::fixtures::{config, dataset, dataset_of, device};

#[test]
fn frozen_surfels_learn_nothing_but_colours() {
    let mut trainer = trainer(&["train.steps=9", "train.freeze_surfels=true"]);
    let before = trainer.scene();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    let after = trainer.scene();
    assert!(!before.surfels.is_empty());
    assert_eq!(after.surfels.positions, before.surfels.positions);
    assert_eq!(after.surfels.quaternions, before.surfels.quaternions);
    assert_eq!(after.surfels.log_scales, before.surfels.log_scales);
    assert_ne!(after.surfels.colour, before.surfels.colour);
    assert_ne!(after.gaussians.positions, before.gaussians.positions);
}

#[test]
fn gaussians_that_draw_nothing_are_in_no_scene_and_make_room_for_others() {
    for (set, replaced) in [("refine.replace_until=20000", true), ("refine.replace_until=0", false)] {
        // batches after 12, 16, …, 48 steps, replacements after 52, …, 76
        let mut trainer = trainer(&["train.steps=100", "refine.budget=300", "refine.split=false", set]);
        while trainer.completed_steps() < 52 {
            trainer.step().unwrap();
        }
        let mut opacities = gaussians(&mut trainer).opacities();
        let mut sorted = opacities.clone();
        sorted.sort_by(f32::total_cmp);
        let median = sorted[sorted.len() / 2];
        let (count, left) = (opacities.len(), opacities.iter().filter(|&&o| o > median).count());
        assert!(left > 20 && left < count, "{left} of {count}");
        opacities.iter_mut().filter(|o| **o <= median).for_each(|o| *o = -1.0);
        gaussians(&mut trainer).reset_opacities(&opacities);
        assert_eq!(trainer.scene().gaussians.len(), left);

        let report = trainer.step().unwrap().unwrap();
        let said = format!("{} Gaussians that draw nothing removed", count - left);
        assert_eq!(report.events.iter().any(|event| event.contains(&said)), replaced, "{:?}", report.events);
        let alive = gaussians(&mut trainer).opacities().iter().filter(|&&o| o > 0.0).count();
        assert_eq!(alive > left, replaced, "{alive}, {left} before");
    }
}

#[test]
fn what_hides_points_from_views_that_saw_them_is_removed_if_that_is_wanted() {
    for (set, is_wanted) in [("refine.clear_sight=true", true), ("refine.clear_sight=false", false)] {
        // batches after 12, 16, …, 48 steps
        let mut trainer = trainer(&["train.steps=100", "refine.budget=300", "refine.split=false", set]);
        while trainer.completed_steps() < 48 {
            trainer.step().unwrap();
        }
        // the first Gaussian hides what two cameras have before them
        let data = dataset();
        let centres: Vec<DVec3> = data.train.iter().map(|view| view.camera.centre()).collect();
        let near = |a: &DVec3, b: &DVec3| a.distance(centres[0]).total_cmp(&b.distance(centres[0]));
        let other = *centres[1..].iter().min_by(|a, b| near(a, b)).unwrap();
        let ahead = data.train[0].camera.camera_from_world.rotation.transpose() * DVec3::Z;
        let distance = centres[0].distance(other);
        let middle = 0.5 * (centres[0] + other) + distance * ahead;
        let gaussians = gaussians(&mut trainer);
        let mut positions = tensor_to_rows(&gaussians.columns.positions.raw());
        positions[..3].copy_from_slice(&middle.as_vec3().to_array());
        gaussians.columns.positions.set(&positions);
        let mut log_scales = tensor_to_rows(&gaussians.columns.log_scales.raw());
        log_scales[..3].fill((0.5 * distance).ln() as f32);
        gaussians.columns.log_scales.set(&log_scales);
        let mut opacities = gaussians.opacities();
        opacities[0] = 0.9;
        gaussians.reset_opacities(&opacities);

        let events = trainer.step().unwrap().unwrap().events;
        let removed = events.iter().find_map(|event| event.split_once(" Gaussians removed that hide points"));
        let count = removed.map(|(before, _)| before.rsplit(' ').next().unwrap().parse::<usize>().unwrap());
        assert_eq!(count.is_some_and(|count| count > 0), is_wanted, "{events:?}");
    }
}

#[test]
fn gaussians_are_added_where_no_surfel_is_if_that_is_wanted() {
    for (set, grows) in [("refine.add_everywhere=true", true), ("refine.add_everywhere=false", false)] {
        let few = ["train.steps=40", "init.method=random", "init.random_gaussians=100", "refine.budget=300"];
        let mut trainer = trainer(&[&few[..], &["refine.split=false", set]].concat());
        assert!(trainer.scene().surfels.is_empty());
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        assert_eq!(gaussians(&mut trainer).len() > 100, grows, "{set}");
    }
}

#[test]
fn surfels_enter_where_views_agree_and_leave_where_they_do_harm() {
    let set = [
        "train.steps=300",
        "stages.gaussians=0.7",
        "refine.budget=1500",
        "refine.judge_surfels_at=[0, 1000]",
        "refine.surfel_prune_from=15000",
    ];
    let options = BuiltinOptions { width: 40, height: 40, train_views: 12, points: 400, ..Default::default() };
    let dataset = Arc::new(builtin(&options));
    let mut trainer = Trainer::new(config(&set), dataset.clone(), device()).unwrap();
    while trainer.stage().kind != StageKind::Joint {
        trainer.step().unwrap();
    }
    let surfels = trainer.scene().surfels;
    assert!((10..=300).contains(&surfels.len()), "{}", surfels.len());
    // their centres are on the surfaces of the room
    let depths: Vec<Vec<f32>> = dataset.train.iter().map(|view| builtin_geometry(&view.camera).0).collect();
    let on_surface = |position: &[f32; 3]| {
        let world = DVec3::from_array(position.map(f64::from));
        let errors = dataset.train.iter().zip(&depths).filter_map(|(view, depth)| {
            let (x, y, z) = view.camera.project(world)?;
            let inside = x >= 0.0 && y >= 0.0 && x < 40.0 && y < 40.0;
            inside.then(|| (f64::from(depth[y as usize * 40 + x as usize]) - z).abs() / z)
        });
        errors.fold(f64::INFINITY, f64::min) < 0.05
    };
    let good = surfels.positions.as_chunks::<3>().0.iter().filter(|position| on_surface(position)).count();
    assert!(good * 5 >= surfels.len() * 4, "{good} of {}", surfels.len());

    // three of them close before cameras, in a colour of no photograph, leave where they are judged
    while trainer.completed_steps() < 214 {
        trainer.step().unwrap();
    }
    let mut wrong = trainer.scene().surfels;
    for row in 0..3 {
        let position = dataset.train[4 * row].camera.unproject(20.0, 20.0, 1.0).as_vec3();
        wrong.positions[3 * row..][..3].copy_from_slice(&position.to_array());
        wrong.colour.base[3 * row..][..3].fill(20.0);
    }
    let surfels = trainer.stage.parameters().surfels;
    surfels.columns.positions.set(&wrong.positions);
    surfels.columns.colour.base.set(&wrong.colour.base);
    let events = trainer.step().unwrap().unwrap().events;
    assert!(events.iter().any(|event| event.contains("surfels removed")), "{events:?}");
    let after = trainer.scene().surfels;
    assert!(!after.is_empty() && after.colour.base.iter().all(|&base| base < 15.0), "{:?}", after.colour.base);
}

#[test]
fn all_views_are_seen_between_two_changes_that_judge_by_views() {
    // 7 views, stages of 40, 40 and 120 steps: no stage begins where a pass over the views would
    let views = 7;
    let set = ["train.steps=200", "stages.surfels=0.2", "stages.gaussians=0.2", "refine.surfel_min_pixels=0"];
    let mut trainer = Trainer::new(config(&set), dataset_of(views), device()).unwrap();
    let mut stage = trainer.stage();
    // views since the last of these events, and their number at each of them
    let mut windows = ["added by densification", "surfels pruned", "Gaussians pruned"]
        .map(|event| (event, BTreeSet::new(), Vec::<usize>::new()));
    while !trainer.is_finished() {
        let report = trainer.step().unwrap().unwrap();
        for (event, seen, counts) in &mut windows {
            if trainer.stage() != stage {
                seen.clear();
            }
            if report.events.iter().any(|said| said.contains(*event)) {
                counts.push(seen.len());
                seen.clear();
            }
            seen.insert(report.view);
        }
        stage = trainer.stage();
    }
    for (event, _, counts) in windows {
        assert!(!counts.is_empty() && counts.iter().all(|&count| count == views), "{event}: {counts:?}");
    }
}

#[test]
fn what_is_fine_is_drawn_as_coarse_as_the_views_resolve_it() {
    let mut trainer = trainer(&["train.steps=20", "train.method=mip-splatting", "refine.budget=300"]);
    let log_scales = |trainer: &mut Trainer| gaussians(trainer).to_data().log_scales;
    let fine = vec![-20.0; log_scales(&mut trainer).len()];
    gaussians(&mut trainer).columns.log_scales.set(&fine);
    let scene = trainer.scene();
    // a pixel of a view of 24 px is more than 0.01 of this scene, which is about 2 wide
    assert!(scene.gaussians.log_scales.iter().all(|&scale| f64::from(scale).exp() > 0.447 * 0.01));
    assert!(scene.gaussians.opacities.iter().all(|&opacity| opacity < 1e-6), "what has no size has no weight");
    assert_eq!(scene.info.screen_filter, ScreenFilter::Compensated);
}

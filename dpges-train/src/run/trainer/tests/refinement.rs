//! Changes of the set of primitives while a run trains.

use std::collections::BTreeSet;
use std::sync::Arc;

use burn::tensor::DType;
use dpges_core::ops::peel::{PeelOptions, peel};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{Peeling, ScreenFilter, Surfels};
use glam::{DVec3, Vec3};

use super::{after, gaussians, trainer};
use crate::config::StageKind;
use crate::dataset::{builtin, builtin_geometry};
use crate::run::Trainer;
use crate::run::fixtures::{config, dataset_of, device, options, step_until};

#[test]
fn frozen_surfels_learn_nothing_but_colours() {
    let mut trainer = trainer(&["train.steps=9", "train.freeze_surfels=true"]);
    let before = trainer.scene();
    step_until(&mut trainer, Trainer::is_finished);
    let after = trainer.scene();
    assert!(!before.surfels.is_empty());
    assert_eq!(after.surfels.positions, before.surfels.positions);
    assert_eq!(after.surfels.quaternions, before.surfels.quaternions);
    assert_eq!(after.surfels.log_scales, before.surfels.log_scales);
    assert_ne!(after.surfels.colour, before.surfels.colour);
    assert_ne!(after.gaussians.positions, before.gaussians.positions);
}

#[test]
fn the_factor_of_geometry_scales_its_rates_and_no_others() {
    let one_step = |factor: usize| {
        let mut trainer = trainer(&["train.steps=9", &format!("optimizer.joint_geometry={factor}")]);
        let before = trainer.scene();
        trainer.step().unwrap();
        (before, trainer.scene())
    };
    let (before, after) = one_step(0);
    assert_eq!(after.surfels.positions, before.surfels.positions);
    assert_eq!(after.gaussians.positions, before.gaussians.positions);
    assert_eq!(after.gaussians.log_scales, before.gaussians.log_scales);
    assert_ne!(after.gaussians.colour, before.gaussians.colour);
    let [once, twice] = [1, 2].map(|factor| {
        let (before, after) = one_step(factor);
        let moved = before.gaussians.log_scales.iter().zip(&after.gaussians.log_scales).map(|(a, b)| (b - a).abs());
        moved.fold(0.0, f32::max)
    });
    assert!(once > 0.0 && (twice / once - 2.0).abs() < 1e-3, "{once}, {twice}");
}

#[test]
fn long_runs_leave_out_gaussians_if_the_scene_has_an_environment() {
    let loss = |steps: usize, environment: &str, dropout: f64| {
        let set = [&format!("train.steps={steps}"), environment, &format!("train.dropout={dropout}")];
        let mut trainer = trainer(&set.map(|text| text as &str));
        trainer.step().unwrap();
        trainer.step().unwrap().unwrap().loss
    };
    // 3 views
    let [short, long] = [150, 450];
    for (steps, environment, is_changed) in [
        (long, "model.environment=sh0", true),
        (short, "model.environment=sh0", false),
        (long, "model.environment=none", false),
    ] {
        let is_different = loss(steps, environment, 0.0) != loss(steps, environment, 0.2);
        assert_eq!(is_different, is_changed, "{steps} steps, {environment}");
    }
}

#[test]
fn gaussians_that_draw_nothing_are_in_no_scene_and_make_room_for_others() {
    for (set, replaced) in [("refine.replace_until=20000", true), ("refine.replace_until=0", false)] {
        // batches after 12, 16, …, 48 steps, replacements after 52, …, 76
        let mut trainer = after(trainer(&["train.steps=100", "refine.budget=300", "refine.split_until=0", set]), 52);
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
        let said = format!("{} Gaussians removed that draw nothing", count - left);
        assert_eq!(report.events.iter().any(|event| event.contains(&said)), replaced, "{:?}", report.events);
        let alive = gaussians(&mut trainer).opacities().iter().filter(|&&o| o > 0.0).count();
        assert_eq!(alive > left, replaced, "{alive}, {left} before");
    }
}

#[test]
fn what_is_before_a_camera_makes_room_for_copies() {
    let dataset = Arc::new(builtin(&options(24, [3, 6], 800)));
    let centre = dataset.train[0].camera.centre().as_vec3().to_array();
    for (set, leave) in [("refine.new_gaussians=copies", true), ("refine.new_gaussians=black", false)] {
        let set = ["train.steps=100", "refine.budget=400", "refine.split_until=0", set];
        let mut trainer = after(Trainer::new(config(&set), dataset.clone(), device()).unwrap(), 52);
        let all = gaussians(&mut trainer);
        let mut positions = all.columns.positions.raw_rows();
        positions[..15].copy_from_slice(&centre.repeat(5));
        all.columns.positions.set(&positions);
        let rows = |trainer: &mut Trainer| {
            let positions = gaussians(trainer).columns.positions.raw_rows();
            positions.as_chunks::<3>().0.iter().filter(|&&position| position == centre).count()
        };
        assert_eq!(rows(&mut trainer), 5);
        let before = gaussians(&mut trainer).len();
        let report = trainer.step().unwrap().unwrap();
        assert!(report.events.iter().any(|event| event.contains("Gaussians removed")), "{:?}", report.events);
        let near = gaussians(&mut trainer).columns.positions.raw_rows();
        let near = near.as_chunks::<3>().0.iter().filter(|at| Vec3::from_array(**at).distance(centre.into()) < 0.1);
        assert_eq!(near.count(), if leave { 0 } else { 5 });
        assert!(!leave || gaussians(&mut trainer).len() >= before, "copies take their place");
    }
}

#[test]
fn black_gaussians_are_added_over_surfels_only() {
    for (set, grows) in [("refine.new_gaussians=copies", true), ("refine.new_gaussians=black", false)] {
        let few = ["train.steps=40", "init.method=random", "init.random_gaussians=100", "refine.budget=300"];
        let mut trainer = trainer(&[&few[..], &["refine.split_until=0", set]].concat());
        assert!(trainer.scene().surfels.is_empty());
        step_until(&mut trainer, Trainer::is_finished);
        assert_eq!(gaussians(&mut trainer).len() > 100, grows, "{set}");
    }
    let set = ["train.steps=40", "refine.budget=900", "refine.split_until=0", "refine.new_gaussians=black"];
    let mut trainer = trainer(&set);
    let before = gaussians(&mut trainer).len();
    step_until(&mut trainer, Trainer::is_finished);
    assert!(gaussians(&mut trainer).len() > before, "{before}");
}

#[test]
fn copies_fill_the_budget() {
    let set = ["train.steps=100", "refine.budget=700", "refine.split_until=0", "refine.surfel_prune_from=15000"];
    let mut trainer = trainer(&set);
    let mut batches = 0;
    while !trainer.is_finished() {
        let events = trainer.step().unwrap().unwrap().events;
        batches += usize::from(events.iter().any(|event| event.contains("added of")));
    }
    assert_eq!(batches, 10 + 7);
    let scene = trainer.scene();
    let primitives = scene.surfels.len() + scene.gaussians.len();
    // a few fade after the last replacement
    assert!((665..=700).contains(&primitives), "{primitives}");
}

#[test]
fn surfels_enter_where_views_agree() {
    let set = ["train.steps=300", "stages.gaussians=0.7", "refine.budget=1500", "refine.surfel_prune_from=15000"];
    let dataset = Arc::new(builtin(&options(40, [12, 6], 400)));
    let mut trainer = Trainer::new(config(&set), dataset.clone(), device()).unwrap();
    step_until(&mut trainer, |trainer| trainer.stage().kind == StageKind::Joint);
    let scene = trainer.scene();
    let surfels = &scene.surfels;
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
    // and few of their pixels are in front of the surface that is seen there: more than half are before surfels are shrunk
    let options = PeelOptions { layer_count: 1, peeling: Peeling::Nearest, ..(&scene.info).into() };
    let on_device = Surfels::from_data(surfels, &device(), DType::F32);
    let (mut covered, mut in_front) = (0, 0);
    for (view, depth) in dataset.train.iter().zip(&depths) {
        let layers = peel(&on_device, &view.camera, &options).unwrap();
        let (alpha, of_surfel) = (tensor_to_rows(&layers.alpha), tensor_to_rows(&layers.depth));
        for pixel in (0..depth.len()).filter(|&pixel| alpha[pixel] > 0.5) {
            covered += 1;
            in_front += usize::from(of_surfel[pixel] < 0.96 * depth[pixel]);
        }
    }
    assert!(covered > 1500 && in_front * 5 < covered, "{in_front} of {covered} pixels");
}

#[test]
fn surfels_start_somewhere_where_depths_agree_nowhere() {
    let set = ["train.steps=20", "stages.gaussians=0.5", "refine.budget=400"];
    let first_joint_scene = |points: bool| {
        let mut data = builtin(&options(24, [2, 6], 200));
        if !points {
            data.points = Default::default();
        }
        let mut trainer = Trainer::new(config(&set), Arc::new(data), device()).unwrap();
        step_until(&mut trainer, |trainer| trainer.stage().kind == StageKind::Joint);
        trainer.scene()
    };
    for points in [true, false] {
        let surfels = first_joint_scene(points).surfels.len();
        assert!((5..=100).contains(&surfels), "{surfels} surfels, points {points}");
    }
}

#[test]
fn all_views_are_seen_between_two_changes_that_judge_by_views() {
    // 7 views, stages of 40, 40 and 120 steps: no stage begins where a pass over the views would
    let views = 7;
    let set = ["train.steps=200", "stages.surfels=0.2", "stages.gaussians=0.2", "refine.surfel_pixels=0px"];
    let set = [&set[..], &["refine.gaussian_prune_until=2000"]].concat();
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

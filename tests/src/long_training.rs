//! Long training on data that is partly wrong stays sane.
//!
//! `DPGES_LONG_STEPS` sets the number of steps (1000 unless set).

use std::sync::Arc;

use dpges_core::scene::SceneData;
use dpges_core::scene::schema::Columns;
use dpges_train::config::Config;
use dpges_train::dataset::{BuiltinOptions, Dataset, builtin};
use dpges_train::eval::evaluate;
use dpges_train::run::Trainer;

use crate::budget::number;
use crate::devices::ndarray;

/// How far from the middle of the cameras a primitive may be, and how large, in extents of the scene.
const MOST_EXTENTS: f32 = 100.0;

/// The built-in scene with 1 % of the pixels of a view black, white or saturated, a view twice, and a view with the pose of
/// another.
fn partly_wrong() -> Dataset {
    let size = 24;
    let options =
        BuiltinOptions { width: size, height: size, train_views: 10, test_views: 4, points: 300, ..Default::default() };
    let mut data = builtin(&options);
    let spoil = |value: &mut u8| *value = if *value < 128 { 255 } else { 0 };
    data.train[1].repaint(|picture| picture.bytes.iter_mut().step_by(101).for_each(spoil)).unwrap();
    let mut twin = data.train[2].clone();
    twin.name = "twin.png".to_owned();
    data.train.push(twin);
    data.train[4].camera = data.train[7].camera;
    data
}

/// The defaults with `factor` times their learning rates.
fn faster(factor: f64, set: &[&str]) -> Config {
    let mut config = Config::with(set).unwrap();
    let rates = &mut config.optimizer;
    for rate in [
        &mut rates.position_start,
        &mut rates.position_end,
        &mut rates.quaternions,
        &mut rates.log_scales,
        &mut rates.opacities,
        &mut rates.base,
        &mut rates.detail,
    ] {
        *rate *= factor;
    }
    config
}

fn assert_sane(scene: &SceneData, data: &Dataset, step: usize) {
    let extent = data.extent as f32;
    let sets = scene.surfels.iter().chain(scene.gaussians.iter());
    for (attribute, values) in sets {
        let name = attribute.name;
        assert!(values.iter().all(|value| value.is_finite()), "step {step}: {name} is not finite");
        let largest = values.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
        if name.ends_with(".positions") {
            assert!(largest < MOST_EXTENTS * extent, "step {step}: {name} reach {largest}");
        } else if name.ends_with(".log_scales") {
            let largest = values.iter().fold(f32::MIN, |largest, &value| largest.max(value)).exp();
            assert!(largest < MOST_EXTENTS * extent, "step {step}: {name} reach {largest} world units");
        }
    }
}

#[test]
fn twice_the_learning_rates_on_data_that_is_partly_wrong() {
    let data = Arc::new(partly_wrong());
    let steps = number("DPGES_LONG_STEPS").unwrap_or(1000) as usize;
    let set = [&*format!("train.steps={steps}"), "refine.budget=700", "stages.surfels=0.2"];
    let mut trainer = Trainer::new(faster(2.0, &set), Arc::clone(&data), ndarray()).unwrap();
    let (mut events, mut step) = (0, 0);
    while !trainer.is_finished() {
        if let Some(report) = trainer.step().unwrap() {
            assert!(report.loss.is_finite(), "step {}: the loss is {}", report.step, report.loss);
            events += report.events.len();
            step = report.step;
        }
        if step % (steps / 20) == 0 {
            assert_sane(&trainer.scene(), &data, step);
        }
    }
    let scene = trainer.scene();
    assert_sane(&scene, &data, steps);
    let psnr = evaluate(&scene, &data.test, &ndarray()).unwrap().psnr;
    println!("{steps} steps, {events} events, {psnr:.2} dB held out");
    assert!(events > 10, "what is removed and added is said");
    assert!(psnr > 12.0, "{psnr:.2} dB held out");
}

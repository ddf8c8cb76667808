//! Runs on photographs that are masked.

use super::fixtures::{STAGES, finished, options, trained};
use super::*;
use crate::dataset::{Picture, View, builtin};
use crate::eval::evaluate;

/// A third of every training photograph is painted over, another third in each, and masked if that is asked for.
pub fn overpainted(data: &Dataset, value: u8, masked: bool) -> Dataset {
    let mut data = data.clone();
    data.train.iter_mut().enumerate().for_each(|(index, view)| paint(view, index % 3, value, masked));
    data
}

fn paint(view: &mut View, third: usize, value: u8, masked: bool) {
    let change = |picture: &mut Picture| {
        let (width, area) = (picture.width, picture.area());
        let is_painted = |pixel: usize| pixel % width * 3 / width == third;
        for pixel in (0..area).filter(|&pixel| is_painted(pixel)) {
            picture.bytes[3 * pixel..][..3].fill(value);
        }
        if masked {
            picture.counted = Some((0..area).map(|pixel| !is_painted(pixel)).collect());
        }
    };
    view.repaint(change).unwrap();
}

fn dataset(size: usize, train_views: usize) -> Dataset {
    builtin(&options(size, [train_views, 4], 400))
}

#[test]
fn what_is_painted_over_and_masked_changes_no_bit_of_a_run() {
    let all = [&STAGES[..], &["discs.lambda_distortion=0.1"]].concat();
    let runs: [&[&str]; 4] = [
        &all,
        &["train.steps=60", "stages.gaussians=0.5", "refine.budget=700", "refine.new_gaussians=black"],
        &["train.steps=60", "train.exposure=on", "stages.gaussians=0.5", "refine.budget=700"],
        &["train.steps=30", "train.method=3dgs", "refine.budget=300", "model.colour=sh1"],
    ];
    let clean = dataset(24, 5);
    for set in runs {
        let [black, white] = [0, 255].map(|value| finished(set, overpainted(&clean, value, true)));
        assert!(black == white, "{set:?}");
    }
    for exposure in ["train.exposure=off", "train.exposure=on"] {
        let set = ["train.steps=30", "refine.budget=auto", "data.validation_every=2", exposure];
        let [black, white] = [0, 255].map(|value| {
            let mut data = overpainted(&clean, value, true);
            data.keep_for_validation(2);
            finished(&set, data)
        });
        assert!(black == white, "{set:?}");
    }
}

#[test]
fn masks_make_up_for_what_is_painted_over() {
    let clean = dataset(32, 16);
    let set = ["train.steps=400", "refine.budget=1500", "refine.surfel_pixels=1px/MP"];
    let psnr = |data: Dataset| {
        let trainer = trained(&set, Arc::new(data));
        evaluate(&trainer.scene(), &clean.test, trainer.device()).unwrap().psnr
    };
    let whole = psnr(clean.clone());
    let masked = psnr(overpainted(&clean, 255, true));
    let unmasked = psnr(overpainted(&clean, 255, false));
    println!("held out: {whole:.2} dB clean, {masked:.2} dB masked, {unmasked:.2} dB painted over");
    assert!(masked > whole - 2.5, "{whole:.2} dB clean, {masked:.2} dB masked");
    assert!(masked > unmasked + 2.0, "{masked:.2} dB masked, {unmasked:.2} dB painted over");
}

use std::ops::Range;

use dpges_core::scene::{ColourModel, GaussianData, Rendering, SceneInfo, SurfelData};
use dpges_core::testing::ranks::on_ranks;

use super::*;
use crate::dataset::{BuiltinOptions, builtin};
use crate::device::place::Place;
use crate::metrics::lpips::{Network, Weights};
use crate::run::fixtures::device;
use crate::views::exposure::Correction;

fn nothing(background: [f64; 3]) -> SceneData {
    let colour_model = ColourModel::SphericalBeta { lobes: 0 };
    let info = SceneInfo { colour_model, layer_count: 2, background, ..SceneInfo::default() };
    SceneData { info, surfels: SurfelData::default(), gaussians: GaussianData::default(), environment: None }
}

/// Two held-out views of the built-in scene, `side` px wide and high.
fn views(side: usize) -> Vec<View> {
    builtin(&BuiltinOptions { width: side, height: side, train_views: 2, test_views: 2, ..Default::default() }).test
}

fn measured(scene: &SceneData, views: &[View], measures: Measures) -> Evaluation {
    let found: Result<_> =
        evaluate_each(&TrainingRenderer::new(scene, &device()), scene, views, measures, |_, _| Ok(()));
    found.unwrap()
}

#[test]
fn scores_are_those_of_eight_bit_pictures() {
    let mut views = views(12);
    views[0].repaint(|picture| picture.bytes.fill(128)).unwrap();
    views[1].repaint(|picture| picture.bytes.fill(64)).unwrap();
    let evaluation = evaluate(&nothing([0.5; 3]), &views, &device()).unwrap();
    let [equal, darker] = [0, 1].map(|view| evaluation.views[view].scores);
    assert_eq!(equal.psnr, LARGEST_PSNR, "0.5 and 128/255 are the same of 256 steps");
    let error = (128.0 - 64.0) / 255.0f64;
    assert!((darker.psnr + 20.0 * error.log10()).abs() < 1e-3);
    assert!((equal.ssim - 1.0).abs() < 1e-6 && darker.ssim < 1.0);
    assert_eq!(evaluation.psnr, (equal.psnr + darker.psnr) / 2.0);
    assert_eq!(evaluation.perceptual, Perceptual::default());
    assert!(evaluate(&nothing([0.0; 3]), &[], &device()).unwrap_err().to_string().contains("views"));

    let score = |index: usize, width: usize| {
        let picture = Rgb8Image { width, height: 12, bytes: vec![128; 3 * width * 12] };
        score_picture(&views[index], &picture, 0.0, &device(), Measures::BASIC)
    };
    assert_eq!(score(0, 12).unwrap().scores.psnr, LARGEST_PSNR);
    for (index, expected) in [equal, darker].into_iter().enumerate() {
        let found = score(index, 12).unwrap().scores;
        assert!((found.psnr - expected.psnr).abs() < 1e-4 && (found.ssim - expected.ssim).abs() < 1e-6);
        assert!((found.flip - expected.flip).abs() < 1e-6);
    }
    assert!(score(0, 11).unwrap_err().to_string().contains("picture"));
}

#[test]
fn coverage_is_the_share_of_pixels_that_surfels_hide() {
    let views = views(16);
    assert_eq!(evaluate(&nothing([0.0; 3]), &views, &device()).unwrap().coverage, Some(0.0));
    let mut scene = nothing([0.0; 3]);
    scene.surfels = SurfelData { log_scales: vec![3.0; 2], ..SurfelData::neutral(scene.info.colour_model, 1) };
    let covered = evaluate(&scene, &views, &device()).unwrap();
    let shares: Vec<f64> = covered.views.iter().map(|view| view.coverage.unwrap()).collect();
    assert_eq!(covered.coverage.unwrap(), shares.iter().sum::<f64>() / 2.0);
    assert!(shares.iter().all(|share| (0.1..=1.0).contains(share)), "{shares:?}");
    let blended = SceneInfo { rendering: Rendering::Ellipsoids, ..scene.info.clone() };
    let blended = SceneData { info: blended, surfels: SurfelData::default(), ..scene };
    assert_eq!(evaluate(&blended, &views, &device()).unwrap().coverage, None);
}

#[test]
fn what_does_not_count_is_in_no_score() {
    let mut views = views(32);
    let counted: Vec<bool> = (0..32 * 32).map(|pixel| pixel % 32 < 20).collect();
    for (index, view) in views.iter_mut().enumerate() {
        let garbage = 255 * index as u8;
        let paint = |picture: &mut Picture| {
            picture.bytes = counted.iter().flat_map(|&counts| [if counts { 128 } else { garbage }; 3]).collect();
            picture.counted = Some(counted.clone());
        };
        view.repaint(paint).unwrap();
    }
    let measures = Measures { fitted: true, ..Measures::perceptual(&[]) };
    let [equal, darker] = [0.5, 0.25].map(|value| {
        let evaluation = measured(&nothing([value; 3]), &views, measures);
        [0, 1].map(|view| evaluation.views[view].scores)
    });
    assert!(equal[0] == equal[1] && darker[0] == darker[1], "{equal:?} {darker:?}");
    assert_eq!((equal[0].psnr, equal[0].flip, equal[0].perceptual.ssimulacra2), (LARGEST_PSNR, 0.0, Some(100.0)));
    assert!((equal[0].ssim - 1.0).abs() < 1e-6 && darker[0].ssim < 1.0 && darker[0].flip > 0.0);
    assert!((darker[0].psnr + 20.0 * (64.0 / 255.0f64).log10()).abs() < 1e-3, "{darker:?}");
    assert_eq!(darker[0].fitted.psnr_fitted, Some(LARGEST_PSNR));
}

#[test]
fn perceptual_measures_are_those_of_the_same_pictures() {
    let mut views = views(32);
    views[0].repaint(|picture| picture.bytes.fill(128)).unwrap();
    let weights = Weights::new(Network::Alex, |tensor| {
        (0..tensor.shape.iter().product::<usize>()).map(|i| (i * 37 % 101) as f32 / 1000.0).collect()
    });
    let networks = [Lpips::new(&weights, &device())];
    let evaluation = measured(&nothing([0.5; 3]), &views, Measures::perceptual(&networks));
    let [equal, other] = [0, 1].map(|view| evaluation.views[view].scores);
    let Perceptual { ms_ssim, ssimulacra2, lpips_alex, lpips_vgg } = equal.perceptual;
    assert_eq!((ms_ssim, lpips_vgg), (None, None), "too small, and not asked for");
    assert_eq!((ssimulacra2, lpips_alex), (Some(100.0), Some(0.0)));
    assert!(other.perceptual.ssimulacra2.unwrap() < 100.0 && other.perceptual.lpips_alex.unwrap() > 0.0);
    assert_eq!(evaluation.scores(), Scores::mean(&[equal, other]));
}

/// Size of pictures that an exposure is fitted to.
const WIDTH: usize = 17;
const HEIGHT: usize = 12;

fn tensor(values: Vec<f32>) -> Tensor<3> {
    Tensor::from_data(TensorData::new(values, [3, HEIGHT, WIDTH]), (&Device::flex(), DType::F32))
}

/// An image, and a photograph of it with another exposure.
fn exposed() -> [Tensor<3>; 2] {
    let image = tensor((0..3 * HEIGHT * WIDTH).map(|i| 0.2 + 0.6 * (i * 37 % 101) as f32 / 101.0).collect());
    let change = Correction { gain: [0.5, 0.75, 1.25], offset: [0.25, 0.0, -0.125] };
    [image.clone(), change.applied(image)]
}

/// The pixels of `columns`.
fn within(columns: Range<usize>) -> Vec<bool> {
    (0..HEIGHT * WIDTH).map(|pixel| columns.contains(&(pixel % WIDTH))).collect()
}

#[test]
fn an_exposure_that_fits_the_left_half_is_applied_to_the_right() {
    let [image, photograph] = exposed();
    let both = fitted(&quantised(photograph.clone()), None, &image).unwrap();
    assert!(both.psnr_fitted.unwrap() > 50.0 && both.ssim_fitted.unwrap() > 0.999, "{both:?}");
    // the right half of another photograph: what the left half says of it is wrong
    let half = WIDTH / 2;
    let [left, right] = [0..half, half..WIDTH].map(|columns| [0..3, 0..HEIGHT, columns]);
    let mixed = Tensor::cat(vec![photograph.slice(left), image.clone().slice(right)], 2);
    let wrong = fitted(&quantised(mixed), None, &image).unwrap();
    assert!(wrong.psnr_fitted.unwrap() < 25.0, "{wrong:?}");
    let narrow = image.slice([0..3, 0..HEIGHT, 0..1]);
    assert_eq!(fitted(&narrow, None, &narrow).unwrap(), Fitted::default());
}

#[test]
fn pixels_that_do_not_count_are_neither_fitted_nor_judged() {
    let [image, photograph] = exposed();
    // a column of each half is black
    let counted: Vec<bool> = (0..HEIGHT * WIDTH).map(|pixel| ![3, 12].contains(&(pixel % WIDTH))).collect();
    let mut painted = tensor_to_rows(&photograph);
    let planes = painted.iter_mut().zip(counted.iter().cycle());
    planes.filter(|(_, counts)| !**counts).for_each(|(value, _)| *value = 0.0);
    let photograph = quantised(tensor(painted));
    let with_mask = fitted(&photograph, Some(&counted), &image).unwrap();
    assert!(with_mask.psnr_fitted.unwrap() > 50.0 && with_mask.ssim_fitted.unwrap() > 0.999, "{with_mask:?}");
    let without = fitted(&photograph, None, &image).unwrap();
    assert!(without.psnr_fitted.unwrap() < 25.0, "{without:?}");
    // nothing counts in one half
    for half in [0..WIDTH / 2, WIDTH / 2..WIDTH] {
        assert_eq!(fitted(&photograph, Some(&within(half)), &image).unwrap(), Fitted::default());
    }
}

#[test]
fn fits_are_part_of_an_evaluation_if_they_are_wanted() {
    let mut views = views(12);
    views[0].repaint(|picture| picture.bytes.fill(191)).unwrap();
    let scene = nothing([0.5; 3]);
    let plain = measured(&scene, &views, Measures::BASIC);
    assert_eq!((plain.fitted, plain.deciding_psnr()), (Fitted::default(), plain.psnr));
    assert!(!serde_json::to_string(&plain).unwrap().contains("fitted"));
    let with = measured(&scene, &views, Measures { fitted: true, ..Measures::BASIC });
    // a plain picture differs from a plain photograph by an offset
    let [first, second] = [0, 1].map(|view| with.views[view].scores);
    assert!(first.psnr < 13.0 && first.fitted.psnr_fitted.unwrap() > 50.0);
    let mean = (first.fitted.psnr_fitted.unwrap() + second.fitted.psnr_fitted.unwrap()) / 2.0;
    assert_eq!((with.fitted.psnr_fitted, with.deciding_psnr()), (Some(mean), mean));
    let json = serde_json::to_value(&with).unwrap();
    assert_eq!(json["psnr_fitted"].as_f64(), Some(mean));
    assert_eq!(serde_json::from_value::<Evaluation>(json).unwrap(), with);
}

#[test]
fn cameras_are_fitted_to_the_left_half_and_judged_by_the_right() {
    let mut views = views(16);
    // nothing on the right counts
    views[1].repaint(|picture| picture.counted = Some((0..16 * 16).map(|pixel| pixel % 16 < 8).collect())).unwrap();
    let mut scene = nothing([0.5; 3]);
    scene.gaussians = GaussianData::neutral(scene.info.colour_model, 1);
    let measures = Measures { posed: true, ..Measures::BASIC };
    let found = measured(&scene, &views, measures);
    let [first, second] = [0, 1].map(|view| found.views[view].scores.fitted);
    assert!(first.psnr_posed.is_some() && first.ssim_posed.is_some() && first.psnr_fitted.is_none());
    assert_eq!((second, found.fitted), (Fitted::default(), Fitted::default()));
    let json = serde_json::to_value(&found).unwrap();
    assert_eq!(json["views"][0]["psnr_posed"].as_f64(), first.psnr_posed);
    let both = measured(&scene, &views[..1], Measures { fitted: true, ..measures }).fitted;
    assert!(both.psnr_posed.is_some() && both.psnr_posed != first.psnr_posed, "{both:?}");
}

#[test]
fn reports_of_earlier_versions_are_read() {
    let view = r#"{"name":"a","psnr":20.0,"ssim":0.5,"flip":0.25,"seconds":0.5,"width":8,"height":4}"#;
    let text = format!(
        r#"{{"scene":"a","dataset":"builtin","split":"test","views":[{view}],"psnr":20.0,"ssim":0.5,"flip":0.25,
        "surfels":1,"gaussians":2,"seconds_per_view":0.5,"bytes":3}}"#
    );
    let report: EvalReport = serde_json::from_str(&text).unwrap();
    assert_eq!((report.training_seconds, report.peak_memory_bytes), (None, None));
    assert_eq!(report.evaluation.views[0].scores.perceptual, Perceptual::default());
    let mut written = serde_json::to_value(&report).unwrap();
    assert_eq!(written, serde_json::from_str::<serde_json::Value>(&text).unwrap(), "nothing is added");
    written["lpips_vgg"] = 0.125.into();
    written["views"][0]["ssimulacra2"] = 60.5.into();
    let report: EvalReport = serde_json::from_value(written).unwrap();
    assert_eq!(report.evaluation.perceptual.lpips_vgg, Some(0.125));
    assert_eq!(report.evaluation.views[0].scores.perceptual.ssimulacra2, Some(60.5));
}

#[test]
fn views_are_shared_out_among_ranks_and_all_get_the_scores() {
    let options = BuiltinOptions { width: 32, height: 24, train_views: 2, test_views: 5, ..Default::default() };
    let dataset = builtin(&options);
    let device = device();
    let mut peeled = nothing([0.5; 3]);
    peeled.gaussians = GaussianData::neutral(ColourModel::SphericalBeta { lobes: 0 }, 3);
    peeled.gaussians.positions = vec![0.0, 0.0, 0.0, 0.3, 0.1, 0.0, -0.2, 0.2, 0.1];
    let info = SceneInfo { rendering: Rendering::Ellipsoids, ..peeled.info.clone() };
    let blended = SceneData { info, ..peeled.clone() };
    for scene in [peeled, blended] {
        let is_sharded = scene.info.rendering == Rendering::Peeled;
        let scores = |count: usize| {
            on_ranks(count, |ranks| {
                let (rank, place) = (ranks.rank(), Place { device: device.clone(), ranks });
                let renderer = TrainingRenderer::on_ranks(&scene, &place);
                let mut visited = Vec::new();
                let visit = |index: usize, _: &Rendered| -> Result<()> {
                    visited.push(index);
                    Ok(())
                };
                let found = evaluate_each(&renderer, &scene, &dataset.test, Measures::perceptual(&[]), visit);
                assert!(visited.iter().copied().eq((rank..5).step_by(count)));
                found.unwrap()
            })
        };
        let alone = scores(1).remove(0);
        for found in scores(2).iter().chain(&scores(3)) {
            assert_eq!(found.views.len(), 5);
            for (found, alone) in found.views.iter().zip(&alone.views) {
                assert_eq!(found.name, alone.name);
                let [found, alone] = [found.scores, alone.scores];
                // sums of ranks round to another of 256 values here and there
                let most = if is_sharded { 0.05 } else { 1e-9 };
                assert!((found.psnr - alone.psnr).abs() < most, "{found:?}, alone {alone:?}");
                assert!((found.flip - alone.flip).abs() < most, "{found:?}, alone {alone:?}");
            }
            assert!((found.psnr - alone.psnr).abs() < 0.05);
        }
        assert!(alone.views.iter().any(|view| view.scores.psnr != alone.psnr));
    }
}

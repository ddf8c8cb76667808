use dpges_core::scene::{
    BlendOrder, ColourModel, Footprint, GaussianData, MarginLookup, Rendering, SceneInfo, ScreenFilter, SurfelData,
};
use dpges_core::testing::ranks::on_ranks;

use super::*;
use crate::dataset::{BuiltinOptions, builtin};
use crate::device::DeviceName;
use crate::device::place::Place;
use crate::metrics::lpips::Weights;
use crate::views::exposure::Correction;

fn nothing(background: [f64; 3]) -> SceneData {
    let info = SceneInfo {
        colour_model: ColourModel::SphericalBeta { lobes: 0 },
        modulation: 30.0,
        layer_count: 2,
        footprint: Footprint::Kernel,
        backstop: false,
        margin_lookup: MarginLookup::Shifted,
        rendering: Rendering::Peeled,
        screen_filter: ScreenFilter::Compensated,
        blend_order: BlendOrder::Centres,
        weighted_sum: None,
        background,
        offset: [0.0; 3],
        extent: 1.0,
        near: 0.01,
    };
    SceneData { info, surfels: SurfelData::default(), gaussians: GaussianData::default(), environment: None }
}

#[test]
fn scores_are_those_of_eight_bit_pictures() {
    let options = BuiltinOptions { width: 12, height: 12, train_views: 2, test_views: 2, ..Default::default() };
    let mut views = builtin(&options).test;
    views[0].repaint(|picture| picture.bytes.fill(128)).unwrap();
    views[1].repaint(|picture| picture.bytes.fill(64)).unwrap();
    let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
    let evaluation = evaluate(&nothing([0.5; 3]), &views, &device).unwrap();
    assert_eq!(evaluation.views[0].psnr, LARGEST_PSNR, "0.5 and 128/255 are the same of 256 steps");
    let error = (128.0 - 64.0) / 255.0f64;
    assert!((evaluation.views[1].psnr + 20.0 * error.log10()).abs() < 1e-3);
    assert!((evaluation.views[0].ssim - 1.0).abs() < 1e-6 && evaluation.views[1].ssim < 1.0);
    assert_eq!(evaluation.psnr, (evaluation.views[0].psnr + evaluation.views[1].psnr) / 2.0);
    assert_eq!(evaluation.perceptual, Perceptual::default());
    assert!(evaluate(&nothing([0.0; 3]), &[], &device).unwrap_err().to_string().contains("views"));

    let picture = |value: u8| Rgb8Image { width: 12, height: 12, bytes: vec![value; 3 * 12 * 12] };
    let scored =
        |index: usize, value: u8| score_picture(&views[index], &picture(value), 0.0, &device, Measures::BASIC).unwrap();
    assert_eq!(scored(0, 128).psnr, LARGEST_PSNR);
    for (found, expected) in [(scored(1, 128), &evaluation.views[1]), (scored(0, 128), &evaluation.views[0])] {
        assert!((found.psnr - expected.psnr).abs() < 1e-4 && (found.ssim - expected.ssim).abs() < 1e-6);
        assert!((found.flip - expected.flip).abs() < 1e-6);
    }
    let narrow = Rgb8Image { width: 11, height: 12, bytes: vec![0; 3 * 11 * 12] };
    let refused = score_picture(&views[0], &narrow, 0.0, &device, Measures::BASIC).unwrap_err();
    assert!(refused.to_string().contains("picture"));
}

#[test]
fn what_does_not_count_is_in_no_score() {
    let options = BuiltinOptions { width: 32, height: 32, train_views: 2, test_views: 2, ..Default::default() };
    let mut views = builtin(&options).test;
    let counted: Vec<bool> = (0..32 * 32).map(|pixel| pixel % 32 < 20).collect();
    for (index, view) in views.iter_mut().enumerate() {
        let garbage = 255 * index as u8;
        let paint = |picture: &mut Picture| {
            picture.bytes = counted.iter().flat_map(|&counts| [if counts { 128 } else { garbage }; 3]).collect();
            picture.counted = Some(counted.clone());
        };
        view.repaint(paint).unwrap();
    }
    let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
    let scored = |value: f64| {
        let scene = nothing([value; 3]);
        let (renderer, measures) = (Renderer::new(&scene, &device), Measures::perceptual(&[]).fitted(true));
        let evaluation: Result<Evaluation> = evaluate_each(&renderer, &scene, &views, &device, measures, |_, _| Ok(()));
        evaluation.unwrap().views.iter().map(ViewScore::scores).collect::<Vec<_>>()
    };
    let [equal, darker] = [scored(0.5), scored(0.25)].map(|scores| [scores[0], scores[1]]);
    assert!(equal[0] == equal[1] && darker[0] == darker[1], "{equal:?} {darker:?}");
    assert_eq!((equal[0].psnr, equal[0].flip, equal[0].perceptual.ssimulacra2), (LARGEST_PSNR, 0.0, Some(100.0)));
    assert!((equal[0].ssim - 1.0).abs() < 1e-6 && darker[0].ssim < 1.0 && darker[0].flip > 0.0);
    assert!((darker[0].psnr + 20.0 * (64.0 / 255.0f64).log10()).abs() < 1e-3, "{darker:?}");
    assert_eq!(darker[0].fitted.psnr_fitted, Some(LARGEST_PSNR));
}

#[test]
fn perceptual_measures_are_those_of_the_same_pictures() {
    let options = BuiltinOptions { width: 32, height: 32, train_views: 2, test_views: 2, ..Default::default() };
    let mut views = builtin(&options).test;
    views[0].repaint(|picture| picture.bytes.fill(128)).unwrap();
    let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
    let weights = Weights::new(Network::Alex, |tensor| {
        (0..tensor.shape.iter().product::<usize>()).map(|i| (i * 37 % 101) as f32 / 1000.0).collect()
    });
    let networks = [Lpips::new(&weights, &device)];
    let scene = nothing([0.5; 3]);
    let renderer = Renderer::new(&scene, &device);
    let measures = Measures::perceptual(&networks);
    let evaluation: Result<Evaluation> = evaluate_each(&renderer, &scene, &views, &device, measures, |_, _| Ok(()));
    let evaluation = evaluation.unwrap();
    let equal = evaluation.views[0].perceptual;
    assert_eq!((equal.ms_ssim, equal.lpips_vgg), (None, None), "too small, and not asked for");
    assert_eq!((equal.ssimulacra2, equal.lpips_alex), (Some(100.0), Some(0.0)));
    let other = evaluation.views[1].perceptual;
    assert!(other.ssimulacra2.unwrap() < 100.0 && other.lpips_alex.unwrap() > 0.0);
    assert_eq!(evaluation.perceptual, Perceptual::mean(&[equal, other]));
    assert_eq!(evaluation.scores().perceptual, evaluation.perceptual);
}

#[test]
fn an_exposure_that_fits_the_left_half_is_applied_to_the_right() {
    let (width, height) = (17, 12);
    let change = Correction { gain: [0.5, 0.75, 1.25], offset: [0.25, 0.0, -0.125] };
    let shape = |values: Vec<f32>| {
        Tensor::<3>::from_data(TensorData::new(values, [3, height, width]), (&Device::flex(), DType::F32))
    };
    let values = (0..3 * height * width).map(|i| 0.2 + 0.6 * (i * 37 % 101) as f32 / 101.0).collect();
    let image = shape(values);
    let photograph = change.applied(image.clone());
    let both = fitted(&quantised(photograph.clone()), None, &image).unwrap();
    assert!(both.psnr_fitted.unwrap() > 50.0 && both.ssim_fitted.unwrap() > 0.999, "{both:?}");
    // the right half of another photograph: what the left half says of it is wrong
    let half = width / 2;
    let [left, right] = [0..half, half..width].map(|columns| [0..3, 0..height, columns]);
    let mixed = Tensor::cat(vec![photograph.slice(left), image.clone().slice(right)], 2);
    let wrong = fitted(&quantised(mixed), None, &image).unwrap();
    assert!(wrong.psnr_fitted.unwrap() < 25.0, "{wrong:?}");
    let narrow = image.slice([0..3, 0..height, 0..1]);
    assert_eq!(fitted(&narrow, None, &narrow).unwrap(), Fitted::default());
}

#[test]
fn pixels_that_do_not_count_are_neither_fitted_nor_judged() {
    let (width, height) = (17, 12);
    let change = Correction { gain: [0.5, 0.75, 1.25], offset: [0.25, 0.0, -0.125] };
    let shape = |values: Vec<f32>| {
        Tensor::<3>::from_data(TensorData::new(values, [3, height, width]), (&Device::flex(), DType::F32))
    };
    let values = (0..3 * height * width).map(|i| 0.2 + 0.6 * (i * 37 % 101) as f32 / 101.0).collect();
    let image = shape(values);
    // a column of each half is black
    let counted: Vec<bool> = (0..height * width).map(|pixel| ![3, 12].contains(&(pixel % width))).collect();
    let mut painted = tensor_to_rows(&change.applied(image.clone()));
    let planes = painted.iter_mut().zip(counted.iter().cycle());
    planes.filter(|(_, counts)| !**counts).for_each(|(value, _)| *value = 0.0);
    let photograph = quantised(shape(painted));
    let with_mask = fitted(&photograph, Some(&counted), &image).unwrap();
    assert!(with_mask.psnr_fitted.unwrap() > 50.0 && with_mask.ssim_fitted.unwrap() > 0.999, "{with_mask:?}");
    let without = fitted(&photograph, None, &image).unwrap();
    assert!(without.psnr_fitted.unwrap() < 25.0, "{without:?}");
    // nothing counts in one half
    for half in [0..width / 2, width / 2..width] {
        let counted: Vec<bool> = (0..height * width).map(|pixel| half.contains(&(pixel % width))).collect();
        assert_eq!(fitted(&photograph, Some(&counted), &image).unwrap(), Fitted::default());
    }
}

#[test]
fn fits_are_part_of_an_evaluation_if_they_are_wanted() {
    let options = BuiltinOptions { width: 12, height: 12, train_views: 2, test_views: 2, ..Default::default() };
    let mut views = builtin(&options).test;
    views[0].repaint(|picture| picture.bytes.fill(191)).unwrap();
    let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
    let scene = nothing([0.5; 3]);
    let renderer = Renderer::new(&scene, &device);
    let measured = |measures| -> Evaluation {
        let found: Result<Evaluation> = evaluate_each(&renderer, &scene, &views, &device, measures, |_, _| Ok(()));
        found.unwrap()
    };
    let plain = measured(Measures::BASIC);
    assert_eq!((plain.fitted, plain.deciding_psnr()), (Fitted::default(), plain.psnr));
    assert!(!serde_json::to_string(&plain).unwrap().contains("fitted"));
    let with = measured(Measures::BASIC.fitted(true));
    // a plain picture differs from a plain photograph by an offset
    assert!(with.views[0].psnr < 13.0 && with.views[0].fitted.psnr_fitted.unwrap() > 50.0);
    let mean = (0..2).map(|view| with.views[view].fitted.psnr_fitted.unwrap()).sum::<f64>() / 2.0;
    assert_eq!((with.fitted.psnr_fitted, with.deciding_psnr()), (Some(mean), mean));
    let json = serde_json::to_value(&with).unwrap();
    assert_eq!(json["psnr_fitted"].as_f64(), Some(mean));
    assert_eq!(serde_json::from_value::<Evaluation>(json).unwrap(), with);
}

#[test]
fn cameras_are_fitted_to_the_left_half_and_judged_by_the_right() {
    let options = BuiltinOptions { width: 16, height: 16, train_views: 2, test_views: 2, ..Default::default() };
    let mut views = builtin(&options).test;
    // nothing on the right counts
    views[1].repaint(|picture| picture.counted = Some((0..16 * 16).map(|pixel| pixel % 16 < 8).collect())).unwrap();
    let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
    let mut scene = nothing([0.5; 3]);
    let model = scene.info.colour_model;
    scene.gaussians = GaussianData::neutral(model, 1);
    let renderer = Renderer::new(&scene, &device);
    let measured = |views: &[View], measures| -> Evaluation {
        let found: Result<Evaluation> = evaluate_each(&renderer, &scene, views, &device, measures, |_, _| Ok(()));
        found.unwrap()
    };
    let found = measured(&views, Measures::BASIC.posed(true));
    let of = |view: usize| found.views[view].fitted;
    assert!(of(0).psnr_posed.is_some() && of(0).ssim_posed.is_some() && of(0).psnr_fitted.is_none());
    assert_eq!((of(1), found.fitted), (Fitted::default(), Fitted::default()));
    let json = serde_json::to_value(&found).unwrap();
    assert_eq!(json["views"][0]["psnr_posed"].as_f64(), of(0).psnr_posed);
    let both = measured(&views[..1], Measures::BASIC.fitted(true).posed(true)).fitted;
    assert!(both.psnr_posed.is_some() && both.psnr_posed != of(0).psnr_posed, "{both:?}");
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
    assert_eq!(report.evaluation.views[0].perceptual, Perceptual::default());
    let mut written = serde_json::to_value(&report).unwrap();
    assert_eq!(written, serde_json::from_str::<serde_json::Value>(&text).unwrap(), "nothing is added");
    written["lpips_vgg"] = 0.125.into();
    written["views"][0]["ssimulacra2"] = 60.5.into();
    let report: EvalReport = serde_json::from_value(written).unwrap();
    assert_eq!(report.evaluation.perceptual.lpips_vgg, Some(0.125));
    assert_eq!(report.evaluation.views[0].scores().perceptual.ssimulacra2, Some(60.5));
}

#[test]
fn views_are_dealt_out_to_ranks_and_all_get_the_scores() {
    let options = BuiltinOptions { width: 32, height: 24, train_views: 2, test_views: 5, ..Default::default() };
    let dataset = builtin(&options);
    let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
    let mut peeled = nothing([0.5; 3]);
    peeled.gaussians = GaussianData::neutral(ColourModel::SphericalBeta { lobes: 0 }, 3);
    peeled.gaussians.positions = vec![0.0, 0.0, 0.0, 0.3, 0.1, 0.0, -0.2, 0.2, 0.1];
    let info = SceneInfo { rendering: Rendering::Ellipsoids, ..peeled.info.clone() };
    let blended = SceneData { info, ..peeled.clone() };
    for scene in [peeled, blended] {
        let is_dealt = scene.info.rendering == Rendering::Peeled;
        let scores = |count: usize| {
            on_ranks(count, |ranks| {
                let (rank, place) = (ranks.rank(), Place { device: device.clone(), ranks });
                let renderer = Renderer::on_ranks(&scene, &place);
                let mut visited = Vec::new();
                let visit = |index: usize, _: &Rendered| -> Result<()> {
                    visited.push(index);
                    Ok(())
                };
                let found = evaluate_each(&renderer, &scene, &dataset.test, &device, Measures::perceptual(&[]), visit);
                assert!(visited.iter().copied().eq((rank..5).step_by(count)));
                found.unwrap()
            })
        };
        let alone = scores(1).remove(0);
        for found in scores(2).iter().chain(&scores(3)) {
            assert_eq!(found.views.len(), 5);
            for (found, alone) in found.views.iter().zip(&alone.views) {
                assert_eq!(found.name, alone.name);
                // sums of ranks round to another of 256 values here and there
                let most = if is_dealt { 0.05 } else { 1e-9 };
                assert!((found.psnr - alone.psnr).abs() < most, "{found:?}, alone {alone:?}");
                assert!((found.flip - alone.flip).abs() < most, "{found:?}, alone {alone:?}");
            }
            assert!((found.psnr - alone.psnr).abs() < 0.05);
        }
        assert!(alone.views.iter().any(|view| view.psnr != alone.psnr));
    }
}

use burn::tensor::{DType, Tensor};
use glam::DVec3;

use super::*;
use crate::losses::depth::surfel_depth;
use crate::ops::blend::{BlendOptions, Form};
use crate::ops::environment::environment;
use crate::ops::peel::PeelOptions;
use crate::render::blended::{BlendedOptions, render_blended};
use crate::render::summed::{SummedOptions, WeightedSumTensors, render_summed};
use crate::render::{RenderOptions, ViewRequest, render};
use crate::scene::{ColourModel, Peeling, WeightedSum};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;
use crate::testing::scenes::{Recipe, TestScene, random};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Peeled,
    Blended(Form),
    Summed,
}

const KINDS: [Kind; 3] = [Kind::Peeled, Kind::Blended(Form::Ellipsoids), Kind::Blended(Form::Discs)];

fn scene(seed: u64, kind: Kind, model: ColourModel) -> TestScene {
    let surfels = if kind == Kind::Peeled { 6 } else { 0 };
    random(seed, &Recipe { surfels, gaussians: 10, model, width: 21, height: 16, ..Recipe::default() })
}

/// The image and all else that losses compare, of `scene` from `camera`.
fn seen(scene: &TestScene, kind: Kind, camera: &Camera, probe: Option<&PoseProbe>) -> Vec<Tensor<3>> {
    let (surfels, gaussians) = scene.tensors(&device(), DType::F64);
    let view = ViewRequest { pose: probe, ..camera.into() };
    match kind {
        Kind::Peeled => {
            // shares of Gaussians between layers carry no gradient: they are steps here
            let peel = PeelOptions { peeling: Peeling::Nearest, ..PeelOptions::default() };
            let options = RenderOptions { peel, ..RenderOptions::default() };
            let rendered = render(&surfels, &gaussians, view, &options).unwrap();
            let depth = surfel_depth(&rendered)[0].clone();
            vec![rendered.composite.image, rendered.composite.surfel_image, depth]
        }
        Kind::Blended(form) => {
            let blend = BlendOptions { form, max_alpha: 0.9, maps: true, ..BlendOptions::default() };
            let options = BlendedOptions { blend, background: [0.2; 3] };
            let rendered = render_blended(&gaussians, view, &options).unwrap();
            vec![rendered.image, rendered.blend.maps.unwrap().depth]
        }
        Kind::Summed => {
            let sum = WeightedSum { sigma: 6.0, ..WeightedSum::default() };
            let common = WeightedSumTensors::new(&sum, &device(), DType::F64);
            let options = SummedOptions { weight: sum.weight, background: [0.2; 3], depth: true };
            let rendered = render_summed(&gaussians, &common, view, &options).unwrap();
            vec![rendered.image, rendered.depth.unwrap()]
        }
    }
}

/// Sum of all that is [seen], each number with a weight of its own.
fn loss(seen: Vec<Tensor<3>>) -> Tensor<1> {
    let weighted = seen.into_iter().enumerate().map(|(at, image)| {
        let shape = image.dims();
        let weights = Random::new(20 + at as u64).numbers(shape.iter().product(), -1.0, 1.0);
        (image * leaf(&weights, shape, &device()).detach()).sum()
    });
    weighted.reduce(|sum, term| sum + term).unwrap()
}

/// `camera` after a `motion`: a rotation vector and, where it has more numbers, a shift.
fn moved(camera: &Camera, motion: &[f64]) -> Camera {
    let shift = if motion.len() > 3 { DVec3::from_slice(&motion[3..]) } else { DVec3::ZERO };
    let pose = camera.camera_from_world.moved(DVec3::from_slice(&motion[..3]), shift);
    Camera { camera_from_world: pose, ..*camera }
}

/// Compares the gradients of poses with central differences of moved cameras: those of turns and, if `shifts`, of shifts.
fn check_poses(kind: Kind, model: ColourModel, shifts: bool) {
    let numbers = if shifts { 6 } else { 3 };
    let scenes: Vec<TestScene> = (0..4).map(|seed| scene(40 + seed, kind, model)).collect();
    let gradient = |scene: &TestScene| {
        let probe = PoseProbe::new(&scene.camera, &device(), DType::F64);
        let loss = loss(seen(scene, kind, &scene.camera, Some(&probe)));
        values(&probe.gradient(&mut loss.backward()).unwrap())[..numbers].to_vec()
    };
    let found: Vec<f64> = scenes.iter().flat_map(gradient).collect();
    let still = vec![0.0; found.len()];
    // small steps: when a camera moves, all footprints cross pixels
    check(&format!("poses of {kind:?} with {model}"), &still, &found, 2e-7, |motions| {
        let of_scenes = motions.chunks(numbers).zip(&scenes);
        let of_moved = |(motion, scene): (&[f64], &TestScene)| {
            values(&loss(seen(scene, kind, &moved(&scene.camera, motion), None)))[0]
        };
        of_scenes.filter(|(motion, _)| motion.iter().any(|&number| number != 0.0)).map(of_moved).sum()
    });
}

#[test]
fn the_gradient_of_a_pose_is_central_differences_of_a_moved_camera() {
    for kind in KINDS {
        check_poses(kind, ColourModel::SphericalBeta { lobes: 0 }, true);
    }
    check_poses(Kind::Summed, ColourModel::HarmonicsAndOpacity { degree: 0 }, true);
}

#[test]
fn colours_that_depend_on_directions_leave_the_gradient_of_a_turn_exact() {
    for kind in KINDS {
        for model in [ColourModel::SphericalBeta { lobes: 2 }, ColourModel::SphericalHarmonics { degree: 2 }] {
            check_poses(kind, model, false);
        }
    }
    check_poses(Kind::Summed, ColourModel::HarmonicsAndOpacity { degree: 2 }, false);
}

#[test]
fn a_probe_changes_no_bit_of_what_is_rendered() {
    for kind in KINDS {
        let scene = scene(7, kind, ColourModel::SphericalBeta { lobes: 1 });
        let probe = PoseProbe::new(&scene.camera, &device(), DType::F64);
        let with = seen(&scene, kind, &scene.camera, Some(&probe));
        let without = seen(&scene, kind, &scene.camera, None);
        for (with, without) in with.iter().zip(&without) {
            assert_eq!(values(with), values(without), "{kind:?}");
        }
    }
}

#[test]
fn the_gradient_of_a_turn_reaches_an_environment() {
    let camera = scene(5, Kind::Peeled, ColourModel::SphericalBeta { lobes: 0 }).camera;
    let motion = Random::new(6).numbers(6, -0.2, 0.2);
    for count in [4, 9, 16] {
        let coefficients = leaf(&Random::new(7).numbers(3 * count, -1.0, 1.0), [count, 3], &device()).detach();
        let here = moved(&camera, &motion);
        let probe = PoseProbe::new(&here, &device(), DType::F64);
        let with_probe = environment(&probe.environment(&coefficients), &here).unwrap();
        let plain = |camera: &Camera| environment(&coefficients, camera).unwrap();
        assert_eq!(values(&with_probe), values(&plain(&here)));
        let found = values(&probe.gradient(&mut loss(vec![with_probe]).backward()).unwrap());
        // small motions of the camera that stands where the motion has put it
        check(&format!("the turn before {count} coefficients"), &[0.0; 6], &found, 1e-5, |further| {
            values(&loss(vec![plain(&moved(&here, further))]))[0]
        });
    }
}

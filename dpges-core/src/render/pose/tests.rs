use burn::tensor::{DType, Tensor};
use glam::{DQuat, DVec3};

use super::*;
use crate::losses::depth::surfel_depth;
use crate::ops::blend::{BlendOptions, Form};
use crate::ops::environment::environment;
use crate::render::blended::{BlendedOptions, Probes, render_blended_probed};
use crate::render::{RenderOptions, Values, render_probed};
use crate::scene::ColourModel;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;
use crate::testing::scenes::{Recipe, TestScene, random};

/// The kind of scene that is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Peeled,
    Blended(Form),
}

const KINDS: [Kind; 3] = [Kind::Peeled, Kind::Blended(Form::Ellipsoids), Kind::Blended(Form::Discs)];

fn scene(seed: u64, kind: Kind, model: ColourModel) -> TestScene {
    let surfels = if kind == Kind::Peeled { 6 } else { 0 };
    random(seed, &Recipe { surfels, gaussians: 10, model, width: 21, height: 16, ..Recipe::default() })
}

/// The image and all else that losses compare, of `scene` from `camera`.
fn seen(scene: &TestScene, kind: Kind, camera: &Camera, probe: Option<&PoseProbe>) -> Vec<Tensor<3>> {
    let (surfels, gaussians) = scene.tensors(&device(), DType::F64);
    match kind {
        Kind::Peeled => {
            let options = RenderOptions::default();
            let rendered = render_probed(&surfels, &gaussians, camera, probe, &options, Values::Unknown).unwrap();
            let depth = surfel_depth(&rendered)[0].clone();
            vec![rendered.composite.image, rendered.composite.surfel_image, depth]
        }
        Kind::Blended(form) => {
            let blend = BlendOptions { form, max_alpha: 0.9, maps: true, ..BlendOptions::default() };
            let options = BlendedOptions { blend, background: [0.2; 3] };
            let probes = Probes { gaussians: None, pose: probe };
            let rendered = render_blended_probed(&gaussians, probes, camera, &options, Values::Unknown).unwrap();
            vec![rendered.image, rendered.blend.maps.unwrap().depth]
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
        let moved =
            motions.chunks(numbers).zip(&scenes).filter(|(motion, _)| motion.iter().any(|&number| number != 0.0));
        let of_moved = |(motion, scene): (&[f64], &TestScene)| {
            let turn = DVec3::from_slice(&motion[..3]);
            let shift = if shifts { DVec3::from_slice(&motion[3..]) } else { DVec3::ZERO };
            let pose = scene.camera.camera_from_world.moved(turn, shift);
            let camera = Camera { camera_from_world: pose, ..scene.camera };
            values(&loss(seen(scene, kind, &camera, None)))[0]
        };
        moved.map(of_moved).sum()
    });
}

#[test]
fn the_gradient_of_a_pose_is_central_differences_of_a_moved_camera() {
    for kind in KINDS {
        check_poses(kind, ColourModel::SphericalBeta { lobes: 0 }, true);
    }
}

#[test]
fn colours_that_depend_on_directions_leave_the_gradient_of_a_turn_exact() {
    for kind in KINDS {
        for model in [ColourModel::SphericalBeta { lobes: 2 }, ColourModel::SphericalHarmonics { degree: 2 }] {
            check_poses(kind, model, false);
        }
    }
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

/// `scene` in a world that a rigid motion x → `turn` · x + `shift` has moved.
fn moved_world(scene: &TestScene, turn: DQuat, shift: DVec3) -> TestScene {
    let positions = |rows: &mut Vec<f32>| {
        for row in rows.as_chunks_mut::<3>().0 {
            *row = (turn * DVec3::from_array(row.map(f64::from)) + shift).as_vec3().to_array();
        }
    };
    let quaternions = |rows: &mut Vec<f32>| {
        for row in rows.as_chunks_mut::<4>().0 {
            let [w, x, y, z] = row.map(f64::from);
            let moved = turn * DQuat::from_xyzw(x, y, z, w);
            *row = [moved.w, moved.x, moved.y, moved.z].map(|value| value as f32);
        }
    };
    let mut moved = scene.clone();
    positions(&mut moved.surfels.positions);
    positions(&mut moved.gaussians.positions);
    quaternions(&mut moved.surfels.quaternions);
    quaternions(&mut moved.gaussians.quaternions);
    moved
}

#[test]
fn the_gradient_of_a_turn_reaches_an_environment() {
    let camera = scene(5, Kind::Peeled, ColourModel::SphericalBeta { lobes: 0 }).camera;
    let motion = Random::new(6).numbers(6, -0.2, 0.2);
    let moved = |motion: &[f64]| {
        let (turn, shift) = (DVec3::from_slice(&motion[..3]), DVec3::from_slice(&motion[3..]));
        Camera { camera_from_world: camera.camera_from_world.moved(turn, shift), ..camera }
    };
    for count in [4, 9, 16] {
        let coefficients = leaf(&Random::new(7).numbers(3 * count, -1.0, 1.0), [count, 3], &device()).detach();
        let here = moved(&motion);
        let probe = PoseProbe::new(&here, &device(), DType::F64);
        let with_probe = environment(&probe.environment(&coefficients), &here).unwrap();
        let plain = |camera: &Camera| environment(&coefficients, camera).unwrap();
        assert_eq!(values(&with_probe), values(&plain(&here)));
        let found = values(&probe.gradient(&mut loss(vec![with_probe]).backward()).unwrap());
        // small motions of the camera that stands where the motion has put it
        check(&format!("the turn before {count} coefficients"), &[0.0; 6], &found, 1e-5, |further| {
            let (turn, shift) = (DVec3::from_slice(&further[..3]), DVec3::from_slice(&further[3..]));
            let camera = Camera { camera_from_world: here.camera_from_world.moved(turn, shift), ..here };
            values(&loss(vec![plain(&camera)]))[0]
        });
    }
}

#[test]
fn a_moved_camera_sees_what_the_camera_that_stays_sees_of_a_moved_world() {
    let (turn, shift) = (DVec3::new(0.03, -0.05, 0.02), DVec3::new(0.05, -0.02, 0.04));
    for kind in KINDS {
        // of the same colour from everywhere
        let scene = scene(11, kind, ColourModel::SphericalBeta { lobes: 0 });
        let camera = scene.camera;
        let pose = camera.camera_from_world.moved(turn, shift);
        // p → c + exp(−w) (p − c − t)
        let (back, centre) = (DQuat::from_scaled_axis(-turn), camera.centre());
        let world = moved_world(&scene, back, centre - back * (centre + shift));
        let by_camera = seen(&scene, kind, &Camera { camera_from_world: pose, ..camera }, None);
        let by_world = seen(&world, kind, &camera, None);
        let unmoved = seen(&scene, kind, &camera, None);
        for ((by_camera, by_world), unmoved) in by_camera.iter().zip(&by_world).zip(&unmoved) {
            let apart = |other: &Tensor<3>| -> f64 {
                values(by_camera).iter().zip(values(other)).map(|(a, b)| (a - b).abs()).sum()
            };
            // positions of the moved world are rounded to 32 bits
            assert!(apart(by_world) < 1e-3 * apart(unmoved), "{kind:?}: {} of {}", apart(by_world), apart(unmoved));
        }
    }
}

use burn::tensor::{DType, Tensor};

use super::{Alone, Ranks};
use crate::counters::transfers::uploaded;
use crate::ops::environment::environment;
use crate::render::pose::PoseProbe;
use crate::render::{RenderOptions, ViewRequest, render};
use crate::scene::schema::Columns;
use crate::scene::{Gaussians, Surfels};
use crate::testing::compare::relative_l2;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::random::Random;
use crate::testing::ranks::on_ranks;
use crate::testing::scenes::{Recipe, TestScene, random};

/// All numbers of a view of a scene.
#[derive(Clone, Debug, PartialEq)]
struct Seen {
    image: Vec<f64>,
    /// Gradients of all attributes of the surfels, by name.
    of_surfels: Vec<(&'static str, Vec<f64>)>,
    /// The same of own Gaussians.
    of_gaussians: Vec<(&'static str, Vec<f64>)>,
    /// Of the pose, added up over the ranks.
    of_pose: Vec<f64>,
}

const DEGREE_1: [usize; 2] = [4, 3];

fn scene() -> TestScene {
    random(7, &Recipe { surfels: 14, gaussians: 31, width: 23, height: 18, ..Recipe::default() })
}

/// The view of `scene` on one of `ranks`, which has every Gaussian whose row it is the turn of.
fn seen(scene: &TestScene, dtype: DType, ranks: &dyn Ranks) -> Seen {
    let device = device();
    let own: Vec<usize> = (ranks.rank()..scene.gaussians.len()).step_by(ranks.count()).collect();
    let gaussians = Gaussians::from_data(&scene.gaussians.select(&own), &device, dtype).require_grad();
    let surfels = Surfels::from_data(&scene.surfels, &device, dtype).require_grad();
    let probe = PoseProbe::new(&scene.camera, &device, dtype);
    let probe = if ranks.is_first() { probe } else { probe.of_gaussians() };
    let options = RenderOptions::default();
    let camera = &scene.camera;
    let view = ViewRequest { pose: Some(&probe), ranks, ..camera.into() };
    let rendered = render(&surfels, &gaussians, view, &options).unwrap();
    let coefficients = numbers(3, DEGREE_1, dtype);
    let rendered = rendered.in_front_of(environment(&probe.environment(&coefficients), camera).unwrap());
    let image = rendered.composite.image;
    let weights = numbers(4, image.dims(), dtype);
    let mut gradients = (image.clone() * weights).sum().backward();
    let mut of = |tensors: Vec<(&'static str, Tensor<2>)>| {
        tensors
            .into_iter()
            .filter_map(|(name, tensor)| Some((name, values(&tensor.grad_remove(&mut gradients)?))))
            .collect()
    };
    let of_surfels = of(surfels.iter().map(|(attribute, tensor)| (attribute.name, tensor.clone())).collect());
    let of_gaussians = of(gaussians.iter().map(|(attribute, tensor)| (attribute.name, tensor.clone())).collect());
    // nothing reaches the pose of a rank without a Gaussian
    let mut of_pose = probe.gradient(&mut gradients).map_or_else(|| vec![0.0; 6], |gradient| values(&gradient));
    ranks.add_up(&mut of_pose);
    Seen { image: values(&image), of_surfels, of_gaussians, of_pose }
}

fn numbers<const D: usize>(seed: u64, shape: [usize; D], dtype: DType) -> Tensor<D> {
    let numbers = Random::new(seed).numbers(shape.iter().product(), -1.0, 1.0);
    uploaded(numbers, shape, &device(), dtype)
}

/// The gradients of all Gaussians, sharded row by row over the ranks of `parts`.
fn sharded_together(parts: &[Seen], count: usize) -> Vec<(&'static str, Vec<f64>)> {
    let names: Vec<&'static str> = parts[0].of_gaussians.iter().map(|(name, _)| *name).collect();
    let of = |(at, name): (usize, &'static str)| {
        let width = parts.iter().map(|part| part.of_gaussians[at].1.len()).sum::<usize>() / count;
        let row =
            |row: usize| parts[row % parts.len()].of_gaussians[at].1[row / parts.len() * width..][..width].to_vec();
        (name, (0..count).flat_map(row).collect())
    };
    names.into_iter().enumerate().map(of).collect()
}

#[test]
fn pictures_and_gradients_do_not_depend_on_the_number_of_ranks() {
    let scene = scene();
    for (dtype, most) in [(DType::F64, 1e-12), (DType::F32, 2e-4)] {
        let whole = seen(&scene, dtype, &Alone);
        assert!(whole.of_gaussians.len() > 4 && whole.of_surfels.len() > 3);
        for count in [1, 2, 3] {
            let parts = on_ranks(count, |ranks| seen(&scene, dtype, &*ranks));
            let of_gaussians = sharded_together(&parts, scene.gaussians.len());
            for part in &parts {
                // replicated: the same bits everywhere
                assert_eq!(
                    (&part.image, &part.of_surfels, &part.of_pose),
                    (&parts[0].image, &parts[0].of_surfels, &parts[0].of_pose)
                );
            }
            let near = |what: &str, found: &[f64], expected: &[f64]| {
                let apart = relative_l2(found, expected);
                assert!(apart <= most, "{what} of {count} ranks in {dtype:?}: {apart:e}");
            };
            near("image", &parts[0].image, &whole.image);
            near("pose", &parts[0].of_pose, &whole.of_pose);
            for (found, expected) in
                parts[0].of_surfels.iter().chain(&of_gaussians).zip(whole.of_surfels.iter().chain(&whole.of_gaussians))
            {
                assert_eq!(found.0, expected.0);
                near(found.0, &found.1, &expected.1);
            }
        }
    }
}

#[test]
fn two_ranks_give_the_same_bytes_twice() {
    let scene = scene();
    let run = || on_ranks(2, |ranks| seen(&scene, DType::F32, &*ranks));
    assert_eq!(run(), run());
}

#[test]
fn more_ranks_than_gaussians_are_enough_for_them() {
    let mut scene = scene();
    scene.gaussians = scene.gaussians.select(&[0, 1]);
    let whole = seen(&scene, DType::F64, &Alone);
    let parts = on_ranks(3, |ranks| seen(&scene, DType::F64, &*ranks));
    assert!(relative_l2(&parts[2].image, &whole.image) < 1e-12);
    assert!(relative_l2(&parts[2].of_pose, &whole.of_pose) < 1e-12);
}

#[test]
fn numbers_are_gathered_and_added_up_in_the_order_of_the_ranks() {
    let found = on_ranks(3, |ranks| {
        let rank = ranks.rank();
        let mut sums = [rank as f64, 1.0];
        ranks.add_up(&mut sums);
        let all = ranks.gather_numbers(&vec![rank as f32; rank]);
        (sums, all, ranks.any(rank == 2), ranks.any(false), ranks.of_first(vec![rank as f64]))
    });
    for (sums, all, any, none, first) in found {
        assert_eq!((sums, any, none, first), ([3.0, 3.0], true, false, vec![0.0]));
        assert_eq!(all, [vec![], vec![1.0], vec![2.0, 2.0]]);
    }
    let alone: &dyn Ranks = &Alone;
    assert_eq!(alone.gather_numbers(&[1.0f32]), [[1.0]]);
    assert!(alone.any(true) && !alone.any(false));
}

#[test]
#[should_panic = "rank 1 is gone"]
fn a_rank_that_is_gone_ends_the_others() {
    on_ranks(2, |ranks| {
        if ranks.is_first() {
            ranks.gather(&[]);
        }
    });
}

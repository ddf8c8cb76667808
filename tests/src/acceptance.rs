//! The paper's claims about its pictures, each on a scene where it can be seen.

use burn::tensor::{DType, Tensor, TensorData};
use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::losses;
use dpges_core::ops::composite::{CompositeOptions, composite};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::ops::visibility::visibility;
use dpges_core::render::{Render, RenderOptions, render};
use dpges_core::scene::{ColourData, ColourModel, Footprint, GaussianData, Peeling, SurfelData};
use dpges_core::testing::golden::values;
use dpges_core::testing::scenes::{Recipe, TestScene, random};
use glam::DVec3;

use crate::devices::flex;
use crate::large;

const BACKGROUND: [f64; 3] = [0.25, 0.5, 0.75];

fn rendered(scene: &TestScene, peel: PeelOptions) -> Render {
    let (surfels, gaussians) = scene.tensors(&flex(), DType::F64);
    let options = RenderOptions { peel, background: BACKGROUND, ..RenderOptions::default() };
    render(&surfels, &gaussians, &scene.camera, &options).unwrap()
}

fn options(layer_count: usize, modulation: f64, footprint: Footprint) -> PeelOptions {
    PeelOptions { layer_count, modulation, footprint, peeling: Peeling::Nearest }
}

/// At w = 255 every fragment is opaque: the nearest surfel, and the Gaussians in front of it, are all there is (GES).
#[test]
fn fully_modulated_surfels_render_as_ges() {
    let scene = random(5, &Recipe { surfels: 60, gaussians: 150, width: 41, height: 33, ..Recipe::default() });
    let three = rendered(&scene, options(3, 255.0 * (1.0 + 1e-12), Footprint::Kernel));
    let one = rendered(&scene, options(1, 255.0 * (1.0 + 1e-12), Footprint::Kernel));
    assert!(values(&three.layers.alpha).iter().all(|alpha| *alpha == 0.0 || *alpha == 1.0));
    assert_eq!(values(&three.composite.image), values(&one.composite.image));
    let ids: Vec<i64> = three.layers.ids.clone().into_data().iter::<i64>().collect();
    let plane = scene.camera.width * scene.camera.height;
    assert!(ids[plane..].iter().all(|id| *id == -1));
    let covered = ids[..plane].iter().filter(|id| **id >= 0).count();
    assert!(covered > plane / 2 && covered < plane, "{covered} of {plane}");
    // (c_nearest + Σ α c) / (1 + Σ α), the sums over what lies in front
    let colours = values(&three.surfel_colours);
    let composite = &three.composite;
    let (image, sums, weight) =
        (values(&composite.image), values(&composite.gaussian_colour), values(&composite.gaussian_weight));
    for at in 0..plane {
        for c in 0..3 {
            let surfel = usize::try_from(ids[at]).map_or(BACKGROUND[c], |id| colours[3 * id + c]);
            let expected = (surfel + sums[c * plane + at]) / (1.0 + weight[at]);
            approx::assert_relative_eq!(image[c * plane + at], expected, epsilon = 1e-12);
        }
    }
    // Gaussians moved far behind change nothing where a surfel is
    let mut pushed = scene.clone();
    let forward = scene.camera.camera_from_world.rotation.transpose() * DVec3::Z;
    let behind = (scene.camera.centre() + forward * 50.0).as_vec3().to_array();
    pushed.gaussians.positions.chunks_mut(3).for_each(|p| p.copy_from_slice(&behind));
    pushed.gaussians.log_scales.fill(3.0);
    let pushed = rendered(&pushed, options(3, 255.0 * (1.0 + 1e-12), Footprint::Kernel));
    let (weight, surfel_image) = (values(&pushed.composite.gaussian_weight), values(&pushed.composite.surfel_image));
    let image = values(&pushed.composite.image);
    for at in 0..plane {
        assert_eq!(weight[at] == 0.0, ids[at] >= 0, "pixel {at}");
        assert!(ids[at] < 0 || (0..3).all(|c| image[c * plane + at] == surfel_image[c * plane + at]));
    }
}

fn facing_camera(size: usize) -> Camera {
    let pose = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -5.0), DVec3::ZERO, DVec3::NEG_Y);
    let focal = 4.0 * size as f64;
    Camera { camera_from_world: pose, fx: focal, fy: focal, near: 0.2, ..large::camera(size, size) }
}

/// Discs that face the camera, 3 σ beside its axis, at these depths; no two of one colour.
fn rims(depths: &[f64], size: usize) -> TestScene {
    let count = depths.len();
    let beside = |depth: &f64| [3.0, 0.0, (depth - 5.0) as f32];
    let base = (0..3 * count).map(|i| (i as f32 * 0.7).sin()).collect();
    let surfels = SurfelData {
        positions: depths.iter().flat_map(beside).collect(),
        colour: ColourData { base, ..ColourData::default() },
        ..SurfelData::neutral(ColourModel::default(), count)
    };
    TestScene { surfels, gaussians: GaussianData::default(), camera: facing_camera(size) }
}

#[test]
fn a_fourth_rim_is_ignored_and_the_transmittance_loss_opens_the_other_three() {
    let (four, three) = (rims(&[4.0, 5.0, 6.0, 7.0], 1), rims(&[4.0, 5.0, 6.0], 1));
    let peel = options(3, 30.0, Footprint::Kernel);
    let render = rendered(&four, peel);
    assert_eq!(render.layers.ids.clone().into_data().iter::<i64>().collect::<Vec<_>>(), [0, 1, 2]);
    let image = values(&render.composite.image);
    assert_eq!(image, values(&rendered(&three, peel).composite.image));
    let (alpha, colours) = (values(&render.layers.alpha), values(&render.surfel_colours));
    assert!(alpha.iter().all(|a| *a > 0.1 && *a < 0.9), "{alpha:?}");
    let [a, b, c] = [alpha[0], alpha[1], alpha[2]];
    for (channel, found) in image.iter().enumerate() {
        let of = |i: usize| colours[3 * i + channel];
        let expected = a * of(0)
            + b * (1.0 - a) * of(1)
            + c * (1.0 - a) * (1.0 - b) * of(2)
            + (1.0 - a) * (1.0 - b) * (1.0 - c) * BACKGROUND[channel];
        approx::assert_relative_eq!(*found, expected, epsilon = 1e-14);
    }
    // ∂L_t/∂A_i ≥ 0: descent lowers every opacity
    let device = flex().autodiff();
    let opacity = Tensor::<3>::from_data(render.layers.alpha.clone().into_data(), (&device, DType::F64)).require_grad();
    let on_tape = |tensor: &Tensor<3>| Tensor::<3>::from_data(tensor.clone().into_data(), (&device, DType::F64));
    let mut layers = render.layers.clone();
    layers.ids = Tensor::from_data(render.layers.ids.clone().into_data(), &device);
    (layers.alpha, layers.depth) = (opacity.clone(), on_tape(&render.layers.depth));
    let seen = visibility(&layers, &Tensor::zeros([4, 1], (&device, DType::F64)), Peeling::Nearest).unwrap();
    let colours = Tensor::<2>::from_data(render.surfel_colours.clone().into_data(), (&device, DType::F64));
    let sums = Tensor::<4>::zeros([3, 4, 1, 1], (&device, DType::F64));
    let blending = CompositeOptions { background: BACKGROUND, detach_transmittance: false };
    let composite = composite(&layers, &seen, &colours, &sums, &blending).unwrap();
    let view = Render { composite, layers, seen, surfel_colours: colours.clone(), gaussian_colours: colours };
    let gradient = values(&opacity.grad(&losses::transmittance(&view).backward()).unwrap());
    let open = (1.0 - a) * (1.0 - b) * (1.0 - c);
    for (mask, expected) in [(1.0, 1.0 - open), (0.0, 0.0)] {
        let mask = Tensor::<3>::from_data(TensorData::new(vec![mask], [1, 1, 1]), (&device, DType::F64));
        approx::assert_relative_eq!(values(&losses::hidden(&view, mask))[0], expected, epsilon = 1e-14);
    }
    for (found, own) in gradient.iter().zip([a, b, c]) {
        approx::assert_relative_eq!(*found, 2.0 * (1.0 - open) * open / (1.0 - own), epsilon = 1e-12);
    }
}

/// The largest change of a value between two of `steps` frames while the camera moves sideways from outside two discs to
/// where they are opaque, and the range of all values.
fn changes_across_a_rim(footprint: Footprint, steps: usize) -> (f64, f64) {
    let mut scene = rims(&[5.0, 6.0], 9);
    scene.gaussians = GaussianData {
        positions: vec![0.0, 0.0, -0.8, 0.1, 0.0, 0.5, 0.0, 0.1, 2.5],
        log_scales: vec![-1.0; 9],
        opacities: vec![0.8, 0.9, 1.2],
        colour: ColourData { base: vec![1.5, -1.0, 0.2, -1.2, 0.8, 1.0, 0.3, 1.4, -1.4], ..ColourData::default() },
        ..GaussianData::neutral(ColourModel::default(), 3)
    };
    let frame = |step: usize| {
        let mut scene = scene.clone();
        scene.camera.camera_from_world.translation.x -= 1.5 * (step as f64 / steps as f64) - 0.5;
        values(&rendered(&scene, options(3, 30.0, footprint)).composite.image)
    };
    let frames: Vec<Vec<f64>> = (0..=steps).map(frame).collect();
    let change = |pair: &[Vec<f64>]| pair[0].iter().zip(&pair[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let range = frames.iter().flatten().fold([f64::MAX, f64::MIN], |[low, high], &v| [low.min(v), high.max(v)]);
    (frames.windows(2).map(change).fold(0.0, f64::max), range[1] - range[0])
}

/// With the footprint by opacity, the picture changes by no more than the camera's step allows.
#[test]
fn a_camera_moves_across_a_rim_that_fades_out_without_a_jump() {
    let ((coarse, _), (fine, _)) =
        (changes_across_a_rim(Footprint::Opacity, 100), changes_across_a_rim(Footprint::Opacity, 800));
    // what remains is the footprint's own end, a step of 1/255 in opacity
    assert!(coarse > 0.01 && fine < coarse / 8.0 + 2.0 / 255.0 && fine < coarse / 2.0, "{coarse} {fine}");
}

/// With the footprint that is the default, the rim ends in a step of w/255 in opacity: what is behind shows through by as
/// much less, at once. It is an edge in the picture that moves with the surfel, not a change of order.
#[test]
fn the_default_rim_ends_in_one_step_of_its_opacity() {
    let footprint = Footprint::default();
    let (fine, range) = changes_across_a_rim(footprint, 800);
    let step = 30.0 / 255.0;
    assert_eq!(footprint, Footprint::Kernel);
    assert!(fine < step * range + 2.0 / 255.0, "{fine} of {range}");
    assert!(fine > 0.1 * step * range, "{fine} of {range}: if the step is gone, say so in the documents");
}

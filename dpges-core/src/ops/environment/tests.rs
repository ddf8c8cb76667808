use burn::tensor::{DType, Tensor};
use glam::DVec3;

use super::environment;
use crate::camera::{Camera, CameraFromWorld, Distortion, Lens, Projection};
use crate::ops::colour::colour;
use crate::ops::fixtures::{assert_near, weights};
use crate::render::blended::{BlendedOptions, render_blended};
use crate::render::{RenderOptions, render};
use crate::scene::{Colour, ColourModel, Rendering, SceneInfo};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::lenses::{behind, every_model};
use crate::testing::random::Random;
use crate::testing::scenes::{self, Recipe};

const COUNTS: [usize; 4] = [1, 4, 9, 16];

fn camera() -> Camera {
    let camera_from_world = CameraFromWorld::look_at(DVec3::new(1.0, -3.0, 2.0), DVec3::ZERO, DVec3::Z);
    Camera { camera_from_world, fx: 9.0, fy: 11.0, cx: 5.5, cy: 3.0, width: 13, height: 9, near: 0.01, lens: None }
}

fn image(coefficients: &[f64], camera: &Camera) -> Vec<f64> {
    let count = coefficients.len() / 3;
    values(&environment(&leaf(coefficients, [count, 3], &device()), camera).unwrap())
}

#[test]
fn a_pixel_shows_what_the_colour_model_gives_a_primitive_on_its_ray() {
    let mut cameras = vec![camera()];
    cameras.extend(every_model().map(|(_, lens)| behind(camera(), lens, 150.0)));
    for (camera, degree) in cameras.iter().flat_map(|camera| (0..=3).map(move |degree| (camera, degree))) {
        let count = (degree + 1) * (degree + 1);
        let coefficients = Random::new(1).numbers(3 * count, -1.0, 1.0);
        let found = image(&coefficients, camera);
        let pixels: Vec<(usize, usize)> =
            (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y))).collect();
        let far: Vec<f64> = pixels
            .iter()
            .flat_map(|&(x, y)| camera.unproject(x as f64 + 0.5, y as f64 + 0.5, 7.0).to_array())
            .collect();
        let device = device();
        let model = ColourModel::SphericalHarmonics { degree };
        let of_all = |row: &[f64]| leaf(&row.repeat(pixels.len()), [pixels.len(), row.len()], &device);
        let primitives = Colour::new(model, of_all(&coefficients[..3]), of_all(&coefficients[3..]));
        let positions = leaf(&far, [pixels.len(), 3], &device);
        let expected = values(&colour(&primitives, &positions, camera.centre().to_array()).unwrap());
        for pixel in 0..pixels.len() {
            for channel in 0..3 {
                let (found, expected) = (found[channel * pixels.len() + pixel], expected[3 * pixel + channel] - 0.5);
                approx::assert_relative_eq!(found, expected, epsilon = 1e-12);
            }
        }
    }
}

#[test]
fn pixels_without_a_ray_show_nothing() {
    let fold = Distortion { numerator: [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0], ..Distortion::new(Projection::Perspective) };
    let camera = Camera { lens: Some(Lens::new(fold)), ..camera() };
    let found = image(&[1.0, 1.0, 1.0], &camera);
    for (at, value) in found.iter().enumerate().take(camera.width * camera.height) {
        let (x, y) = ((at % camera.width) as f64 + 0.5, (at / camera.width) as f64 + 0.5);
        assert_eq!(*value != 0.0, camera.ray(x, y).is_some(), "({x}, {y})");
    }
    assert!(found.contains(&0.0) && found.iter().any(|&value| value > 0.0));
}

#[test]
fn gradients_are_central_differences() {
    let [.., (_, fisheye), _, _] = every_model();
    for (camera, count) in
        [camera(), behind(camera(), fisheye, 170.0)].into_iter().flat_map(|camera| COUNTS.map(|count| (camera, count)))
    {
        let coefficients = Random::new(3).numbers(3 * count, -1.0, 1.0);
        let at = leaf(&coefficients, [count, 3], &device());
        let out = environment(&at, &camera).unwrap();
        let weights = Random::new(4).numbers(3 * camera.width * camera.height, -1.0, 1.0);
        let upstream = leaf(&weights, out.dims(), &device()).detach();
        let found = values(&at.grad(&(out * upstream).sum().backward()).unwrap());
        check(&format!("{count} coefficients"), &coefficients, &found, 1e-4, |moved| {
            image(moved, &camera).iter().zip(&weights).map(|(a, b)| a * b).sum()
        });
    }
}

#[test]
fn coefficients_of_no_degree_are_refused_by_name() {
    for shape in [[0, 3], [5, 3], [25, 3], [4, 4]] {
        let coefficients = Tensor::<2>::zeros(shape, (&device(), DType::F32));
        let error = environment(&coefficients, &camera()).unwrap_err().to_string();
        assert!(error.contains("`environment`") && error.contains("degree"), "{error}");
    }
}

fn small() -> scenes::TestScene {
    scenes::random(8, &Recipe { surfels: 12, gaussians: 20, width: 14, height: 10, ..Recipe::default() })
}

/// An environment of one colour is a background of that colour, in every image and for every gradient.
#[test]
fn a_constant_environment_is_a_background() {
    let scene = small();
    let sky = [0.3, 0.6, -0.2];
    let coefficients: Vec<f64> = sky.iter().map(|c| c / crate::scene::SH_C0).collect();
    let device = device();
    let behind = || environment(&leaf(&coefficients, [1, 3], &device), &scene.camera).unwrap();
    let near = |found: &[f64], expected: &[f64]| assert_near(found, expected, 1e-11);

    let of = |in_front: bool| {
        let (surfels, gaussians) = scene.leaves(&device, DType::F64);
        let background = if in_front { [0.0; 3] } else { sky };
        let options = RenderOptions { background, ..RenderOptions::default() };
        let view = render(&surfels, &gaussians, &scene.camera, &options).unwrap();
        let view = if in_front { view.in_front_of(behind()) } else { view }.composite;
        let weights = Random::new(5).numbers(2 * 3 * 140, -1.0, 1.0);
        let [a, b] = [&weights[..420], &weights[420..]].map(|w| leaf(w, [3, 10, 14], &device).detach());
        let gradients = (view.image.clone() * a + view.surfel_image.clone() * b).sum().backward();
        let of = |tensor: &Tensor<2>| tensor.grad(&gradients).map_or_else(Vec::new, |g| values(&g));
        let leaves = [&surfels.positions, &surfels.log_scales, &gaussians.positions, &gaussians.opacities];
        [vec![values(&view.image), values(&view.surfel_image)], leaves.map(of).to_vec()].concat()
    };
    of(true).iter().zip(of(false)).for_each(|(found, expected)| near(found, &expected));

    let of = |in_front: bool| {
        let (_, gaussians) = scene.leaves(&device, DType::F64);
        let background = if in_front { [0.0; 3] } else { sky };
        let info = SceneInfo { rendering: Rendering::Ellipsoids, background, ..SceneInfo::default() };
        let options = BlendedOptions::new(&info).unwrap();
        let view = render_blended(&gaussians, &scene.camera, &options).unwrap();
        let view = if in_front { view.in_front_of(behind()) } else { view };
        let gradients = (view.image.clone() * view.image.clone()).sum().backward();
        let of = |tensor: &Tensor<2>| values(&tensor.grad(&gradients).unwrap());
        vec![values(&view.image), of(&gaussians.positions), of(&gaussians.opacities)]
    };
    of(true).iter().zip(of(false)).for_each(|(found, expected)| near(found, &expected));
}

#[test]
fn gradients_reach_the_environment_of_a_rendered_view() {
    let scene = small();
    let device = device();
    let coefficients = Random::new(6).numbers(48, -1.0, 1.0);
    let weights = weights(7, [3, 10, 14]);
    let (surfels, gaussians) = scene.leaves(&device, DType::F64);
    let loss = |coefficients: &Tensor<2>| {
        let view = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap();
        let view = view.in_front_of(environment(coefficients, &scene.camera).unwrap()).composite;
        ((view.image + view.surfel_image) * weights.clone()).sum()
    };
    let at = leaf(&coefficients, [16, 3], &device);
    let found = values(&at.grad(&loss(&at).backward()).unwrap());
    assert!(found.iter().any(|g| g.abs() > 1e-3));
    check("the environment", &coefficients, &found, 1e-4, |moved| values(&loss(&leaf(moved, [16, 3], &device)))[0]);
}

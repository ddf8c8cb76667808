use burn::tensor::{DType, Tensor};
use glam::{DQuat, DVec3};

use super::{
    GeometryWeights, Supervision, expected_depth, geometry, in_camera_axes, normal_consistency, normals_from_depth,
};
use crate::camera::{Camera, CameraFromWorld, Lens};
use crate::ops::fixtures::{
    self, SURFEL_NAMES, SURFEL_WIDTHS, assert_near, check_rows, constant, surfel_rows, weights,
};
use crate::ops::peel::PeelOptions;
use crate::render::{RenderOptions, render};
use crate::scene::{ColourModel, Footprint, Peeling, Surfels};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check_elements, leaf};
use crate::testing::lenses::every_model;
use crate::testing::random::Random;
use crate::testing::scenes::{self, Recipe, TestScene};

/// In the world's axes; the principal point is far from the centre of the image.
fn axis_camera() -> Camera {
    Camera { fx: 40.0, fy: 55.0, cx: 3.2, cy: 9.1, width: 13, height: 11, near: 0.1, ..fixtures::axis_camera() }
}

fn pixel_count(camera: &Camera) -> usize {
    camera.width * camera.height
}

/// Point at `depth` on the ray through the centre of pixel `at`.
fn point(camera: &Camera, at: usize, depth: f64) -> DVec3 {
    camera.unproject((at % camera.width) as f64 + 0.5, (at / camera.width) as f64 + 0.5, depth)
}

fn is_border(camera: &Camera, at: usize) -> bool {
    let (x, y) = (at % camera.width, at / camera.width);
    x == 0 || y == 0 || x + 1 == camera.width || y + 1 == camera.height
}

fn depth_image(camera: &Camera, depth: &[f64]) -> Tensor<3> {
    constant(depth, [1, camera.height, camera.width])
}

/// Checks the normals of an image of depths pixel by pixel.
fn assert_normals(camera: &Camera, depth: &[f64], tolerance: f64, expected: impl Fn(usize) -> DVec3) {
    let found = values(&normals_from_depth(depth_image(camera, depth), camera));
    let count = pixel_count(camera);
    assert_eq!(found.len(), 3 * count);
    for at in 0..count {
        let normal = DVec3::new(found[at], found[count + at], found[2 * count + at]);
        let expected = if is_border(camera, at) { DVec3::ZERO } else { expected(at) };
        assert!((normal - expected).length() <= tolerance, "{normal} at pixel {at}, expected {expected}");
    }
}

/// Depths of a plane with a normal.
fn plane(camera: &Camera, towards: DVec3) -> Vec<f64> {
    (0..pixel_count(camera)).map(|at| -2.0 / towards.dot(point(camera, at, 1.0))).collect()
}

/// Compares the gradient of a weighted sum of the normals with respect to depths above 0 with central differences.
fn check_gradient(name: &str, camera: &Camera, depths: &[f64], seed: u64) {
    let weights = weights(seed, [3, camera.height, camera.width]);
    let loss = |depth: Tensor<3>| (normals_from_depth(depth, camera) * weights.clone()).sum();
    let at = leaf(depths, [1, camera.height, camera.width], &device());
    let found = values(&at.grad(&loss(at.clone()).backward()).unwrap());
    let elements: Vec<usize> = (0..depths.len()).filter(|&pixel| depths[pixel] > 0.0).collect();
    check_elements(name, depths, &found, &elements, 1e-6, |moved| values(&loss(depth_image(camera, moved)))[0]);
}

#[test]
fn planes_have_their_normal_towards_the_camera() {
    let camera = axis_camera();
    for towards in [DVec3::NEG_Z, DVec3::new(0.5, -0.3, -1.0).normalize(), DVec3::new(-0.2, 0.6, -0.9).normalize()] {
        assert_normals(&camera, &plane(&camera, towards), 1e-12, |_| towards);
    }
}

#[test]
fn planes_have_their_normal_towards_the_camera_through_lenses_too() {
    for (name, lens) in every_model() {
        let camera = Camera { lens: Some(Lens::new(lens)), ..axis_camera() };
        let towards = DVec3::new(0.3, -0.2, -1.0).normalize();
        let mut depths = plane(&camera, towards);
        assert_normals(&camera, &depths, 1e-11, |_| towards);
        // with neighbours at the camera's centre, and with none
        depths[4 * camera.width + 5] = 0.0;
        depths[7 * camera.width + 4] = 0.0;
        depths[7 * camera.width + 6] = 0.0;
        check_gradient(name, &camera, &depths, 11);
    }
}

#[test]
fn spheres_have_their_normal_to_within_the_size_of_a_pixel_squared() {
    let camera = Camera { fx: 100.0, fy: 120.0, ..axis_camera() };
    let centre = DVec3::new(0.05, 0.1, 4.0);
    let depth = |at| {
        let ray = point(&camera, at, 1.0);
        let (along, squared) = (ray.dot(centre), ray.length_squared());
        (along - (along * along - squared * (centre.length_squared() - 1.0)).sqrt()) / squared
    };
    let depths: Vec<f64> = (0..pixel_count(&camera)).map(depth).collect();
    assert_normals(&camera, &depths, 1e-3, |at| point(&camera, at, depths[at]) - centre);
}

#[test]
fn normals_are_the_cross_product_of_central_differences_also_beside_missing_depths() {
    let camera = axis_camera();
    let mut depths = Random::new(4).numbers(pixel_count(&camera), 1.0, 3.0);
    // single pixels, and the lower part of the image
    for (at, depth) in depths.iter_mut().enumerate() {
        if at.is_multiple_of(5) || at / camera.width >= 7 {
            *depth = 0.0;
        }
    }
    assert_normals(&camera, &depths, 1e-10, |at| {
        let difference =
            |step: usize| point(&camera, at + step, depths[at + step]) - point(&camera, at - step, depths[at - step]);
        difference(camera.width).cross(difference(1)).normalize_or_zero()
    });
}

#[test]
fn images_without_interior_have_no_normals() {
    for (width, height) in [(2, 5), (5, 2), (1, 1)] {
        let camera = Camera { width, height, ..axis_camera() };
        assert_normals(&camera, &vec![2.0; width * height], 0.0, |_| DVec3::NEG_Z);
    }
}

#[test]
fn the_gradient_of_normals_from_depth_is_central_differences() {
    let camera = Camera { width: 7, height: 6, ..axis_camera() };
    let depths = Random::new(5).numbers(pixel_count(&camera), 1.0, 3.0);
    check_gradient("normals from depth", &camera, &depths, 6);
}

#[test]
fn a_lone_depth_has_no_normals_around_it_and_no_gradient() {
    let camera = Camera { width: 7, height: 6, ..axis_camera() };
    let mut depths = vec![0.0; pixel_count(&camera)];
    depths[2 * camera.width + 3] = 2.0;
    let depth = leaf(&depths, [1, 6, 7], &device());
    let normals = normals_from_depth(depth.clone(), &camera);
    assert!(values(&normals).iter().all(|n| *n == 0.0));
    let gradient = values(&depth.grad(&normals.sum().backward()).unwrap());
    assert!(gradient.iter().all(|g| *g == 0.0), "{gradient:?}");
}

#[test]
fn expected_depth_is_0_without_gradient_where_nothing_is() {
    let sum = leaf(&[3.0, 0.0, 0.5], [1, 1, 3], &device());
    let alpha = leaf(&[0.75, 0.0, 1.0], [1, 1, 3], &device());
    let depth = expected_depth(sum.clone(), alpha.clone());
    assert_eq!(values(&depth), [4.0, 0.0, 0.5]);
    let gradients = depth.sum().backward();
    assert_near(&values(&sum.grad(&gradients).unwrap()), &[1.0 / 0.75, 0.0, 1.0], 1e-14);
    assert_near(&values(&alpha.grad(&gradients).unwrap()), &[-3.0 / 0.5625, 0.0, -0.5], 1e-14);
}

#[test]
fn normal_consistency_is_its_formula_and_alpha_is_detached() {
    // two pixels: (0, 0, −0.5) and (0.6, 0.2, 0) against (0, 0, −1) and (1, 0, 0)
    let normal = leaf(&[0.0, 0.6, 0.0, 0.2, -0.5, 0.0], [3, 1, 2], &device());
    let depth_normal = leaf(&[0.0, 1.0, 0.0, 0.0, -1.0, 0.0], [3, 1, 2], &device());
    let alpha = leaf(&[0.5, 0.8], [1, 1, 2], &device());
    let loss = normal_consistency(normal.clone(), depth_normal.clone(), alpha.clone(), None);
    approx::assert_relative_eq!(values(&loss)[0], (0.75 + 0.52) / 2.0, max_relative = 1e-14);
    let gradients = loss.backward();
    let assert_close = |found: &Tensor<3>, expected: [f64; 6]| {
        assert_near(&values(&found.grad(&gradients).unwrap()), &expected, 1e-14);
    };
    assert_close(&normal, [0.0, -0.4, 0.0, 0.0, 0.25, 0.0]);
    assert_close(&depth_normal, [0.0, -0.24, 0.0, -0.08, 0.125, 0.0]);
    assert_eq!(alpha.grad(&gradients).map_or_else(|| vec![0.0; 2], |g| values(&g)), [0.0; 2]);
}

#[test]
fn normals_turn_into_camera_axes() {
    let pose = CameraFromWorld::look_at(DVec3::new(1.0, -3.0, 2.0), DVec3::ZERO, DVec3::Z);
    let camera = Camera { camera_from_world: pose, ..axis_camera() };
    let normals = [DVec3::new(0.36, 0.48, 0.8), DVec3::NEG_Y];
    let planar = |normals: [DVec3; 2]| (0..3).flat_map(|c| normals.map(|n| n[c])).collect::<Vec<f64>>();
    let found = values(&in_camera_axes(constant(&planar(normals), [3, 1, 2]), &camera));
    assert_near(&found, &planar(normals.map(|n| pose.rotation * n)), 1e-14);
}

fn scene(surfels: usize, gaussians: usize) -> TestScene {
    let model = ColourModel::SphericalBeta { lobes: 0 };
    scenes::random(7, &Recipe { surfels, gaussians, model, width: 21, height: 18, ..Recipe::default() })
}

/// An opaque surfel that fills the image and faces the camera, 2 in front of it, and what `geometry` makes of it.
fn loss_of_a_wall(scene: &TestScene, supervision: &Supervision) -> crate::Result<f64> {
    let camera = &scene.camera;
    let turn = DQuat::from_mat3(&camera.camera_from_world.rotation.transpose());
    let (others, gaussians) = scene.tensors(&device(), DType::F64);
    let surfels = Surfels {
        positions: constant(&camera.unproject(camera.cx, camera.cy, 2.0).to_array(), [1, 3]),
        quaternions: constant(&[turn.w, turn.x, turn.y, turn.z], [1, 4]),
        log_scales: constant(&[3.0, 3.0], [1, 2]),
        ..others
    };
    let rendered = render(&surfels, &gaussians, camera, &RenderOptions::default())?;
    let loss = geometry(&rendered, &surfels, camera, supervision, &GeometryWeights::default())?;
    Ok(values(&loss)[0])
}

#[test]
fn terms_are_means_over_all_pixels_of_which_only_supervised_ones_add() {
    let scene = scene(1, 3);
    let (camera, count) = (&scene.camera, pixel_count(&scene.camera));
    let shape = |planes: usize| [planes, camera.height, camera.width];
    // every other pixel: depth half a unit further, normals with a cosine of 0.8 to those of the wall
    let known = |value: f64| move |at: usize| if at.is_multiple_of(2) { value } else { 0.0 };
    let plane = |value: f64| (0..count).map(known(value));
    let depth = constant(&plane(2.5).collect::<Vec<f64>>(), shape(1));
    let normal = constant(&plane(0.6).chain(plane(0.0)).chain(plane(-0.8)).collect::<Vec<f64>>(), shape(3));
    let found = loss_of_a_wall(&scene, &Supervision { depth, normal: normal.clone() }).unwrap();
    let supervised = count.div_ceil(2) as f64;
    let border = (0..count).step_by(2).filter(|&at| is_border(camera, at)).count() as f64;
    let (of_depth, of_normal) = (0.5 * supervised, 0.2 * supervised);
    let of_depth_normal = 0.2 * (supervised - border) + border;
    let expected = (0.1 * of_depth + 0.05 * of_normal + 0.05 * of_depth_normal) / count as f64;
    approx::assert_relative_eq!(found, expected, max_relative = 1e-9);

    let nothing = |planes: usize| constant(&vec![0.0; planes * count], shape(planes));
    assert_eq!(loss_of_a_wall(&scene, &Supervision { depth: nothing(1), normal: nothing(3) }).unwrap(), 0.0);
    let error = loss_of_a_wall(&scene, &Supervision { depth: nothing(3), normal }).unwrap_err();
    assert!(error.to_string().contains("supervision.depth"), "{error}");
}

#[test]
fn the_gradient_of_the_geometry_terms_is_central_differences() {
    const WEIGHTS: GeometryWeights = GeometryWeights { depth: 1.0, normal: 0.7, depth_normal: 0.5 };
    let scene = scene(7, 2);
    let (camera, count) = (&scene.camera, pixel_count(&scene.camera));
    let mut random = Random::new(8);
    let mut depths = random.numbers(count, 1.0, 5.0);
    let normals: Vec<DVec3> =
        (0..count).map(|_| DVec3::new(random.normal(), random.normal(), random.normal()).normalize()).collect();
    depths.iter_mut().step_by(5).for_each(|depth| *depth = 0.0);
    let component =
        |c: usize| normals.iter().enumerate().map(move |(at, n)| if at.is_multiple_of(7) { 0.0 } else { n[c] });
    let supervision = Supervision {
        depth: depth_image(camera, &depths),
        normal: constant(&(0..3).flat_map(component).collect::<Vec<f64>>(), [3, camera.height, camera.width]),
    };
    let peel =
        PeelOptions { layer_count: 3, modulation: 1.5, footprint: Footprint::Opacity, peeling: Peeling::Nearest };
    let options = RenderOptions { peel, ..RenderOptions::default() };
    let loss = |[positions, quaternions, log_scales]: &[Tensor<2>; 3]| {
        let (others, gaussians) = scene.tensors(&device(), DType::F64);
        let [positions, quaternions, log_scales] = [positions, quaternions, log_scales].map(Tensor::clone);
        let surfels = Surfels { positions, quaternions, log_scales, ..others };
        let rendered = render(&surfels, &gaussians, camera, &options).unwrap();
        geometry(&rendered, &surfels, camera, &supervision, &WEIGHTS).unwrap()
    };
    let rows = surfel_rows(&scene.surfels);
    let gradients = check_rows("geometry", SURFEL_NAMES, &rows, SURFEL_WIDTHS, 1e-6, loss);
    assert!(gradients.iter().all(|of| of.iter().any(|g| g.abs() > 1e-3)), "no surfel is seen");
}

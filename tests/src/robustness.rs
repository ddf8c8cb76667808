//! Input that does not fit gets a typed error; input at the extremes gets finite pictures and gradients.

use burn::tensor::{DType, Tensor};
use dpges_core::Error;
use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::losses::{LossWeights, losses};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::schema::{Attribute, Columns, GaussianColumns, SurfelColumns};
use dpges_core::scene::{Footprint, Gaussians, Peeling, Surfels};
use dpges_core::testing::golden::values;
use dpges_core::testing::scenes::TestScene;
use glam::{DMat3, DVec3};

use crate::devices::{flex, ndarray};
use crate::poisoned::scene;

type Input = (Surfels, Gaussians);

fn attributes() -> impl Iterator<Item = &'static Attribute> {
    SurfelColumns::<()>::ATTRIBUTES.iter().chain(GaussianColumns::<()>::ATTRIBUTES)
}

/// Replaces the tensor of an attribute by a function of it.
fn replace(of: &Attribute, (surfels, gaussians): &mut Input, edit: impl Fn(Tensor<2>) -> Tensor<2>) {
    let mut tensors = attributes().zip(surfels.list_mut().into_iter().chain(gaussians.list_mut()));
    let (_, tensor) = tensors.find(|(attribute, _)| *attribute == of).unwrap();
    *tensor = edit(tensor.clone());
}

/// The error of rendering the scene after `edit`.
fn error_after(edit: impl Fn(&mut Input)) -> Error {
    let scene = scene();
    let mut input = scene.tensors(&flex(), DType::F32);
    edit(&mut input);
    render(&input.0, &input.1, &scene.camera, &RenderOptions::default()).unwrap_err()
}

#[test]
fn wrong_shapes_are_named() {
    let model = scene().gaussians.model();
    for attribute in attributes().filter(|attribute| !attribute.is_left_out(model)) {
        let name = attribute.name;
        let twice = |along| {
            error_after(|input| replace(attribute, input, |tensor| Tensor::cat(vec![tensor.clone(), tensor], along)))
        };
        let widened = twice(1);
        assert!(matches!(&widened, Error::Shape { tensor, .. } if tensor == name), "{name}: {widened}");
        // With more positions the others are too short.
        let lengthened = twice(0);
        assert!(matches!(&lengthened, Error::Shape { .. }), "{name}: {lengthened}");
    }
}

#[test]
fn mixed_and_unsupported_element_types_are_named() {
    for attribute in attributes() {
        let error = error_after(|input| replace(attribute, input, |tensor| tensor.cast(DType::F64)));
        let name = attribute.name;
        assert!(matches!(&error, Error::DType { .. }), "{name}: {error}");
        assert!(name == "surfels.positions" || error.to_string().contains(name), "{name}: {error}");
    }
}

#[test]
fn impossible_cameras_and_options_are_named() {
    type Edit = fn(&mut Camera);
    let scene = scene();
    let (surfels, gaussians) = scene.tensors(&ndarray(), DType::F32);
    let error = |camera: Camera, options: RenderOptions| render(&surfels, &gaussians, &camera, &options).unwrap_err();
    let of = |edit: Edit| {
        let mut camera = scene.camera;
        edit(&mut camera);
        error(camera, RenderOptions::default())
    };
    let cases: [(&str, Edit); 11] = [
        ("width", |c| c.width = 0),
        ("height", |c| c.height = 0),
        ("fx", |c| c.fx = 0.0),
        ("fx", |c| c.fx = -1.0),
        ("fy", |c| c.fy = -50.0),
        ("fy", |c| c.fy = f64::NAN),
        ("near", |c| c.near = 0.0),
        ("cx", |c| c.cx = f64::INFINITY),
        ("cy", |c| c.cy = f64::NAN),
        ("rotation", |c| c.camera_from_world.rotation.x_axis.y = f64::NAN),
        ("translation", |c| c.camera_from_world.translation.z = f64::INFINITY),
    ];
    for (name, edit) in cases {
        let error = of(edit);
        assert!(matches!(&error, Error::Camera { field, .. } if *field == name), "{name}: {error}");
    }
    for (name, layer_count, modulation) in
        [("layer_count", 0, 30.0), ("layer_count", 9, 30.0), ("modulation", 3, 0.0), ("modulation", 3, f64::NAN)]
    {
        let peel = PeelOptions { layer_count, modulation, footprint: Footprint::Kernel, peeling: Peeling::Continuous };
        let error = error(scene.camera, RenderOptions { peel, ..RenderOptions::default() });
        assert!(matches!(&error, Error::Option { option, .. } if *option == name), "{name}: {error}");
    }
}

#[test]
fn a_target_of_another_size_is_refused() {
    let scene = scene();
    let (surfels, gaussians) = scene.tensors(&flex(), DType::F32);
    let rendered = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap();
    let target = Tensor::zeros([3, scene.camera.width, scene.camera.height], (&flex(), DType::F32));
    let error = losses(&rendered, surfels.log_scales, target, &LossWeights::default()).unwrap_err();
    assert!(matches!(&error, Error::Shape { tensor, .. } if tensor == "target"), "{error}");
}

/// Renders and trains one step on both backends; everything must be finite.
fn assert_finite(what: &str, scene: &TestScene) {
    for device in [ndarray().autodiff(), flex().autodiff()] {
        for layer_count in [1, 3] {
            let input = scene.leaves(&device, DType::F32);
            let peel = PeelOptions { layer_count, ..PeelOptions::default() };
            let options = RenderOptions { peel, background: [0.2, 0.4, 0.6], ..RenderOptions::default() };
            let rendered = render(&input.0, &input.1, &scene.camera, &options).unwrap();
            let image = values(&rendered.composite.image);
            assert!(image.iter().all(|v| v.is_finite()), "{what}: the image is not finite");
            let target = Tensor::zeros(rendered.composite.image.dims(), (&device, DType::F32)).add_scalar(0.5);
            let terms = losses(&rendered, input.0.log_scales.clone(), target, &LossWeights::default()).unwrap();
            assert!(values(&terms.total)[0].is_finite(), "{what}: the loss is {:?}", values(&terms.total));
            let gradients = terms.total.backward();
            let model = input.1.model();
            let learning = |attribute: &Attribute| attribute.learns() && !attribute.is_left_out(model);
            let all = input.0.iter().chain(input.1.iter());
            for (attribute, tensor) in all.filter(|(attribute, _)| learning(attribute)) {
                let (name, gradient) = (attribute.name, values(&tensor.grad(&gradients).unwrap()));
                let bad = gradient.iter().position(|g| !g.is_finite());
                assert!(bad.is_none(), "{what}: gradient of {name} at {bad:?} is {}", gradient[bad.unwrap_or(0)]);
            }
        }
    }
}

/// What each [`Hazard`](dpges_core::testing::extremes::Hazard) does, farther than that goes.
#[test]
fn what_is_beyond_all_hazards_stays_finite() {
    for size in [-60.0f32, 30.0, 60.0] {
        let mut all = scene();
        all.surfels.log_scales.fill(size);
        all.gaussians.log_scales.fill(size);
        assert_finite(&format!("all log-scales {size}"), &all);
        let mut mixed = scene();
        mixed.surfels.log_scales.iter_mut().step_by(2).for_each(|s| *s = size);
        mixed.gaussians.log_scales.iter_mut().step_by(3).for_each(|s| *s = size);
        assert_finite(&format!("one log-scale of each {size}"), &mixed);
        let mut needles = scene();
        needles.surfels.log_scales.chunks_mut(2).for_each(|s| s.copy_from_slice(&[size, -size]));
        needles.gaussians.log_scales.chunks_mut(3).for_each(|s| s.copy_from_slice(&[size, -size, 0.0]));
        assert_finite(&format!("log-scales ±{size}"), &needles);
    }
    let mut opaque = scene();
    opaque.gaussians.opacities.fill(1e30);
    assert_finite("opacities of 1e30", &opaque);
    let forward = scene().camera.camera_from_world.rotation.transpose() * DVec3::Z;
    for offset in [1e6 * forward, -1e6 * forward, DVec3::new(1e6, -1e6, 1e6), 1e12 * forward] {
        let mut scene = scene();
        let place = (scene.camera.centre() + offset).as_vec3().to_array();
        for positions in [&mut scene.surfels.positions, &mut scene.gaussians.positions] {
            positions.chunks_mut(3).step_by(2).for_each(|p| p.copy_from_slice(&place));
        }
        assert_finite(&format!("at {offset}"), &scene);
        // of matching size there
        for scales in [&mut scene.surfels.log_scales, &mut scene.gaussians.log_scales] {
            scales.fill((offset.length() as f32 * 0.1).ln());
        }
        assert_finite(&format!("at {offset}, large"), &scene);
    }
}

#[test]
fn surfels_exactly_edge_on_stay_finite() {
    let mut scene = scene();
    let pose = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    let camera = &mut scene.camera;
    (camera.camera_from_world, camera.cx, camera.cy) = (pose, 16.5, 8.5);
    // 90° about y: the normal lies along x, the plane holds the axis and the column of pixels through it
    for (p, q) in scene.surfels.positions.chunks_mut(3).zip(scene.surfels.quaternions.chunks_mut(4)) {
        (p[0], p[2]) = (0.0, p[2].abs() + 1.0);
        q.copy_from_slice(&[0.5f32.sqrt(), 0.0, 0.5f32.sqrt(), 0.0]);
    }
    assert_finite("edge-on", &scene);
    for p in scene.surfels.positions.chunks_mut(3) {
        p[0] = 1e-7;
    }
    assert_finite("nearly edge-on", &scene);
}

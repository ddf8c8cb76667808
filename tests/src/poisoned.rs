//! NaN and infinity in every tensor of a scene.

use burn::tensor::{DType, Device};
use dpges_core::Error;
use dpges_core::ops::blend::{BlendOptions, Form};
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::render::{RenderOptions, Values, ViewRequest, render};
use dpges_core::scene::schema::{Attribute, Columns, GaussianColumns, SurfelColumns};
use dpges_core::scene::{GaussianData, SurfelData};
use dpges_core::testing::golden::values;
use dpges_core::testing::scenes::{Recipe, TestScene, random};

const POISONS: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
/// The row that is poisoned.
const ROW: usize = 7;

pub fn scene() -> TestScene {
    random(23, &Recipe { surfels: 20, gaussians: 30, width: 33, height: 18, ..Recipe::default() })
}

pub fn blended(form: Form) -> BlendedOptions {
    BlendedOptions { blend: BlendOptions { form, ..BlendOptions::default() }, background: [0.0; 3] }
}

/// Every attribute of either kind, and the scene with one number of it poisoned, the first or the last of a row.
fn poisoned() -> impl Iterator<Item = (&'static Attribute, f32, TestScene)> {
    let attributes = || SurfelColumns::<()>::ATTRIBUTES.iter().chain(GaussianColumns::<()>::ATTRIBUTES);
    let of_surfels = SurfelData::ATTRIBUTES.len();
    let model = scene().gaussians.model();
    attributes().enumerate().filter(move |(_, attribute)| !attribute.is_left_out(model)).flat_map(
        move |(number, attribute)| {
            POISONS.into_iter().enumerate().map(move |(which, poison)| {
                let mut scene = scene();
                let rows = if number < of_surfels { scene.surfels.len() } else { scene.gaussians.len() };
                let mut columns = scene.surfels.list_mut().into_iter().chain(scene.gaussians.list_mut());
                let column = columns.nth(number).expect("one for each attribute");
                let width = column.len() / rows;
                column[ROW * width + which % 2 * (width - 1)] = poison;
                (attribute, poison, scene)
            })
        },
    )
}

pub fn poisoned_numbers_are_named_with_their_row(device: &Device, dtype: DType) {
    for (attribute, poison, scene) in poisoned() {
        let name = attribute.name;
        let (surfels, gaussians) = scene.tensors(device, dtype);
        let check = |error: Error| {
            let is_named = matches!(&error, Error::NonFinite { tensor, row: ROW, .. } if tensor == name);
            assert!(is_named, "{poison} in {name}: {error}");
        };
        check(render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap_err());
        if GaussianData::ATTRIBUTES.contains(attribute) {
            for form in [Form::Ellipsoids, Form::Discs] {
                check(render_blended(&gaussians, &scene.camera, &blended(form)).unwrap_err());
            }
        }
    }
}

/// Where the caller says that all is finite and it is not, pictures and gradients are anything, but they come to an end,
/// and what is rendered afterwards is as before.
pub fn poisoned_numbers_that_nobody_looked_at_do_no_harm(device: &Device, dtype: DType) {
    let device = device.clone().autodiff();
    let run = |scene: &TestScene| {
        let (surfels, gaussians) = scene.leaves(&device, dtype);
        let view = ViewRequest { values: Values::KnownFinite, ..(&scene.camera).into() };
        let peeled = render(&surfels, &gaussians, view, &RenderOptions::default()).unwrap();
        let mut found = vec![values(&peeled.composite.image)];
        let mut gradients = vec![peeled.composite.image.sum().backward()];
        for form in [Form::Ellipsoids, Form::Discs] {
            let image = render_blended(&gaussians, view, &blended(form)).unwrap().image;
            found.push(values(&image));
            gradients.push(image.sum().backward());
        }
        for gradients in &gradients {
            found.extend(surfels.list().into_iter().filter_map(|leaf| Some(values(&leaf.grad(gradients)?))));
            found.extend(gaussians.list().into_iter().filter_map(|leaf| Some(values(&leaf.grad(gradients)?))));
        }
        found
    };
    let before = run(&scene());
    assert!(before.iter().flatten().all(|value| value.is_finite()));
    for (attribute, poison, scene) in poisoned() {
        let name = attribute.name;
        assert_eq!(run(&scene).len(), before.len(), "{poison} in {name}");
        assert!(run(&self::scene()) == before, "after {poison} in {name}");
    }
}

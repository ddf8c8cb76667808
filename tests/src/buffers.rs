//! Scenes that are larger than the largest buffer of a GPU.

use burn::tensor::{DType, Device};
use dpges_core::backend::device::largest_buffer;
use dpges_core::ops::blend::{BlendOptions, Form};
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::render::room::Drawn;
use dpges_core::render::{RenderOptions, ViewRequest, render};
use dpges_core::scene::schema::Columns;
use dpges_core::scene::tensors::detail_to_rows;
use dpges_core::scene::{BlendOrder, ColourModel, HIGHEST_ALPHA, ScreenFilter, Transparency};
use dpges_core::testing::golden::values;
use dpges_core::testing::kernels::limit_buffers;
use dpges_core::testing::scenes::{self, Recipe, TestScene};
use dpges_core::{Error, Result, within_capacity};

const HARMONICS: ColourModel = ColourModel::SphericalHarmonics { degree: 3 };

/// The picture, and the gradient of the detail of the Gaussians, with all that a step may ask for.
fn step(scene: &TestScene, drawn: Drawn, device: &Device) -> Result<[Vec<f32>; 2]> {
    let (surfels, mut gaussians) = scene.leaves(&device.clone().autodiff(), DType::F32);
    if drawn == Drawn::Blended(Form::Students, BlendOrder::Centres) {
        let degrees = gaussians.opacities.clone().inner().ones_like() * 3.0;
        gaussians.degrees_of_freedom = Some(degrees.autodiff().require_grad());
    }
    let (image, loss) = match drawn {
        Drawn::Surfels | Drawn::Summed => {
            let options = RenderOptions::default();
            let out = render(&surfels, &gaussians, &scene.camera, &options)?.composite.image;
            (out.clone(), out.sum())
        }
        Drawn::Blended(form, order) => {
            let filter = if form == Form::Students { ScreenFilter::Off } else { ScreenFilter::Plain };
            let maps =
                BlendOptions { form, order, filter, maps: true, max_alpha: HIGHEST_ALPHA, ..BlendOptions::default() };
            let options = BlendedOptions { blend: maps, background: [0.0; 3] };
            let probe = gaussians.quaternions.clone().inner().zeros_like().autodiff().require_grad();
            let view = ViewRequest { probe: Some(&probe), ..(&scene.camera).into() };
            let out = render_blended(&gaussians, view, &options)?;
            let maps = out.blend.maps.expect("asked for");
            (out.image.clone(), out.image.sum() + maps.normal.sum() + maps.distortion.sum())
        }
    };
    within_capacity(|| {
        let gradients = loss.backward();
        let mut of = gaussians.colour.clone();
        of.details_mut().for_each(|detail| {
            *detail = detail.grad(&gradients).unwrap_or_else(|| detail.clone().inner().zeros_like());
        });
        [values(&image).into_iter().map(|value| value as f32).collect(), detail_to_rows(&of)]
    })
}

/// Primitives of less than a pixel, so that lists of tiles are short.
fn dust(drawn: Drawn, count: usize, edge: usize) -> TestScene {
    let [surfels, gaussians] = if drawn == Drawn::Surfels { [count, 0] } else { [0, count] };
    let recipe = Recipe { surfels, gaussians, model: HARMONICS, width: edge, height: edge, ..Recipe::default() };
    let mut scene = scenes::random(7, &recipe);
    scene.surfels.log_scales.fill(-6.0);
    scene.gaussians.log_scales.fill(-6.0);
    scene
}

fn limited<T>(bytes: usize, work: impl FnOnce() -> T) -> T {
    limit_buffers(bytes);
    let out = work();
    limit_buffers(usize::MAX);
    out
}

const COUNT: usize = 40_000;

pub fn as_many_fit_as_are_said_to(device: &Device) {
    let blended = |form, order| Drawn::Blended(form, order);
    for drawn in [
        Drawn::Surfels,
        Drawn::Summed,
        blended(Form::Ellipsoids, BlendOrder::Centres),
        blended(Form::Ellipsoids, BlendOrder::Rays),
        blended(Form::Discs, BlendOrder::Centres),
        blended(Form::Students, BlendOrder::Centres),
        blended(Form::Whitened, BlendOrder::Whitened(Transparency::Hybrid)),
    ] {
        let scene = dust(drawn, COUNT, 180);
        let most = (COUNT * drawn.row_bytes()) + drawn.spare_bytes();
        assert_eq!(limited(most, || drawn.most(device)), COUNT);
        let refused = limited(most / 100 * 98, || step(&scene, drawn, device)).err();
        assert!(matches!(refused, Some(Error::Capacity { .. })), "{drawn:?}: {refused:?}");
        limited(most, || step(&scene, drawn, device)).unwrap();
    }
}

/// The order of additions is that of one tensor.
pub fn details_in_parts_change_no_bit(device: &Device) {
    for (drawn, count) in [(Drawn::Summed, 20_000), (Drawn::Blended(Form::Ellipsoids, BlendOrder::Centres), 20_000)] {
        let scene = dust(drawn, count, 80);
        let whole = step(&scene, drawn, device).unwrap();
        let most = 24 * size_of::<f32>() * count;
        let tensors = limited(most, || scene.leaves(&device.clone().autodiff(), DType::F32).1);
        assert_eq!(tensors.colour.details().map(|part| part.dims()[1]).collect::<Vec<_>>(), [24, 21], "{drawn:?}");
        assert!(tensors.check_shapes().is_ok() && tensors.to_data() == scene.gaussians, "{drawn:?}");
        assert_eq!(tensors.map_ref(|_, part| part.dims()[0]).colour.rest, [count]);
        assert!(limited(most, || step(&scene, drawn, device)).unwrap() == whole, "{drawn:?}");
    }
}

/// More than a binding of the driver holds: 128 MiB in Mesa's software driver.
pub fn details_beyond_the_largest_buffer_of_the_driver(device: &Device) {
    let drawn = Drawn::Summed;
    let count = largest_buffer(device) / size_of::<f32>() / 45 + 1;
    if count > 1_000_000 {
        println!("{count} Gaussians would not fit its largest buffer: too many to try");
        return;
    }
    let [image, gradient] = step(&dust(drawn, count, 400), drawn, device).unwrap();
    assert!(image.iter().any(|value| *value != image[0]) && gradient.len() == 45 * count);
    assert!(gradient.iter().all(|value| value.is_finite()) && gradient.iter().any(|value| *value != 0.0));
}

//! Tensors, cameras and options with any numbers: rendering and its backward pass come to an end, what is wrong is refused
//! with a message, and nothing else is.

use burn::tensor::{DType, Device};
use dpges_core::Error;
use dpges_core::ops::blend::{BlendOptions, Form};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::schema::Columns;
use dpges_core::scene::{BlendOrder, ColourModel, Footprint, Peeling, ScreenFilter, Transparency};
use dpges_core::testing::golden::values;
use dpges_core::testing::random::Random;
use dpges_core::testing::scenes::{self, Recipe, TestScene};

use glam::DVec3;

use super::seed;
use crate::budget::seeds;
use crate::devices::{flex, ndarray};

const CASES: u64 = 500;

/// Any number, the unusual ones often.
fn number(random: &mut Random) -> f32 {
    const SPECIAL: [f32; 14] = [
        0.0,
        -0.0,
        1.0,
        -1.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
        f32::MIN_POSITIVE,
        1e-45,
        88.0,
        -104.0,
        16_777_217.0,
    ];
    match random.below(4) {
        0 => SPECIAL[random.below(SPECIAL.len())],
        1 => f32::from_bits((random.unit() * 32f64.exp2()) as u32),
        2 => (random.normal() * 10f64.powf(random.between(-20.0, 20.0))) as f32,
        _ => random.normal() as f32,
    }
}

/// `value`, or any number in `share` of the calls.
fn perhaps(value: f64, share: f64, random: &mut Random) -> f64 {
    if random.unit() < share { f64::from(number(random)) } else { value }
}

struct Case {
    scene: TestScene,
    peeled: RenderOptions,
    blended: BlendedOptions,
}

impl Case {
    fn new(random: &mut Random) -> Self {
        let recipe = Recipe {
            surfels: random.below(7),
            gaussians: random.below(9),
            model: match random.below(2) {
                0 => ColourModel::SphericalHarmonics { degree: random.below(4) },
                _ => ColourModel::SphericalBeta { lobes: random.below(3) },
            },
            width: 1 + random.below(40),
            height: 1 + random.below(40),
            extent: 10f64.powi(random.below(5) as i32 - 2),
        };
        let mut scene = scenes::random(random.below(1 << 30) as u64, &recipe);
        // in many scenes all is finite, so that what is behind the first check is reached
        let share = [0.0, 0.02, 0.02, 0.3, 1.0][random.below(5)];
        let keep_finite = random.below(3) > 0;
        for column in scene.surfels.list_mut().into_iter().chain(scene.gaussians.list_mut()) {
            for value in column {
                let any = perhaps((*value).into(), share, random) as f32;
                *value = if keep_finite && !any.is_finite() { *value } else { any };
            }
        }
        let camera = &mut scene.camera;
        let share = [0.0, 0.0, 0.2][random.below(3)];
        let pose = &mut camera.camera_from_world;
        for value in [&mut camera.fx, &mut camera.fy, &mut camera.cx, &mut camera.cy, &mut camera.near] {
            *value = perhaps(*value, share, random);
        }
        for vector in [&mut pose.translation, &mut pose.rotation.x_axis] {
            *vector = DVec3::from_array(vector.to_array().map(|value| perhaps(value, share, random)));
        }
        let share = [0.0, 0.0, 0.3][random.below(3)];
        let layer_count = if random.unit() < share { random.below(12) } else { 1 + random.below(8) };
        let footprint = [Footprint::Kernel, Footprint::Opacity][random.below(2)];
        let peel = PeelOptions {
            layer_count,
            modulation: perhaps(30.0, share, random),
            footprint,
            peeling: [Peeling::Continuous, Peeling::Nearest, Peeling::Literal][random.below(3)],
        };
        let whitened = |transparency| (Form::Whitened, BlendOrder::Whitened(transparency));
        let (form, order) = [
            (Form::Ellipsoids, BlendOrder::Centres),
            (Form::Ellipsoids, BlendOrder::Rays),
            (Form::Discs, BlendOrder::Centres),
            whitened(Transparency::Hybrid),
            whitened(Transparency::Sorted),
        ][random.below(5)];
        let blend = BlendOptions {
            form,
            order,
            filter: [ScreenFilter::Compensated, ScreenFilter::Plain][random.below(2)],
            max_alpha: perhaps(0.999, share, random),
            min_transmittance: perhaps(1e-4, share, random),
            maps: random.below(2) == 0,
        };
        Self {
            scene,
            peeled: RenderOptions { peel, ..RenderOptions::default() },
            blended: BlendedOptions { blend, background: [0.0; 3] },
        }
    }

    /// Values of the picture and of all gradients; peeled, and blended.
    fn run(&self, device: &Device, dtype: DType) -> [Result<Vec<f64>, Error>; 2] {
        let (surfels, gaussians) = self.scene.leaves(&device.clone().autodiff(), dtype);
        let camera = &self.scene.camera;
        let images = [
            render(&surfels, &gaussians, camera, &self.peeled).map(|rendered| rendered.composite.image),
            render_blended(&gaussians, camera, &self.blended).map(|rendered| rendered.image),
        ];
        images.map(|image| {
            let image = image?;
            let gradients = image.clone().sum().backward();
            let leaves = surfels.list().into_iter().chain(gaussians.list());
            let gradients = leaves.filter_map(|leaf| Some(values(&leaf.grad(&gradients)?)));
            Ok(values(&image).into_iter().chain(gradients.flatten()).collect())
        })
    }

    /// Whether there is nothing to refuse; peeled, and blended.
    fn is_valid(&self) -> [bool; 2] {
        let finite = |columns: Vec<&Vec<f32>>| columns.into_iter().flatten().all(|value| value.is_finite());
        let [surfels, gaussians] = [finite(self.scene.surfels.list()), finite(self.scene.gaussians.list())];
        let camera = self.scene.camera.validate().is_ok();
        [
            surfels && gaussians && camera && self.peeled.peel.validate().is_ok(),
            gaussians && camera && self.blended.blend.validate().is_ok(),
        ]
    }
}

#[test]
fn operations() {
    let devices = [(ndarray(), DType::F32), (ndarray(), DType::F64), (flex(), DType::F32)];
    let (mut accepted, mut refused, mut not_finite) = (0, 0, 0);
    for case in seeds(CASES) {
        let made = Case::new(&mut Random::new((seed() << 32) ^ case));
        for (device, dtype) in &devices {
            for (found, is_valid) in made.run(device, *dtype).into_iter().zip(made.is_valid()) {
                match found {
                    Ok(values) => {
                        assert!(is_valid, "case {case}, {dtype:?}: what is wrong is not refused");
                        accepted += 1;
                        not_finite += usize::from(values.iter().any(|value| !value.is_finite()));
                    }
                    Err(error) => {
                        assert!(!is_valid, "case {case}, {dtype:?}: {error}");
                        assert!(!error.to_string().is_empty());
                        refused += 1;
                    }
                }
            }
        }
    }
    // parameters far beyond the contract may overflow
    println!("operations: {accepted} accepted, of which {not_finite} overflow, {refused} refused");
    assert!(accepted > 0, "nothing is accepted, so that nothing behind the first check is reached");
}

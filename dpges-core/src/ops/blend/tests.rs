use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::{DMat3, DVec3};

use super::{Blend, BlendOptions, OutputKind, blend};
use crate::camera::{Camera, CameraFromWorld};
use crate::math::CameraOf;
use crate::ops::splat::footprint::{Parameters, Splat};
use crate::scene::{Colour, ColourModel, Gaussians};
use crate::testing::compare::relative_l2;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::check;
use crate::testing::random::Random;
use crate::testing::scenes::{self, Recipe};

/// Widths of positions, quaternions, log-scales, opacities and colours.
const WIDTHS: [usize; 5] = [3, 4, 3, 1, 3];
const NAMES: [&str; 5] = ["positions", "quaternions", "log_scales", "opacities", "colours"];
const KINDS: [OutputKind; 3] = [OutputKind::Colour, OutputKind::Alpha, OutputKind::Depth];

/// Positions, quaternions, log-scales, opacities and colours, row-major.
#[derive(Clone, Default)]
struct Flat([Vec<f64>; 5]);

struct Leaves {
    gaussians: Gaussians,
    colours: Tensor<2>,
}

fn constant<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape).convert_dtype(dtype), (device, dtype))
}

fn leaf<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    constant(values, shape, device, dtype).require_grad()
}

fn output(of: &Blend, kind: OutputKind) -> &Tensor<3> {
    match kind {
        OutputKind::Colour => &of.colour,
        OutputKind::Alpha => &of.alpha,
        OutputKind::Depth => &of.depth,
    }
}

/// Colour, alpha, expected and median depth.
fn images(of: &Blend) -> [Vec<f64>; 4] {
    [&of.colour, &of.alpha, &of.depth, &of.median_depth].map(values)
}

impl Leaves {
    fn blend(&self, camera: &Camera) -> Blend {
        blend(&self.gaussians, self.colours.clone(), camera, &BlendOptions::default()).unwrap()
    }

    /// Sum of one output, every pixel with a weight of its own.
    fn loss(&self, kind: OutputKind, camera: &Camera) -> Tensor<1> {
        let blended = self.blend(camera);
        let image = output(&blended, kind);
        let weights = Random::new(9).numbers(image.dims().iter().product(), -1.0, 1.0);
        let weights = constant(&weights, image.dims(), &self.colours.device(), image.dtype());
        (image.clone() * weights).sum()
    }

    /// Gradients of [`Self::loss`] in the order of [`NAMES`], zeros where there is none.
    fn gradients(&self, kind: OutputKind, camera: &Camera) -> [Vec<f64>; 5] {
        let gradients = self.loss(kind, camera).backward();
        let (g, count) = (&self.gaussians, self.gaussians.len());
        let matrix = |tensor: &Tensor<2>| {
            tensor.grad(&gradients).map_or_else(|| vec![0.0; count * tensor.dims()[1]], |g| values(&g))
        };
        let opacities = g.opacities.grad(&gradients).map_or_else(|| vec![0.0; count], |g| values(&g));
        [matrix(&g.positions), matrix(&g.quaternions), matrix(&g.log_scales), opacities, matrix(&self.colours)]
    }
}

impl Flat {
    fn random(seed: u64, recipe: &Recipe) -> (Self, Camera) {
        let scene = scenes::random(seed, recipe);
        let wide = |rows: &[f32]| rows.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
        let g = scene.gaussians;
        let colours = Random::new(seed).numbers(3 * g.len(), -0.3, 1.3);
        let parameters = [wide(&g.positions), wide(&g.quaternions), wide(&g.log_scales), wide(&g.opacities), colours];
        (Self(parameters), scene.camera)
    }

    fn push(&mut self, position: [f64; 3], log_scales: [f64; 3], opacity: f64, colour: [f64; 3]) {
        let quaternion = [0.7, 0.3, -0.5, 0.2];
        let rows: [&[f64]; 5] = [&position, &quaternion, &log_scales, &[opacity], &colour];
        self.0.iter_mut().zip(rows).for_each(|(all, row)| all.extend(row));
    }

    fn len(&self) -> usize {
        self.0[3].len()
    }

    fn row<const W: usize>(&self, of: usize, i: usize) -> [f64; W] {
        self.0[of][W * i..W * (i + 1)].try_into().unwrap()
    }

    /// The same Gaussians, the first of them last.
    fn reversed(&self) -> Self {
        let mut of = 0;
        Self(self.0.each_ref().map(|rows| {
            let reversed = rows.chunks(WIDTHS[of]).rev().flatten().copied().collect();
            of += 1;
            reversed
        }))
    }

    fn leaves_on(&self, device: &Device, dtype: DType) -> Leaves {
        let count = self.len();
        let rows = |i: usize| leaf(&self.0[i], [count, WIDTHS[i]], device, dtype);
        let model = ColourModel::SphericalBeta { lobes: 0 };
        let colour = Colour { model, base: rows(4), detail: leaf(&[], [count, 0], device, dtype) };
        Leaves {
            gaussians: Gaussians {
                positions: rows(0),
                quaternions: rows(1),
                log_scales: rows(2),
                opacities: leaf(&self.0[3], [count], device, dtype),
                colour,
            },
            colours: rows(4),
        }
    }

    fn leaves(&self) -> Leaves {
        self.leaves_on(&device(), DType::F64)
    }

    fn splat(&self, i: usize, camera: &CameraOf<f64>) -> Option<Splat<f64>> {
        let (position, quaternion, log_scales) = (self.row(0, i), self.row(1, i), self.row(2, i));
        let parameters = Parameters { position, quaternion, log_scales, opacity: self.0[3][i] };
        Splat::new(camera, &parameters, self.row(4, i))
    }

    /// [`images`] by sorting all Gaussians at every pixel.
    fn blend_densely(&self, camera: &Camera) -> [Vec<f64>; 4] {
        let of = CameraOf::<f64>::new(camera);
        let splats: Vec<(usize, Splat<f64>)> =
            (0..self.len()).filter_map(|i| self.splat(i, &of).map(|splat| (i, splat))).collect();
        let pixels = camera.width * camera.height;
        let [mut colour, mut alpha, mut depth, mut median] = [3, 1, 1, 1].map(|planes| vec![0.0; planes * pixels]);
        for at in 0..pixels {
            let (x, y) = ((at % camera.width) as f64 + 0.5, (at / camera.width) as f64 + 0.5);
            let weight = |splat: &Splat<f64>| splat.weight(x - splat.mean[0], y - splat.mean[1]);
            let mut order: Vec<_> = splats.iter().filter(|(_, splat)| weight(splat) > 0.0).collect();
            order.sort_by(|(i, a), (j, b)| a.depth.total_cmp(&b.depth).then(i.cmp(j)));
            let mut through = 1.0;
            for (_, splat) in order {
                let opacity = weight(splat).min(0.999);
                let behind = through * (1.0 - opacity);
                if behind < 1e-4 {
                    break;
                }
                for (c, value) in splat.colour.into_iter().enumerate() {
                    colour[c * pixels + at] += value * opacity * through;
                }
                depth[at] += splat.depth * opacity * through;
                if through > 0.5 && behind <= 0.5 {
                    median[at] = splat.depth;
                }
                through = behind;
            }
            alpha[at] = 1.0 - through;
        }
        [colour, alpha, depth, median]
    }
}

fn axis_camera() -> Camera {
    let pose = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    Camera { camera_from_world: pose, fx: 40.0, fy: 44.0, cx: 18.0, cy: 14.0, width: 40, height: 30, near: 0.2 }
}

/// Two that are capped, one behind them that is not blended where they are, a faint one in front of
/// all, a needle, one with its centre outside the image, and one behind the camera.
fn capped() -> Flat {
    let mut flat = Flat::default();
    flat.push([0.1, 0.0, 2.0], [-1.5; 3], 4.0, [0.9, 0.1, 0.2]);
    flat.push([0.0, 0.1, 2.1], [-1.3, -1.6, -1.5], 5.0, [0.2, 0.8, 0.1]);
    flat.push([0.2, 0.1, 3.0], [-0.7, -0.9, -0.4], 0.8, [0.1, -0.2, 0.7]);
    flat.push([-0.3, 0.0, 1.0], [-1.9, -2.1, -1.6], 0.4, [0.3, 0.6, 0.9]);
    flat.push([-0.1, 0.1, 2.5], [-0.7, -4.0, -5.0], 1.3, [1.1, 0.4, 0.5]);
    flat.push([1.6, 0.9, 2.2], [-0.6, -0.3, -0.9], 0.9, [0.5, 0.4, 0.2]);
    flat.push([0.0, 0.0, -1.0], [-0.6, -0.3, -0.9], 0.9, [0.5, 0.4, 0.2]);
    flat
}

/// A Gaussian whose α is capped at every pixel of [`axis_camera`].
fn wall(depth: f64) -> ([f64; 3], [f64; 3], f64) {
    ([0.0, 0.0, depth], [depth.ln(); 3], 100.0)
}

#[test]
fn blending_equals_sorting_at_every_pixel() {
    let mut scenes = vec![(capped(), axis_camera()), (capped().reversed(), axis_camera())];
    for (seed, gaussians) in [(1, 40), (2, 400), (3, 1500)] {
        let recipe = Recipe { surfels: 0, gaussians, width: 45, height: 37, ..Recipe::default() };
        scenes.push(Flat::random(seed, &recipe));
    }
    for (gaussians, camera) in scenes {
        let (found, expected) = (images(&gaussians.leaves().blend(&camera)), gaussians.blend_densely(&camera));
        assert!(expected[1].iter().any(|alpha| *alpha > 0.5));
        for (found, expected) in found.iter().zip(&expected) {
            assert_eq!(found.len(), expected.len());
            for (a, b) in found.iter().zip(expected) {
                approx::assert_relative_eq!(*a, *b, epsilon = 1e-11, max_relative = 1e-11);
            }
        }
    }
}

#[test]
fn nothing_blends_to_nothing() {
    let camera = axis_camera();
    let mut unseen = Flat::default();
    unseen.push([0.0, 0.0, -2.0], [-1.0; 3], 1.0, [1.0; 3]);
    unseen.push([0.0, 0.0, 2.0], [-1.0; 3], 0.0, [1.0; 3]);
    for gaussians in [Flat::default(), unseen] {
        let leaves = gaussians.leaves();
        let blended = leaves.blend(&camera);
        assert_eq!(blended.colour.dims(), [3, 30, 40]);
        for image in [&blended.alpha, &blended.depth, &blended.median_depth] {
            assert_eq!(image.dims(), [1, 30, 40]);
        }
        assert!(images(&blended).iter().flatten().all(|v| *v == 0.0));
        for kind in KINDS {
            assert!(leaves.gradients(kind, &camera).iter().flatten().all(|g| *g == 0.0));
        }
    }
}

#[test]
fn an_opaque_gaussian_hides_what_is_behind_and_two_end_the_pixel() {
    let (camera, red, blue) = (axis_camera(), [0.9, 0.1, 0.0], [0.0, 0.2, 0.8]);
    let of = |walls: &[(f64, [f64; 3])]| {
        let mut flat = Flat::default();
        for &(depth, colour) in walls {
            let (position, log_scales, opacity) = wall(depth);
            flat.push(position, log_scales, opacity, colour);
        }
        images(&flat.leaves().blend(&camera))
    };
    let alone = of(&[(2.0, red)]);
    let pixels = camera.width * camera.height;
    for at in 0..pixels {
        for (c, value) in red.into_iter().enumerate() {
            approx::assert_relative_eq!(alone[0][c * pixels + at], 0.999 * value, epsilon = 1e-12);
        }
        approx::assert_relative_eq!(alone[1][at], 0.999, epsilon = 1e-12);
        approx::assert_relative_eq!(alone[2][at], 0.999 * 2.0, epsilon = 1e-12);
        assert_eq!(alone[3][at], 2.0);
    }
    assert_eq!(of(&[(2.0, red), (3.0, blue)]), alone);
    assert_eq!(of(&[(3.0, blue), (2.0, red), (2.5, blue)]), alone);

    let mut veiled = Flat::default();
    let (position, log_scales, opacity) = wall(2.0);
    veiled.push(position, log_scales, opacity, red);
    veiled.push([0.0, 0.0, 3.0], log_scales, 0.5, blue);
    let veiled = images(&veiled.leaves().blend(&camera));
    for (found, alone) in veiled[0].iter().zip(&alone[0]) {
        assert!((found - alone).abs() <= 0.0005 * 0.8, "{found}, alone {alone}");
    }
    assert_ne!(veiled[0], alone[0]);
    assert_eq!(veiled[3], alone[3]);
}

#[test]
fn ties_in_depth_are_broken_by_index() {
    let camera = axis_camera();
    let red_share = |first: [f64; 3], second: [f64; 3]| {
        let mut flat = Flat::default();
        flat.push([0.0, 0.0, 2.0], [0.0; 3], 0.6, first);
        flat.push([0.0, 0.0, 2.0], [0.0; 3], 0.6, second);
        images(&flat.leaves().blend(&camera))[0][14 * camera.width + 18]
    };
    let (red, green) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    assert!(red_share(red, green) > 0.55);
    assert!(red_share(green, red) < 0.3);
}

#[test]
fn the_order_of_the_parameters_does_not_matter() {
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (gaussians, camera) = Flat::random(12, &recipe);
    let reversed = gaussians.reversed().leaves();
    let leaves = gaussians.leaves();
    assert_eq!(images(&leaves.blend(&camera)), images(&reversed.blend(&camera)));
    for kind in KINDS {
        let back = Flat(reversed.gradients(kind, &camera)).reversed();
        assert_eq!(leaves.gradients(kind, &camera), back.0);
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let recipe = Recipe { surfels: 0, gaussians: 200, width: 170, height: 150, ..Recipe::default() };
    let (gaussians, camera) = Flat::random(13, &recipe);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let leaves = gaussians.leaves_on(&device(), DType::F32);
            (images(&leaves.blend(&camera)), KINDS.map(|kind| leaves.gradients(kind, &camera)))
        })
    };
    let alone = on(1);
    assert_eq!(alone, on(2));
    assert_eq!(alone, on(5));
}

#[test]
fn gradients_of_every_output_are_central_differences() {
    let recipe = Recipe { surfels: 0, gaussians: 9, width: 29, height: 21, ..Recipe::default() };
    let (random, random_camera) = Flat::random(31, &recipe);
    // the last is seen by more tiles than are summed at a time
    let cases = [
        (random, random_camera, 1e-6),
        (capped(), axis_camera(), 1e-6),
        (capped(), axis_camera().resized(140, 120), 1e-7),
    ];
    for (gaussians, camera, step) in cases {
        let leaves = gaussians.leaves();
        for kind in KINDS {
            let found = leaves.gradients(kind, &camera);
            assert!(found[0].iter().any(|g| *g != 0.0));
            for (i, found) in found.iter().enumerate() {
                let name = format!("{kind:?} with respect to {}", NAMES[i]);
                check(&name, &gaussians.0[i], found, step, |moved| {
                    let mut gaussians = gaussians.clone();
                    gaussians.0[i] = moved.to_vec();
                    values(&gaussians.leaves().loss(kind, &camera))[0]
                });
            }
        }
    }
}

#[test]
fn single_precision_is_close_to_double() {
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (gaussians, camera) = Flat::random(14, &recipe);
    let (single, double) = (gaussians.leaves_on(&device(), DType::F32), gaussians.leaves());
    for kind in KINDS {
        let [found, expected] = [&single, &double].map(|leaves| values(output(&leaves.blend(&camera), kind)));
        let distance = relative_l2(&found, &expected);
        assert!(distance < 1e-4, "{kind:?}: {distance:e}");
        let (found, expected) = (single.gradients(kind, &camera), double.gradients(kind, &camera));
        for (name, (found, expected)) in NAMES.iter().zip(found.iter().zip(&expected)) {
            let distance = relative_l2(found, expected);
            assert!(distance < 5e-3, "{kind:?} with respect to {name}: {distance:e}");
        }
    }
}

#[cfg(all(feature = "ndarray", feature = "flex"))]
#[test]
fn both_cpu_backends_agree_to_the_bit() {
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (gaussians, camera) = Flat::random(15, &recipe);
    for dtype in [DType::F32, DType::F64] {
        let [ndarray, flex] =
            [Device::ndarray(), Device::flex()].map(|device| gaussians.leaves_on(&device.autodiff(), dtype));
        assert_eq!(images(&ndarray.blend(&camera)), images(&flex.blend(&camera)));
        for kind in KINDS {
            assert_eq!(ndarray.gradients(kind, &camera), flex.gradients(kind, &camera));
        }
    }
}

#[test]
fn options_outside_their_range_are_refused() {
    let leaves = capped().leaves();
    let refused = |options: BlendOptions| {
        blend(&leaves.gaussians, leaves.colours.clone(), &axis_camera(), &options).unwrap_err().to_string()
    };
    let opaque = BlendOptions { max_alpha: 1.0, ..BlendOptions::default() };
    assert_eq!(refused(opaque), "option `max_alpha` is 1, expected a number above 0 and at most 0.9999");
    let endless = BlendOptions { min_transmittance: 0.0, ..BlendOptions::default() };
    assert_eq!(refused(endless), "option `min_transmittance` is 0, expected a number between 0 and 1");
    assert!(BlendOptions { max_alpha: f64::NAN, ..BlendOptions::default() }.validate().is_err());
}

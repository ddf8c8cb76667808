use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::{DMat3, DVec3};

use super::brute_force::{self, Pixel, Primitive, Shape, centre_of, pixel};
use super::{ALPHA_PLANE, Blend, BlendOptions, DEPTH_PLANE, DISTORTION_PLANE, Form, NORMAL_PLANE, blend};
use crate::camera::{Camera, CameraFromWorld};
use crate::ops::splat::footprint::Parameters;
use crate::scene::{Colour, ColourModel, Gaussians};
use crate::testing::compare::relative_l2;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::check;
use crate::testing::random::Random;
use crate::testing::scenes::{self, Recipe};

/// Widths of positions, quaternions, log-scales, opacities, colours and the probe.
const WIDTHS: [usize; 6] = [3, 4, 3, 1, 3, 4];
const NAMES: [&str; 6] = ["positions", "quaternions", "log_scales", "opacities", "colours", "probe"];
const FORMS: [Form; 2] = [Form::Ellipsoids, Form::Discs];

#[derive(Clone, Copy, Debug)]
enum Output {
    Colour,
    Alpha,
    Depth,
    Normal,
    Distortion,
}

/// In the order of their planes.
const OUTPUTS: [Output; 5] = [Output::Colour, Output::Alpha, Output::Depth, Output::Normal, Output::Distortion];

impl Output {
    /// First plane and number of planes.
    fn planes(self) -> (usize, usize) {
        match self {
            Self::Colour => (0, 3),
            Self::Alpha => (ALPHA_PLANE, 1),
            Self::Depth => (DEPTH_PLANE, 1),
            Self::Normal => (NORMAL_PLANE, 3),
            Self::Distortion => (DISTORTION_PLANE, 1),
        }
    }

    fn of(self, blended: &Blend) -> &Tensor<3> {
        let maps = || blended.maps.as_ref().unwrap();
        match self {
            Self::Colour => &blended.colour,
            Self::Alpha => &blended.alpha,
            Self::Depth => &maps().depth,
            Self::Normal => &maps().normal,
            Self::Distortion => &maps().distortion,
        }
    }

    /// A weight for every element of the output.
    fn weights(self, pixels: usize) -> Vec<f64> {
        let (first, count) = self.planes();
        Random::new(9 + first as u64).numbers(count * pixels, -1.0, 1.0)
    }
}

fn with_maps(form: Form) -> BlendOptions {
    BlendOptions { form, maps: true, ..BlendOptions::default() }
}

/// Positions, quaternions, log-scales, opacities and colours, row-major.
#[derive(Clone, Default)]
struct Flat([Vec<f64>; 5]);

struct Leaves {
    gaussians: Gaussians,
    colours: Tensor<2>,
    probe: Tensor<2>,
}

fn constant<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape).convert_dtype(dtype), (device, dtype))
}

fn leaf<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    constant(values, shape, device, dtype).require_grad()
}

/// The outputs in order and, with maps, median depth.
fn images(of: &Blend) -> Vec<Vec<f64>> {
    match &of.maps {
        None => vec![values(&of.colour), values(&of.alpha)],
        Some(maps) => OUTPUTS.iter().map(|output| values(output.of(of))).chain([values(&maps.median_depth)]).collect(),
    }
}

/// [`images`] with maps.
fn images_of_pixels(pixels: &[Pixel]) -> Vec<Vec<f64>> {
    let of_output = |output: &Output| -> Vec<f64> {
        let (first, count) = output.planes();
        (first..first + count).flat_map(|plane| pixels.iter().map(move |pixel| pixel.planes[plane])).collect()
    };
    let median_depth: Vec<f64> = pixels.iter().map(|pixel| pixel.median_depth).collect();
    OUTPUTS.iter().map(of_output).chain([median_depth]).collect()
}

fn reversed(rows: &[f64], width: usize) -> Vec<f64> {
    rows.chunks(width).rev().flatten().copied().collect()
}

impl Leaves {
    fn blend(&self, camera: &Camera, options: &BlendOptions) -> Blend {
        blend(&self.gaussians, self.colours.clone(), Some(self.probe.clone()), camera, options).unwrap()
    }

    /// Sum of some outputs, every element with a weight of its own.
    fn loss(&self, outputs: &[Output], camera: &Camera, options: &BlendOptions) -> Tensor<1> {
        let blended = self.blend(camera, options);
        let weighted = |output: &Output| {
            let image = output.of(&blended);
            let weights = output.weights(camera.width * camera.height);
            (image.clone() * constant(&weights, image.dims(), &image.device(), image.dtype())).sum()
        };
        outputs.iter().map(weighted).reduce(|a, b| a + b).unwrap()
    }

    /// Gradients of [`Self::loss`] in the order of [`NAMES`].
    fn gradients(&self, outputs: &[Output], camera: &Camera, options: &BlendOptions) -> [Vec<f64>; 6] {
        let gradients = self.loss(outputs, camera, options).backward();
        let of = |tensor: &Tensor<2>| values(&tensor.grad(&gradients).unwrap());
        let g = &self.gaussians;
        let opacities = values(&g.opacities.grad(&gradients).unwrap());
        [of(&g.positions), of(&g.quaternions), of(&g.log_scales), opacities, of(&self.colours), of(&self.probe)]
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
        self.push_turned([0.7, 0.3, -0.5, 0.2], position, log_scales, opacity, colour);
    }

    fn push_turned(
        &mut self,
        quaternion: [f64; 4],
        position: [f64; 3],
        log_scales: [f64; 3],
        opacity: f64,
        colour: [f64; 3],
    ) {
        let rows: [&[f64]; 5] = [&position, &quaternion, &log_scales, &[opacity], &colour];
        self.0.iter_mut().zip(rows).for_each(|(all, row)| all.extend(row));
    }

    fn len(&self) -> usize {
        self.0[3].len()
    }

    fn row<const W: usize>(&self, of: usize, i: usize) -> [f64; W] {
        self.0[of][W * i..W * (i + 1)].try_into().unwrap()
    }

    /// The same primitives, the first of them last.
    fn reversed(&self) -> Self {
        Self(std::array::from_fn(|of| reversed(&self.0[of], WIDTHS[of])))
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
            probe: leaf(&vec![0.0; 4 * count], [count, 4], device, dtype),
        }
    }

    fn leaves(&self) -> Leaves {
        self.leaves_on(&device(), DType::F64)
    }

    /// Front to back.
    fn primitives(&self, camera: &Camera, form: Form) -> Vec<Primitive> {
        let primitive = |i: usize| {
            let (position, quaternion, log_scales) = (self.row(0, i), self.row(1, i), self.row(2, i));
            let parameters = Parameters { position, quaternion, log_scales, opacity: self.0[3][i] };
            Primitive::new(camera, form, i, &parameters, self.row(4, i))
        };
        let mut primitives: Vec<Primitive> = (0..self.len()).filter_map(primitive).collect();
        brute_force::sort(&mut primitives);
        primitives
    }
}

/// Every pixel from its definition.
fn dense(primitives: &[Primitive], camera: &Camera, options: &BlendOptions) -> Vec<Pixel> {
    let pixels = 0..camera.width * camera.height;
    pixels.map(|i| pixel(primitives, camera, options, centre_of(camera, i))).collect()
}

fn axis_camera() -> Camera {
    let pose = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    Camera { camera_from_world: pose, fx: 40.0, fy: 44.0, cx: 18.0, cy: 14.0, width: 40, height: 30, near: 0.2 }
}

/// Pixel of [`axis_camera`] with its centre half a pixel right of and below the axis.
const BESIDE_AXIS: usize = 14 * 40 + 18;

/// Two that are capped, one behind them that is not blended where they are, a faint one in front of
/// all, a needle, one with its centre outside the image, and one behind the camera.
fn capped() -> Flat {
    let mut flat = Flat::default();
    flat.push([0.1, 0.0, 2.0], [-1.5, -1.55, -1.6], 4.0, [0.9, 0.1, 0.2]);
    flat.push([0.0, 0.1, 2.1], [-1.3, -1.6, -1.5], 5.0, [0.2, 0.8, 0.1]);
    flat.push([0.2, 0.1, 3.0], [-0.7, -0.9, -0.4], 0.8, [0.1, -0.2, 0.7]);
    flat.push([-0.3, 0.0, 1.0], [-1.9, -2.1, -1.6], 0.4, [0.3, 0.6, 0.9]);
    flat.push([-0.1, 0.1, 2.5], [-0.7, -4.0, -5.0], 1.3, [1.1, 0.4, 0.5]);
    flat.push([1.6, 0.9, 2.2], [-0.6, -0.3, -0.9], 0.9, [0.5, 0.4, 0.2]);
    flat.push([0.0, 0.0, -1.0], [-0.6, -0.3, -0.9], 0.9, [0.5, 0.4, 0.2]);
    flat
}

/// [`capped`] and, for discs: two smaller than a pixel, one that reaches behind the camera, and one seen edge-on.
fn slanted() -> Flat {
    let mut flat = capped();
    flat.push([-0.4, -0.2, 1.9], [-6.0, -6.5, 0.0], 0.9, [0.7, 0.2, 0.4]);
    flat.push([-0.5, 0.2, 1.7], [-2.0, -6.1, 0.0], 0.7, [0.2, 0.3, 0.8]);
    flat.push([0.3, 0.2, 0.8], [-0.3, -0.2, 0.0], 0.2, [0.6, 0.6, 0.1]);
    flat.push_turned([0.737, 0.676, 0.0, 0.0], [0.2, 0.1, 1.8], [-1.6, -1.4, 0.0], 0.6, [0.1, 0.9, 0.9]);
    flat
}

fn scene_of(form: Form) -> Flat {
    match form {
        Form::Ellipsoids => capped(),
        Form::Discs => slanted(),
    }
}

/// A Gaussian whose α is capped at every pixel of [`axis_camera`].
fn wall(depth: f64) -> ([f64; 3], [f64; 3], f64) {
    ([0.0, 0.0, depth], [depth.ln(); 3], 100.0)
}

#[test]
fn blending_equals_sorting_at_every_pixel() {
    let mut round = capped();
    round.push([0.2, -0.1, 1.5], [-1.7; 3], 0.3, [0.4, 0.4, 0.9]);
    let mut scenes = vec![(round.clone(), axis_camera()), (round.reversed(), axis_camera())];
    scenes.push((slanted(), axis_camera()));
    for (seed, gaussians) in [(1, 40), (2, 400), (3, 1000)] {
        let recipe = Recipe { surfels: 0, gaussians, width: 45, height: 37, ..Recipe::default() };
        scenes.push(Flat::random(seed, &recipe));
    }
    for (form, tolerance) in [(Form::Ellipsoids, 1e-11), (Form::Discs, 1e-9)] {
        let options = with_maps(form);
        for (flat, camera) in &scenes {
            let expected = images_of_pixels(&dense(&flat.primitives(camera, form), camera, &options));
            assert!(expected[1].iter().any(|alpha| *alpha > 0.5));
            let leaves = flat.leaves();
            let found = images(&leaves.blend(camera, &options));
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                assert_eq!(found.len(), expected.len());
                for (a, b) in found.iter().zip(expected) {
                    approx::assert_relative_eq!(*a, *b, epsilon = tolerance, max_relative = tolerance);
                }
            }
            let without_maps = BlendOptions { maps: false, ..options };
            assert_eq!(images(&leaves.blend(camera, &without_maps)), found[..2]);
        }
    }
}

#[test]
fn the_slanted_discs_have_both_kinds_of_hits_and_of_low_pass_filters() {
    let camera = axis_camera();
    let discs = slanted().primitives(&camera, Form::Discs);
    let unfiltered = |disc: &Primitive| matches!(disc.shape, Shape::Disc { low_pass: None, .. });
    assert_eq!(discs.iter().filter(|disc| unfiltered(disc)).count(), 1);
    let filtered = |disc: &Primitive| (0..1200).filter(|&i| disc.shape.is_filtered(centre_of(&camera, i))).count();
    assert!(discs.iter().any(|disc| filtered(disc) > 1000));
    assert!(discs.iter().any(|disc| (1..1000).contains(&filtered(disc))));
}

#[test]
fn nothing_blends_to_nothing() {
    let camera = axis_camera();
    let mut unseen = Flat::default();
    unseen.push([0.0, 0.0, -2.0], [-1.0; 3], 1.0, [1.0; 3]);
    unseen.push([0.0, 0.0, 2.0], [-1.0; 3], 0.0, [1.0; 3]);
    for (flat, form) in [Flat::default(), unseen].iter().flat_map(|flat| FORMS.map(|form| (flat, form))) {
        let (leaves, options) = (flat.leaves(), with_maps(form));
        let blended = leaves.blend(&camera, &options);
        assert_eq!(blended.colour.dims(), [3, 30, 40]);
        assert_eq!(blended.maps.as_ref().unwrap().median_depth.dims(), [1, 30, 40]);
        assert!(images(&blended).iter().flatten().all(|v| *v == 0.0));
        let gradients = leaves.gradients(&OUTPUTS, &camera, &options);
        for (gradient, width) in gradients.iter().zip(WIDTHS) {
            assert_eq!(gradient.len(), flat.len() * width);
            assert!(gradient.iter().all(|g| *g == 0.0));
        }
    }
}

#[test]
fn an_opaque_gaussian_hides_what_is_behind_and_two_end_the_pixel() {
    let (camera, red, blue) = (axis_camera(), [0.9, 0.1, 0.0], [0.0, 0.2, 0.8]);
    let options = with_maps(Form::Ellipsoids);
    let of = |walls: &[(f64, [f64; 3])]| {
        let mut flat = Flat::default();
        for &(depth, colour) in walls {
            let (position, log_scales, opacity) = wall(depth);
            flat.push(position, log_scales, opacity, colour);
        }
        images(&flat.leaves().blend(&camera, &options))
    };
    let alone = of(&[(2.0, red)]);
    let pixels = camera.width * camera.height;
    for at in 0..pixels {
        for (c, value) in red.into_iter().enumerate() {
            approx::assert_relative_eq!(alone[0][c * pixels + at], 0.999 * value, epsilon = 1e-12);
        }
        approx::assert_relative_eq!(alone[1][at], 0.999, epsilon = 1e-12);
        approx::assert_relative_eq!(alone[2][at], 0.999 * 2.0, epsilon = 1e-12);
        assert_eq!((alone[4][at], alone[5][at]), (0.0, 2.0));
    }
    assert_eq!(of(&[(2.0, red), (3.0, blue)]), alone);
    assert_eq!(of(&[(3.0, blue), (2.0, red), (2.5, blue)]), alone);

    let mut veiled = Flat::default();
    let (position, log_scales, opacity) = wall(2.0);
    veiled.push(position, log_scales, opacity, red);
    veiled.push([0.0, 0.0, 3.0], log_scales, 0.5, blue);
    let veiled = images(&veiled.leaves().blend(&camera, &options));
    for (found, alone) in veiled[0].iter().zip(&alone[0]) {
        assert!((found - alone).abs() <= 0.0005 * 0.8, "{found}, alone {alone}");
    }
    assert_ne!(veiled[0], alone[0]);
    assert_eq!(veiled[5], alone[5]);
}

#[test]
fn a_disc_that_faces_the_camera_is_a_gaussian_of_its_scales_and_no_smaller_than_a_pixel() {
    let camera = axis_camera();
    let alone = |log_scales: [f64; 3]| {
        let mut flat = Flat::default();
        flat.push_turned([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 2.0], log_scales, 0.8, [0.5, 0.25, 1.0]);
        images(&flat.leaves().blend(&camera, &with_maps(Form::Discs)))
    };
    let pixels = camera.width * camera.height;
    // half a pixel is 0.5 z / f world units
    let squared = (1.0 / 40.0 / f64::exp(-1.2)).powi(2) + (1.0 / 44.0 / f64::exp(-0.9)).powi(2);
    // ρ = 2 |d|² with d = (½, ½)
    for (log_scales, squared) in [([-1.2, -0.9, 3.0], squared), ([-7.0, -8.0, 3.0], 1.0)] {
        let alpha = 0.8 * (-0.5 * squared).exp();
        let found = alone(log_scales);
        let at = |output: usize, plane: usize| found[output][plane * pixels + BESIDE_AXIS];
        let planes = [at(0, 0), at(0, 1), at(0, 2), at(1, 0), at(2, 0), at(3, 0), at(3, 1), at(3, 2), at(4, 0)];
        let expected = [0.5 * alpha, 0.25 * alpha, alpha, alpha, 2.0 * alpha, 0.0, 0.0, -alpha, 0.0];
        for (found, expected) in planes.into_iter().zip(expected) {
            approx::assert_relative_eq!(found, expected, epsilon = 1e-12);
        }
    }
    assert_eq!(alone([-1.2, -0.9, 3.0])[5][BESIDE_AXIS], 2.0);
    assert_eq!(alone([-7.0, -8.0, 3.0])[5][BESIDE_AXIS], 0.0);
}

#[test]
fn ties_in_depth_are_broken_by_index() {
    let camera = axis_camera();
    let (red, green) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    for form in FORMS {
        let red_share = |first: [f64; 3], second: [f64; 3]| {
            let mut flat = Flat::default();
            flat.push([0.0, 0.0, 2.0], [0.0; 3], 0.6, first);
            flat.push([0.0, 0.0, 2.0], [0.0; 3], 0.6, second);
            images(&flat.leaves().blend(&camera, &with_maps(form)))[0][BESIDE_AXIS]
        };
        assert!(red_share(red, green) > 0.55);
        assert!(red_share(green, red) < 0.3);
    }
}

#[test]
fn the_order_of_the_parameters_does_not_matter() {
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (flat, camera) = Flat::random(12, &recipe);
    let (leaves, backwards) = (flat.leaves(), flat.reversed().leaves());
    for options in FORMS.map(with_maps) {
        assert_eq!(images(&leaves.blend(&camera, &options)), images(&backwards.blend(&camera, &options)));
        let found = backwards.gradients(&OUTPUTS, &camera, &options);
        let expected = leaves.gradients(&OUTPUTS, &camera, &options);
        for ((found, expected), width) in found.iter().zip(&expected).zip(WIDTHS) {
            assert_eq!(&reversed(found, width), expected);
        }
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let recipe = Recipe { surfels: 0, gaussians: 200, width: 170, height: 150, ..Recipe::default() };
    let (flat, camera) = Flat::random(13, &recipe);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let leaves = flat.leaves_on(&device(), DType::F32);
            FORMS.map(with_maps).map(|options| {
                (images(&leaves.blend(&camera, &options)), leaves.gradients(&OUTPUTS, &camera, &options))
            })
        })
    };
    let alone = on(1);
    assert_eq!(alone, on(2));
    assert_eq!(alone, on(5));
}

/// Checks the gradients of each of some outputs, of the parameters one after the other.
fn check_gradients(flat: &Flat, camera: &Camera, options: &BlendOptions, outputs: &[Output], step: f64) {
    let leaves = flat.leaves();
    for output in outputs {
        let found = leaves.gradients(&[*output], camera, options);
        assert!(found[0].iter().any(|g| *g != 0.0));
        for (of, parameters) in flat.0.iter().enumerate() {
            let name = format!("{output:?} of {:?} with respect to {}", options.form, NAMES[of]);
            check(&name, parameters, &found[of], step, |moved| {
                let mut flat = flat.clone();
                flat.0[of] = moved.to_vec();
                values(&flat.leaves().loss(&[*output], camera, options))[0]
            });
        }
    }
}

#[test]
fn gradients_of_every_output_of_ellipsoids_are_central_differences() {
    let recipe = Recipe { surfels: 0, gaussians: 9, width: 29, height: 21, ..Recipe::default() };
    let (random, random_camera) = Flat::random(31, &recipe);
    let options = with_maps(Form::Ellipsoids);
    check_gradients(&random, &random_camera, &options, &OUTPUTS, 1e-6);
    check_gradients(&capped(), &axis_camera(), &options, &OUTPUTS, 1e-6);
}

#[test]
fn gradients_of_every_output_of_discs_are_central_differences() {
    let recipe = Recipe { surfels: 0, gaussians: 9, width: 29, height: 21, ..Recipe::default() };
    let (random, random_camera) = Flat::random(31, &recipe);
    let options = with_maps(Form::Discs);
    check_gradients(&random, &random_camera, &options, &OUTPUTS, 1e-6);
    check_gradients(&slanted(), &axis_camera(), &options, &OUTPUTS, 1e-6);
}

#[test]
fn gradients_are_central_differences_in_more_tiles_than_are_summed_at_a_time() {
    let camera = axis_camera().resized(140, 120);
    check_gradients(&capped(), &camera, &with_maps(Form::Ellipsoids), &[Output::Colour], 1e-7);
}

#[test]
fn maps_do_not_change_the_gradient_of_colour() {
    let recipe = Recipe { surfels: 0, gaussians: 100, width: 61, height: 40, ..Recipe::default() };
    let (flat, camera) = Flat::random(16, &recipe);
    let leaves = flat.leaves();
    for form in FORMS {
        let [without, with] = [false, true].map(|maps| {
            let options = BlendOptions { form, maps, ..BlendOptions::default() };
            leaves.gradients(&[Output::Colour, Output::Alpha], &camera, &options)
        });
        assert_eq!(without, with);
    }
}

/// What the probe's gradient is made of, from central differences at every pixel: of the weighted sum of all planes
/// with respect to the projected centre.
fn brute_force_probe(flat: &Flat, camera: &Camera, options: &BlendOptions) -> Vec<f64> {
    const STEP: f64 = 1e-6;
    let pixels = camera.width * camera.height;
    let weights: Vec<f64> = OUTPUTS.iter().flat_map(|output| output.weights(pixels)).collect();
    let mut primitives = flat.primitives(camera, options.form);
    let mut sums = vec![0.0; 4 * flat.len()];
    for k in 0..primitives.len() {
        let Primitive { row, shape, .. } = primitives[k];
        for (i, axis) in (0..pixels).flat_map(|i| [(i, 0), (i, 1)]) {
            let at = centre_of(camera, i);
            if shape.is_filtered(at) {
                continue;
            }
            let mut moved = |by: f64| {
                match &mut primitives[k].shape {
                    Shape::Ellipse(splat) => splat.mean[axis] += by,
                    Shape::Disc { rows, .. } => rows[axis][2] += by,
                }
                let planes = pixel(&primitives, camera, options, at).planes;
                primitives[k].shape = shape;
                planes.iter().enumerate().map(|(plane, value)| weights[plane * pixels + i] * value).sum::<f64>()
            };
            let slope = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
            let per_centre = match shape {
                Shape::Ellipse(_) => 1.0,
                Shape::Disc { rows, .. } => rows[2][2],
            };
            let gradient = slope * per_centre * 0.5 * [camera.width, camera.height][axis] as f64;
            sums[4 * row + axis] += gradient;
            sums[4 * row + 2 + axis] += gradient.abs();
        }
    }
    sums
}

#[test]
fn the_probe_collects_what_every_pixel_wants_of_the_projected_centre() {
    let camera = axis_camera();
    for options in FORMS.map(with_maps) {
        let flat = scene_of(options.form);
        let expected = brute_force_probe(&flat, &camera, &options);
        let found = flat.leaves().gradients(&OUTPUTS, &camera, &options);
        let largest = expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        assert!(largest > 1.0);
        for (a, b) in found[5].iter().zip(&expected) {
            approx::assert_relative_eq!(*a, *b, epsilon = 1e-6 * largest, max_relative = 1e-5);
        }
    }
}

#[test]
fn no_value_depends_on_the_probe() {
    let (leaves, camera) = (capped().leaves(), axis_camera());
    for options in FORMS.map(with_maps) {
        let with = |probe: Option<Tensor<2>>| {
            images(&blend(&leaves.gaussians, leaves.colours.clone(), probe, &camera, &options).unwrap())
        };
        assert_eq!(with(None), with(Some(leaves.probe.clone() + 1.0)));
    }
}

#[test]
fn single_precision_is_close_to_double() {
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (flat, camera) = Flat::random(14, &recipe);
    let (single, double) = (flat.leaves_on(&device(), DType::F32), flat.leaves());
    // z of a hit has no bound where a disc is seen edge-on
    let bounded: &[Output] = &[Output::Colour, Output::Alpha, Output::Normal];
    for (form, outputs) in [(Form::Ellipsoids, OUTPUTS.as_slice()), (Form::Discs, bounded)] {
        let options = with_maps(form);
        let [found, expected] = [&single, &double].map(|leaves| leaves.blend(&camera, &options));
        for output in outputs {
            let distance = relative_l2(&values(output.of(&found)), &values(output.of(&expected)));
            assert!(distance < 1e-4, "{output:?} of {form:?}: {distance:e}");
        }
        let [found, expected] = [&single, &double].map(|leaves| leaves.gradients(outputs, &camera, &options));
        for (name, (found, expected)) in NAMES.iter().zip(found.iter().zip(&expected)) {
            let distance = relative_l2(found, expected);
            assert!(distance < 1e-2, "{form:?} with respect to {name}: {distance:e}");
        }
    }
}

#[test]
fn single_precision_tells_near_surfaces_apart_far_behind_the_near_plane() {
    let camera = Camera { near: 0.01, ..axis_camera() };
    let mut flat = Flat::default();
    flat.push([0.0, 0.0, 4.0], [0.5, 0.6, 0.4], 0.5, [0.5; 3]);
    flat.push([0.0, 0.0, 4.05], [0.5, 0.4, 0.6], 0.5, [0.5; 3]);
    let options = with_maps(Form::Ellipsoids);
    let [found, expected] = [DType::F32, DType::F64].map(|dtype| {
        let blended = flat.leaves_on(&device(), dtype).blend(&camera, &options);
        values(Output::Distortion.of(&blended))
    });
    assert!(expected[BESIDE_AXIS] > 0.0 && expected[BESIDE_AXIS] < 1e-9);
    assert!(relative_l2(&found, &expected) < 1e-3);
}

#[cfg(all(feature = "ndarray", feature = "flex"))]
#[test]
fn both_cpu_backends_agree_to_the_bit() {
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (flat, camera) = Flat::random(15, &recipe);
    for (dtype, options) in
        [DType::F32, DType::F64].into_iter().flat_map(|dtype| FORMS.map(|form| (dtype, with_maps(form))))
    {
        let [ndarray, flex] =
            [Device::ndarray(), Device::flex()].map(|device| flat.leaves_on(&device.autodiff(), dtype));
        assert_eq!(images(&ndarray.blend(&camera, &options)), images(&flex.blend(&camera, &options)));
        let [ndarray, flex] = [ndarray, flex].map(|leaves| leaves.gradients(&OUTPUTS, &camera, &options));
        assert_eq!(ndarray, flex);
    }
}

#[test]
fn options_outside_their_range_are_refused() {
    let leaves = capped().leaves();
    let refused = |options: BlendOptions| {
        blend(&leaves.gaussians, leaves.colours.clone(), None, &axis_camera(), &options).unwrap_err().to_string()
    };
    let opaque = BlendOptions { max_alpha: 1.0, ..BlendOptions::default() };
    assert_eq!(refused(opaque), "option `max_alpha` is 1, expected a number above 0 and at most 0.9999");
    let endless = BlendOptions { min_transmittance: 0.0, ..BlendOptions::default() };
    assert_eq!(refused(endless), "option `min_transmittance` is 0, expected a number between 0 and 1");
    assert!(BlendOptions { max_alpha: f64::NAN, ..BlendOptions::default() }.validate().is_err());
}

#[test]
fn a_probe_of_another_shape_is_refused() {
    let leaves = capped().leaves();
    let probe = Some(leaves.colours.clone());
    let error = blend(&leaves.gaussians, leaves.colours, probe, &axis_camera(), &BlendOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "tensor `probe` has shape [7, 3], expected [7, 4]");
}

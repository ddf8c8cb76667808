mod brute_force;
mod gradients;
mod pictures;
mod precision;
mod probe;
mod rays;
mod students;
mod whitened;

use burn::tensor::{DType, Device, Tensor, TensorData};
use glam::{DMat3, DVec3};

use self::brute_force::{Pixel, Primitive, Shape, centre_of, pixel};
use super::{ALPHA_PLANE, Blend, BlendOptions, DEPTH_PLANE, DISTORTION_PLANE, Form, NORMAL_PLANE, blend};
use crate::camera::{Camera, CameraFromWorld, Distortion, Lens, Projection};
use crate::footprint::gaussian::cpu::Parameters;
use crate::scene::{BlendOrder, Colour, ColourModel, Gaussians, ScreenFilter, Transparency};
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

fn plainly_filtered() -> BlendOptions {
    BlendOptions { filter: ScreenFilter::Plain, ..with_maps(Form::Ellipsoids) }
}

fn by_rays() -> BlendOptions {
    BlendOptions { order: BlendOrder::Rays, ..plainly_filtered() }
}

fn hybrid(transparency: Transparency) -> BlendOptions {
    BlendOptions { order: BlendOrder::Whitened(transparency), max_alpha: 0.9999, ..with_maps(Form::Whitened) }
}

/// Forms and orders of Gaussians and discs.
fn every_way() -> [BlendOptions; 4] {
    [with_maps(Form::Ellipsoids), with_maps(Form::Discs), by_rays(), hybrid(Transparency::Hybrid)]
}

/// Positions, quaternions, log-scales, opacities and colours, row-major; then degrees of freedom, of students.
#[derive(Clone, Default)]
struct Flat([Vec<f64>; 5], Vec<f64>);

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
        blend(&self.gaussians, &self.colours, Some(&self.probe), camera, options).unwrap()
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
        (Self(parameters, Vec::new()), scene.camera)
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
        Self(std::array::from_fn(|of| reversed(&self.0[of], WIDTHS[of])), reversed(&self.1, 1))
    }

    fn leaves_on(&self, device: &Device, dtype: DType) -> Leaves {
        let count = self.len();
        let rows = |i: usize| leaf(&self.0[i], [count, WIDTHS[i]], device, dtype);
        let model = ColourModel::SphericalBeta { lobes: 0 };
        let colour = Colour::new(model, rows(4), leaf(&[], [count, 0], device, dtype));
        Leaves {
            gaussians: Gaussians {
                positions: rows(0),
                quaternions: rows(1),
                log_scales: rows(2),
                opacities: leaf(&self.0[3], [count, 1], device, dtype),
                opacity_base: leaf(&[], [count, 0], device, dtype),
                opacity_detail: leaf(&[], [count, 0], device, dtype),
                colour,
                degrees_of_freedom: (!self.1.is_empty()).then(|| leaf(&self.1, [count, 1], device, dtype)),
            },
            colours: rows(4),
            probe: leaf(&vec![0.0; 4 * count], [count, 4], device, dtype),
        }
    }

    fn leaves(&self) -> Leaves {
        self.leaves_on(&device(), DType::F64)
    }

    /// Front to back.
    fn primitives(&self, camera: &Camera, options: &BlendOptions) -> Vec<Primitive> {
        let primitive = |i: usize| {
            let (position, quaternion, log_scales) = (self.row(0, i), self.row(1, i), self.row(2, i));
            let parameters = Parameters {
                position,
                quaternion,
                log_scales,
                opacity: self.0[3][i],
                degrees_of_freedom: self.1.get(i).copied().unwrap_or(f64::INFINITY),
            };
            Primitive::new(camera, options, i, &parameters, self.row(4, i))
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
    Camera {
        camera_from_world: pose,
        fx: 40.0,
        fy: 44.0,
        cx: 18.0,
        cy: 14.0,
        width: 40,
        height: 30,
        near: 0.2,
        lens: None,
    }
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
        Form::Ellipsoids | Form::Whitened => capped(),
        Form::Discs => slanted(),
        Form::Students => students::mixed(),
    }
}

/// A Gaussian whose α is capped at every pixel of [`axis_camera`].
fn wall(depth: f64) -> ([f64; 3], [f64; 3], f64) {
    ([0.0, 0.0, depth], [depth.ln(); 3], 100.0)
}

mod brute_force;
mod gradients;
mod pictures;
mod precision;
mod probe;
mod rays;
mod students;
mod whitened;

use burn::tensor::{DType, Device, Tensor};

use self::brute_force::{Pixel, Primitive, Shape, centre_of, pixel};
use super::{ALPHA_PLANE, Blend, BlendOptions, DEPTH_PLANE, DISTORTION_PLANE, Form, NORMAL_PLANE, blend};
use crate::camera::{Camera, Distortion, Lens, Projection};
use crate::footprint::gaussian::cpu::Parameters;
use crate::ops::fixtures::{Flat, assert_near, axis_camera, gradient_of, of_type, replaced};
use crate::scene::{BlendOrder, Gaussians, ScreenFilter, Transparency};
use crate::testing::compare::relative_l2;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::check;
use crate::testing::random::Random;

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

struct Leaves {
    gaussians: Gaussians,
    colours: Tensor<2>,
    probe: Tensor<2>,
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
            (image.clone() * of_type(&weights, image.dims(), &image.device(), image.dtype())).sum()
        };
        outputs.iter().map(weighted).reduce(|a, b| a + b).unwrap()
    }

    /// Gradients of [`Self::loss`] in the order of [`NAMES`].
    fn gradients(&self, outputs: &[Output], camera: &Camera, options: &BlendOptions) -> [Vec<f64>; 6] {
        let gradients = self.loss(outputs, camera, options).backward();
        let g = &self.gaussians;
        [&g.positions, &g.quaternions, &g.log_scales, &g.opacities, &self.colours, &self.probe]
            .map(|tensor| values(&tensor.grad(&gradients).unwrap()))
    }
}

impl Flat {
    fn push(&mut self, position: [f64; 3], log_scales: [f64; 3], opacity: f64, colour: [f64; 3]) {
        self.push_turned([0.7, 0.3, -0.5, 0.2], position, log_scales, opacity, colour);
    }

    /// The same primitives, the first of them last.
    fn reversed(&self) -> Self {
        Self(std::array::from_fn(|of| reversed(&self.0[of], WIDTHS[of])), reversed(&self.1, 1))
    }

    fn leaves_on(&self, device: &Device, dtype: DType) -> Leaves {
        let (gaussians, colours) = self.gaussians_on(device, dtype);
        let probe = of_type(&vec![0.0; 4 * self.len()], [self.len(), 4], device, dtype).require_grad();
        Leaves { gaussians, colours, probe }
    }

    fn leaves(&self) -> Leaves {
        self.leaves_on(&device(), DType::F64)
    }

    /// Front to back.
    fn primitives(&self, camera: &Camera, options: &BlendOptions) -> Vec<Primitive> {
        let primitive = |i: usize| Primitive::new(camera, options, i, &self.parameters(i), self.row(4, i));
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

/// Compares pictures with every pixel from its definition, all but the last `left_out` of the [`images`], and those without maps
/// with them.
fn check_pictures(flat: &Flat, camera: &Camera, options: &BlendOptions, tolerance: f64, left_out: usize) {
    let expected = images_of_pixels(&dense(&flat.primitives(camera, options), camera, options));
    assert!(expected[1].iter().any(|alpha| *alpha > 0.5));
    let leaves = flat.leaves();
    let found = images(&leaves.blend(camera, options));
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(&expected).take(expected.len() - left_out) {
        assert_near(found, expected, tolerance);
    }
    let without_maps = BlendOptions { maps: false, ..*options };
    assert_eq!(images(&leaves.blend(camera, &without_maps)), found[..2]);
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

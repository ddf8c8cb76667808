//! How far 32-bit pictures and gradients are from 64-bit ones, and whether they are finite, at the extremes.

use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use glam::DMat3;

use super::extremes::{Extreme, Hazard};
use super::golden::{gradient, values};
use super::random::Random;
use crate::camera::Camera;
use crate::counters::transfers::uploaded;
use crate::error::Result;
use crate::losses::{self, LossWeights, losses};
use crate::ops::blend::{BlendOptions, Form};
use crate::render::blended::{BlendedOptions, render_blended};
use crate::render::{RenderOptions, render};
use crate::scene::schema::Columns;
use crate::scene::{Gaussians, ScreenFilter, Surfels};

/// Gradients smaller than this are compared as if they were of this size. The loss is of the order of 1, a position in
/// units of the size of the world.
const SMALLEST_NORM: f64 = 1e-9;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Way {
    Peeled,
    Ellipsoids,
    /// Blended ellipsoids without compensation.
    PlainEllipsoids,
    Discs,
}

impl Way {
    pub const ALL: [Self; 4] = [Self::Peeled, Self::Ellipsoids, Self::PlainEllipsoids, Self::Discs];

    pub fn name(self) -> &'static str {
        match self {
            Self::Peeled => "peeled",
            Self::Ellipsoids => "ellipsoids",
            Self::PlainEllipsoids => "ellipsoids, plain",
            Self::Discs => "discs",
        }
    }
}

/// One tensor of one scene, rendered in one way: the picture, or the gradient of the loss with respect to an attribute.
#[derive(Clone, Debug)]
pub struct Deviation {
    pub seed: u64,
    pub hazards: Vec<Hazard>,
    pub way: Way,
    /// `image`, or the name of an attribute.
    pub tensor: &'static str,
    pub non_finite: usize,
    /// For a picture: the largest difference of a value, relative to the largest value where that is 1 or more. For a
    /// gradient: relative L2 distance, with positions in units of the size of the world. Infinite if a value is not
    /// finite.
    pub error: f64,
}

type Named = (&'static str, Vec<f64>);
type Found = Vec<Named>;

/// Renders and differentiates an extreme scene in f32 on `device` and in f64 on the CPU.
pub fn deviations(extreme: &Extreme, way: Way, device: &Device) -> Result<Vec<Deviation>> {
    let found = compute(extreme, way, device, DType::F32)?;
    let exact = compute(extreme, way, &crate::backend::device::cpu(), DType::F64)?;
    let compare = |((tensor, found), (_, exact)): (Named, Named)| {
        let non_finite = found.iter().chain(&exact).filter(|value| !value.is_finite()).count();
        let error = if non_finite == 0 { distance(tensor, &found, &exact, extreme.extent) } else { f64::INFINITY };
        Deviation { seed: extreme.seed, hazards: extreme.hazards.clone(), way, tensor, non_finite, error }
    };
    Ok(found.into_iter().zip(exact).map(compare).collect())
}

/// The condition of each tensor of [`deviations`], in its order: how far it moves in f64, as [`Deviation::error`] measures,
/// if every number of the scene and of the camera moves by half a unit in the last place of an f32, up or down. The largest
/// of `moves` random choices. No arithmetic in f32 can promise less than that.
pub fn conditions(extreme: &Extreme, way: Way, moves: usize) -> Result<Vec<f64>> {
    let device = crate::backend::device::cpu();
    let exact = compute(extreme, way, &device, DType::F64)?;
    let mut largest = vec![0.0f64; exact.len()];
    let mut random = Random::new(extreme.seed ^ 0xc0_4d17);
    for _ in 0..moves {
        let device = device.clone().autodiff();
        let (surfels, gaussians) = extreme.scene.tensors(&device, DType::F64);
        let surfels = surfels.map(|_, tensor| moved(&tensor, &mut random)).require_grad();
        let gaussians = gaussians.map(|_, tensor| moved(&tensor, &mut random)).require_grad();
        let camera = moved_camera(&extreme.scene.camera, &mut random);
        let found = differentiate(extreme, way, &surfels, &gaussians, &camera)?;
        for (largest, ((tensor, found), (_, exact))) in largest.iter_mut().zip(found.iter().zip(&exact)) {
            *largest = largest.max(distance(tensor, found, exact, extreme.extent));
        }
    }
    Ok(largest)
}

/// Up or down by half a unit in the last place of an f32.
fn moved_number(value: f64, random: &mut Random) -> f64 {
    let magnitude = (value as f32).abs();
    let half_unit = 0.5 * (f64::from(magnitude.next_up()) - f64::from(magnitude));
    match (value == 0.0, random.below(2)) {
        (true, _) => value,
        (false, 0) => value - half_unit,
        (false, _) => value + half_unit,
    }
}

fn moved(tensor: &Tensor<2>, random: &mut Random) -> Tensor<2> {
    let numbers: Vec<f64> = values(tensor).into_iter().map(|value| moved_number(value, random)).collect();
    Tensor::from_data(TensorData::new(numbers, tensor.dims()), (&tensor.device(), DType::F64))
}

fn moved_camera(camera: &Camera, random: &mut Random) -> Camera {
    let mut moved = *camera;
    let pose = &mut moved.camera_from_world;
    pose.rotation = DMat3::from_cols_array(&pose.rotation.to_cols_array().map(|value| moved_number(value, random)));
    pose.translation = pose.translation.to_array().map(|value| moved_number(value, random)).into();
    for value in [&mut moved.fx, &mut moved.fy, &mut moved.cx, &mut moved.cy] {
        *value = moved_number(*value, random);
    }
    moved
}

/// How far `found` is from `exact`, see [`Deviation::error`].
fn distance(tensor: &str, found: &[f64], exact: &[f64], extent: f64) -> f64 {
    if tensor == IMAGE {
        return largest_difference(found, exact);
    }
    let unit = if tensor.ends_with(".positions") { extent } else { 1.0 };
    let in_units = |values: &[f64]| values.iter().map(|value| value * unit).collect::<Vec<_>>();
    relative(&in_units(found), &in_units(exact))
}

const IMAGE: &str = "image";

fn largest_difference(found: &[f64], exact: &[f64]) -> f64 {
    let largest = exact.iter().fold(1.0f64, |largest, value| largest.max(value.abs()));
    found.iter().zip(exact).fold(0.0f64, |worst, (a, b)| worst.max((a - b).abs())) / largest
}

fn relative(found: &[f64], exact: &[f64]) -> f64 {
    let norm = |values: &mut dyn Iterator<Item = f64>| {
        // scaled, so that squares of huge gradients do not overflow
        let values: Vec<f64> = values.collect();
        let largest = values.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
        if largest == 0.0 { 0.0 } else { largest * values.iter().map(|v| (v / largest).powi(2)).sum::<f64>().sqrt() }
    };
    let difference = norm(&mut found.iter().zip(exact).map(|(a, b)| a - b));
    difference / norm(&mut exact.iter().copied()).max(SMALLEST_NORM)
}

fn compute(extreme: &Extreme, way: Way, device: &Device, dtype: DType) -> Result<Found> {
    let device = device.clone().autodiff();
    let (surfels, gaussians) = extreme.scene.leaves(&device, dtype);
    differentiate(extreme, way, &surfels, &gaussians, &extreme.scene.camera)
}

/// The picture and the gradients of `surfels` and `gaussians`, which are leaves, against the target of an extreme scene.
fn differentiate(
    extreme: &Extreme,
    way: Way,
    surfels: &Surfels,
    gaussians: &Gaussians,
    camera: &Camera,
) -> Result<Found> {
    let (device, dtype) = (gaussians.positions.device(), gaussians.positions.dtype());
    let count = 3 * camera.width * camera.height;
    let target = Random::new(extreme.seed).numbers(count, 0.0, 1.0);
    let target = uploaded(target, [3, camera.height, camera.width], &device, dtype);
    if way == Way::Peeled {
        let options = RenderOptions { peel: extreme.peel, background: [0.2, 0.4, 0.6], ..RenderOptions::default() };
        let rendered = render(surfels, gaussians, camera, &options)?;
        let total = losses(&rendered, surfels.log_scales.clone(), target, &LossWeights::default())?.total;
        let gradients = total.backward();
        let mut found = vec![(IMAGE, values(&rendered.composite.image))];
        found.extend(gradients_of(surfels, &gradients));
        found.extend(gradients_of(gaussians, &gradients));
        return Ok(found);
    }
    let (form, filter) = match way {
        Way::Discs => (Form::Discs, ScreenFilter::Compensated),
        Way::PlainEllipsoids => (Form::Ellipsoids, ScreenFilter::Plain),
        Way::Peeled | Way::Ellipsoids => (Form::Ellipsoids, ScreenFilter::Compensated),
    };
    let blend = BlendOptions { form, filter, ..BlendOptions::default() };
    let options = BlendedOptions { blend, background: [0.2, 0.4, 0.6] };
    let rendered = render_blended(gaussians, camera, &options)?;
    let gradients = losses::rgb(&rendered.image, target, LossWeights::default().dssim)?.total.backward();
    let mut found = vec![(IMAGE, values(&rendered.image))];
    found.extend(gradients_of(gaussians, &gradients));
    Ok(found)
}

fn gradients_of(columns: &impl Columns<Value = Tensor<2>>, gradients: &Gradients) -> Found {
    let learnt = columns.iter().filter(|(attribute, _)| attribute.learns());
    learnt.map(|(attribute, tensor)| (attribute.name, gradient(tensor, gradients))).collect()
}

/// The errors of one group of tensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distribution {
    pub count: usize,
    pub median: f64,
    /// The error that 99.9 % do not exceed.
    pub nearly_all: f64,
    pub largest: f64,
}

impl Distribution {
    /// The distribution of `errors`; `None` if there are none.
    pub fn of(mut errors: Vec<f64>) -> Option<Self> {
        errors.sort_by(f64::total_cmp);
        let last = errors.len().checked_sub(1)?;
        let at = |share: f64| errors[(share * last as f64).ceil() as usize];
        Some(Self { count: errors.len(), median: at(0.5), nearly_all: at(0.999), largest: errors[last] })
    }
}

#[cfg(test)]
mod tests {
    use super::super::extremes::extreme_of;
    use super::*;

    #[test]
    fn ordinary_scenes_are_close_and_a_value_that_is_off_is_found() {
        let extreme = extreme_of(Hazard::OneDepth, 3);
        for way in Way::ALL {
            let found = deviations(&extreme, way, &crate::backend::device::cpu()).unwrap();
            assert!(found.len() >= 6, "{found:?}");
            assert!(found.iter().all(|deviation| deviation.error < 1e-2), "{found:?}");
            assert!(found.iter().any(|deviation| deviation.error > 0.0), "f32 and f64 differ somewhere");
        }
        assert_eq!(largest_difference(&[1.0, 2.0], &[1.0, 4.0]), 0.5);
        assert!((relative(&[3.0, 4.0], &[3.0, 3.0]) - 1.0 / 18f64.sqrt()).abs() < 1e-15);
        assert_eq!(relative(&[1e300, 0.0], &[-1e300, 0.0]), 2.0);
        assert_eq!(relative(&[0.0], &[0.0]), 0.0);
    }

    #[test]
    fn distributions_are_those_of_sorted_errors() {
        let errors: Vec<f64> = (0..=1000).rev().map(f64::from).collect();
        let found = Distribution::of(errors).unwrap();
        assert_eq!(found, Distribution { count: 1001, median: 500.0, nearly_all: 999.0, largest: 1000.0 });
        assert_eq!(Distribution::of(Vec::new()), None);
    }
}

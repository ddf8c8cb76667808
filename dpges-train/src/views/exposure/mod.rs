//! Changes of exposure and white balance from one photograph to the next.
//!
//! A photograph shows `gain · C + offset` in each channel, where C is the display-referred colour of the scene. Gains and
//! offsets are exactly what all photographs could have in common with the scene, so that their means can be held still;
//! what a full matrix adds, such as another saturation, a camera hardly changes between two photographs of a scene.

pub(crate) mod state;

use std::sync::Arc;

use burn::tensor::{Device, Tensor, TensorData};
use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::counters::transfers::upload;
use dpges_core::losses::Target;
use dpges_core::scene::tensors::tensor_to_rows;
use serde::{Deserialize, Serialize};

use crate::dataset::{Dataset, Picture, View, pictures, sampled};
use crate::views::target::ToTarget;

/// Pictures that differ by a larger gain, or by less than one over it, show different things.
const MOST_GAIN: f64 = 4.0;
/// Points of a dataset that are looked up in its photographs.
const SAMPLED_POINTS: usize = 20_000;
/// Fewest points by which the brightness of a photograph is judged.
const FEWEST_POINTS: usize = 16;

/// The change by the exposure of one photograph: `photograph = gain · scene + offset`, display-referred.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// Gains of red, green and blue.
    pub gain: [f64; 3],
    /// Likewise.
    pub offset: [f64; 3],
}

impl Correction {
    /// From the numbers that are trained: three logarithms of gains, three offsets.
    pub fn of_row(row: &[f32; 6]) -> Self {
        let [red, green, blue, offset @ ..] = row.map(f64::from);
        Self { gain: [red, green, blue].map(f64::exp), offset }
    }

    /// The one by which `image` is nearest to `photograph` in the mean square, both [3, H, W], over the pixels that count:
    /// at least one of `counted` [H × W], or of all. Gains stay between 1/4 and 4, and are 1 where the image is of one colour.
    pub fn fitted(image: &Tensor<3>, photograph: &Tensor<3>, counted: Option<&[bool]>) -> Self {
        let (image, photograph) = (tensor_to_rows(image), tensor_to_rows(photograph));
        let pixels = image.len() / 3;
        let plane = |rows: &[f32], channel: usize| -> Vec<f32> {
            let counts = |pixel: &usize| counted.is_none_or(|counted| counted[*pixel]);
            (0..pixels).filter(counts).map(|pixel| rows[channel * pixels + pixel]).collect()
        };
        let lines = [0, 1, 2].map(|channel| line(&plane(&image, channel), &plane(&photograph, channel)));
        Self { gain: lines.map(|(gain, _)| gain), offset: lines.map(|(_, offset)| offset) }
    }

    /// `image` [3, H, W] of the scene as the photograph shows it.
    pub fn applied(&self, image: Tensor<3>) -> Tensor<3> {
        let (gain, offset) = (per_channel(self.gain, &image), per_channel(self.offset, &image));
        image * gain + offset
    }

    /// `photograph` [3, H, W] as the scene looks.
    pub fn undone(&self, photograph: Tensor<3>) -> Tensor<3> {
        let (gain, offset) = (per_channel(self.gain, &photograph), per_channel(self.offset, &photograph));
        (photograph - offset) / gain
    }

    /// A `colour` of the photograph as it is in the scene.
    pub fn undone_colour(&self, colour: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|channel| ((f64::from(colour[channel]) - self.offset[channel]) / self.gain[channel]) as f32)
    }
}

/// [3, 1, 1] on the device of `like`, in its element type.
fn per_channel(values: [f64; 3], like: &Tensor<3>) -> Tensor<3> {
    let data = TensorData::new(values.to_vec(), [3, 1, 1]).convert_dtype(like.dtype());
    Tensor::from_data(upload(data), (&like.device(), like.dtype()))
}

/// Slope and intercept of the line through `from` and `to`, of the same length, by least squares.
fn line(from: &[f32], to: &[f32]) -> (f64, f64) {
    let mean = |values: &[f32]| values.iter().map(|&value| f64::from(value)).sum::<f64>() / values.len() as f64;
    let (mean_from, mean_to) = (mean(from), mean(to));
    let (mut variance, mut covariance) = (0.0, 0.0);
    for (&x, &y) in from.iter().zip(to) {
        let x = f64::from(x) - mean_from;
        variance += x * x;
        covariance += x * (f64::from(y) - mean_to);
    }
    let gain = if variance > 0.0 { (covariance / variance).clamp(1.0 / MOST_GAIN, MOST_GAIN) } else { 1.0 };
    (gain, mean_to - gain * mean_from)
}

/// A camera, and the photograph that it took, as the scene looks: with what its exposure has changed undone.
#[derive(Clone, Debug)]
pub struct Seen<'a> {
    pub camera: &'a Camera,
    /// As it was taken.
    pub picture: Arc<Picture>,
    /// The correction; `None` if the photograph is taken as it is.
    pub correction: Option<&'a Correction>,
}

impl<'a> Seen<'a> {
    /// The view with its photograph.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if its photograph cannot be read again.
    pub fn by(view: &'a View, correction: Option<&'a Correction>) -> Result<Self> {
        Ok(Self { camera: &view.camera, picture: view.picture()?, correction })
    }

    /// Display-referred red, green and blue of a pixel, counted row by row.
    pub fn colour(&self, pixel: usize) -> [f32; 3] {
        let colour = self.picture.colour(pixel);
        self.correction.map_or(colour, |correction| correction.undone_colour(colour))
    }

    /// The photograph on `device`, and which of its pixels count.
    pub fn target(&self, device: &Device) -> Target {
        let Target { image, mask } = self.picture.target(device);
        let image = match self.correction {
            Some(correction) => correction.undone(image),
            None => image,
        };
        Target { image, mask }
    }
}

/// How differently bright the training photographs of `dataset` show the same points: the standard deviation over views of
/// the logarithm to base 2 of how much brighter the points are in a photograph than by their own colours. A sample
/// stands for many views. `None` if fewer than two photographs show enough points with a colour.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn brightness_spread(dataset: &Dataset) -> Result<Option<f64>> {
    let points = &dataset.points;
    let mut seen = vec![Vec::new(); dataset.train.len()];
    for point in (0..points.positions.len()).step_by(points.positions.len().div_ceil(SAMPLED_POINTS).max(1)) {
        points.seen_by.of(point).iter().for_each(|&view| seen[view as usize].push(point));
    }
    let asked = dataset.train.iter().zip(&seen).filter(|(_, points)| points.len() >= FEWEST_POINTS);
    let asked: Vec<(&View, &Vec<usize>)> = asked.collect();
    let (views, seen): (Vec<&View>, Vec<&Vec<usize>>) = sampled(asked.len()).map(|index| asked[index]).unzip();
    let mut sums = Vec::with_capacity(views.len());
    for ((View { camera, .. }, picture), seen) in pictures(views).zip(seen) {
        let picture = picture?;
        let brightness = |colour: [f32; 3]| colour.into_iter().map(f64::from).sum::<f64>();
        let (mut count, mut in_photograph, mut of_points) = (0, 0.0, 0.0);
        for &point in seen {
            let world = glam::Vec3::from_array(points.positions[point]).as_dvec3();
            let Some((pixel, _)) = camera.pixel(world).filter(|(pixel, _)| picture.counts(*pixel)) else { continue };
            count += 1;
            in_photograph += brightness(picture.colour(pixel));
            of_points += brightness(points.colours[point]);
        }
        sums.push((count, in_photograph, of_points));
    }
    let is_known = |&(count, shown, own): &(usize, f64, f64)| count >= FEWEST_POINTS && shown > 0.0 && own > 0.0;
    let stops: Vec<f64> = sums.into_iter().filter(is_known).map(|(_, shown, own)| (shown / own).log2()).collect();
    if stops.len() < 2 {
        return Ok(None);
    }
    let mean = stops.iter().sum::<f64>() / stops.len() as f64;
    let squares: f64 = stops.iter().map(|stop| (stop - mean).powi(2)).sum();
    Ok(Some((squares / (stops.len() - 1) as f64).sqrt()))
}

#[cfg(test)]
mod tests {
    use burn::tensor::DType;

    use super::*;
    use crate::dataset::{BuiltinOptions, Tracks, builtin};

    const CHANGE: Correction = Correction { gain: [0.75, 1.0, 1.5], offset: [0.05, -0.1, 0.0] };

    fn picture(values: &[f32], [height, width]: [usize; 2]) -> Tensor<3> {
        Tensor::from_data(TensorData::new(values.to_vec(), [3, height, width]), (&Device::flex(), DType::F32))
    }

    fn assert_close(found: &[f64], expected: &[f64], tolerance: f64) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < tolerance, "{found}, expected {expected}");
        }
    }

    #[test]
    fn a_known_correction_is_found_again_and_undone() {
        let values: Vec<f32> = (0..3 * 4 * 5).map(|i| (i * 37 % 101) as f32 / 101.0).collect();
        let image = picture(&values, [4, 5]);
        let photograph = CHANGE.applied(image.clone());
        let found = Correction::fitted(&image, &photograph, None);
        assert_close(&found.gain, &CHANGE.gain, 1e-5);
        assert_close(&found.offset, &CHANGE.offset, 1e-5);
        let undone: Vec<f64> = tensor_to_rows(&CHANGE.undone(photograph.clone())).iter().map(|&v| v.into()).collect();
        let expected: Vec<f64> = values.iter().map(|&v| v.into()).collect();
        assert_close(&undone, &expected, 1e-6);
        let rows = tensor_to_rows(&photograph);
        let undone = CHANGE.undone_colour([rows[7], rows[27], rows[47]]).map(f64::from);
        assert_close(&undone, &[expected[7], expected[27], expected[47]], 1e-6);
    }

    #[test]
    fn pixels_that_do_not_count_are_not_fitted() {
        let values: Vec<f32> = (0..3 * 4 * 5).map(|i| (i * 37 % 101) as f32 / 101.0).collect();
        let image = picture(&values, [4, 5]);
        let counted: Vec<bool> = (0..4 * 5).map(|pixel| pixel % 5 != 2).collect();
        let mut garbage = tensor_to_rows(&CHANGE.applied(image.clone()));
        garbage.iter_mut().skip(2).step_by(5).for_each(|value| *value = 9.0);
        let found = Correction::fitted(&image, &picture(&garbage, [4, 5]), Some(&counted));
        assert_close(&found.gain, &CHANGE.gain, 1e-5);
        assert_close(&found.offset, &CHANGE.offset, 1e-5);
    }

    #[test]
    fn what_no_exposure_does_is_not_fitted() {
        let ramp = [0.1, 0.2, 0.3, 0.4];
        let image = picture(&[ramp, ramp, [0.5; 4]].concat(), [2, 2]);
        let photograph =
            picture(&[[0.9, 0.6, 0.3, 0.0], [0.0, 1.0, 2.0, 3.0], [0.25, 0.5, 0.25, 0.5]].concat(), [2, 2]);
        let found = Correction::fitted(&image, &photograph, None);
        assert_close(&found.gain, &[0.25, 4.0, 1.0], 1e-6);
        // the means agree all the same
        assert_close(&found.offset, &[0.45 - 0.0625, 1.5 - 1.0, 0.375 - 0.5], 1e-6);
    }

    #[test]
    fn photographs_are_seen_without_what_their_exposure_has_changed() {
        let options =
            BuiltinOptions { width: 6, height: 4, train_views: 2, test_views: 0, points: 0, ..Default::default() };
        let dataset = builtin(&options);
        let unchanged = Correction { gain: [1.0; 3], offset: [0.0; 3] };
        let device = Device::flex();
        for (view, correction) in dataset.train.iter().zip([unchanged, CHANGE]) {
            let views = [None, Some(&correction)].map(|correction| Seen::by(view, correction).unwrap());
            let targets = views.each_ref().map(|seen| tensor_to_rows(&seen.target(&device).image));
            for pixel in [0, 13, 23] {
                let [plain, undone] = views.each_ref().map(|seen| seen.colour(pixel));
                assert_eq!(plain, view.picture().unwrap().rgb(pixel % 6, pixel / 6));
                for (channel, (plain, undone)) in plain.into_iter().zip(undone).enumerate() {
                    assert_eq!(plain, targets[0][channel * 24 + pixel]);
                    assert!((undone - targets[1][channel * 24 + pixel]).abs() < 1e-6);
                }
                assert_eq!(plain == undone, correction == unchanged);
            }
        }
    }

    #[test]
    fn the_spread_of_brightness_is_that_of_the_exposures() {
        let spread = |exposure_stops: f64| {
            let options = BuiltinOptions { test_views: 0, exposure_stops, ..Default::default() };
            brightness_spread(&builtin(&options)).unwrap()
        };
        let (equal, different) = (spread(0.0).unwrap(), spread(1.0).unwrap());
        assert!(equal < 0.05 && different > 0.12, "{equal}, {different}");
        let mut unknown = builtin(&BuiltinOptions { test_views: 0, points: 30, ..Default::default() });
        unknown.points.seen_by = Tracks::default();
        assert_eq!(brightness_spread(&unknown).unwrap(), None);
    }
}

//! Depth maps beside the photographs as targets for the depth of a training view.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::Camera;
use dpges_core::counters::transfers::upload;
use dpges_core::losses::depth::{depth_map, fitted_disparity};
use glam::Vec3;

use crate::dataset::{Dataset, DepthKind, DepthMap, View};

/// Fewest points of the dataset that give a relative map its scale and shift. Otherwise the render does.
const FEWEST_POINTS: usize = 16;
/// Factor up to which metric depths may differ from those of points in the median.
const SAME_UNIT: f64 = 1.5;
/// Variance up to which relative values, which reach 1, are all the same: no line through them means anything.
const FLAT: f64 = 1e-8;

/// For the relative map of each training view the scale and the shift that the points of the dataset give it, if they
/// do: disparity, in 1 / world units, = scale · value + shift.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMaps(Vec<Option<[f64; 2]>>);

/// The depth map of one view in one step.
#[derive(Clone, Debug)]
pub struct DepthTarget {
    /// [1, H, W] disparities, in 1 / world units or relative; 0 where unknown.
    values: Tensor<3>,
    /// Whether only the render can give them a scale and a shift.
    is_relative: bool,
    pub weight: f64,
}

impl DepthTarget {
    /// The loss, without its weight, of the rendered expected `depth`, world units, and its `coverage`, both [1, H, W]; 0 where there
    /// is nothing.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if the render has another size.
    pub fn loss(&self, depth: Tensor<3>, coverage: Tensor<3>) -> dpges_core::Result<Tensor<1>> {
        let disparity = if self.is_relative {
            fitted_disparity(self.values.clone(), depth.clone(), coverage.clone())?
        } else {
            self.values.clone()
        };
        depth_map(depth, coverage, disparity)
    }
}

impl DepthMaps {
    /// `None` if no training view has a map.
    pub fn new(dataset: &Dataset) -> Option<Self> {
        let maps = dataset.train.iter().filter_map(|view| view.depth.as_ref());
        let (count, relative) = (maps.clone().count(), maps.filter(|map| map.kind == DepthKind::Relative).count());
        if count == 0 {
            return None;
        }
        let empty = empty(dataset);
        if let Some(first) = empty.first() {
            tracing::warn!(
                "{} of {count} depth maps know nothing, that of view `{first}` first: they are 0 wherever the photograph \
                 counts (data.depth)",
                empty.len()
            );
        }
        let pairs = pairs(dataset);
        contradictions(dataset, &pairs).iter().for_each(|found| tracing::warn!("{found} (data.depth)"));
        let is_relative = |view: &View| view.depth.as_ref().is_some_and(|map| map.kind == DepthKind::Relative);
        let of_view = |(view, pairs): (&View, &Vec<[f64; 2]>)| is_relative(view).then(|| rising_line(pairs)).flatten();
        let fits: Vec<Option<[f64; 2]>> = dataset.train.iter().zip(&pairs).map(of_view).collect();
        let views = dataset.train.len();
        if relative > 0 {
            let by_points = fits.iter().flatten().count();
            tracing::info!(
                "{count} of {views} training views have depth maps; points of the dataset give {by_points} of them their \
                 scale and shift, the render the others"
            );
        } else {
            tracing::info!("{count} of {views} training views have depth maps");
        }
        Some(Self(fits))
    }

    /// The target from `map`, that of the training view with index `view` and `camera`, on `device`.
    pub fn target(&self, map: &DepthMap, view: usize, camera: &Camera, weight: f64, device: &Device) -> DepthTarget {
        let values = TensorData::new(self.disparities(map, view), [1, camera.height, camera.width]);
        DepthTarget {
            values: Tensor::from_data(upload(values), (device, DType::F32)),
            is_relative: map.kind == DepthKind::Relative && self.0[view].is_none(),
            weight,
        }
    }

    /// [H × W] disparities that `map`, that of the training view with index `view`, has once its scale and shift are known,
    /// or relative ones if only the render can give them these.
    fn disparities(&self, map: &DepthMap, view: usize) -> Vec<f32> {
        let disparity = |value: f64| match (map.kind, self.0[view]) {
            (DepthKind::Metric, _) => value.recip(),
            (DepthKind::Relative, Some([scale, shift])) => (scale * value + shift).max(0.0),
            (DepthKind::Relative, None) => value,
        };
        (0..map.steps.len()).map(|pixel| map.value(pixel).map_or(0.0, |value| disparity(value) as f32)).collect()
    }
}

/// Names of the training views whose maps know nothing.
fn empty(dataset: &Dataset) -> Vec<&str> {
    let is_empty = |view: &&View| view.depth.as_ref().is_some_and(|map| map.steps.iter().all(|&steps| steps == 0));
    dataset.train.iter().filter(is_empty).map(|view| view.name.as_str()).collect()
}

/// Sentences about maps in other units than the points of the dataset, or that are larger where these are farther away.
fn contradictions(dataset: &Dataset, pairs: &[Vec<[f64; 2]>]) -> Vec<String> {
    let of_kind = |wanted: DepthKind| {
        let views = dataset.train.iter().zip(pairs);
        views.filter(move |(view, _)| view.depth.as_ref().is_some_and(|map| map.kind == wanted)).map(|(_, pairs)| pairs)
    };
    let mut found = Vec::new();
    let mut ratios: Vec<f64> =
        of_kind(DepthKind::Metric).flatten().map(|[depth, disparity]| depth * disparity).collect();
    if ratios.len() >= FEWEST_POINTS {
        let middle = ratios.len() / 2;
        let (_, &mut ratio, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
        if !(1.0 / SAME_UNIT..=SAME_UNIT).contains(&ratio) {
            found.push(format!(
                "depth maps are {ratio:.3} times as far, in the median, as the points of the dataset: are they depths, not \
                 their inverses, and in its units (`depth_unit_scale_factor`)?"
            ));
        }
    }
    let judged: Vec<_> = of_kind(DepthKind::Relative).filter(|pairs| pairs.len() >= FEWEST_POINTS).collect();
    let falling = judged.iter().filter(|pairs| rising_line(pairs).is_none()).count();
    if 2 * falling > judged.len() {
        found.push(format!(
            "{falling} of {} depth maps are not larger where points of the dataset are nearer: turn them round, near is white",
            judged.len()
        ));
    }
    found
}

/// For each training view the values of its map at points of `dataset` that it saw, and their disparities.
fn pairs(dataset: &Dataset) -> Vec<Vec<[f64; 2]>> {
    let mut pairs = vec![Vec::new(); dataset.train.len()];
    for (position, seen_by) in dataset.points.positions.iter().zip(dataset.points.seen_by.iter()) {
        let world = Vec3::from_array(*position).as_dvec3();
        for &view in seen_by {
            let View { camera, depth, .. } = &dataset.train[view as usize];
            let Some(map) = depth else { continue };
            let Some((pixel, z)) = camera.pixel(world) else { continue };
            pairs[view as usize].extend(map.value(pixel).map(|value| [value, z.recip()]));
        }
    }
    pairs
}

/// Slope and intercept of the line through `pairs` by least squares, if there are enough of them, with different values of
/// the map, and it rises.
fn rising_line(pairs: &[[f64; 2]]) -> Option<[f64; 2]> {
    if pairs.len() < FEWEST_POINTS {
        return None;
    }
    let mean = |of: usize| pairs.iter().map(|pair| pair[of]).sum::<f64>() / pairs.len() as f64;
    let (mean_x, mean_y) = (mean(0), mean(1));
    let sum = |of: fn(f64, f64) -> f64| pairs.iter().map(|[x, y]| of(x - mean_x, y - mean_y)).sum::<f64>();
    let variance = sum(|x, _| x * x);
    let slope = sum(|x, y| x * y) / variance;
    let rises = variance > FLAT * pairs.len() as f64 && slope > 0.0;
    rises.then_some([slope, mean_y - slope * mean_x])
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::tensors::tensor_to_rows;

    use super::*;
    use crate::dataset::{BuiltinOptions, builtin, builtin_geometry};
    use crate::run::fixtures::options;

    fn dataset(kind: DepthKind) -> Dataset {
        builtin(&BuiltinOptions { depth: Some(kind), ..options(48, [3, 0], 600) })
    }

    /// Median of the relative errors of the disparities of view `view` as depths.
    fn median_error(dataset: &Dataset, disparities: &[f32], view: usize) -> f64 {
        let (depth, _) = builtin_geometry(&dataset.train[view].camera);
        let error = |(z, d): (&f32, &f32)| f64::from((z * d - 1.0).abs());
        let mut errors: Vec<f64> = depth.iter().zip(disparities).map(error).collect();
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    }

    #[test]
    fn points_give_relative_maps_their_scale_and_shift() {
        let dataset = dataset(DepthKind::Relative);
        let maps = DepthMaps::new(&dataset).unwrap();
        for (view, map) in dataset.train.iter().map(|view| view.depth.as_ref().unwrap()).enumerate() {
            assert!(maps.0[view].is_some());
            let error = median_error(&dataset, &maps.disparities(map, view), view);
            assert!(error < 0.05, "view {view}: {error}");
        }
    }

    #[test]
    fn maps_that_contradict_the_points_are_said() {
        for (kind, said) in
            [(DepthKind::Metric, "0.100 times as far"), (DepthKind::Relative, "3 of 3 depth maps are not larger")]
        {
            let mut dataset = dataset(kind);
            let found = |dataset: &Dataset| contradictions(dataset, &pairs(dataset));
            assert_eq!(found(&dataset), [""; 0]);
            for map in dataset.train.iter_mut().map(|view| view.depth.as_mut().unwrap()) {
                if kind == DepthKind::Metric {
                    map.step *= 0.1;
                } else {
                    map.steps = map.steps.iter().map(|&steps| u16::MAX - steps).collect();
                }
            }
            let found = found(&dataset);
            assert!(found.len() == 1 && found[0].contains(said), "{found:?}");
        }
    }

    #[test]
    fn metric_maps_need_no_points() {
        let mut dataset = dataset(DepthKind::Metric);
        dataset.points.positions.clear();
        let maps = DepthMaps::new(&dataset).unwrap();
        let map = dataset.train[1].depth.as_ref().unwrap();
        assert!(median_error(&dataset, &maps.disparities(map, 1), 1) < 1e-3);
        dataset.train.iter_mut().for_each(|view| view.depth = None);
        assert_eq!(DepthMaps::new(&dataset), None);
    }

    #[test]
    fn without_points_the_render_gives_them() {
        let mut dataset = dataset(DepthKind::Relative);
        dataset.points.positions.clear();
        let maps = DepthMaps::new(&dataset).unwrap();
        assert_eq!(maps.0, [None; 3]);
        let map = dataset.train[0].depth.as_ref().unwrap();
        let device = Device::flex();
        let tensor =
            |values: Vec<f32>| Tensor::<3>::from_data(TensorData::new(values, [1, 48, 48]), (&device, DType::F32));
        let target = DepthTarget { values: tensor(maps.disparities(map, 0)), is_relative: true, weight: 1.0 };
        let (depth, _) = builtin_geometry(&dataset.train[0].camera);
        let loss =
            |depth: Vec<f32>| tensor_to_rows(&target.loss(tensor(depth), tensor(vec![1.0; 48 * 48])).unwrap())[0];
        let right = loss(depth.clone());
        // of any size, but not of another shape
        let twice = loss(depth.iter().map(|z| 2.0 * z).collect());
        let bent = loss(depth.iter().enumerate().map(|(at, z)| z * (1.0 + 0.5 * (at % 48) as f32 / 48.0)).collect());
        assert!(right < 1e-3 && twice < 1e-3 && bent > 0.01, "{right} {twice} {bent}");
    }

    #[test]
    fn lines_that_fall_or_have_few_points_are_none() {
        let line = |slope: f64, count: usize| {
            let pairs: Vec<[f64; 2]> = (0..count).map(|i| [i as f64, slope * i as f64 + 0.5]).collect();
            rising_line(&pairs)
        };
        let [slope, shift] = line(0.25, 16).unwrap();
        assert!((slope - 0.25).abs() < 1e-12 && (shift - 0.5).abs() < 1e-12);
        assert_eq!((line(0.25, 15), line(-0.25, 16), rising_line(&[[1.0, 2.0]; 20])), (None, None, None));
        // one value, whose mean is rounded
        let flat: Vec<[f64; 2]> = (0..50).map(|i| [12_345.0 / 65_535.0, 0.1 + 0.01 * f64::from(i)]).collect();
        assert_eq!(rising_line(&flat), None);
    }

    #[test]
    fn maps_of_one_value_and_maps_that_know_nothing_give_no_disparities() {
        let mut dataset = dataset(DepthKind::Relative);
        for (view, steps) in dataset.train.iter_mut().zip([0, 12_345]) {
            let map = view.depth.as_mut().unwrap();
            map.steps = vec![steps; map.steps.len()].into();
        }
        assert_eq!(empty(&dataset), [dataset.train[0].name.as_str()]);
        let maps = DepthMaps::new(&dataset).unwrap();
        assert_eq!(maps.0.iter().map(Option::is_some).collect::<Vec<_>>(), [false, false, true]);
        let known = |view: usize| {
            let map = dataset.train[view].depth.as_ref().unwrap();
            maps.disparities(map, view).iter().any(|&disparity| disparity > 0.0)
        };
        assert_eq!([0, 1, 2].map(known), [false, true, true]);
    }
}

//! Spherical Beta lobes that a primitive can do without: those that no view shows, and those that look the same from
//! everywhere, which the base colour takes over.

use std::array::from_fn;

use dpges_core::scene::lobes::{ABSENT_LOBE, LOBE_LEN, is_absent, lobe_axis, softplus};
use dpges_core::scene::{ColourData, ColourModel, SH_C0};
use rayon::prelude::*;

use crate::dataset::neighbours::as_points;

/// Why a lobe can go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Redundancy {
    /// It adds less than the threshold to every channel, whatever camera looks.
    Idle,
    /// Its contribution differs by less than the threshold between cameras: its mean red, green and blue.
    Constant([f64; 3]),
}

/// A lobe that can go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RedundantLobe {
    pub row: usize,
    /// Index among the primitive's lobes.
    pub lobe: usize,
    pub why: Redundancy,
}

/// How many lobes were dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Without replacement.
    pub idle: usize,
    /// Into the base colour.
    pub folded: usize,
}

/// The lobes that can go from primitives at `positions` [N × 3] with room for `lobes`, by row and lobe: what one adds
/// to the colour, `softplus(rgb) max(0, d·μ)^(4 e^β)` (DBS), is below `threshold` in every camera, or differs by less
/// than that between any two. Each of them changes the colour in any camera by less than `threshold`.
///
/// `camera_centres` in world units, like the positions: all that may look, as nothing is asked about what they see.
/// Without any, no lobe goes. Absent lobes have gone before.
pub fn redundant_lobes(
    positions: &[f32],
    colour: &ColourData,
    lobes: usize,
    camera_centres: &[[f64; 3]],
    threshold: f64,
) -> Vec<RedundantLobe> {
    if camera_centres.is_empty() {
        return Vec::new();
    }
    let (all, _) = colour.detail.as_chunks::<LOBE_LEN>();
    let of_primitive = |(row, position): (usize, &[f32; 3])| {
        let directions: Vec<[f64; 3]> = camera_centres.iter().map(|centre| direction(position, centre)).collect();
        let raw = all[row * lobes..(row + 1) * lobes].iter().enumerate();
        raw.filter_map(move |(lobe, raw)| Some(RedundantLobe { row, lobe, why: judge(raw, &directions, threshold)? }))
    };
    as_points(positions).par_iter().enumerate().flat_map_iter(of_primitive).collect()
}

/// Drops the lobes in `redundant` from primitives with room for `lobes`: they become [`ABSENT_LOBE`], and what is constant
/// about them part of the base colour.
pub fn drop_lobes(colour: &mut ColourData, lobes: usize, redundant: &[RedundantLobe]) -> Dropped {
    let mut dropped = Dropped::default();
    for &RedundantLobe { row, lobe, why } in redundant {
        match why {
            Redundancy::Idle => dropped.idle += 1,
            Redundancy::Constant(mean) => {
                let base = &mut colour.base[row * 3..][..3];
                base.iter_mut().zip(mean).for_each(|(base, mean)| *base += (mean / SH_C0) as f32);
                dropped.folded += 1;
            }
        }
        colour.detail[(row * lobes + lobe) * LOBE_LEN..][..LOBE_LEN].copy_from_slice(&ABSENT_LOBE);
    }
    dropped
}

/// The `keep` lobes of every primitive that differ most between cameras, in their order; what the others add in the
/// mean over the cameras becomes part of the base colour. `positions`, `colour`, `lobes` and `camera_centres` are those
/// of [`redundant_lobes`], and there is at least one camera. The result has room for `keep` lobes.
pub fn keep_lobes(
    positions: &[f32],
    colour: &ColourData,
    lobes: usize,
    camera_centres: &[[f64; 3]],
    keep: usize,
) -> ColourData {
    let (all, _) = colour.detail.as_chunks::<LOBE_LEN>();
    let of_primitive = |(row, position): (usize, &[f32; 3])| {
        let directions: Vec<[f64; 3]> = camera_centres.iter().map(|centre| direction(position, centre)).collect();
        let raw = &all[row * lobes..(row + 1) * lobes];
        // absent lobes come behind those that do not change at all
        let change = |raw: &[f32; LOBE_LEN]| if is_absent(raw) { -1.0 } else { Lit::new(raw).change(&directions) };
        let changes: Vec<f64> = raw.iter().map(change).collect();
        let mut order: Vec<usize> = (0..lobes).collect();
        order.sort_by(|&a, &b| changes[b].total_cmp(&changes[a]));
        let (kept, others) = order.split_at_mut(keep.min(lobes));
        kept.sort_unstable();
        let mut base: [f32; 3] = from_fn(|channel| colour.base[3 * row + channel]);
        for lobe in others.iter().map(|&lobe| &raw[lobe]).filter(|raw| !is_absent(&raw[..])).map(Lit::new) {
            let mean = lobe.mean(&directions);
            base.iter_mut().zip(lobe.colour).for_each(|(base, channel)| *base += (channel * mean / SH_C0) as f32);
        }
        let mut detail: Vec<f32> = kept.iter().flat_map(|&lobe| raw[lobe]).collect();
        detail.extend([ABSENT_LOBE].repeat(keep.saturating_sub(lobes)).as_flattened());
        (base, detail)
    };
    let primitives: Vec<_> = as_points(positions).par_iter().enumerate().map(of_primitive).collect();
    ColourData::new(
        ColourModel::SphericalBeta { lobes: keep },
        primitives.iter().flat_map(|(base, _)| *base).collect(),
        primitives.into_iter().flat_map(|(_, detail)| detail).collect(),
    )
}

/// Whether the lobe `raw` can go if it is seen in `directions`, and why.
fn judge(raw: &[f32; LOBE_LEN], directions: &[[f64; 3]], threshold: f64) -> Option<Redundancy> {
    if is_absent(raw) {
        return None;
    }
    let lobe = Lit::new(raw);
    let (_, most) = lobe.extremes(directions);
    if lobe.largest() * most < threshold {
        return Some(Redundancy::Idle);
    }
    if lobe.change(directions) < threshold {
        let mean = lobe.mean(directions);
        return Some(Redundancy::Constant(lobe.colour.map(|channel| channel * mean)));
    }
    None
}

/// A lobe as it is rendered: `colour max(0, d·axis)^exponent` in direction d.
struct Lit {
    colour: [f64; 3],
    axis: [f64; 3],
    exponent: f64,
}

impl Lit {
    fn new(raw: &[f32; LOBE_LEN]) -> Self {
        let [red, green, blue, theta, phi, beta] = raw.map(f64::from);
        Self { colour: [red, green, blue].map(softplus), axis: lobe_axis(theta, phi), exponent: 4.0 * beta.exp() }
    }

    fn largest(&self) -> f64 {
        self.colour.into_iter().fold(0.0, f64::max)
    }

    fn cosine(&self, d: &[f64; 3]) -> f64 {
        (d[0] * self.axis[0] + d[1] * self.axis[1] + d[2] * self.axis[2]).clamp(0.0, 1.0)
    }

    /// The share of its colour that it adds at an angle to its axis.
    fn share(&self, cosine: f64) -> f64 {
        if cosine > 0.0 { cosine.powf(self.exponent) } else { 0.0 }
    }

    /// The least and the largest share over `directions`.
    fn extremes(&self, directions: &[[f64; 3]]) -> (f64, f64) {
        let cosines = directions.iter().map(|d| self.cosine(d));
        // the share rises with the cosine: two powers in place of one for every camera
        let (least, most) = cosines.fold((1.0, 0.0), |(least, most): (f64, f64), c| (least.min(c), most.max(c)));
        (self.share(least), self.share(most))
    }

    /// Largest difference between two of `directions`, in units of colour.
    fn change(&self, directions: &[[f64; 3]]) -> f64 {
        let (least, most) = self.extremes(directions);
        self.largest() * (most - least)
    }

    /// Mean share over `directions`.
    fn mean(&self, directions: &[[f64; 3]]) -> f64 {
        directions.iter().map(|d| self.share(self.cosine(d))).sum::<f64>() / directions.len() as f64
    }
}

/// Unit vector from a camera to a primitive; zero at the camera itself.
fn direction(position: &[f32; 3], centre: &[f64; 3]) -> [f64; 3] {
    let offset: [f64; 3] = from_fn(|axis| f64::from(position[axis]) - centre[axis]);
    let length = offset.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-12);
    offset.map(|x| x / length)
}

#[cfg(test)]
mod tests {
    use burn::tensor::DType;
    use dpges_core::ops::colour::colour;
    use dpges_core::scene::Colour;
    use dpges_core::scene::tensors::rows_to_tensor;
    use dpges_core::testing::device;
    use dpges_core::testing::golden::values;

    use super::*;

    /// A grey lobe of raw colour `raw` along +z.
    fn along_z(raw: f32, beta: f32) -> [f32; LOBE_LEN] {
        [raw, raw, raw, 0.0, 0.0, beta]
    }

    /// Cameras that look at the origin in directions at these angles, in degrees, to +z.
    fn cameras(angles: &[f64]) -> Vec<[f64; 3]> {
        angles
            .iter()
            .map(|angle| angle.to_radians().sin_cos())
            .map(|(sin, cos)| [-2.0 * sin, 0.0, -2.0 * cos])
            .collect()
    }

    fn at_origin(lobes: &[[f32; LOBE_LEN]]) -> ColourData {
        ColourData { base: vec![0.0; 3], detail: lobes.as_flattened().to_vec(), ..ColourData::default() }
    }

    #[test]
    fn a_lobe_is_idle_below_the_threshold_in_every_camera() {
        // 0.1 · 0.5⁴ at 60°, nothing at 90° and beyond
        let colour = at_origin(&[along_z(0.0, 0.0)]);
        let found = |threshold| redundant_lobes(&[0.0; 3], &colour, 1, &cameras(&[60.0, 90.0, 180.0]), threshold);
        assert_eq!(found(0.006_26), [RedundantLobe { row: 0, lobe: 0, why: Redundancy::Idle }]);
        assert!(found(0.006_24).is_empty());
        // seen from straight ahead it is worth 0.1
        assert!(redundant_lobes(&[0.0; 3], &colour, 1, &cameras(&[60.0, 0.0]), 0.0937).is_empty());
        assert!(redundant_lobes(&[0.0; 3], &colour, 1, &[], 1.0).is_empty());
    }

    #[test]
    fn a_constant_lobe_goes_into_the_base_colour() {
        // 0.1 · t^(4 e^−6): 0.1 straight ahead, 0.1 · 2^(−0.009915) at 60°
        let mut colour = at_origin(&[along_z(-20.0, 1.0), along_z(0.0, -6.0)]);
        let cameras = cameras(&[0.0, 60.0]);
        assert!(redundant_lobes(&[0.0; 3], &colour, 2, &cameras, 6.8e-4).is_empty());
        let redundant = redundant_lobes(&[0.0; 3], &colour, 2, &cameras, 6.9e-4);
        let [RedundantLobe { row: 0, lobe: 1, why: Redundancy::Constant(mean) }] = redundant[..] else {
            panic!("{redundant:?}")
        };
        assert!(mean.iter().all(|channel| (channel - 0.099_657_5).abs() < 1e-6), "{mean:?}");

        assert_eq!(drop_lobes(&mut colour, 2, &redundant), Dropped { idle: 0, folded: 1 });
        let expected = (0.099_657_5 / SH_C0) as f32;
        assert!(colour.base.iter().all(|base| (base - expected).abs() < 1e-5), "{:?}", colour.base);
        assert_eq!(colour.detail[6..], ABSENT_LOBE);
        assert!(redundant_lobes(&[0.0; 3], &colour, 2, &cameras, 1.0).is_empty());
    }

    #[test]
    fn rows_and_lobes_are_told_apart() {
        let (bright, dim) = (along_z(1.0, 0.0), along_z(-2.0, 0.0));
        let mut colour = ColourData {
            base: vec![0.0; 9],
            detail: [bright, dim, bright, bright, dim, bright].concat(),
            ..ColourData::default()
        };
        let redundant = redundant_lobes(&[0.0; 9], &colour, 2, &cameras(&[0.0, 90.0]), 0.01);
        let idle = |row, lobe| RedundantLobe { row, lobe, why: Redundancy::Idle };
        assert_eq!(redundant, [idle(0, 1), idle(2, 0)]);
        assert_eq!(drop_lobes(&mut colour, 2, &redundant), Dropped { idle: 2, folded: 0 });
        let gone = ABSENT_LOBE;
        assert_eq!(colour.detail, [bright, gone, bright, bright, gone, bright].concat());
        assert_eq!(colour.base, [0.0; 9]);
        let plain = ColourData { base: vec![0.0; 9], ..ColourData::default() };
        assert!(redundant_lobes(&[0.0; 9], &plain, 0, &cameras(&[0.0]), 1.0).is_empty());
    }

    #[test]
    fn the_lobes_that_change_most_are_kept_and_the_mean_of_others_goes_into_the_base_colour() {
        // seen from 0° and 60°: the first changes by 0.09375, the second by less than 7e-4, the third is absent
        let (sharp, flat) = (along_z(0.0, 0.0), along_z(0.0, -6.0));
        let colour = at_origin(&[flat, sharp, ABSENT_LOBE]);
        let cameras = cameras(&[0.0, 60.0]);
        let kept = keep_lobes(&[0.0; 3], &colour, 3, &cameras, 1);
        assert_eq!((kept.model, &kept.detail[..]), (ColourModel::SphericalBeta { lobes: 1 }, &sharp[..]));
        let expected = (0.099_657_5 / SH_C0) as f32;
        assert!(kept.base.iter().all(|base| (base - expected).abs() < 1e-5), "{:?}", kept.base);
        assert_eq!(keep_lobes(&[0.0; 3], &colour, 3, &cameras, 2).detail, [flat, sharp].concat());
        let none = keep_lobes(&[0.0; 3], &colour, 3, &cameras, 0);
        // the mean of the sharp one is 0.1 (1 + 1/16) / 2
        let expected = ((0.099_657_5 + 0.053_125) / SH_C0) as f32;
        assert!(none.detail.is_empty() && none.base.iter().all(|base| (base - expected).abs() < 1e-5), "{none:?}");
        let all = keep_lobes(&[0.0; 3], &colour, 3, &cameras, 3);
        assert_eq!((&all.base, &all.detail), (&colour.base, &colour.detail));
        let more = keep_lobes(&[0.0; 3], &colour, 3, &cameras, 4);
        assert_eq!(more.detail, [flat, sharp, ABSENT_LOBE, ABSENT_LOBE].concat());
    }

    /// Colours [N × 3] from `centre`.
    fn seen(data: &ColourData, positions: &[f32], lobes: usize, centre: [f64; 3]) -> Vec<f64> {
        let device = device();
        let tensor = |rows: &[f32], width| rows_to_tensor(rows, width, &device, DType::F32);
        let model = ColourModel::SphericalBeta { lobes };
        let of = Colour::new(model, tensor(&data.base, 3), tensor(&data.detail, model.detail_len()));
        values(&colour(&of, &tensor(positions, 3), centre).unwrap())
    }

    #[test]
    fn no_camera_sees_a_primitive_change_by_more_than_the_threshold_per_lobe() {
        const THRESHOLD: f64 = 0.02;
        let (count, lobes) = (60, 2);
        let wave = |i: usize, pace: f64, from: f64, to: f64| {
            (from + (to - from) * (0.5 + 0.5 * (i as f64 * pace).sin())) as f32
        };
        let positions: Vec<f32> = (0..3 * count).map(|i| wave(i, 1.3, -1.0, 1.0)).collect();
        let lobe = |i: usize| {
            let raw = [0.37, 0.41, 0.43].map(|pace| wave(i, pace, -1.0, 0.4));
            [raw[0], raw[1], raw[2], wave(i, 0.91, 0.0, 3.1), wave(i, 0.77, -3.1, 3.1), wave(i, 1.7, -6.0, 3.0)]
        };
        let detail: Vec<f32> = (0..count * lobes).flat_map(lobe).collect();
        let before = ColourData { base: vec![0.1; 3 * count], detail, ..ColourData::default() };
        let cameras: Vec<[f64; 3]> =
            (0..7).map(|i| f64::from(i) * 0.4).map(|angle| [5.0 * angle.cos(), 5.0 * angle.sin(), 1.0]).collect();

        let redundant = redundant_lobes(&positions, &before, lobes, &cameras, THRESHOLD);
        let mut after = before.clone();
        let dropped = drop_lobes(&mut after, lobes, &redundant);
        assert!(dropped.idle > 10 && dropped.folded > 2 && redundant.len() < count * lobes - 10, "{dropped:?}");
        assert_eq!(dropped.idle + dropped.folded, redundant.len());
        for centre in cameras {
            let (old, new) = (seen(&before, &positions, lobes, centre), seen(&after, &positions, lobes, centre));
            for (at, (old, new)) in old.iter().zip(&new).enumerate() {
                let gone = redundant.iter().filter(|redundant| redundant.row == at / 3).count() as f64;
                assert!((old - new).abs() <= gone * THRESHOLD + 1e-6, "row {}: {old} became {new}", at / 3);
            }
        }
    }
}

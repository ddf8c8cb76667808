//! Points of a cloud as they are read: no more than a number of them, whatever the size of the file.

use std::collections::HashSet;

use glam::DVec3;

use super::super::ply::GREY;
use super::super::source::RawPoints;
use crate::Tracks;

/// Each time that there are too many, voxels grow by this: to about half the points on surfaces.
const GROWTH: f64 = std::f64::consts::SQRT_2;

/// The first point in each voxel. A scan has most of its points beside the scanner, and thinned so has them alike everywhere.
pub(super) struct Kept {
    most: usize,
    /// Side of the voxels, world units; 0 as long as all points are kept.
    pub side: f64,
    voxels: HashSet<[i64; 3]>,
    pub positions: Vec<DVec3>,
    /// In the unit of the file; NaN where there is none.
    colours: Vec<[f32; 3]>,
    /// Points that were offered, and those of them that say that they are none.
    pub all: u64,
    pub invalid: u64,
}

impl Kept {
    pub fn new(most: usize) -> Self {
        let (voxels, positions, colours) = Default::default();
        Self { most, side: 0.0, voxels, positions, colours, all: 0, invalid: 0 }
    }

    /// Takes a point; `None` for one that the file marks as invalid.
    pub fn offer(&mut self, position: Option<DVec3>, colour: [f32; 3]) {
        self.all += 1;
        let Some(position) = position.filter(|position| position.is_finite()) else {
            self.invalid += 1;
            return;
        };
        if self.side > 0.0 && !self.voxels.insert(voxel(position, self.side)) {
            return;
        }
        self.positions.push(position);
        self.colours.push(colour);
        while self.positions.len() > self.most {
            self.coarsen();
        }
    }

    fn coarsen(&mut self) {
        let (low, high) = bounds(&self.positions);
        // as many on a square as wide as all of them
        let guess = (high - low).max_element() / (self.most as f64).sqrt();
        self.side = (GROWTH * self.side).max(guess).max(f64::MIN_POSITIVE);
        self.voxels.clear();
        let mut next = 0;
        for row in 0..self.positions.len() {
            if self.voxels.insert(voxel(self.positions[row], self.side)) {
                (self.positions[next], self.colours[next]) = (self.positions[row], self.colours[row]);
                next += 1;
            }
        }
        self.positions.truncate(next);
        self.colours.truncate(next);
    }

    /// The largest channel of a colour, in the unit of the file; 0 without colours.
    pub fn brightest(&self) -> f32 {
        self.colours.as_flattened().iter().copied().fold(0.0, f32::max)
    }

    /// Colours relative to `white`, in the unit of the file, grey where there are none.
    pub fn into_points(self, white: f32) -> RawPoints {
        let of_white = |channel: f32| {
            let relative = channel / white;
            if relative.is_nan() { GREY } else { relative.clamp(0.0, 1.0) }
        };
        let colours = self.colours.into_iter().map(|colour| colour.map(of_white)).collect();
        RawPoints { positions: self.positions, colours, seen_by: Tracks::default() }
    }
}

fn voxel(position: DVec3, side: f64) -> [i64; 3] {
    (position / side).to_array().map(|number| number.floor() as i64)
}

/// The corners of the box around `positions`.
pub(super) fn bounds<'a>(positions: impl IntoIterator<Item = &'a DVec3>) -> (DVec3, DVec3) {
    let nothing = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    positions.into_iter().fold(nothing, |(low, high), &position| (low.min(position), high.max(position)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_many_points_are_thinned_alike_everywhere() {
        // a plane of 4 x 4 with a dense corner, far from the origin
        let origin = DVec3::new(5e6, -4e6, 300.0);
        let mut kept = Kept::new(500);
        for at in 0..200 * 200 {
            let unit = DVec3::new(f64::from(at % 200), f64::from(at / 200), 0.0) / 200.0;
            kept.offer(Some(origin + unit * 0.1), [1.0; 3]);
            kept.offer(Some(origin + unit * 4.0), [1.0; 3]);
        }
        let dense = kept.positions.iter().filter(|position| (**position - origin).max_element() < 1.0).count();
        assert!((150..=500).contains(&kept.positions.len()), "{}", kept.positions.len());
        assert!(dense < kept.positions.len() / 8, "{dense} of {}", kept.positions.len());
        assert!((0.1..0.5).contains(&kept.side) && kept.all == 80_000, "{}", kept.side);
    }

    #[test]
    fn few_points_stay_as_they_are_and_invalid_ones_are_counted() {
        let mut kept = Kept::new(3);
        for position in [Some(DVec3::ONE), None, Some(DVec3::NAN), Some(DVec3::ONE), Some(DVec3::X)] {
            kept.offer(position, [f32::NAN, 100.0, 400.0]);
        }
        assert_eq!((kept.all, kept.invalid, kept.side, kept.brightest()), (5, 2, 0.0, 400.0));
        let points = kept.into_points(200.0);
        assert_eq!(points.positions, [DVec3::ONE, DVec3::ONE, DVec3::X]);
        assert_eq!(points.colours, [[GREY, 0.5, 1.0]; 3]);
        // many at one place need no voxels of any size
        let mut alike = Kept::new(3);
        (0..10).for_each(|_| alike.offer(Some(DVec3::ONE), [0.0; 3]));
        assert_eq!(alike.positions, [DVec3::ONE]);
    }
}

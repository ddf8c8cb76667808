//! Shared parts of the readers of splats.

use std::collections::BTreeSet;

use glam::DVec3;

use super::harmonics::{MAX_DEGREE, coefficient_count};
use crate::percentile::percentiles;

/// Largest degree of harmonics that a format has.
const LARGEST_DEGREE: usize = 4;
/// Splats farther than so many of their radii from the origin are recentred, as datasets are.
const FAR: f64 = 100.0;

/// Facts about a file besides its splats.
#[derive(Clone, Debug, Default)]
pub(super) struct Notes {
    pub own: bool,
    /// Splats that were left out.
    pub not_finite: usize,
    /// Degree of harmonics that were left out above [`MAX_DEGREE`].
    pub degree: Option<usize>,
    /// Sentences about what is read in another way than usual.
    pub read_as: BTreeSet<&'static str>,
}

/// The degree to read of splats with `coefficients` above the base colour.
pub(super) fn kept_degree(coefficients: usize, notes: &mut Notes) -> Result<usize, String> {
    let degree = (0..=LARGEST_DEGREE).find(|&degree| coefficient_count(degree) == coefficients + 1);
    let degree = degree.ok_or_else(|| format!("{coefficients} coefficients of harmonics are of no degree"))?;
    notes.degree = (degree > MAX_DEGREE).then_some(degree);
    Ok(degree.min(MAX_DEGREE))
}

/// Positions near the origin, in f32, and where that is: `offset`, or if they are far from there, amid them.
pub(super) fn placed(positions: Vec<DVec3>, offset: DVec3) -> (Vec<[f32; 3]>, [f64; 3]) {
    let along = |axis: usize| percentiles(positions.iter().map(|position| position[axis]).collect(), [0.5]);
    let amid = DVec3::from([0, 1, 2].map(|axis| along(axis).map_or(0.0, |[median]| median)));
    let spread = percentiles(positions.iter().map(|position| (*position - amid).length()).collect(), [0.5]);
    let is_far = spread.is_some_and(|[spread]| amid.length() > FAR * spread);
    let shift = if is_far { amid.round() } else { DVec3::ZERO };
    let near = |position: DVec3| (position - shift).as_vec3().to_array();
    (positions.into_iter().map(near).collect(), (offset + shift).to_array())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_have_degrees_and_the_fifth_band_is_named() {
        let mut notes = Notes::default();
        assert_eq!([0, 3, 8, 15].map(|count| kept_degree(count, &mut notes).unwrap()), [0, 1, 2, 3]);
        assert_eq!((kept_degree(24, &mut notes), notes.degree), (Ok(3), Some(4)));
        assert!(kept_degree(7, &mut notes).is_err());
    }
}

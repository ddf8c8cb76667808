//! Measured points: a cloud of a scanner, a survey or photogrammetry that takes the place of the points of a dataset.

mod e57_file;
mod kept;
mod las_file;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use dpges_core::camera::Camera;
use glam::DVec3;
use rayon::prelude::*;

use self::kept::{Kept, bounds};
use super::ply;
use super::source::RawPoints;
use crate::error::{DatasetError, Result};
use crate::finding::{Kind, Notices};
use crate::neighbours::{Neighbour, Sites};
use crate::{Tracks, sampled};

/// Points that are kept at most, an order more than there are surfels.
const MOST_POINTS: usize = 2_000_000;
/// Most points that are looked up in pictures.
const LOOKED_UP: usize = 20_000;
/// Median distance of the points of the dataset from the measured ones that is named, in extents.
const FAR_OFF: f64 = 0.1;
/// Distance of a point of the dataset from a measured one up to which both are in the same place, in extents.
const SAME_PLACE: f64 = 0.01;

/// The points of the file `path`, up to [`MOST_POINTS`], in the place of the `own` ones of a dataset with these `cameras` and an
/// `extent` in world units. All are in the coordinates of the files. Views that saw one of the `own` saw the one next to it.
///
/// # Errors
/// [`DatasetError::MeasuredPoints`] for a file that is not there, cut short or of another kind, for points that are invalid or all the
/// same, and for those in no picture.
pub(crate) fn read(
    path: &Path,
    cameras: &[Camera],
    own: &RawPoints,
    extent: f64,
    notices: &mut Notices,
) -> Result<RawPoints> {
    let wrong = |reason| DatasetError::MeasuredPoints { path: path.to_owned(), reason };
    let (format, kept, white) = offered(path, MOST_POINTS).map_err(wrong)?;
    let Kept { all, invalid, side, .. } = kept;
    let (low, high) = bounds(&kept.positions);
    if kept.positions.is_empty() || low == high {
        return Err(wrong(format!(
            "do not have two different points: {invalid} of {all} are invalid, the others at one place; export them again"
        )));
    }
    judge_views(&kept.positions, cameras, notices).map_err(wrong)?;
    let next = next_to(&kept.positions, &own.positions);
    judge_distance(&next, extent, notices);
    let mut message = format!("measured points {} ({format}): {} of {all}", path.display(), kept.positions.len());
    if invalid > 0 {
        message += &format!(", without {invalid} invalid ones");
    }
    if side > 0.0 {
        message += &format!(", the first in each voxel of {side:.4} world units");
    }
    notices.add(Kind::Aside, message, "they take the place of the points of the dataset");
    let seen_by = tracks(&next, &own.seen_by, kept.positions.len(), extent);
    Ok(RawPoints { seen_by, ..kept.into_points(white) })
}

/// The format of the file, at most so many of its points, and the white of their colours.
fn offered(path: &Path, most: usize) -> Result<(&'static str, Kept, f32), String> {
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(8).read_to_end(&mut start));
    read.map_err(|error| format!("cannot be read: {error}; restore the file, or name another"))?;
    let mut kept = Kept::new(most);
    let (format, white) = match start.as_slice() {
        [b'p', b'l', b'y', ..] => ("PLY", ply_file(path, &mut kept)),
        b"ASTM-E57" => ("E57", e57_file::read(path, &mut kept).map_err(|error| error.to_string())),
        [b'L', b'A', b'S', b'F', ..] => ("LAS", las_file::read(path, &mut kept).map_err(|error| error.to_string())),
        _ => {
            let found = String::from_utf8_lossy(&start).into_owned();
            return Err(format!(
                "are not PLY, LAS, LAZ or E57: they begin with {found:?}; export them as one of these"
            ));
        }
    };
    let white =
        white.map_err(|error| format!("are truncated or corrupt {format}: {error}; copy or export them again"))?;
    Ok((format, kept, white))
}

fn ply_file(path: &Path, kept: &mut Kept) -> Result<f32, String> {
    let RawPoints { positions, colours, .. } = ply::points(path).map_err(|error| match error {
        DatasetError::Ply { source, .. } => source.to_string(),
        other => other.to_string(),
    })?;
    positions.into_iter().zip(colours).for_each(|(position, colour)| kept.offer(Some(position), colour));
    Ok(1.0)
}

/// Says so if most cameras have none of `positions` in their pictures.
///
/// # Errors
/// The reason, if none has.
fn judge_views(positions: &[DVec3], cameras: &[Camera], notices: &mut Notices) -> Result<(), String> {
    let step = positions.len().div_ceil(LOOKED_UP).max(1);
    let looking: Vec<&Camera> = sampled(cameras.len()).map(|index| &cameras[index]).collect();
    let is_blind = |camera: &&&Camera| positions.iter().step_by(step).all(|&point| camera.pixel(point).is_none());
    let blind = looking.par_iter().filter(is_blind).count();
    if blind == looking.len() {
        let centres: Vec<DVec3> = cameras.iter().map(Camera::centre).collect();
        return Err(format!(
            "are in no picture: they lie in {}, the cameras in {}; export both in the same coordinates, with the same offset, axes and unit",
            ranges(positions),
            ranges(&centres)
        ));
    }
    if 2 * blind > looking.len() {
        let message = format!("{blind} of {} cameras have no measured point in their pictures", looking.len());
        notices.add(Kind::NoPoints, message, "look whether cameras and points have the same coordinates");
    }
    Ok(())
}

/// The measured point next to each of the `own` ones, and their squared distance, world units².
fn next_to(positions: &[DVec3], own: &[DVec3]) -> Vec<Option<Neighbour>> {
    if own.is_empty() {
        return Vec::new();
    }
    // f32 is exact enough beside a point
    let beside = |&point: &DVec3| (point - positions[0]).as_vec3().to_array();
    let sites = Sites::new(&positions.iter().map(beside).collect::<Vec<_>>());
    own.par_iter().map(|point| sites.nearest(beside(point), 1, None).first().copied()).collect()
}

/// Says so if the points of the dataset are far from the measured ones `next` to them.
fn judge_distance(next: &[Option<Neighbour>], extent: f64, notices: &mut Notices) {
    let mut squared: Vec<f32> = next.iter().flatten().map(|&(_, squared)| squared).collect();
    squared.sort_by(f32::total_cmp);
    let median = squared.get(squared.len() / 2).map_or(0.0, |&middle| f64::from(middle).sqrt());
    if median > FAR_OFF * extent {
        let percent = 100.0 * median / extent;
        let message = format!(
            "half the points of the dataset are over {median:.4} world units ({percent:.0} % of the extent) from measured ones"
        );
        notices.add(Kind::OffPose, message, "look whether both have the same coordinates and unit");
    }
}

/// The views of `count` measured points: of those next to a point of the dataset that is in the same place, its views `seen_by`.
fn tracks(next: &[Option<Neighbour>], seen_by: &Tracks, count: usize, extent: f64) -> Tracks {
    if seen_by.are_unknown() {
        return Tracks::default();
    }
    let mut views: HashMap<u32, Vec<u32>> = HashMap::new();
    for (own, next) in next.iter().enumerate() {
        if let Some((row, squared)) = *next
            && f64::from(squared).sqrt() <= SAME_PLACE * extent
        {
            views.entry(row).or_default().extend(seen_by.of(own));
        }
    }
    (0..count as u32).map(|row| views.remove(&row).unwrap_or_default()).collect()
}

fn ranges(positions: &[DVec3]) -> String {
    let (low, high) = bounds(positions);
    let along = |name: &str, axis: usize| format!("{name} {:.3} to {:.3}", low[axis], high[axis]);
    format!("{}, {}, {}", along("x", 0), along("y", 1), along("z", 2))
}

//! Clouds of scanners: E57 of the ASTM, each scan with its pose, in Cartesian or spherical coordinates.

use std::path::Path;

use e57::{CartesianCoordinate, E57Reader, Error};
use glam::DVec3;

use super::kept::Kept;

/// Offers the points of all scans where their poses put them. Returns the white of their colours, which are intensities where there are no
/// others.
pub(super) fn read(path: &Path, kept: &mut Kept) -> e57::Result<f32> {
    let mut reader = E57Reader::from_file(path)?;
    for scan in reader.pointclouds() {
        let points = reader.pointcloud_simple(&scan)?;
        // such an error is that of a packet without a whole point, as of an index; there are more packets, or the next error is another
        for point in points.filter(|point| !matches!(point, Err(Error::Internal { .. }))) {
            let point = point?;
            let position = match point.cartesian {
                CartesianCoordinate::Valid { x, y, z } => Some(DVec3::new(x, y, z)),
                // without a distance, or nothing at all
                CartesianCoordinate::Direction { .. } | CartesianCoordinate::Invalid => None,
            };
            let colour = point.color.map_or([f32::NAN; 3], |colour| [colour.red, colour.green, colour.blue]);
            kept.offer(position, colour);
        }
    }
    Ok(1.0)
}

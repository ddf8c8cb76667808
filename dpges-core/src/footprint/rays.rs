//! The rays of the pixels of a camera with a lens, on the CPU.

use std::sync::{Arc, Mutex};

use rayon::prelude::*;

use crate::camera::{Camera, Lens};
use crate::math::V3;

/// So many tables are kept: training renders views of few cameras, and each several times in a row.
const KEPT: usize = 2;

/// Everything that rays in camera axes depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Key {
    lens: Lens,
    intrinsics: [f64; 4],
    size: [usize; 2],
}

/// Ray of every pixel, [H × W], camera axes, of depth 1; 0 where the lens shows nothing.
pub type Rays = Arc<Vec<V3<f64>>>;

static TABLES: Mutex<Vec<(Key, Rays)>> = Mutex::new(Vec::new());

/// The rays through the pixel centres of `camera`; `None` for a pinhole, whose rays are linear in the pixel.
pub fn rays(camera: &Camera) -> Option<Rays> {
    let &Camera { lens, fx, fy, cx, cy, width, height, .. } = camera;
    let key = Key { lens: lens?, intrinsics: [fx, fy, cx, cy], size: [width, height] };
    // a table is whole or absent: a thread that panicked left nothing half done
    let tables = || TABLES.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    if let Some((_, rays)) = tables().iter().find(|(known, _)| *known == key) {
        return Some(rays.clone());
    }
    let ray = |at: usize| {
        let (x, y) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
        camera.ray(x, y).map_or([0.0; 3], |ray| ray.to_array())
    };
    // without the lock: two threads may compute one table, and neither waits for the other
    let rays: Rays = Arc::new((0..width * height).into_par_iter().map(ray).collect());
    let mut tables = tables();
    tables.insert(0, (key, rays.clone()));
    tables.truncate(KEPT);
    Some(rays)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraFromWorld;
    use crate::camera::{Distortion, Projection};
    use glam::DVec3;

    fn camera(lens: Option<Lens>, width: usize) -> Camera {
        let camera_from_world = CameraFromWorld::look_at(DVec3::ONE, DVec3::ZERO, DVec3::Z);
        let (fx, fy, cx, cy) = (9.0, 8.0, 6.0, 4.5);
        Camera { camera_from_world, fx, fy, cx, cy, width, height: 9, near: 0.1, lens }
    }

    #[test]
    fn tables_hold_the_rays_of_their_own_camera() {
        assert!(rays(&camera(None, 12)).is_none());
        let fisheye = Lens::new(Distortion::new(Projection::Equidistant));
        let bent = Lens::new(Distortion {
            numerator: [-0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
            ..Distortion::new(Projection::Perspective)
        });
        // more cameras than are kept, twice
        for (lens, width) in [(fisheye, 12), (bent, 12), (fisheye, 13), (bent, 11), (fisheye, 12), (bent, 12)] {
            let camera = camera(Some(lens), width);
            let table = rays(&camera).unwrap();
            assert_eq!(table.len(), width * 9);
            for (at, ray) in table.iter().enumerate() {
                let expected = camera.ray((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
                assert_eq!(Some(DVec3::from(*ray)), expected);
            }
        }
    }
}

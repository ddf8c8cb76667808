//! Where a scene is first seen from.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;
use glam::DVec3;

use super::viewpoint::{Surroundings, Viewpoint};
use crate::path::{Extent, NamedCamera};
use crate::up::Up;

/// A view of the whole, turning about its middle.
pub fn overview(extent: &Extent, up: DVec3, near: f64) -> Viewpoint {
    let camera = extent.overview(up, near, [1; 2]);
    Viewpoint::of(&camera, camera.depth(extent.centre))
}

/// The view of the first of `views`, or of the whole without any, and what is up: `up`, or as the scene says, or as most
/// views are held.
pub fn first_view(
    info: &SceneInfo,
    extent: &Extent,
    views: &[NamedCamera],
    up: Option<Up>,
) -> (Surroundings, Viewpoint) {
    let of_views = || Up::of_cameras(views.iter().map(|(_, camera)| camera)).filter(|_| info.up.is_none());
    let up = up.or_else(of_views).unwrap_or(Up::of(info)).direction();
    let first = |(_, camera): &(String, Camera)| Viewpoint::of(camera, extent.depth_before(camera));
    let home = views.first().map_or_else(|| overview(extent, up, info.near), first);
    (Surroundings { up, size: extent.radius }, home)
}

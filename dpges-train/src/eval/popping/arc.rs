//! The path along which popping is looked for.

use std::f64::consts::FRAC_PI_6;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;
use dpges_core::{Error, Result};
use dpges_render::CameraPath;

use crate::dataset::{Dataset, View};

/// Frames of the path.
pub const FRAMES: usize = 60;
/// Length of the path that is aimed at, in extents of the scene: 7 frames are 3 % of an extent.
const LENGTH: f64 = 0.25;
/// A turn of so much along the path counts as much as being longer by its length, radians.
const TURN: f64 = FRAC_PI_6;

/// [`FRAMES`] cameras from one view of `dataset`, in the coordinates of the scene, to another nearby: the pair of views, trained on or
/// not, whose distance is nearest to a quarter of the extent, with the least turn between them. The pictures have the size of the first.
///
/// # Errors
/// [`Error::Option`] if there are fewer than two views.
pub fn arc(dataset: &Dataset, info: &SceneInfo) -> Result<Vec<Camera>> {
    let mut views: Vec<&View> = dataset.train.iter().chain(&dataset.validation).chain(&dataset.test).collect();
    // the same path whatever each view is used for
    views.sort_by(|a, b| a.name.cmp(&b.name));
    let cameras: Vec<Camera> = views.iter().map(|view| Camera { near: info.near, ..view.camera }).collect();
    let length = LENGTH * info.extent;
    let unfitness = |[a, b]: [&Camera; 2]| (a.centre().distance(b.centre()) / length - 1.0).abs() + turn(a, b) / TURN;
    let pairs = cameras.iter().enumerate().flat_map(|(index, a)| cameras[..index].iter().map(move |b| [b, a]));
    let ends = pairs.min_by(|&a, &b| unfitness(a).total_cmp(&unfitness(b))).ok_or_else(|| Error::Option {
        option: "views",
        expected: "at least two, to go from one to the other".to_owned(),
        found: cameras.len().to_string(),
    })?;
    let path = CameraPath::new(ends.map(|end| *end).to_vec(), false).expect("two cameras");
    Ok(path.frames(FRAMES))
}

/// Angle between the axes of two cameras, radians.
fn turn(a: &Camera, b: &Camera) -> f64 {
    let between = a.camera_from_world.rotation * b.camera_from_world.rotation.transpose();
    let trace = between.x_axis.x + between.y_axis.y + between.z_axis.z;
    (0.5 * (trace - 1.0)).clamp(-1.0, 1.0).acos()
}

//! The paths along which popping and jumps are looked for.

use std::f64::consts::{FRAC_PI_6, PI};

use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;
use dpges_core::{Error, Result};
use dpges_render::{CameraPath, Up};

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
    let path = CameraPath::new(ends(dataset, info)?.to_vec(), false).expect("two cameras");
    Ok(path.frames(FRAMES))
}

/// The cameras of all views, in the order of their names: the same whatever each view is used for.
fn cameras(dataset: &Dataset, info: &SceneInfo) -> Vec<Camera> {
    let mut views: Vec<&View> = dataset.train.iter().chain(&dataset.validation).chain(&dataset.test).collect();
    views.sort_by(|a, b| a.name.cmp(&b.name));
    views.iter().map(|view| Camera { near: info.near, ..view.camera }).collect()
}

/// The first and the last camera of [`arc`].
fn ends(dataset: &Dataset, info: &SceneInfo) -> Result<[Camera; 2]> {
    let cameras = cameras(dataset, info);
    let length = LENGTH * info.extent;
    let unfitness = |[a, b]: [&Camera; 2]| (a.centre().distance(b.centre()) / length - 1.0).abs() + turn(a, b) / TURN;
    let pairs = cameras.iter().enumerate().flat_map(|(index, a)| cameras[..index].iter().map(move |b| [b, a]));
    let ends = pairs.min_by(|&a, &b| unfitness(a).total_cmp(&unfitness(b))).ok_or_else(|| Error::Option {
        option: "views",
        expected: "at least two, to go from one to the other".to_owned(),
        found: cameras.len().to_string(),
    })?;
    Ok(ends.map(|end| *end))
}

/// Angle of the path along which jumps are looked for, radians.
const TURNED: f64 = PI / 30.0;

/// Cameras in `steps` equal steps, in the coordinates of the scene: the first view of `dataset` by name, trained on or not, turned by 6°
/// about what the views look at; or where they do not look at one place, those between the ends of [`arc`].
///
/// # Errors
/// Those of [`arc`].
pub fn turn_about_the_middle(dataset: &Dataset, info: &SceneInfo) -> Result<impl Fn(usize) -> Vec<Camera>> {
    let ends = ends(dataset, info)?;
    let (cameras, up) = (cameras(dataset, info), Up::of(info));
    Ok(move |steps: usize| {
        let turned = CameraPath::arc(&cameras, up, TURNED, steps);
        turned.unwrap_or_else(|| CameraPath::new(ends.to_vec(), false).expect("two cameras").frames(steps + 1))
    })
}

/// Angle between the axes of two cameras, radians.
fn turn(a: &Camera, b: &Camera) -> f64 {
    let between = a.camera_from_world.rotation * b.camera_from_world.rotation.transpose();
    let trace = between.x_axis.x + between.y_axis.y + between.z_axis.z;
    (0.5 * (trace - 1.0)).clamp(-1.0, 1.0).acos()
}

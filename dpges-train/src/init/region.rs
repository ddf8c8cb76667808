//! The part of the world that the cameras look at.

use dpges_core::camera::Camera;
use glam::{DMat3, DVec3};

/// Size of the region relative to the sphere that a typical camera sees completely.
const SLACK: f64 = 1.1;

/// Points that say where a scene is.
const LEAST_POINTS: usize = 50;
/// Share of the points beyond either side of a box around them.
const OUTLIERS: f64 = 0.02;
/// A box around points is longer by this share of its length on either side.
const MARGIN: f64 = 0.1;

/// An axis-aligned box, world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Region {
    pub low: DVec3,
    pub high: DVec3,
}

impl Region {
    /// Lengths of the sides, world units.
    pub fn size(&self) -> DVec3 {
        self.high - self.low
    }

    /// A cube around the point nearest to all optical axes that contains the sphere the median camera sees completely.
    /// If two fifths of the cameras look away from it, the cube is centred on their mean and reaches `extent` (world units)
    /// to each side.
    pub fn in_sight(cameras: &[Camera], extent: f64) -> Self {
        let mean = cameras.iter().map(Camera::centre).sum::<DVec3>() / cameras.len().max(1) as f64;
        let focus = nearest_to_axes(cameras, mean, extent);
        let ahead = |camera: &Camera| (focus - camera.centre()).dot(forward(camera));
        let mut radii: Vec<f64> = cameras.iter().map(|camera| ahead(camera) * narrowest_sine(camera)).collect();
        radii.sort_by(f64::total_cmp);
        // of the faces of panoramas one half looks away
        let looks_there = radii.get(2 * radii.len() / 5).is_some_and(|&radius| radius > 0.0);
        match radii.get(radii.len() / 2) {
            Some(&radius) if looks_there => Self::cube(focus, SLACK * radius.max(0.1 * extent)),
            _ => Self::cube(mean, extent),
        }
    }

    /// The box of most of `positions` (world units), a little enlarged. `None` if these are too few to tell.
    pub fn around(positions: &[[f32; 3]]) -> Option<Self> {
        if positions.len() < LEAST_POINTS {
            return None;
        }
        let of_axis = |axis: usize| {
            let mut along: Vec<f32> = positions.iter().map(|position| position[axis]).collect();
            along.sort_by(f32::total_cmp);
            let outside = (OUTLIERS * along.len() as f64) as usize;
            [along[outside], along[along.len() - 1 - outside]].map(f64::from)
        };
        let [x, y, z] = [0, 1, 2].map(of_axis);
        let (low, high) = (DVec3::new(x[0], y[0], z[0]), DVec3::new(x[1], y[1], z[1]));
        let more = MARGIN * (high - low);
        Some(Self { low: low - more, high: high + more })
    }

    pub fn cube(centre: DVec3, half_side: f64) -> Self {
        Self { low: centre - half_side, high: centre + half_side }
    }
}

/// The point nearest to all optical axes, by least squares. For parallel axes, a point about `extent` ahead of `mean`.
fn nearest_to_axes(cameras: &[Camera], mean: DVec3, extent: f64) -> DVec3 {
    const PULL: f64 = 1e-4;
    let looking = cameras.iter().map(forward).sum::<DVec3>().try_normalize().unwrap_or(DVec3::ZERO);
    let ahead = mean + looking * extent;
    let weight = PULL * cameras.len().max(1) as f64;
    let (mut matrix, mut right) = (DMat3::IDENTITY * weight, ahead * weight);
    for camera in cameras {
        let d = forward(camera);
        let across = DMat3::IDENTITY - DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        matrix += across;
        right += across * camera.centre();
    }
    matrix.inverse() * right
}

fn forward(camera: &Camera) -> DVec3 {
    camera.camera_from_world.rotation.row(2)
}

/// Sine of the smallest angle between the optical axis and a border of the picture.
fn narrowest_sine(camera: &Camera) -> f64 {
    if camera.lens.is_some() {
        let (width, height) = (camera.width as f64, camera.height as f64);
        let borders = [(0.0, camera.cy), (width, camera.cy), (camera.cx, 0.0), (camera.cx, height)];
        let sines = borders.map(|(x, y)| {
            let ray = camera.unproject(x, y, 1.0) - camera.centre();
            let ahead = ray.dot(forward(camera)) / ray.length();
            // beyond a right angle the sphere around any point ahead is seen whole
            if ahead > 0.0 { (1.0 - ahead * ahead).max(1e-6).sqrt() } else { 1.0 }
        });
        return sines.into_iter().fold(1.0, f64::min);
    }
    let across = camera.cx.min(camera.width as f64 - camera.cx) / camera.fx;
    let along = camera.cy.min(camera.height as f64 - camera.cy) / camera.fy;
    let tangent = across.min(along).max(1e-3);
    tangent / (1.0 + tangent * tangent).sqrt()
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::{CameraFromWorld, Distortion, Lens, Projection};

    use super::*;
    use crate::dataset::Face;
    use crate::init::plane_sweep;

    fn camera(eye: DVec3, target: DVec3) -> Camera {
        let camera_from_world = CameraFromWorld::look_at(eye, target, DVec3::Z);
        Camera { camera_from_world, ..plane_sweep::tests::camera(DVec3::X, 800, 1111.0) }
    }

    #[test]
    fn a_lens_of_half_the_space_sees_nearly_all_of_a_sphere_around_its_target() {
        let fisheye = Lens::new(Distortion::new(Projection::Equidistant));
        let (width, edge) = (800.0, 85f64.to_radians());
        let pinhole = camera(DVec3::ZERO, DVec3::X);
        let wide = Camera { fx: 0.5 * width / edge, fy: 0.5 * width / edge, lens: Some(fisheye), ..pinhole };
        assert!((narrowest_sine(&wide) - edge.sin()).abs() < 1e-9);
        let straight = Camera { lens: Some(Lens::new(Distortion::new(Projection::Perspective))), ..pinhole };
        assert!((narrowest_sine(&straight) - narrowest_sine(&pinhole)).abs() < 1e-9);
    }

    fn around(middle: DVec3) -> Vec<Camera> {
        (0..12)
            .map(|i| {
                let angle = i as f64 / 12.0 * std::f64::consts::TAU;
                let height = 0.4 * (i % 3) as f64;
                camera(middle + 4.0 * DVec3::new(angle.cos(), angle.sin(), height), middle)
            })
            .collect()
    }

    #[test]
    fn cameras_on_a_ring_see_the_middle() {
        let middle = DVec3::new(1.0, -2.0, 5.0);
        let cameras = around(middle);
        let region = Region::in_sight(&cameras, 4.4);
        let centre = (region.low + region.high) / 2.0;
        assert!(centre.distance(middle) < 0.01, "{region:?}");
        assert!((1.3..1.8).contains(&(region.size().x / 2.0)), "{region:?}");
    }

    #[test]
    fn parallel_lone_and_diverging_cameras_have_a_region_too() {
        let lone = camera(DVec3::ZERO, DVec3::X);
        let region = Region::in_sight(&[lone], 2.0);
        assert!(((region.low + region.high) / 2.0).distance(2.0 * DVec3::X) < 1e-6);
        let wall: Vec<Camera> = (0..4).map(|i| camera(DVec3::Y * i as f64, DVec3::new(9.0, i as f64, 0.0))).collect();
        let region = Region::in_sight(&wall, 3.0);
        assert!(region.low.is_finite() && region.size().min_element() > 0.0 && region.high.x > 1.0);
        let outwards: Vec<Camera> =
            around(DVec3::ZERO).iter().map(|inwards| camera(inwards.centre(), 2.0 * inwards.centre())).collect();
        let region = Region::in_sight(&outwards, 4.4);
        assert!((region.size().x - 8.8).abs() < 1e-9);
        let pose = |camera: Camera| camera.camera_from_world;
        let faces = |camera| Face::ALL.map(|face| face.camera(&pose(camera), 64, 0.01));
        let panoramas: Vec<Camera> = around(DVec3::ZERO).into_iter().flat_map(faces).collect();
        assert!((Region::in_sight(&panoramas, 4.4).size().x - 8.8).abs() < 1e-9);
    }

    #[test]
    fn a_box_around_points_leaves_outliers_out() {
        let mut positions: Vec<[f32; 3]> = (0..=100).map(|i| [i as f32 / 100.0, 2.0, -(i as f32)]).collect();
        positions.extend([[1e6; 3], [-1e6; 3]]);
        let Region { low, high } = Region::around(&positions).unwrap();
        assert!((low - DVec3::new(-0.088, 2.0, -108.8)).length() < 0.1, "{low}");
        assert!((high - DVec3::new(1.088, 2.0, 8.8)).length() < 0.1, "{high}");
        assert_eq!(Region::around(&positions[..LEAST_POINTS - 1]), None);
    }
}

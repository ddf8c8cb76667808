//! Cameras with OpenCV axes (x right, y down, z forward) and a free principal point: pinholes, or with a [`Lens`]. Pixel
//! (column i, row j) is sampled at (i + 0.5, j + 0.5).
//!
//! Depth is camera-space z, or the distance from the camera's centre for a lens that sees more than half the space
//! ([`Lens::is_wide`]). A point is the centre plus its depth times the ray of its pixel.

mod lens;

use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

pub use lens::{Distortion, Lens, Projection, Seen};

/// Rigid motion from world to camera axes: `x_camera = rotation · x_world + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraFromWorld {
    pub rotation: DMat3,
    pub translation: DVec3,
}

impl CameraFromWorld {
    /// From a quaternion (w, x, y, z), which is normalised, and a translation, as in COLMAP.
    pub fn from_quaternion(wxyz: [f64; 4], translation: DVec3) -> Self {
        let [w, x, y, z] = wxyz;
        Self { rotation: DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()), translation }
    }

    /// A camera at `eye` that looks at `target`, with `up` upwards in the picture.
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let down = forward.cross(right);
        let rotation = DMat3::from_cols(right, down, forward).transpose();
        Self { rotation, translation: -(rotation * eye) }
    }

    /// Camera centre in world units.
    pub fn centre(&self) -> DVec3 {
        -(self.rotation.transpose() * self.translation)
    }

    /// The same camera turned about its centre by the rotation vector `turn`, rad, then shifted by `shift`, world units, both
    /// along world axes.
    pub fn moved(&self, turn: DVec3, shift: DVec3) -> Self {
        let rotation = self.rotation * DMat3::from_quat(DQuat::from_scaled_axis(-turn));
        Self { rotation, translation: -(rotation * (self.centre() + shift)) }
    }

    /// The same camera in the world shifted by `-offset`.
    pub fn recentred(&self, offset: DVec3) -> Self {
        Self { rotation: self.rotation, translation: self.translation + self.rotation * offset }
    }
}

/// A camera. Focal lengths and principal point in px, `near` in world units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    pub camera_from_world: CameraFromWorld,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    pub width: usize,
    pub height: usize,
    /// Fragments, and Gaussians by their centres, exist only beyond this depth.
    pub near: f64,
    /// The lens; `None` for a pinhole camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<Lens>,
}

/// A lens shows Gaussians whose centres appear up to this many times as far from the principal point as the farthest corner
/// of the picture: farther out their footprints are no longer near ellipses (3DGS).
const COVERAGE: f64 = 1.3;

impl Camera {
    /// Checks that the camera can be rendered from, also in f32.
    ///
    /// # Errors
    /// [`Error::Camera`] for an empty image, a focal length or near plane that is not positive, any value that is not
    /// finite, each as an f32, or a lens that shows nothing.
    pub fn validate(&self) -> Result<()> {
        let positive = |field, value: f64| {
            if (value as f32).is_finite() && value as f32 > 0.0 {
                Ok(())
            } else {
                Err(Error::Camera { field, expected: "a positive, finite 32-bit number", found: value.to_string() })
            }
        };
        let finite = |field, ok: bool, found: String| {
            if ok { Ok(()) } else { Err(Error::Camera { field, expected: "finite 32-bit numbers", found }) }
        };
        let (width, height) = (self.width as f64, self.height as f64);
        let sizes = [("width", width), ("height", height), ("fx", self.fx), ("fy", self.fy), ("near", self.near)];
        sizes.into_iter().try_for_each(|(field, value)| positive(field, value))?;
        finite("cx", (self.cx as f32).is_finite(), self.cx.to_string())?;
        finite("cy", (self.cy as f32).is_finite(), self.cy.to_string())?;
        let pose = &self.camera_from_world;
        finite(
            "rotation",
            pose.rotation.as_mat3().is_finite(),
            format!("{:?}", pose.rotation.transpose().to_cols_array_2d()),
        )?;
        finite("translation", pose.translation.as_vec3().is_finite(), format!("{:?}", pose.translation.to_array()))?;
        match &self.lens {
            Some(lens) if !lens.is_sound() => {
                let expected = "finite coefficients that keep it one to one around the principal point";
                Err(Error::Camera { field: "lens", expected, found: format!("{:?}", lens.distortion()) })
            }
            _ => Ok(()),
        }
    }

    /// Checks that it is a pinhole camera, for what draws nothing else.
    ///
    /// # Errors
    /// [`Error::Camera`] if it has a lens.
    pub fn require_pinhole(&self) -> Result<()> {
        match &self.lens {
            None => Ok(()),
            Some(lens) => Err(Error::Camera {
                field: "lens",
                expected: "none: only pinhole cameras are possible here; undistort the photographs (`data.undistort`)",
                found: format!("{:?}", lens.distortion().projection),
            }),
        }
    }

    /// A pinhole camera whose axis meets the middle of the picture; `focal_px` is the focal length both ways, `near` in world
    /// units.
    pub fn pinhole(camera_from_world: CameraFromWorld, focal_px: f64, [width, height]: [usize; 2], near: f64) -> Self {
        let [cx, cy] = [width, height].map(|px| 0.5 * px as f64);
        Self { camera_from_world, fx: focal_px, fy: focal_px, cx, cy, width, height, near, lens: None }
    }

    /// The pinhole camera with the same intrinsics.
    pub fn without_lens(&self) -> Self {
        Self { lens: None, ..*self }
    }

    /// Camera centre in world units.
    pub fn centre(&self) -> DVec3 {
        self.camera_from_world.centre()
    }

    /// The same camera for an image of `width` × `height` px: same field of view, scaled focal
    /// lengths and principal point.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, width, height, ..*self }
    }

    /// Depth of a world point, world units.
    pub fn depth(&self, world: DVec3) -> f64 {
        let p = self.in_camera(world);
        self.lens.map_or(p.z, |lens| lens.depth(p.to_array()))
    }

    /// Largest distance from the principal point, focal lengths, at which Gaussians are shown through a lens.
    pub fn coverage(&self) -> f64 {
        let across = self.cx.abs().max((self.width as f64 - self.cx).abs()) / self.fx;
        let along = self.cy.abs().max((self.height as f64 - self.cy).abs()) / self.fy;
        COVERAGE * across.hypot(along)
    }

    /// A pixel position relative to the principal point.
    fn in_focal_lengths(&self, x_px: f64, y_px: f64) -> [f64; 2] {
        [(x_px - self.cx) / self.fx, (y_px - self.cy) / self.fy]
    }

    fn in_camera(&self, world: DVec3) -> DVec3 {
        self.camera_from_world.rotation * world + self.camera_from_world.translation
    }

    /// Position in px and depth of a world point; `None` at or behind the near plane, and where a lens does not see.
    pub fn project(&self, world: DVec3) -> Option<(f64, f64, f64)> {
        let p = self.in_camera(world);
        if let Some(lens) = &self.lens {
            let depth = lens.depth(p.to_array());
            let [x, y] = lens.position(p.to_array()).filter(|_| depth > self.near)?;
            return Some((self.fx * x + self.cx, self.fy * y + self.cy, depth));
        }
        (p.z > self.near).then(|| (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy, p.z))
    }

    /// Row-major index of the pixel that shows a world point, and the depth of the point, world units; `None` if it is not
    /// in the picture.
    pub fn pixel(&self, world: DVec3) -> Option<(usize, f64)> {
        let (x, y, depth) = self.project(world)?;
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
        inside.then(|| (y as usize * self.width + x as usize, depth))
    }

    /// Maps a pixel position (x, y, 1), px, of the camera without its lens to a vector in world axes along its ray, of
    /// camera-space z 1.
    pub fn world_from_pixel(&self) -> DMat3 {
        let camera_from_pixel = DMat3::from_cols(
            DVec3::new(1.0 / self.fx, 0.0, 0.0),
            DVec3::new(0.0, 1.0 / self.fy, 0.0),
            DVec3::new(-self.cx / self.fx, -self.cy / self.fy, 1.0),
        );
        self.camera_from_world.rotation.transpose() * camera_from_pixel
    }

    /// The ray through pixel position (`x_px`, `y_px`) in camera axes, of depth 1; `None` where a lens shows nothing.
    pub fn ray(&self, x_px: f64, y_px: f64) -> Option<DVec3> {
        let [x, y] = self.in_focal_lengths(x_px, y_px);
        match &self.lens {
            None => Some(DVec3::new(x, y, 1.0)),
            Some(lens) => lens.ray([x, y]).map(DVec3::from),
        }
    }

    /// Whether each pixel has a [`ray`](Self::ray), [height × width]; `None` if all have. The pixels of the border tell: what
    /// a lens shows has no holes and no bays.
    pub fn shown_pixels(&self) -> Option<Vec<bool>> {
        let lens = self.lens.as_ref()?;
        let (width, height) = (self.width, self.height);
        let is_shown =
            |column: usize, row: usize| lens.shows(self.in_focal_lengths(column as f64 + 0.5, row as f64 + 0.5));
        let rows_are_shown = (0..width).all(|column| is_shown(column, 0) && is_shown(column, height - 1));
        if rows_are_shown && (0..height).all(|row| is_shown(0, row) && is_shown(width - 1, row)) {
            return None;
        }
        Some((0..width * height).map(|pixel| is_shown(pixel % width, pixel / width)).collect())
    }

    /// World point seen at pixel position (`x_px`, `y_px`) at `depth`. Where a lens shows nothing, it is the nearest that it
    /// shows.
    pub fn unproject(&self, x_px: f64, y_px: f64, depth: f64) -> DVec3 {
        let [x, y] = self.in_focal_lengths(x_px, y_px);
        let ray = self.lens.map_or(DVec3::new(x, y, 1.0), |lens| lens.nearest_ray([x, y]).into());
        let p = ray * depth;
        self.camera_from_world.rotation.transpose() * (p - self.camera_from_world.translation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        let camera_from_world = CameraFromWorld::look_at(DVec3::new(1.0, -3.0, 2.0), DVec3::ZERO, DVec3::Z);
        let (fx, fy, cx, cy) = (60.0, 70.0, 20.0, 11.0);
        Camera { camera_from_world, fx, fy, cx, cy, width: 48, height: 32, near: 0.01, lens: None }
    }

    #[test]
    fn look_at_puts_the_target_on_the_principal_point_and_up_is_up() {
        let camera = camera();
        let (x, y, depth) = camera.project(DVec3::ZERO).unwrap();
        approx::assert_relative_eq!(x, 20.0, epsilon = 1e-12);
        approx::assert_relative_eq!(y, 11.0, epsilon = 1e-12);
        approx::assert_relative_eq!(depth, 14f64.sqrt(), epsilon = 1e-12);
        assert_eq!(camera.depth(DVec3::ZERO), depth);
        assert!(camera.project(DVec3::new(0.0, 0.0, 0.1)).unwrap().1 < y);
        approx::assert_relative_eq!(camera.camera_from_world.rotation.determinant(), 1.0, epsilon = 1e-12);
    }

    #[test]
    fn unproject_inverts_project_also_after_resizing_and_recentring() {
        let world = DVec3::new(0.3, -0.2, 0.5);
        let offset = DVec3::new(5e5, -2e6, 10.0);
        let camera = camera().resized(96, 64);
        let (x, y, depth) = camera.project(world).unwrap();
        assert!((camera.unproject(x, y, depth) - world).length() < 1e-12);
        let along = camera.world_from_pixel() * DVec3::new(x, y, 1.0) * depth;
        assert!((camera.centre() + along - world).length() < 1e-12);
        let pose = camera.camera_from_world;
        let far = Camera { camera_from_world: pose.recentred(-offset), ..camera };
        let near = Camera { camera_from_world: far.camera_from_world.recentred(offset), ..far };
        assert!((near.project(world).unwrap().0 - x).abs() < 1e-6);
    }

    #[test]
    fn a_moved_camera_is_turned_about_its_centre_and_shifted() {
        let pose = camera().camera_from_world;
        let (turn, shift) = (DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.1, -0.2, 0.3));
        let moved = pose.moved(turn, shift);
        assert!((moved.centre() - pose.centre() - shift).length() < 1e-12);
        let axis = |pose: &CameraFromWorld| pose.rotation.transpose() * DVec3::Z;
        let expected = DQuat::from_rotation_z(0.5) * axis(&pose);
        assert!((axis(&moved) - expected).length() < 1e-12);
        let back = moved.moved(-turn, -shift);
        assert!((back.translation - pose.translation).length() < 1e-12);
    }

    #[test]
    fn pixels_show_what_is_in_the_picture() {
        let camera = camera();
        let (width, height) = (camera.width, camera.height);
        let at = |x: f64, y: f64| camera.pixel(camera.unproject(x, y, 2.0));
        assert_eq!(at(3.5, 2.5).map(|(pixel, _)| pixel), Some(2 * width + 3));
        assert!((at(3.5, 2.5).unwrap().1 - 2.0).abs() < 1e-12);
        assert_eq!(at(width as f64 - 0.5, height as f64 - 0.5).map(|(pixel, _)| pixel), Some(width * height - 1));
        for (x, y) in [(-0.5, 2.5), (width as f64 + 0.5, 2.5), (3.5, -0.5), (3.5, height as f64 + 0.5)] {
            assert_eq!(at(x, y), None);
        }
        assert_eq!(camera.pixel(camera.unproject(3.5, 2.5, -1.0)), None);
    }

    #[test]
    fn pixels_without_a_ray_are_told_from_those_with_one() {
        use crate::testing::lenses::every_model;

        assert_eq!(camera().shown_pixels(), None);
        let mut partly = 0;
        for (name, distortion) in every_model() {
            let lens = Lens::new(distortion);
            let reach = lens.radial(lens.limit());
            // the circle of the lens touches the sides of the first, lies within the second and around the third
            for size in [1.0, 0.6, 5.0] {
                let camera = camera();
                let focal = size * 0.5 * camera.height as f64 / reach;
                let camera = Camera { fx: focal, fy: focal, cx: 24.0, cy: 16.0, lens: Some(lens), ..camera };
                let has_ray: Vec<bool> = (0..camera.width * camera.height)
                    .map(|pixel| {
                        let (x, y) = ((pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5);
                        camera.ray(x, y).is_some()
                    })
                    .collect();
                let shown = camera.shown_pixels().unwrap_or_else(|| vec![true; has_ray.len()]);
                assert!(shown == has_ray, "{name}, {size}");
                partly += usize::from(shown.contains(&true) && shown.contains(&false));
            }
        }
        assert!(partly >= 4, "{partly} pictures are shown in part");
    }

    #[test]
    fn what_draws_pinholes_alone_names_the_lens() {
        camera().require_pinhole().unwrap();
        let lens = Some(Lens::new(Distortion::new(Projection::Equidistant)));
        let message = Camera { lens, ..camera() }.require_pinhole().unwrap_err().to_string();
        for part in ["`lens` is Equidistant", "only pinhole cameras", "data.undistort"] {
            assert!(message.contains(part), "{part}: {message}");
        }
    }

    #[test]
    fn bad_cameras_are_named() {
        let at = |y: f64| {
            let mut camera = camera();
            camera.camera_from_world.translation.y = y;
            camera
        };
        for (bad, part) in [
            (Camera { fx: -1.0, ..camera() }, "`fx` is -1"),
            (Camera { width: 0, ..camera() }, "`width`"),
            (at(f64::NAN), "`translation`"),
            (at(1e300), "`translation`"),
            (Camera { near: 1e-60, ..camera() }, "`near` is 0.00"),
        ] {
            let message = bad.validate().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        camera().validate().unwrap();
    }
}

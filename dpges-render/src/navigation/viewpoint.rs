//! Where a camera stands, where it looks, what it turns about, and how a motion changes that.

use std::f64::consts::PI;

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::{DQuat, DVec3};

use super::motion::Motion;
use crate::path::pose;

/// The view stays this far from straight up and straight down, rad: there, turning has no direction.
const POLE: f64 = 0.05;
/// Nearest and farthest that the focus can be, in sizes of the scene.
const FOCUS_RANGE: [f64; 2] = [1e-4, 1e3];

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// World units.
    pub eye: DVec3,
    /// Turns camera axes (x right, y down, z forward) into world axes.
    pub world_from_camera: DQuat,
}

impl Pose {
    pub fn of(camera_from_world: &CameraFromWorld) -> Self {
        let world_from_camera = DQuat::from_mat3(&camera_from_world.rotation.transpose()).normalize();
        Self { eye: camera_from_world.centre(), world_from_camera }
    }

    pub fn right(&self) -> DVec3 {
        self.world_from_camera * DVec3::X
    }

    pub fn down(&self) -> DVec3 {
        self.world_from_camera * DVec3::Y
    }

    pub fn forward(&self) -> DVec3 {
        self.world_from_camera * DVec3::Z
    }

    /// Turned by `yaw` to the right about `up`, and by `pitch` downwards, rad.
    fn turned(&self, yaw: f64, pitch: f64, up: DVec3) -> DQuat {
        let from_up = self.forward().angle_between(up);
        let pitch = (from_up + pitch).clamp(POLE.min(from_up), (PI - POLE).max(from_up)) - from_up;
        let pitched = DQuat::from_axis_angle(self.right(), -pitch) * self.world_from_camera;
        (DQuat::from_axis_angle(up, -yaw) * pitched).normalize()
    }
}

/// A lens with the principal point in the middle and square pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// rad
    pub vertical_field_of_view: f64,
    /// Near plane, world units.
    pub near: f64,
}

impl Lens {
    pub fn of(camera: &Camera) -> Self {
        let vertical_field_of_view = 2.0 * (0.5 * camera.height as f64 / camera.fy).atan();
        Self { vertical_field_of_view, near: camera.near }
    }

    /// Height of what is seen at depth 1.
    pub fn height_at_one(&self) -> f64 {
        2.0 * (0.5 * self.vertical_field_of_view).tan()
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// Unit vector upwards, about which views turn.
    pub up: DVec3,
    /// World units; the speed of flying is in proportion to it.
    pub size: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    pub pose: Pose,
    /// Depth of the point that the view turns about, world units.
    pub focus_distance: f64,
    pub lens: Lens,
}

impl Viewpoint {
    pub fn focus(&self) -> DVec3 {
        self.pose.eye + self.focus_distance * self.pose.forward()
    }

    /// The camera for a picture of this size, px.
    pub fn camera(&self, [width, height]: [usize; 2]) -> Camera {
        let focal = height as f64 / self.lens.height_at_one();
        let camera_from_world = pose(self.pose.eye, self.pose.world_from_camera);
        Camera::pinhole(camera_from_world, focal, [width, height], self.lens.near)
    }

    #[must_use]
    pub fn moved(&self, motion: &Motion, surroundings: &Surroundings) -> Self {
        let Surroundings { up, size } = *surroundings;
        let mut view = *self;
        if motion.orbit != glam::DVec2::ZERO {
            let focus = view.focus();
            view.pose.world_from_camera = view.pose.turned(motion.orbit.x, motion.orbit.y, up);
            view.pose.eye = focus - view.focus_distance * view.pose.forward();
        }
        if motion.look != glam::DVec2::ZERO {
            view.pose.world_from_camera = view.pose.turned(motion.look.x, motion.look.y, up);
        }
        let height_at_focus = view.lens.height_at_one() * view.focus_distance;
        view.pose.eye -= height_at_focus * (motion.pan.x * view.pose.right() + motion.pan.y * view.pose.down());
        if motion.approach != 0.0 {
            let focus = view.focus();
            let [nearest, farthest] = FOCUS_RANGE.map(|limit| limit * size);
            let nearest = nearest.max(view.lens.near).min(view.focus_distance);
            let distance = view.focus_distance * (-motion.approach).exp();
            view.focus_distance = distance.clamp(nearest, farthest.max(view.focus_distance));
            view.pose.eye = focus - view.focus_distance * view.pose.forward();
        }
        view.pose.eye += size * (view.pose.world_from_camera * motion.walk);
        view
    }
}

#[cfg(test)]
pub mod tests {
    use glam::{DVec2, dvec2, dvec3};

    use super::*;

    const WORLD: Surroundings = Surroundings { up: DVec3::Z, size: 2.0 };

    /// From `eye` to the origin, about which it turns.
    pub fn view_from(eye: DVec3) -> Viewpoint {
        let pose = Pose::of(&CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z));
        let lens = Lens { vertical_field_of_view: 0.9, near: 0.01 };
        Viewpoint { pose, focus_distance: eye.length(), lens }
    }

    fn view() -> Viewpoint {
        view_from(dvec3(3.0, -2.0, 1.5))
    }

    #[test]
    fn poses_and_lenses_come_back_from_their_cameras() {
        let view = view();
        let camera = view.camera([640, 360]);
        let (pose, lens) = (Pose::of(&camera.camera_from_world), Lens::of(&camera));
        assert!((pose.eye - view.pose.eye).length() < 1e-12);
        assert!(pose.world_from_camera.dot(view.pose.world_from_camera).abs() > 1.0 - 1e-12);
        approx::assert_relative_eq!(lens.vertical_field_of_view, 0.9, epsilon = 1e-12);
        let (x, y, depth) = camera.project(DVec3::ZERO).unwrap();
        assert!((dvec2(x, y) - dvec2(320.0, 180.0)).length() < 1e-9);
        approx::assert_relative_eq!(depth, view.focus_distance, epsilon = 1e-9);
    }

    #[test]
    fn orbiting_keeps_the_focus_its_distance_and_the_horizon() {
        let mut now = view();
        for step in 0..200 {
            let orbit = dvec2(0.3, 0.2 * f64::from(step).sin());
            now = now.moved(&Motion { orbit, ..Motion::default() }, &WORLD);
            assert!(now.focus().length() < 1e-9, "{:?}", now.focus());
            assert!((now.pose.eye.length() - now.focus_distance).abs() < 1e-9);
            assert!(now.pose.right().z.abs() < 1e-9, "the horizon tilts");
        }
    }

    #[test]
    fn a_drag_to_the_right_moves_what_is_in_front_of_the_focus_to_the_right() {
        let near_side = 0.2 * view().pose.eye;
        let turned = |orbit| view().moved(&Motion { orbit, ..Motion::default() }, &WORLD).camera([200, 200]);
        let (x, y, _) = turned(DVec2::ZERO).project(near_side).unwrap();
        assert!(turned(dvec2(0.2, 0.0)).project(near_side).unwrap().0 > x + 1.0);
        assert!(turned(dvec2(0.0, 0.2)).project(near_side).unwrap().1 > y + 1.0);
    }

    #[test]
    fn turning_stops_before_the_poles_and_comes_back_from_them() {
        for pitch in [10.0, -10.0] {
            let orbit = Motion { orbit: dvec2(0.0, pitch), ..Motion::default() };
            let at_pole = view().moved(&orbit, &WORLD);
            let from_up = at_pole.pose.forward().angle_between(DVec3::Z);
            assert!(from_up > 0.04 && from_up < PI - 0.04, "{from_up}");
            let back = at_pole.moved(&Motion { orbit: dvec2(0.0, -0.1 * pitch), ..Motion::default() }, &WORLD);
            assert!((back.pose.forward().angle_between(DVec3::Z) - from_up).abs() > 0.9);
        }
    }

    #[test]
    fn looking_turns_about_the_eye() {
        let look = Motion { look: dvec2(0.2, -0.1), ..Motion::default() };
        let after = view().moved(&look, &WORLD);
        assert_eq!(after.pose.eye, view().pose.eye);
        assert!(after.pose.forward().dot(view().pose.right()) > 0.1, "to the right");
        assert!(after.pose.forward().dot(view().pose.down()) < -0.05, "and up");
    }

    #[test]
    fn panning_moves_the_focus_by_the_way_of_the_cursor() {
        let (size, drag_px) = ([640, 360], dvec2(37.0, -12.0));
        let after = view().moved(&Motion { pan: drag_px / 360.0, ..Motion::default() }, &WORLD);
        let (x, y, depth) = after.camera(size).project(view().focus()).unwrap();
        assert!((dvec2(x, y) - (dvec2(320.0, 180.0) + drag_px)).length() < 1e-9, "{x} {y}");
        approx::assert_relative_eq!(depth, view().focus_distance, epsilon = 1e-9);
    }

    #[test]
    fn approaching_keeps_the_focus_and_stays_in_front_of_it() {
        let approach = |approach| view().moved(&Motion { approach, ..Motion::default() }, &WORLD);
        let near = approach(2f64.ln());
        approx::assert_relative_eq!(near.focus_distance, 0.5 * view().focus_distance, epsilon = 1e-9);
        assert!(near.focus().length() < 1e-9);
        let nearest = approach(1e3);
        assert!(nearest.focus_distance > 0.0 && nearest.focus().length() < 1e-9);
        assert!(approach(-1e3).focus_distance.is_finite());
    }

    #[test]
    fn walking_is_in_sizes_of_the_scene_along_the_axes_of_the_camera() {
        let after = view().moved(&Motion { walk: dvec3(0.0, 0.0, 0.25), ..Motion::default() }, &WORLD);
        assert!((after.pose.eye - (view().pose.eye + 0.5 * view().pose.forward())).length() < 1e-12);
        assert_eq!(after.focus_distance, view().focus_distance);
    }
}

//! Flying from one view to another.

use super::viewpoint::{Lens, Pose, Viewpoint};

/// Shortest and longest flight, s.
const DURATION: [f64; 2] = [0.35, 1.4];
/// Seconds for a way as long as the distance to the focus, or for a turn by a radian.
const PACE: f64 = 0.6;

#[derive(Clone, Copy, Debug)]
pub struct Flight {
    from: Viewpoint,
    to: Viewpoint,
    duration: f64,
    elapsed: f64,
}

impl Flight {
    pub fn new(from: Viewpoint, to: Viewpoint) -> Self {
        let way = (to.pose.eye - from.pose.eye).length() / from.focus_distance.max(to.focus_distance);
        let turn = from.pose.world_from_camera.angle_between(to.pose.world_from_camera);
        let duration = (PACE * (way + turn)).clamp(DURATION[0], DURATION[1]);
        Self { from, to, duration, elapsed: 0.0 }
    }

    /// The view `seconds` later, and whether it is the last: exactly the one flown to.
    pub fn advance(&mut self, seconds: f64) -> (Viewpoint, bool) {
        self.elapsed += seconds;
        if self.elapsed >= self.duration {
            return (self.to, true);
        }
        (between(&self.from, &self.to, eased(self.elapsed / self.duration)), false)
    }
}

fn eased(share: f64) -> f64 {
    share * share * (3.0 - 2.0 * share)
}

fn between(from: &Viewpoint, to: &Viewpoint, share: f64) -> Viewpoint {
    let geometric = |a: f64, b: f64| (a.ln() + share * (b.ln() - a.ln())).exp();
    // glam's slerp takes the shorter of the two ways
    let world_from_camera = from.pose.world_from_camera.slerp(to.pose.world_from_camera, share);
    let (wide, narrow) = (from.lens.vertical_field_of_view, to.lens.vertical_field_of_view);
    Viewpoint {
        pose: Pose { eye: from.pose.eye.lerp(to.pose.eye, share), world_from_camera },
        focus_distance: geometric(from.focus_distance, to.focus_distance),
        lens: Lens { vertical_field_of_view: geometric(wide, narrow), near: geometric(from.lens.near, to.lens.near) },
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3, dvec3};

    use super::super::viewpoint::tests::view_from;
    use super::*;

    fn view(eye: DVec3, field: f64) -> Viewpoint {
        Viewpoint { lens: Lens { vertical_field_of_view: field, near: 0.1 * field }, ..view_from(eye) }
    }

    #[test]
    fn it_starts_and_ends_at_rest_and_arrives_exactly() {
        let (from, to) = (view(dvec3(2.0, 0.0, 1.0), 0.8), view(dvec3(-1.0, 3.0, 0.5), 0.4));
        let mut flight = Flight::new(from, to);
        let mut eyes = vec![from.pose.eye];
        loop {
            let (now, arrived) = flight.advance(0.01);
            eyes.push(now.pose.eye);
            assert!((now.pose.world_from_camera.length() - 1.0).abs() < 1e-9);
            assert!((0.4..=0.8).contains(&now.lens.vertical_field_of_view));
            if arrived {
                assert_eq!(now, to);
                break;
            }
            assert!(eyes.len() < 1000, "it never arrives");
        }
        let speeds: Vec<f64> = eyes.windows(2).map(|pair| (pair[1] - pair[0]).length()).collect();
        let fastest = speeds.iter().copied().fold(0.0, f64::max);
        assert!(speeds[0] < 0.2 * fastest && speeds[speeds.len() - 2] < 0.2 * fastest, "{speeds:?}");
    }

    #[test]
    fn it_turns_the_shorter_way() {
        let from = view(dvec3(2.0, 0.0, 0.0), 0.8);
        let mut to = from;
        let turn = DQuat::from_axis_angle(DVec3::Z, 0.4) * from.pose.world_from_camera;
        to.pose.world_from_camera = -turn;
        let half = between(&from, &to, 0.5);
        let turned = half.pose.world_from_camera.angle_between(from.pose.world_from_camera);
        assert!((turned - 0.2).abs() < 1e-9, "{turned}");
    }
}

//! The view over time: hands, inertia, flights.

use dpges_core::camera::Camera;
use glam::DVec3;

use super::flight::Flight;
use super::hands::{Input, Mode};
use super::motion::Motion;
use super::viewpoint::{Lens, Pose, Surroundings, Viewpoint};

/// Time in which a thrown view loses all but 1/e of its speed, s.
const COASTING: f64 = 0.14;
/// Time in which keys bring the view up to speed or to rest, but for 1/e, s.
const KEYS: f64 = 0.08;
/// Time over which the speed of a drag is averaged, s.
const DRAG: f64 = 0.04;
/// Longest step, s: a slow frame does not throw the view.
const LONGEST_STEP: f64 = 0.2;

#[derive(Clone, Debug)]
pub struct Navigator {
    viewpoint: Viewpoint,
    pub surroundings: Surroundings,
    pub mode: Mode,
    /// Per second.
    thrown: Motion,
    /// Per second.
    driven: Motion,
    flight: Option<Flight>,
}

impl Navigator {
    pub fn new(viewpoint: Viewpoint, surroundings: Surroundings) -> Self {
        let (thrown, driven) = (Motion::NONE, Motion::NONE);
        Self { viewpoint, surroundings, mode: Mode::default(), thrown, driven, flight: None }
    }

    pub fn viewpoint(&self) -> &Viewpoint {
        &self.viewpoint
    }

    /// Stands still at `viewpoint`.
    pub fn jump(&mut self, viewpoint: Viewpoint) {
        self.stop();
        self.viewpoint = viewpoint;
    }

    pub fn fly(&mut self, viewpoint: Viewpoint) {
        self.stop();
        self.flight = Some(Flight::new(self.viewpoint, viewpoint));
    }

    pub fn lens_mut(&mut self) -> &mut Lens {
        &mut self.viewpoint.lens
    }

    /// Flies sideways until `point` is in the middle of the picture, and turns about it from then on.
    pub fn focus_on(&mut self, point: DVec3) {
        let to_point = point - self.viewpoint.pose.eye;
        let depth = to_point.dot(self.viewpoint.pose.forward());
        if depth > self.viewpoint.lens.near {
            let mut target = self.viewpoint;
            target.focus_distance = depth;
            target.pose.eye += to_point - depth * self.viewpoint.pose.forward();
            self.fly(target);
        }
    }

    pub fn is_flying(&self) -> bool {
        self.flight.is_some()
    }

    /// Stands still where the view is.
    pub fn stop(&mut self) {
        self.flight = None;
        self.thrown = Motion::NONE;
        self.driven = Motion::NONE;
    }

    /// Goes on by `seconds`. Returns whether the view changes by itself from here, so that another frame is wanted.
    pub fn advance(&mut self, input: &Input, seconds: f64) -> bool {
        if input.is_active() {
            self.flight = None;
        }
        if let Some(flight) = &mut self.flight {
            let (viewpoint, arrived) = flight.advance(seconds);
            self.viewpoint = viewpoint;
            if arrived {
                self.flight = None;
            }
            return !arrived;
        }
        let step = seconds.clamp(1e-4, LONGEST_STEP);
        self.thrown = self.thrown + (1.0 / COASTING) * input.push;
        let coasted = if input.dragging {
            let fresh = 1.0 - (-step / DRAG).exp();
            self.thrown = (1.0 - fresh) * self.thrown + (fresh / step) * input.drag;
            input.drag
        } else {
            let left = (-step / COASTING).exp();
            let way = COASTING * (1.0 - left) * self.thrown;
            self.thrown = left * self.thrown;
            // touchpads scroll and pinch without holding the view
            input.drag + way
        };
        let fresh = 1.0 - (-step / KEYS).exp();
        self.driven = (1.0 - fresh) * self.driven + fresh * input.keys;
        self.viewpoint = self.viewpoint.moved(&(coasted + step * self.driven), &self.surroundings);
        if self.thrown.is_rest() {
            self.thrown = Motion::NONE;
        }
        if self.driven.is_rest() && input.keys == Motion::NONE {
            self.driven = Motion::NONE;
        }
        self.thrown != Motion::NONE || self.driven != Motion::NONE
    }
}

impl Viewpoint {
    /// As `camera` sees, turning about what it has at `focus_distance`.
    pub fn of(camera: &Camera, focus_distance: f64) -> Self {
        Self { pose: Pose::of(&camera.camera_from_world), focus_distance, lens: Lens::of(camera) }
    }
}

#[cfg(test)]
mod tests {
    use glam::{dvec2, dvec3};

    use super::super::viewpoint::tests::view_from;
    use super::*;

    fn navigator() -> Navigator {
        Navigator::new(view_from(dvec3(4.0, 0.0, 1.0)), Surroundings { up: DVec3::Z, size: 1.0 })
    }

    /// Keys that walk ahead.
    fn ahead() -> Input {
        Input { keys: Motion { walk: dvec3(0.0, 0.0, 1.0), ..Motion::NONE }, ..Input::default() }
    }

    fn drag(orbit: f64) -> Input {
        let drag = Motion { orbit: dvec2(orbit, 0.0), ..Motion::NONE };
        Input { drag, dragging: true, ..Input::default() }
    }

    fn advance(navigator: &mut Navigator, input: &Input, seconds: f64, frames: usize) {
        for _ in 0..frames {
            navigator.advance(input, seconds);
        }
    }

    fn heading(navigator: &Navigator) -> f64 {
        let forward = navigator.viewpoint().pose.forward();
        forward.y.atan2(forward.x)
    }

    #[test]
    fn a_drag_is_followed_exactly() {
        let mut navigator = navigator();
        let before = heading(&navigator);
        advance(&mut navigator, &drag(0.02), 0.016, 10);
        let turned = (heading(&navigator) - before).rem_euclid(std::f64::consts::TAU);
        assert!((turned - (std::f64::consts::TAU - 0.2)).abs() < 1e-9, "{turned}");
    }

    #[test]
    fn a_touchpad_moves_the_view_without_holding_it() {
        let mut navigator = navigator();
        let before = navigator.viewpoint().focus_distance;
        let mut input = Input::default();
        input.pinch(2.0);
        assert!(!navigator.advance(&input, 0.016), "nothing goes on");
        assert!((navigator.viewpoint().focus_distance - 0.5 * before).abs() < 1e-9);
    }

    #[test]
    fn inertia_dies_and_its_way_does_not_depend_on_the_frame_rate() {
        let ways = [0.004, 0.016, 0.05].map(|step| {
            let mut navigator = navigator();
            let rate = 1.5;
            let frames = (0.4_f64 / step).round() as usize;
            advance(&mut navigator, &drag(rate * step), step, frames);
            let released = heading(&navigator);
            let mut frames = 0;
            while navigator.advance(&Input::default(), step) {
                frames += 1;
                assert!(frames < 2000, "it never rests");
            }
            let rest = *navigator.viewpoint();
            assert!(!navigator.advance(&Input::default(), step));
            assert_eq!(*navigator.viewpoint(), rest);
            (released - heading(&navigator)).rem_euclid(std::f64::consts::TAU)
        });
        for way in ways {
            assert!((way - 1.5 * COASTING).abs() < 0.01, "{ways:?}");
        }
    }

    #[test]
    fn a_held_view_is_not_thrown() {
        let mut navigator = navigator();
        advance(&mut navigator, &drag(0.05), 0.016, 10);
        advance(&mut navigator, &drag(0.0), 0.016, 30);
        let held = heading(&navigator);
        while navigator.advance(&Input::default(), 0.016) {}
        assert!((heading(&navigator) - held).abs() < 1e-3);
    }

    #[test]
    fn a_push_goes_all_its_way() {
        let mut navigator = navigator();
        let before = navigator.viewpoint().focus_distance;
        let push = Motion { approach: 0.5, ..Motion::NONE };
        let mut input = Input { push, ..Input::default() };
        while navigator.advance(&input, 0.016) {
            input = Input::default();
        }
        let factor = navigator.viewpoint().focus_distance / before;
        assert!((factor.ln() + 0.5).abs() < 1e-3, "{factor}");
    }

    #[test]
    fn keys_reach_their_speed_and_let_go() {
        let mut navigator = navigator();
        (0..100).for_each(|_| assert!(navigator.advance(&ahead(), 0.01)));
        let way = (navigator.viewpoint().pose.eye - dvec3(4.0, 0.0, 1.0)).length();
        assert!((way - (1.0 - KEYS)).abs() < 0.02, "{way}");
        let mut frames = 0;
        while navigator.advance(&Input::default(), 0.01) {
            frames += 1;
        }
        assert!(frames < 200, "{frames}");
    }

    #[test]
    fn hands_interrupt_a_flight() {
        let mut navigator = navigator();
        let mut target = *navigator.viewpoint();
        target.pose.eye = dvec3(0.0, 4.0, 1.0);
        navigator.fly(target);
        assert!(navigator.advance(&Input::default(), 0.05) && navigator.is_flying());
        navigator.advance(&drag(0.1), 0.05);
        assert!(!navigator.is_flying());
        navigator.fly(target);
        while navigator.advance(&Input::default(), 0.05) {}
        assert_eq!(*navigator.viewpoint(), target);
    }

    #[test]
    fn a_slow_frame_is_no_jump() {
        let mut navigator = navigator();
        navigator.advance(&ahead(), 60.0);
        assert!((navigator.viewpoint().pose.eye - dvec3(4.0, 0.0, 1.0)).length() <= LONGEST_STEP);
    }

    #[test]
    fn the_focus_moves_to_a_picked_point() {
        let mut navigator = navigator();
        let point = dvec3(0.5, 0.3, 0.2);
        navigator.focus_on(point);
        while navigator.advance(&Input::default(), 0.05) {}
        assert!((navigator.viewpoint().focus() - point).length() < 1e-9);
        navigator.focus_on(dvec3(100.0, 0.0, 0.0));
        assert!(!navigator.is_flying(), "what is behind cannot be turned about");
    }
}

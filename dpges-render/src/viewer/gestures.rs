//! The meaning of mouse, touchpad, touch screen and keys of egui for a view.

use egui::{Event, InputState, Key, MouseWheelSource, MouseWheelUnit, PointerButton, Response, Ui};
use glam::{DVec2, DVec3};

use crate::navigation::{Drag, Input, Keys, Mode, Motion};

/// Points of a touchpad's scroll that count as a notch.
const POINTS_PER_NOTCH: f64 = 50.0;
const NOTCHES_PER_PAGE: f64 = 5.0;

/// Gestures on the picture of `response`. Keys count only if `takes_keys`. A `tool` has the first button: the second does what
/// that does otherwise.
pub fn gestures(ui: &Ui, response: &Response, mode: Mode, takes_keys: bool, tool: bool) -> Input {
    let height = f64::from(response.rect.height()).max(1.0);
    let mut input = Input::default();
    let dragged = [PointerButton::Primary, PointerButton::Secondary, PointerButton::Middle]
        .into_iter()
        .find(|&button| response.dragged_by(button) && !(tool && button == PointerButton::Primary));
    let turns_by = if tool { PointerButton::Secondary } else { PointerButton::Primary };
    // not within `ui.input`, which locks what this reads
    let drag = way(response.drag_delta()) / height;
    ui.input(|state| {
        if let Some(button) = dragged {
            let pans = button != turns_by || state.modifiers.shift;
            let turns = if state.modifiers.command { Drag::Look } else { mode.drag() };
            input.drag = if pans { Drag::Pan } else { turns }.motion(drag);
            input.dragging = true;
        }
        if response.contains_pointer() {
            wheel(state, mode, height, &mut input);
        }
        if takes_keys {
            input.keys = keys(state, mode);
        }
    });
    input
}

fn way(delta: egui::Vec2) -> DVec2 {
    DVec2::new(delta.x.into(), delta.y.into())
}

/// Wheels approach. Two fingers turn, with shift they pan; pinching approaches.
fn wheel(state: &InputState, mode: Mode, height: f64, input: &mut Input) {
    for event in &state.events {
        let Event::MouseWheel { unit, delta, source, modifiers, .. } = event else { continue };
        // egui makes a zoom of it
        if modifiers.command || modifiers.ctrl {
            continue;
        }
        let delta = way(*delta);
        let fingers = match source {
            MouseWheelSource::Trackpad | MouseWheelSource::Momentum => true,
            MouseWheelSource::Wheel => false,
            MouseWheelSource::Unknown => *unit == MouseWheelUnit::Point,
        };
        if fingers {
            let drag = if modifiers.shift { Drag::Pan } else { mode.drag() };
            input.drag = input.drag + drag.motion(delta / height);
        } else {
            let notches = match unit {
                MouseWheelUnit::Line => delta.y,
                MouseWheelUnit::Point => delta.y / POINTS_PER_NOTCH,
                MouseWheelUnit::Page => delta.y * NOTCHES_PER_PAGE,
            };
            input.wheel(notches);
        }
    }
    input.pinch(state.zoom_delta().into());
    if let Some(touch) = state.multi_touch() {
        input.drag = input.drag + Drag::Pan.motion(way(touch.translation_delta) / height);
        input.dragging = true;
    }
}

fn keys(state: &InputState, mode: Mode) -> Motion {
    if state.modifiers.command || state.modifiers.alt {
        return Motion::NONE;
    }
    let axis = |more, less| f64::from(i8::from(state.key_down(more)) - i8::from(state.key_down(less)));
    let keys = Keys {
        walk: DVec3::new(axis(Key::D, Key::A), axis(Key::Q, Key::E), axis(Key::W, Key::S)),
        turn: DVec2::new(axis(Key::ArrowRight, Key::ArrowLeft), axis(Key::ArrowDown, Key::ArrowUp)),
        approach: 0.0,
        faster: state.modifiers.shift,
    };
    keys.motion(mode)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use egui::{Modifiers, TouchPhase, vec2};
    use egui_kittest::Harness;

    use super::*;
    use crate::navigation::hands::{NOTCH, TURN, WALK};

    /// Shows a picture of 300 × 200 points and returns the last input and the sum of all drags.
    fn harness(mode: Mode, tool: bool) -> Harness<'static, (Input, Motion)> {
        let app = move |ui: &mut Ui, seen: &mut (Input, Motion)| {
            let (_, response) = ui.allocate_exact_size(vec2(300.0, 200.0), egui::Sense::click_and_drag());
            seen.0 = gestures(ui, &response, mode, true, tool);
            seen.1 = seen.1 + seen.0.drag + seen.0.push;
        };
        Harness::builder().with_size(vec2(320.0, 220.0)).build_ui_state(app, Default::default())
    }

    fn dragged(mode: Mode, button: PointerButton, modifiers: Modifiers) -> Motion {
        dragged_with(false, mode, button, modifiers)
    }

    fn dragged_with(tool: bool, mode: Mode, button: PointerButton, modifiers: Modifiers) -> Motion {
        let mut harness = harness(mode, tool);
        harness.event(Event::ModifiersChanged(modifiers));
        let press = |pos, pressed| Event::PointerButton { pos, button, pressed, modifiers };
        let (start, end) = (egui::pos2(100.0, 100.0), egui::pos2(140.0, 90.0));
        for event in [Event::PointerMoved(start), press(start, true), Event::PointerMoved(end), press(end, false)] {
            harness.event(event);
            harness.step();
        }
        harness.state().1
    }

    #[test]
    fn buttons_and_modes_turn_look_and_pan() {
        let heights = DVec2::new(40.0, -10.0) / 200.0;
        let near = |a: DVec2, b: DVec2| assert!((a - b).length() < 1e-6, "{a} {b}");
        near(dragged(Mode::Orbit, PointerButton::Primary, Modifiers::NONE).orbit, PI * heights);
        near(dragged(Mode::Fly, PointerButton::Primary, Modifiers::NONE).look, PI * heights);
        near(dragged(Mode::Orbit, PointerButton::Secondary, Modifiers::NONE).pan, heights);
        near(dragged(Mode::Fly, PointerButton::Middle, Modifiers::NONE).pan, heights);
        near(dragged(Mode::Orbit, PointerButton::Primary, Modifiers::SHIFT).pan, heights);
        assert_eq!(dragged_with(true, Mode::Orbit, PointerButton::Primary, Modifiers::NONE), Motion::NONE);
        near(dragged_with(true, Mode::Orbit, PointerButton::Secondary, Modifiers::NONE).orbit, PI * heights);
        near(dragged_with(true, Mode::Orbit, PointerButton::Middle, Modifiers::NONE).pan, heights);
    }

    fn scrolled(unit: MouseWheelUnit, source: MouseWheelSource, modifiers: Modifiers) -> Motion {
        let mut harness = harness(Mode::Orbit, false);
        harness.event(Event::PointerMoved(egui::pos2(100.0, 100.0)));
        harness.step();
        let (delta, phase) = (vec2(0.0, 2.0), TouchPhase::Move);
        harness.event(Event::MouseWheel { unit, delta, phase, source, modifiers });
        harness.step();
        harness.state().1
    }

    #[test]
    fn wheels_approach_and_fingers_turn() {
        let wheel = scrolled(MouseWheelUnit::Line, MouseWheelSource::Unknown, Modifiers::NONE);
        assert!((wheel.approach - 2.0 * NOTCH).abs() < 1e-9 && wheel.orbit == DVec2::ZERO, "{wheel:?}");
        let fingers = scrolled(MouseWheelUnit::Point, MouseWheelSource::Unknown, Modifiers::NONE);
        assert!(fingers.orbit.y > 0.0 && fingers.approach == 0.0, "{fingers:?}");
        let shifted = scrolled(MouseWheelUnit::Point, MouseWheelSource::Trackpad, Modifiers::SHIFT);
        assert!(shifted.pan != DVec2::ZERO && shifted.orbit == DVec2::ZERO, "{shifted:?}");
    }

    #[test]
    fn pinching_approaches() {
        let mut harness = harness(Mode::Orbit, false);
        harness.event(Event::PointerMoved(egui::pos2(100.0, 100.0)));
        harness.step();
        harness.event(Event::Zoom(1.5));
        harness.step();
        assert!((harness.state().1.approach - 1.5f64.ln()).abs() < 1e-6);
    }

    #[test]
    fn keys_walk_and_turn() {
        let mut harness = harness(Mode::Orbit, false);
        harness.key_down(Key::W);
        harness.key_down(Key::ArrowLeft);
        harness.step();
        let keys = harness.state().0.keys;
        assert!((keys.walk - DVec3::new(0.0, 0.0, WALK)).length() < 1e-9 && keys.orbit.x == -TURN, "{keys:?}");
        harness.key_up(Key::W);
        harness.key_up(Key::ArrowLeft);
        harness.step();
        assert_eq!(harness.state().0.keys, Motion::NONE);
    }
}

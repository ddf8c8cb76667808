//! Where the view is and how hands move it.

use egui::{ComboBox, Slider, Ui};
use glam::DVec3;

use super::super::state::State;
use crate::navigation::Mode;

const AXES: [(&str, DVec3); 6] = [
    ("+x", DVec3::X),
    ("+y", DVec3::Y),
    ("+z", DVec3::Z),
    ("−x", DVec3::NEG_X),
    ("−y", DVec3::NEG_Y),
    ("−z", DVec3::NEG_Z),
];

pub fn show(state: &mut State, ui: &mut Ui) {
    ui.horizontal_wrapped(|ui| {
        ui.label("dragging");
        ui.selectable_value(&mut state.navigator.mode, Mode::Orbit, "orbits");
        ui.selectable_value(&mut state.navigator.mode, Mode::Fly, "looks around");
        if ui.button("Home").clicked() {
            state.leave_for(state.home);
        }
    });
    let size = state.navigator.surroundings.size;
    let lens = state.navigator.lens_mut();
    let mut degrees = lens.vertical_field_of_view.to_degrees();
    if ui.add(Slider::new(&mut degrees, 5.0..=120.0).suffix("°").text("field of view")).changed() {
        lens.vertical_field_of_view = degrees.to_radians();
    }
    let near = 1e-4 * size..=2.0 * size;
    let slider = Slider::new(&mut lens.near, near).logarithmic(true).clamping(egui::SliderClamping::Edits);
    ui.add(slider.text("near plane"));
    let up = state.navigator.surroundings.up;
    let named = AXES.iter().find(|(_, axis)| axis.dot(up) > 0.9999).map(|(name, _)| *name);
    ComboBox::from_label("up").selected_text(named.unwrap_or("as the cameras")).show_ui(ui, |ui| {
        for (name, axis) in AXES {
            ui.selectable_value(&mut state.navigator.surroundings.up, axis, name);
        }
    });
}

//! Distances.

use egui::Ui;

use super::super::measuring::text_of;
use super::super::state::State;

pub fn show(state: &mut State, ui: &mut Ui) {
    let measuring = &mut state.measuring;
    ui.horizontal(|ui| {
        ui.toggle_value(&mut measuring.active, "Pick points");
        if ui.add_enabled(!measuring.points.is_empty(), egui::Button::new("Clear")).clicked() {
            measuring.points.clear();
        }
    });
    for (point, name) in measuring.points.iter().zip(["from", "to"]) {
        let [x, y, z] = point.to_array();
        ui.monospace(format!("{name:4} {x:9.4} {y:9.4} {z:9.4}"));
    }
    if let Some(distance) = measuring.distance() {
        ui.strong(format!("{} world units", text_of(distance)));
    } else if measuring.active {
        ui.weak("Click two points on surfaces.");
    }
}

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
    let Some(distance) = measuring.distance() else {
        if measuring.active {
            ui.weak("Click two points on surfaces.");
        }
        return;
    };
    let Some(shown) = &mut state.scene else { return };
    ui.strong(text_of(distance, shown.info.metres_per_unit));
    ui.horizontal(|ui| {
        ui.label("Known length");
        ui.add(egui::TextEdit::singleline(&mut measuring.known).hint_text("1.25m").desired_width(70.0));
    });
    if measuring.known.is_empty() {
        return;
    }
    match measuring.scale() {
        Err(reason) => {
            ui.weak(reason);
        }
        Ok(scale) => {
            ui.horizontal(|ui| {
                if ui.button("Measure by it").clicked() {
                    shown.info.metres_per_unit = Some(scale);
                }
                let store = ui.button("Copy command").on_hover_text("The command that stores the scale in the scene");
                if let (true, Some(command)) = (store.clicked(), measuring.command(&shown.name)) {
                    ui.ctx().copy_text(command);
                }
            });
        }
    }
}

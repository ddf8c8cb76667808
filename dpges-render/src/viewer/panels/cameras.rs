//! The cameras of the dataset.

use egui::{ScrollArea, Ui};

use super::super::state::State;

/// Height of the list, points.
const HEIGHT: f32 = 130.0;

pub fn show(state: &mut State, ui: &mut Ui) {
    let count = state.views.as_ref().map_or(0, |views| views.cameras.len());
    if state.pending_views.is_some() {
        ui.horizontal(|ui| {
            ui.spinner();
            ui.weak("reading the dataset");
        });
        return;
    }
    if count == 0 {
        ui.weak("This scene came without cameras: `--data DATASET` names them.");
        return;
    }
    ui.horizontal(|ui| {
        if ui.button("Previous").clicked() {
            state.step_view(-1);
        }
        if ui.button("Next").clicked() {
            state.step_view(1);
        }
        ui.weak(format!("{count} cameras"));
    });
    let row = ui.spacing().interact_size.y;
    let list = ScrollArea::vertical().id_salt("cameras").max_height(HEIGHT).auto_shrink([false, true]);
    list.show_rows(ui, row, count, |ui, rows| {
        for index in rows {
            let name = state.views.as_ref().map_or("", |views| &views.cameras[index].0);
            let response = ui.selectable_label(state.chosen_view == Some(index), name);
            if response.clicked() || response.double_clicked() {
                state.go_to_view(index, response.double_clicked());
            }
        }
    });
}

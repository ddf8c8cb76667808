//! The scene beside its photographs.

use egui::Ui;

use super::super::comparison::Comparison;
use super::super::state::State;

pub fn show(state: &mut State, ui: &mut Ui) {
    if state.views.is_none() {
        ui.weak("There are no photographs to compare with.");
        return;
    }
    ui.horizontal_wrapped(|ui| {
        for kind in Comparison::ALL {
            ui.selectable_value(&mut state.comparing.kind, kind, kind.name());
        }
    });
    if state.comparing.kind == Comparison::Off {
        return;
    }
    if state.at_view.is_none() {
        ui.label("The view has left the camera.");
        if let Some(chosen) = state.chosen_view
            && ui.button("Back to it").clicked()
        {
            state.go_to_view(chosen, false);
        }
    } else if state.comparing.kind == Comparison::Error {
        if let Some(error) = state.comparing.mean_error() {
            ui.label(format!("mean absolute error {:.2} of 255", 255.0 * error));
        }
        ui.weak("dark: equal; yellow: a quarter of full scale or more");
    }
}

//! The scene beside its photographs.

use egui::Ui;

use super::super::app::Viewer;
use super::super::comparison::Comparison;

pub fn show(viewer: &mut Viewer, ui: &mut Ui) {
    if viewer.views.is_none() {
        ui.weak("There are no photographs to compare with.");
        return;
    }
    ui.horizontal_wrapped(|ui| {
        for kind in Comparison::ALL {
            ui.selectable_value(&mut viewer.comparing.kind, kind, kind.name());
        }
    });
    if viewer.comparing.kind == Comparison::Off {
        return;
    }
    match (viewer.at_view, viewer.chosen_view) {
        (Some(_), _) if viewer.comparing.kind == Comparison::Error => {
            if let Some(error) = viewer.comparing.mean_error() {
                ui.label(format!("mean absolute error {:.2} of 255", 255.0 * error));
            }
            ui.weak("dark: equal; yellow: a quarter of full scale or more");
        }
        (Some(_), _) => {}
        (None, chosen) => {
            ui.label("The view has left the camera.");
            if let Some(chosen) = chosen
                && ui.button("Back to it").clicked()
            {
                viewer.go_to_view(chosen, false);
            }
        }
    }
}

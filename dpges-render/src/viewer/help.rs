//! The list of keys over the picture.

use egui::{Align2, Context, Grid, RichText, Window};

use super::keys::HELP;

/// Shows the list; `open` becomes false when it is closed.
pub fn show(context: &Context, open: &mut bool) {
    let window = Window::new("Mouse and keys").open(open).collapsible(false).resizable(false);
    window.anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(context, |ui| {
        Grid::new("keys").num_columns(2).striped(true).spacing([24.0, 4.0]).show(ui, |ui| {
            for (keys, meaning) in HELP {
                ui.label(RichText::new(keys).strong());
                ui.label(meaning);
                ui.end_row();
            }
        });
    });
}

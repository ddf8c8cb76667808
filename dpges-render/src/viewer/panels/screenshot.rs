//! Pictures as files.

use std::path::PathBuf;

use egui::{DragValue, TextEdit, Ui};

use super::super::dialogs::Purpose;
use super::super::state::State;

/// Size that is offered first, px.
const FULL_HD: [usize; 2] = [1920, 1080];

pub fn show(state: &mut State, ui: &mut Ui) {
    let largest = state.canvas.as_ref().map_or(8192, |canvas| canvas.largest_size());
    let form = &mut state.screenshot;
    ui.horizontal(|ui| {
        ui.selectable_value(&mut form.size, None, "as the window");
        if ui.selectable_label(form.size.is_some(), "size").clicked() && form.size.is_none() {
            form.size = Some(FULL_HD);
        }
        if let Some([width, height]) = &mut form.size {
            ui.add(DragValue::new(width).range(1..=largest).suffix(" px"));
            ui.add(DragValue::new(height).range(1..=largest).suffix(" px"));
        }
    });
    ui.add(TextEdit::singleline(&mut form.file).desired_width(f32::INFINITY));
    ui.horizontal(|ui| {
        if ui.button("Save").on_hover_text("key P").clicked() {
            state.save_screenshot(&PathBuf::from(state.screenshot.file.clone()));
        }
        if ui.button("Save as…").clicked() {
            state.ask(ui.ctx(), Purpose::SaveScreenshot);
        }
    });
}

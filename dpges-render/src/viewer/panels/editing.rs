//! Selecting, deleting, saving.

use dpges_core::scene::Rendering;
use egui::{Button, Context, Slider, TextEdit, Ui};

use super::super::dialogs::Purpose;
use super::super::editing::{Edit, RADII, Tool};
use super::super::question::question;
use super::super::state::State;

pub fn show(state: &mut State, ui: &mut Ui) {
    let editing = &mut state.editing;
    let Some(scene) = &editing.scene else {
        ui.weak("Scenes in levels of detail or in training are not edited.");
        return;
    };
    let selected = scene.marks.selected_count();
    let (undoes, redoes, changed) = (scene.marks.can_undo(), scene.marks.can_redo(), !scene.is_saved());
    let has_layers = state.scene.as_ref().is_some_and(|shown| shown.info.rendering == Rendering::Peeled);
    let mut asked = None;
    ui.horizontal(|ui| {
        for (tool, name, keys) in [(Tool::Box, "Box", "key R"), (Tool::Brush, "Brush", "key B")] {
            let choice = ui.selectable_label(editing.tool == Some(tool), name);
            if choice.on_hover_text(format!("{keys}; shift adds, ctrl subtracts, right drag turns")).clicked() {
                asked = Some(Edit::Tool(tool));
            }
        }
        ui.add_enabled(has_layers, egui::Checkbox::new(&mut editing.seen_only, "only what is seen")).on_hover_text(
            "Leaves out what is behind the first surface. Otherwise all in the region is selected, however far away.",
        );
    });
    if editing.tool == Some(Tool::Brush) {
        ui.add(Slider::new(&mut editing.radius, RADII[0]..=RADII[1]).logarithmic(true).text("brush"))
            .on_hover_text("keys [ and ]");
    }
    let mut buttons = |ui: &mut Ui, buttons: &[(&str, &str, bool, Edit)]| {
        ui.horizontal(|ui| {
            for &(name, keys, enabled, edit) in buttons {
                if ui.add_enabled(enabled, Button::new(name)).on_hover_text(keys).clicked() {
                    asked = Some(edit);
                }
            }
        });
    };
    buttons(
        ui,
        &[
            ("All", "ctrl + A", true, Edit::SelectAll),
            ("Nothing", "ctrl + D", selected > 0, Edit::SelectNothing),
            ("Invert", "key I", true, Edit::Invert),
        ],
    );
    buttons(
        ui,
        &[
            ("Delete", "key Delete", selected > 0, Edit::Delete),
            ("Undo", "ctrl + Z", undoes, Edit::Undo),
            ("Redo", "ctrl + shift + Z", redoes, Edit::Redo),
        ],
    );
    ui.weak(format!("{selected} selected{}", if changed { "; not saved" } else { "" }));
    ui.add(TextEdit::singleline(&mut editing.file).desired_width(f32::INFINITY));
    ui.horizontal(|ui| {
        if ui.button("Save").on_hover_text("ctrl + S").clicked() {
            asked = Some(Edit::Save);
        }
        if ui.button("Save as…").clicked() {
            state.ask(ui.ctx(), Purpose::SaveScene);
        }
    });
    if let Some(edit) = asked {
        state.edit(edit);
    }
}

/// Asks whether a file is to be replaced, where that is open.
pub fn ask_to_replace(state: &mut State, context: &Context) {
    let Some(file) = &state.editing.asks_for else { return };
    let text = format!("{} is there already.", file.display());
    if let Some(answer) = question(context, "Replace the file?", &text, &["Replace", "Back"]) {
        state.editing.asks_for = None;
        if answer == 0 {
            state.save_edited(true);
        }
    }
}

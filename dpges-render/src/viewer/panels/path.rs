//! The camera path.

use egui::{Button, DragValue, Id, TextEdit, Ui};

use super::super::dialogs::Purpose;
use super::super::state::State;
use crate::navigation::Viewpoint;

enum Request {
    Show(usize),
    Remove(usize),
    Move(usize, usize),
}

pub fn show(state: &mut State, ui: &mut Ui) {
    ui.horizontal(|ui| {
        if ui.button("Add view").on_hover_text("key K").clicked() {
            state.add_to_path();
        }
        let name = if state.path.is_playing() { "Stop" } else { "Play" };
        if ui.add_enabled(state.path.can_play(), Button::new(name)).clicked() {
            state.path.play_or_stop();
        }
        ui.add(DragValue::new(&mut state.path.seconds).range(0.5..=600.0).speed(0.1).suffix(" s"));
    });
    match keys(state, ui) {
        Some(Request::Show(at)) => {
            let focus_distance = state.navigator.viewpoint().focus_distance;
            state.leave_for(Viewpoint::of(&state.path.cameras[at], focus_distance));
        }
        Some(Request::Remove(at)) => state.path.remove(at),
        Some(Request::Move(from, to)) => state.path.reorder(from, to),
        None => {}
    }
    ui.add(TextEdit::singleline(&mut state.path.file).desired_width(f32::INFINITY));
    ui.horizontal(|ui| {
        if ui.add_enabled(!state.path.cameras.is_empty(), Button::new("Save")).clicked() {
            state.save_path();
        }
        if ui.button("Load").clicked() {
            state.load_path();
        }
        if ui.button("Save as…").clicked() {
            state.ask(ui.ctx(), Purpose::SavePath);
        }
        if ui.button("Load from…").clicked() {
            state.ask(ui.ctx(), Purpose::LoadPath);
        }
    });
}

/// The list of key cameras, which are dragged into another order.
fn keys(state: &State, ui: &mut Ui) -> Option<Request> {
    let mut request = None;
    let count = state.path.cameras.len();
    if count < 2 {
        ui.weak("A path goes through two views or more.");
    }
    for at in 0..count {
        let row = ui.horizontal(|ui| {
            let id = Id::unique(("key camera", at));
            ui.dnd_drag_source(id, at, |ui| ui.label(format!("↕ view {}", at + 1)));
            if ui.small_button("show").clicked() {
                request = Some(Request::Show(at));
            }
            if ui.small_button("delete").clicked() {
                request = Some(Request::Remove(at));
            }
        });
        if let Some(from) = row.response.dnd_release_payload::<usize>() {
            request = Some(Request::Move(*from, at));
        }
        if row.response.dnd_hover_payload::<usize>().is_some() {
            let stroke = ui.visuals().selection.stroke;
            ui.painter().rect_stroke(row.response.rect, 2.0, stroke, egui::StrokeKind::Outside);
        }
    }
    request
}

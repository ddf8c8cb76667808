//! Edits of the scene by keys and buttons.

use std::path::PathBuf;

use super::editing::{Edit, EditedScene};
use super::messages::Message;
use super::state::State;

/// Ratio of the radii of the brush before and after a key.
const STEP: f32 = 1.25;

impl State {
    pub fn edit(&mut self, edit: Edit) {
        let editing = &mut self.editing;
        let Some(scene) = &mut editing.scene else {
            let text = "Scenes in levels of detail or in training are not edited: open the scene file itself.";
            self.message = Some(Message::Note(text.to_owned()));
            return;
        };
        let marks = &mut scene.marks;
        let mut redraws = false;
        match edit {
            Edit::Tool(tool) => {
                let taken = editing.tool != Some(tool);
                editing.lay_down();
                editing.tool = taken.then_some(tool);
                self.measuring.active = false;
            }
            Edit::SmallerBrush => editing.resize_brush(1.0 / STEP),
            Edit::LargerBrush => editing.resize_brush(STEP),
            Edit::SelectAll => marks.select_all(),
            Edit::SelectNothing => marks.select_nothing(),
            Edit::Invert => marks.invert(),
            Edit::Delete => redraws = marks.delete(),
            Edit::Undo => redraws = marks.undo(),
            Edit::Redo => redraws = marks.redo(),
            Edit::Save => self.save_edited(false),
        }
        if redraws {
            self.show_edited();
        }
    }

    /// Shows what is not deleted.
    fn show_edited(&mut self) {
        let (Some(kept), Some(shown)) = (self.editing.scene.as_ref().map(EditedScene::kept), &mut self.scene) else {
            return;
        };
        if let Some(Err(error)) = self.canvas.as_mut().map(|canvas| canvas.upload(&kept)) {
            self.message = Some(Message::Error(format!("{} cannot be shown: {error}", shown.name)));
            return;
        }
        shown.counts = [kept.surfels.len(), kept.gaussians.len()];
        self.generation += 1;
    }

    /// Writes what is not deleted to the file that is named; asks first if there is one already, unless it `replaces` that.
    pub fn save_edited(&mut self, replaces: bool) {
        let file = PathBuf::from(&self.editing.file);
        if !replaces && file.exists() {
            self.editing.asks_for = Some(file);
        } else if let Some(scene) = &mut self.editing.scene {
            self.message = Some(scene.save(&file).into());
        }
    }
}

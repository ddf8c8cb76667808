//! A line at the top of the window: what went wrong, or what was done.

use egui::{Color32, Frame, RichText, Ui};

/// A line that stays until it is closed or another takes its place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    Note(String),
    Error(String),
}

impl From<Result<String, String>> for Message {
    fn from(outcome: Result<String, String>) -> Self {
        outcome.map_or_else(Self::Error, Self::Note)
    }
}

impl Message {
    /// Shows the line. Returns whether it was closed.
    pub fn show(&self, ui: &mut Ui) -> bool {
        let (text, fill) = match self {
            Self::Note(text) => (text, Color32::from_rgb(32, 60, 44)),
            Self::Error(text) => (text, Color32::from_rgb(92, 28, 28)),
        };
        let frame = Frame::new().fill(fill).inner_margin(8.0);
        let shown = frame.show(ui, |ui| {
            ui.set_width(ui.available_width());
            ui.horizontal_wrapped(|ui| {
                let closed = ui.small_button("close").clicked();
                ui.label(RichText::new(text).color(Color32::WHITE));
                closed
            })
        });
        shown.inner.inner
    }
}

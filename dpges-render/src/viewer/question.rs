//! A question over the window.

use egui::{Context, Id, Modal};

/// Shows it. Returns the number of the answer, once there is one: the last if it is closed otherwise.
pub fn question(context: &Context, title: &str, text: &str, answers: &[&str]) -> Option<usize> {
    let modal = Modal::new(Id::unique(title)).show(context, |ui| {
        ui.set_width(360.0);
        ui.heading(title);
        ui.label(text);
        ui.add_space(8.0);
        // all of them are shown, whichever is chosen
        let show = |ui: &mut egui::Ui| answers.iter().map(|answer| ui.button(*answer).clicked()).collect::<Vec<_>>();
        ui.horizontal_wrapped(show).inner
    });
    let chosen = modal.inner.iter().position(|clicked| *clicked);
    chosen.or_else(|| modal.should_close().then(|| answers.len() - 1))
}

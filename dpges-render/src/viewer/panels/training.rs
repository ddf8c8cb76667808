//! The training that the window watches.

use egui::{ProgressBar, Ui};

use super::super::live::{LiveProgress, LiveScene};

pub fn show(live: &LiveScene, ui: &mut Ui) {
    let LiveProgress { step, steps, psnr, text } = live.progress();
    let end = live.end();
    ui.add_space(3.0);
    ui.horizontal_wrapped(|ui| {
        if end.is_none() {
            let (paused, stopping) = (live.is_paused(), live.should_stop());
            let name = if paused { "Resume" } else { "Pause" };
            if ui.add_enabled(!stopping, egui::Button::new(name)).clicked() {
                live.set_paused(!paused);
            }
            if ui.add_enabled(!stopping, egui::Button::new("Stop")).clicked() {
                live.stop();
            }
            if stopping {
                ui.label("stopping after this step…");
            }
        }
        let share = step as f32 / steps.max(1) as f32;
        ui.add(ProgressBar::new(share).desired_width(160.0).text(format!("step {step} of {steps}")));
        if let Some(psnr) = psnr {
            ui.label(format!("{psnr:.2} dB"));
        }
        match &end {
            Some(Ok(text)) => ui.strong(text),
            Some(Err(reason)) => ui.colored_label(ui.visuals().error_fg_color, reason),
            None => ui.weak(text),
        };
    });
    ui.add_space(3.0);
}

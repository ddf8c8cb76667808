//! The page that is shown without a scene.

use std::path::PathBuf;

use egui::{RichText, ScrollArea, TextEdit, Ui};

use super::dialogs::Purpose;
use super::recent::RecentFiles;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Choice {
    Ask(Purpose),
    Open(PathBuf),
    Forget(PathBuf),
}

/// Shows the page; `typed` is the path in its field.
pub fn show(ui: &mut Ui, recent: &RecentFiles, typed: &mut String) -> Option<Choice> {
    let mut choice = None;
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.vertical_centered(|ui| {
            ui.add_space((0.18 * ui.available_height()).max(16.0));
            ui.set_max_width(560.0);
            ui.heading(RichText::new("dpges").size(34.0).strong());
            ui.label("Drop a scene file or the folder of a run here, or open one.");
            ui.add_space(14.0);
            ui.horizontal(|ui| {
                ui.add_space((0.5 * (ui.available_width() - 250.0)).max(0.0));
                if ui.button(RichText::new("Open scene…").size(16.0)).clicked() {
                    choice = Some(Choice::Ask(Purpose::OpenScene));
                }
                if ui.button(RichText::new("Open run…").size(16.0)).clicked() {
                    choice = Some(Choice::Ask(Purpose::OpenRun));
                }
            });
            ui.add_space(8.0);
            let hint = "or type its path and press Enter";
            let field = ui.add(TextEdit::singleline(typed).hint_text(hint).desired_width(380.0));
            let entered = field.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
            if entered && !typed.trim().is_empty() {
                choice = Some(Choice::Open(PathBuf::from(typed.trim())));
            }
            ui.add_space(20.0);
            ui.label("No scene yet? Train the small built-in one in about two minutes, or your own photographs:");
            ui.add_space(4.0);
            ui.monospace("dpges train --out runs/first");
            ui.monospace("dpges train PHOTOGRAPHS --view");
            if !recent.paths.is_empty() {
                ui.add_space(20.0);
                ui.label(RichText::new("Recent").strong());
                for path in &recent.paths {
                    let name = ui.link(path.display().to_string());
                    if name.clicked() {
                        choice = Some(Choice::Open(path.clone()));
                    }
                    name.context_menu(|ui| {
                        if ui.button("Forget").clicked() {
                            choice = Some(Choice::Forget(path.clone()));
                            ui.close();
                        }
                    });
                }
            }
            ui.add_space(20.0);
            ui.weak("F1: mouse and keys");
        });
    });
    choice
}

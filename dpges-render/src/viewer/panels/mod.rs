//! The panel on the right: one file per section.

mod cameras;
mod comparison;
pub mod editing;
mod measuring;
mod navigation;
mod path;
mod scene;
mod screenshot;
mod speed;
pub mod training;

use egui::{CollapsingHeader, ScrollArea, Ui};

use super::state::State;

type Section = fn(&mut State, &mut Ui);

/// Titles, whether they are open at first, and what they show.
const SECTIONS: [(&str, bool, Section); 9] = [
    ("Picture", true, scene::show),
    ("View", true, navigation::show),
    ("Cameras", true, cameras::show),
    ("Comparison", true, comparison::show),
    ("Speed", false, speed::show),
    ("Measure", false, measuring::show),
    ("Edit", false, editing::show),
    ("Camera path", false, path::show),
    ("Screenshot", false, screenshot::show),
];

pub fn show(state: &mut State, ui: &mut Ui) {
    ScrollArea::vertical().auto_shrink([false, true]).show(ui, |ui| {
        ui.add_space(4.0);
        scene::title(state, ui);
        for (title, open, section) in SECTIONS {
            CollapsingHeader::new(title).default_open(open).show(ui, |ui| section(state, ui));
        }
    });
}

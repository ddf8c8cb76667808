//! Options of the picture.

use dpges_core::scene::{BlendOrder, Footprint, Peeling, Rendering};
use egui::{ComboBox, Slider, Ui};

use super::super::dialogs::Purpose;
use super::super::state::State;
use crate::stream::StreamStatus;
use crate::{Display, MAX_LAYERS, RenderOptions};

const LARGEST_MODULATION: f64 = 200.0;

pub fn title(state: &mut State, ui: &mut Ui) {
    ui.horizontal_wrapped(|ui| {
        if ui.button("Open scene…").clicked() {
            state.ask(ui.ctx(), Purpose::OpenScene);
        }
        if ui.button("Open run…").clicked() {
            state.ask(ui.ctx(), Purpose::OpenRun);
        }
        if ui.button("Help").clicked() {
            state.help_open = true;
        }
    });
    if let Some(scene) = &state.scene {
        ui.add(egui::Label::new(egui::RichText::new(&scene.name).strong()).truncate());
        let [surfels, gaussians] = scene.counts;
        ui.weak(format!("{surfels} surfels, {gaussians} Gaussians, {}", scene.info.rendering));
        if let Some(stream) = &state.stream {
            ui.weak(streamed(stream));
        }
        if scene.info.blend_order != BlendOrder::Centres {
            ui.weak("drawn in the order of their centres, and not along rays as they were trained");
        }
    }
}

fn streamed(stream: &StreamStatus) -> String {
    let StreamStatus { resident, budget, loading, failed, .. } = stream;
    let mut text = format!("{resident} of at most {budget} primitives are in memory");
    if *loading > 0 {
        text += &format!(", {loading} cells are being loaded");
    }
    if *failed > 0 {
        text += &format!(", {failed} could not be loaded");
    }
    text
}

pub fn show(state: &mut State, ui: &mut Ui) {
    let Some(info) = state.scene.as_ref().map(|scene| scene.info.clone()) else { return };
    let peeled = info.rendering == Rendering::Peeled;
    let mut display = state.options.display;
    ui.add_enabled_ui(peeled, |ui| {
        ui.horizontal_wrapped(|ui| {
            for (kind, number) in Display::ALL.into_iter().zip(1..) {
                let choice = ui.selectable_value(&mut display, kind, kind.to_string());
                choice.on_hover_text(format!("key {number}"));
            }
        });
    });
    state.set_display(display);
    let options = &mut state.options;
    ui.add_enabled_ui(peeled, |ui| {
        ui.add(Slider::new(&mut options.layer_count, 1..=MAX_LAYERS).text("layers K"));
        ui.add(Slider::new(&mut options.modulation, 1.0..=LARGEST_MODULATION).logarithmic(true).text("rims w"))
            .on_hover_text("The opacity of a surfel is min(1, w G): the larger, the harder its rim.");
        let name = |footprint| match footprint {
            Footprint::Kernel => "kernel",
            Footprint::Opacity => "opacity",
        };
        ComboBox::from_label("footprint").selected_text(name(options.footprint)).show_ui(ui, |ui| {
            for footprint in [Footprint::Kernel, Footprint::Opacity] {
                ui.selectable_value(&mut options.footprint, footprint, name(footprint));
            }
        });
        let name = |peeling| match peeling {
            Peeling::Continuous => "continuous",
            Peeling::Nearest => "nearest",
            Peeling::Literal => "literal",
        };
        ComboBox::from_label("peeling").selected_text(name(options.peeling)).show_ui(ui, |ui| {
            for peeling in [Peeling::Continuous, Peeling::Nearest, Peeling::Literal] {
                ui.selectable_value(&mut options.peeling, peeling, name(peeling));
            }
        });
    });
    ui.add(Slider::new(&mut options.smallest_px, 0.0..=4.0).text("smallest, px"))
        .on_hover_text("Primitives that are smaller on the screen are not drawn.");
    ui.horizontal(|ui| {
        let mut colour = options.background.map(|channel| channel as f32);
        if ui.color_edit_button_rgb(&mut colour).changed() {
            options.background = colour.map(f64::from);
        }
        ui.label("background");
        let trained = RenderOptions { display: options.display, ..RenderOptions::from(&info) };
        if ui.add_enabled(*options != trained, egui::Button::new("As trained")).clicked() {
            *options = trained;
        }
    });
}

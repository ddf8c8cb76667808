//! Frame times, and how many pixels are drawn.

use egui::{Slider, Ui};
use egui_plot::{HLine, Legend, Line, Plot, PlotPoints};

use super::super::frame_times::FrameTime;
use super::super::resolution::LEAST_SCALE;
use super::super::state::State;

pub fn show(state: &mut State, ui: &mut Ui) {
    let resolution = &mut state.resolution;
    ui.checkbox(&mut resolution.automatic, "fewer pixels while moving, to hold");
    if resolution.automatic {
        ui.add(Slider::new(&mut resolution.frames_per_second, 5.0..=240.0).logarithmic(true).text("frames/s"));
        ui.weak(format!("while moving: {:.0} % of the pixels along an edge", 100.0 * resolution.control.scale()));
    } else {
        ui.add(Slider::new(&mut resolution.scale, LEAST_SCALE..=1.0).text("pixels along an edge"));
    }
    let goal = 1e3 / resolution.frames_per_second;
    let shows_goal = resolution.automatic;
    let (wall, gpu) = (state.frame_times.line(|frame| frame.wall_ms), state.frame_times.line(FrameTime::gpu_ms));
    let plot = Plot::new("frame times").height(110.0).legend(Legend::default()).include_y(0.0).allow_drag(false);
    plot.allow_zoom(false).allow_scroll(false).show_x(false).y_axis_label("ms").show_axes([false, true]).show(
        ui,
        |plot| {
            plot.line(Line::new("frame", PlotPoints::from(wall)));
            plot.line(Line::new("GPU", PlotPoints::from(gpu)));
            if shows_goal {
                plot.hline(HLine::new("goal", goal));
            }
        },
    );
    passes(state, ui);
    if let Some(canvas) = &state.canvas {
        ui.weak(canvas.adapter_name());
    }
}

fn passes(state: &State, ui: &mut Ui) {
    let Some(frame) = state.frame_times.last() else { return };
    let Some(sum) = frame.gpu_ms() else {
        ui.weak("This device has no clock for its passes.");
        return;
    };
    egui::Grid::new("passes").num_columns(3).striped(true).show(ui, |ui| {
        for pass in &frame.passes {
            ui.label(pass.name);
            ui.monospace(format!("{:7.2} ms", pass.milliseconds));
            ui.weak(format!("{:3.0} %", 100.0 * pass.milliseconds / sum.max(1e-9)));
            ui.end_row();
        }
        ui.strong("GPU");
        ui.monospace(format!("{sum:7.2} ms"));
        ui.end_row();
    });
}

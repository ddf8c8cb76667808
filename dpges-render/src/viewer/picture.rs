//! The picture of the scene in the window: hands, drawing, overlays.

use std::time::{Duration, Instant};

use dpges_core::camera::Camera;
use egui::{Align2, Color32, FontId, Rect, Response, Sense, Ui};

use super::comparison::Comparison;
use super::frame_times::FrameTime;
use super::gestures::gestures;
use super::measuring::pixel_at;
use super::messages::Message;
use super::state::State;
use crate::navigation::Viewpoint;
use crate::stream::StreamStatus;

impl State {
    pub(super) fn picture(&mut self, ui: &mut Ui) {
        let rect = ui.available_rect_before_wrap();
        let response = ui.allocate_rect(rect, Sense::click_and_drag());
        let moving = self.advance(ui, &response);
        if moving {
            ui.ctx().request_repaint();
        }
        let pixels = |length: f32| (length * ui.pixels_per_point()).round().max(0.0) as usize;
        self.window_px = [pixels(rect.width()), pixels(rect.height())];
        // a minimised window has no pixels
        if self.window_px.contains(&0) {
            return;
        }
        let compared = self.compared_view(ui);
        let Some(camera) = self.draw(ui, rect, compared, moving) else { return };
        let kind = if compared.is_some() { self.comparing.kind } else { Comparison::Off };
        let place = match self.canvas.as_ref().and_then(|canvas| canvas.texture()) {
            Some((texture, _)) => self.comparing.show(kind, ui, rect, &camera, texture),
            None => rect,
        };
        self.pick(&response, place);
        if self.measuring.active {
            self.editing.lay_down();
        }
        self.editing.follow(ui, &response, place, &camera, || self.canvas.as_ref()?.depths());
        let painter = ui.painter().with_clip_rect(place);
        self.editing.paint(&painter, place, &camera, response.hover_pos());
        let metres_per_unit = self.scene.as_ref().and_then(|shown| shown.info.metres_per_unit);
        self.measuring.paint(&painter, place, &camera, metres_per_unit);
        self.status(ui, rect, &camera);
        if (self.measuring.active || self.editing.tool.is_some()) && response.hovered() {
            ui.set_cursor_icon(egui::CursorIcon::Crosshair);
        }
    }

    /// Moves the view. Returns whether it goes on moving by itself.
    fn advance(&mut self, ui: &Ui, response: &Response) -> bool {
        let seconds = f64::from(ui.input(|input| input.stable_dt));
        let takes_keys = !ui.ctx().egui_wants_keyboard_input();
        let input = gestures(ui, response, self.navigator.mode, takes_keys, self.editing.tool.is_some());
        if input.is_active() {
            self.path.stop();
            self.at_view = None;
        }
        if let Some(camera) = self.path.advance(seconds) {
            self.at_view = None;
            self.navigator.jump(Viewpoint::of(&camera, self.navigator.viewpoint().focus_distance));
            return true;
        }
        self.navigator.advance(&input, seconds) || input.is_active()
    }

    /// The camera whose photograph is compared with the scene, once the view is there.
    fn compared_view(&mut self, ui: &Ui) -> Option<usize> {
        if self.comparing.kind == Comparison::Off || self.navigator.is_flying() {
            return None;
        }
        let (view, views) = (self.at_view?, self.views.as_ref()?);
        self.comparing.load(ui.ctx(), views, view).then_some(view)
    }

    /// Draws the scene for `rect`. Returns the camera it is seen by.
    fn draw(&mut self, ui: &Ui, rect: Rect, compared: Option<usize>, moving: bool) -> Option<Camera> {
        let resolution = &self.resolution;
        let scale = match (resolution.automatic, moving) {
            (true, true) => resolution.control.scale(),
            (true, false) => resolution.control.scale_at_rest(),
            (false, _) => resolution.scale,
        };
        let canvas = self.canvas.as_mut()?;
        let largest = canvas.largest_size();
        let scaled = |px: usize| ((px as f64 * scale).round() as usize).clamp(1, largest);
        let camera = match compared.and_then(|view| self.views.as_ref()?.cameras.get(view)) {
            Some((_, camera)) => {
                let place = self.comparing.kind.place(rect, camera);
                let px = |length: f32| scaled((length * ui.pixels_per_point()).round() as usize);
                let near = self.navigator.viewpoint().lens.near;
                Camera { near, ..camera.resized(px(place.width()), px(place.height())) }
            }
            None => self.navigator.viewpoint().camera(self.window_px.map(scaled)),
        };
        if let (Comparison::Error, Some(view)) = (self.comparing.kind, compared) {
            let full = self.views.as_ref()?.cameras.get(view)?.1;
            let options = self.options;
            let draw = |[width, height]: [usize; 2]| canvas.picture(&full.resized(width, height), &options);
            if let Err(error) = self.comparing.update_error(ui.ctx(), &options, self.generation, draw) {
                self.message = Some(Message::Error(error.to_string()));
            }
        }
        // as sharp as the view is once it rests
        let sharp = [camera.width, camera.height].map(|px| ((px as f64 / scale).round() as usize).max(1));
        let stream = canvas.advance(&camera.resized(sharp[0], sharp[1]));
        match canvas.draw(&camera, &self.options) {
            Ok(drawn) => self.take_time(drawn, moving),
            Err(error) => self.message = Some(Message::Error(error.to_string())),
        }
        self.take_stream(ui, stream);
        Some(camera)
    }

    /// Takes note of how far the levels of detail are, and of what could not be loaded.
    fn take_stream(&mut self, ui: &Ui, stream: Option<StreamStatus>) {
        let Some(now) = &stream else { return };
        if now.changing {
            ui.ctx().request_repaint();
        } else if let Some(seconds) = now.retry_in {
            ui.ctx().request_repaint_after(Duration::from_secs_f64(seconds));
        }
        let before = self.stream.as_ref().and_then(|before| before.reason.clone());
        if now.reason != before {
            let told = |reason: &String| {
                Message::Error(format!("A part of the scene stays coarse for now, and is tried again: {reason}"))
            };
            if self.message.is_none() || self.message == before.as_ref().map(told) {
                self.message = now.reason.as_ref().map(told);
            }
        }
        self.stream = stream;
    }

    fn take_time(&mut self, drawn: bool, moving: bool) {
        let now = Instant::now();
        if drawn {
            let passes = self.canvas.iter().flat_map(|canvas| canvas.pass_times()).copied().collect();
            let wall_ms = self.last_drawn.map(|last| 1e3 * (now - last).as_secs_f64());
            let frame = FrameTime { wall_ms, passes };
            if let (true, Some(ms)) = (moving && wall_ms.is_some(), frame.ms()) {
                self.resolution.control.observe(ms, 1e3 / self.resolution.frames_per_second);
            }
            self.frame_times.push(frame);
        }
        self.last_drawn = moving.then_some(now);
    }

    /// Clicks pick points while measuring; double clicks choose the focus.
    fn pick(&mut self, response: &Response, place: Rect) {
        let measures = self.measuring.active && response.clicked();
        let focuses = !self.measuring.active && self.editing.tool.is_none() && response.double_clicked();
        if !measures && !focuses {
            return;
        }
        let Some(canvas) = &self.canvas else { return };
        let (Some(pointer), Some((_, camera))) = (response.interact_pointer_pos(), canvas.texture()) else { return };
        let Some((x, y)) = pixel_at(place, camera, pointer) else { return };
        match canvas.depth_at(x as u32, y as u32) {
            Some(depth) => {
                let point = camera.unproject(x.floor() + 0.5, y.floor() + 0.5, depth);
                if measures {
                    self.measuring.pick(point);
                } else {
                    self.at_view = None;
                    self.navigator.focus_on(point);
                }
            }
            None if measures => {
                self.message = Some(Message::Note("There is no surface at that point: pick another one.".to_owned()));
            }
            None => {}
        }
    }

    /// A line at the bottom left: where the view is, how large the picture is, how fast it comes.
    fn status(&self, ui: &Ui, rect: Rect, camera: &Camera) {
        let mut parts = Vec::new();
        if let (Some(view), Some(views)) = (self.at_view, &self.views) {
            parts.extend(views.cameras.get(view).map(|(name, _)| name.clone()));
        }
        parts.push(format!("{} × {} px", camera.width, camera.height));
        let selected = self.editing.scene.as_ref().map_or(0, |scene| scene.marks.selected_count());
        if selected > 0 {
            parts.push(format!("{selected} selected"));
        }
        parts.extend(self.frame_times.frames_per_second().map(|rate| format!("{rate:.0} frames/s")));
        let font = FontId::proportional(12.0);
        let text = ui.painter().layout_no_wrap(parts.join("  ·  "), font, Color32::from_gray(230));
        let place = Align2::LEFT_BOTTOM.anchor_size(rect.left_bottom() + egui::vec2(8.0, -7.0), text.size());
        ui.painter().rect_filled(place.expand2(egui::vec2(5.0, 3.0)), 3.0, Color32::from_black_alpha(150));
        ui.painter().galley(place.min, text, Color32::WHITE);
    }
}

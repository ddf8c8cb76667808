//! The viewer: what happens from frame to frame.

use std::path::PathBuf;
use std::sync::Arc;

use eframe::egui_wgpu::RenderState;
use egui::{CentralPanel, Context, Frame, Id, Panel, Spinner, Ui, ViewportCommand};

use super::dialogs::{Answer, Purpose};
use super::editing::{EditedScene, Editing};
use super::keys::{Command, commands, show_help};
use super::live::LiveScene;
use super::loading::{Opened, Opener};
use super::measuring::Measuring;
use super::messages::Message;
use super::panels;
use super::path_editor::PathEditor;
use super::pending::Pending;
use super::question::question;
use super::recent::RecentFiles;
use super::start::{DeviceFailure, Start};
use super::start_page::{self, Choice};
use super::state::{State, waker};
use super::views::{DatasetViews, Views};
use crate::RenderError;
use crate::navigation::Mode;

/// An action that would lose edits that are not saved.
enum Leaving {
    Close,
    Open(PathBuf),
}

/// The viewer, for any window of egui.
pub struct Viewer {
    pub(super) state: State,
    /// The path that was asked for last, while it is read.
    opening: Option<(PathBuf, Pending<Result<Opened, String>>)>,
    opener: Opener,
    recent: RecentFiles,
    typed_path: String,
    /// Whether the user is asked what becomes of the training.
    closing: bool,
    may_close: bool,
    /// The action that the user is asked about, while edits are not saved.
    leaving: Option<Leaving>,
    failure: DeviceFailure,
}

impl Viewer {
    pub fn new(
        context: &Context,
        gpu: Option<&RenderState>,
        storage: Option<&dyn eframe::Storage>,
        start: Start,
        opener: Opener,
        failure: DeviceFailure,
    ) -> Result<Self, RenderError> {
        let recent = storage.and_then(|storage| eframe::get_value(storage, RecentFiles::KEY));
        let mut viewer = Self {
            state: State::new(gpu)?,
            opening: None,
            opener,
            recent: recent.unwrap_or_default(),
            typed_path: String::new(),
            closing: false,
            may_close: false,
            leaving: None,
            failure,
        };
        match start {
            Start::Page => {}
            Start::Open(path) => viewer.open(context, path),
            Start::Scene { name, opened } => viewer.take(context, name, *opened),
            Start::Live(live, views) => {
                live.on_news(waker(context));
                viewer.state.live = Some(live);
                viewer.state.views = views;
            }
        }
        Ok(viewer)
    }

    pub fn show(&mut self, ui: &mut Ui) {
        let context = ui.ctx().clone();
        self.take_news(&context);
        self.close_if_asked(&context);
        if !context.egui_wants_keyboard_input() {
            for command in ui.input(commands) {
                self.obey(&context, command);
            }
        }
        if self.state.panel_open && self.state.scene.is_some() {
            let panel = Panel::right("panel").default_size(316.0).size_range(250.0..=480.0);
            panel.show(ui, |ui| panels::show(&mut self.state, ui));
        }
        if let Some(live) = self.state.live.clone() {
            Panel::bottom("training").show(ui, |ui| panels::training::show(&live, ui));
        }
        if let Some(message) = &self.state.message {
            let shown = Panel::top("message").frame(Frame::new()).show_separator_line(false);
            if shown.show(ui, |ui| message.show(ui)).inner {
                self.state.message = None;
            }
        }
        let frame = Frame::new().fill(ui.visuals().panel_fill);
        CentralPanel::no_frame().frame(frame).show(ui, |ui| self.centre(ui));
        if self.state.help_open {
            show_help(&context, &mut self.state.help_open);
        }
        if self.closing {
            self.ask_about_training(&context);
        }
        self.ask_about_edits(&context);
        panels::editing::ask_to_replace(&mut self.state, &context);
        drop_hint(&context);
    }

    fn centre(&mut self, ui: &mut Ui) {
        if self.state.scene.is_some() {
            self.state.picture(ui);
        } else if self.state.live.is_some() {
            waiting(ui, "The first picture of the scene is on its way.");
        } else if let Some((path, _)) = &self.opening {
            waiting(ui, &format!("Opening {}", path.display()));
        } else if let Some(choice) = start_page::show(ui, &self.recent, &mut self.typed_path) {
            match choice {
                Choice::Ask(purpose) => self.state.ask(ui.ctx(), purpose),
                Choice::Open(path) => self.open(ui.ctx(), path),
                Choice::Forget(path) => self.recent.remove(&path),
            }
        }
    }

    /// Takes messages of threads, dialogs and other windows since the last frame.
    fn take_news(&mut self, context: &Context) {
        let closes = self.state.live.as_ref().is_some_and(LiveScene::closes);
        if (self.failure.reason().is_some() || closes) && !self.may_close {
            self.may_close = true;
            context.send_viewport_cmd(ViewportCommand::Close);
        }
        let failed = || Err("reading it failed unexpectedly".to_owned());
        if let Some((path, pending)) = self.opening.take() {
            match pending.poll(failed) {
                None => self.opening = Some((path, pending)),
                Some(Ok(opened)) => {
                    self.recent.add(&path);
                    self.state.message = None;
                    self.take(context, path.display().to_string(), opened);
                }
                Some(Err(reason)) => self.state.message = Some(Message::Error(reason)),
            }
        }
        let failed = || Err("reading the dataset failed unexpectedly".to_owned());
        if let Some(result) = self.state.pending_views.as_ref().and_then(|pending| pending.poll(failed)) {
            self.take_views(result);
        }
        if let Some(scene) = self.state.live.as_ref().and_then(LiveScene::take_scene) {
            let is_first = self.state.scene.is_none();
            self.state.show_scene("training".to_owned(), &scene, &scene.info, is_first);
        }
        match self.state.dialogs.poll() {
            Some(Answer::File(purpose, file)) => self.use_file(context, purpose, file),
            Some(Answer::NoDialogs) => {
                let text = "This system shows no file dialogs (no desktop portal): drop the file onto the window, or \
                            start with `dpges view FILE`.";
                self.state.message = Some(Message::Note(text.to_owned()));
            }
            Some(Answer::Cancelled) | None => {}
        }
        let dropped = context.input(|input| input.raw.dropped_files.first().map(|file| file.path().to_owned()));
        if let Some(path) = dropped {
            self.open(context, path);
        }
    }

    pub(super) fn open(&mut self, context: &Context, path: PathBuf) {
        if self.state.live.is_some() {
            let text = "This window shows a training: open other scenes in another one, with `dpges view`.";
            self.state.message = Some(Message::Note(text.to_owned()));
        } else if self.state.editing.is_unsaved() {
            self.leaving = Some(Leaving::Open(path));
        } else {
            self.read(context, path);
        }
    }

    fn read(&mut self, context: &Context, path: PathBuf) {
        let (opener, opened) = (Arc::clone(&self.opener), path.clone());
        self.opening = Some((path, Pending::start(move || opener(&opened), waker(context))));
    }

    fn use_file(&mut self, context: &Context, purpose: Purpose, file: PathBuf) {
        match purpose {
            Purpose::OpenScene | Purpose::OpenRun => self.open(context, file),
            Purpose::SaveScreenshot => {
                self.state.screenshot.file = file.display().to_string();
                self.state.save_screenshot(&file);
            }
            // the dialog has asked already
            Purpose::SaveScene => {
                self.state.editing.file = file.display().to_string();
                self.state.save_edited(true);
            }
            Purpose::SavePath => {
                self.state.path.file = file.display().to_string();
                self.state.save_path();
            }
            Purpose::LoadPath => {
                self.state.path.file = file.display().to_string();
                self.state.load_path();
            }
        }
    }

    /// Shows what was opened, in place of what was there. If it cannot be shown, what was there stays.
    fn take(&mut self, context: &Context, name: String, opened: Opened) {
        let (views, later) = match opened.views {
            Views::None => (None, None),
            Views::Ready(views) => (Some(views), None),
            Views::Later(read) => (None, Some(read)),
        };
        let before = std::mem::replace(&mut self.state.views, views);
        let (shown, is_whole) = match opened.levels {
            Some(levels) => (self.state.show_levels(context, name, &opened.scene, levels), false),
            None => (self.state.show_scene(name, &opened.scene, &opened.drawn, true), true),
        };
        if !shown {
            self.state.views = before;
            return;
        }
        self.state.comparing.forget();
        self.state.measuring.points.clear();
        self.state.editing = Editing::new(is_whole.then(|| EditedScene::new(opened.scene)));
        self.state.path = PathEditor::default();
        self.state.pending_views = later.map(|read| Pending::start(read, waker(context)));
    }

    /// Takes the views that came after their scene, and goes to the first unless the view was moved since.
    fn take_views(&mut self, result: Result<DatasetViews, String>) {
        self.state.pending_views = None;
        match result {
            Ok(views) => {
                let untouched = *self.state.navigator.viewpoint() == self.state.home;
                let stayed = *self.state.navigator.viewpoint();
                self.state.views = Some(views);
                if let Some(shown) = self.state.scene.take() {
                    self.state.settle_in(&shown);
                    self.state.scene = Some(shown);
                }
                if !untouched {
                    self.state.navigator.jump(stayed);
                    self.state.at_view = None;
                }
            }
            Err(reason) => {
                self.state.message =
                    Some(Message::Error(format!("there are no photographs to compare with: {reason}")));
            }
        }
    }

    fn obey(&mut self, context: &Context, command: Command) {
        match command {
            Command::Help => self.state.help_open = !self.state.help_open,
            Command::Open => self.state.ask(context, Purpose::OpenScene),
            Command::Fullscreen => {
                let now = context.input(|input| input.viewport().fullscreen.unwrap_or(false));
                context.send_viewport_cmd(ViewportCommand::Fullscreen(!now));
            }
            _ if self.state.scene.is_none() => {}
            Command::Display(display) => self.state.set_display(display),
            Command::Mode => {
                self.state.navigator.mode =
                    if self.state.navigator.mode == Mode::Orbit { Mode::Fly } else { Mode::Orbit };
            }
            Command::Home => self.state.leave_for(self.state.home),
            Command::LevelUp => self.state.navigator.surroundings.up = -self.state.navigator.viewpoint().pose.down(),
            Command::PreviousView => self.state.step_view(-1),
            Command::NextView => self.state.step_view(1),
            Command::Compare => self.state.comparing.kind = self.state.comparing.kind.next(),
            Command::Measure => self.state.measuring.active = !self.state.measuring.active,
            Command::Edit(edit) => self.state.edit(edit),
            Command::Screenshot => self.state.save_screenshot(&PathBuf::from(self.state.screenshot.file.clone())),
            Command::AddToPath => self.state.add_to_path(),
            Command::PlayPath => self.state.path.play_or_stop(),
            Command::Panel => self.state.panel_open = !self.state.panel_open,
            Command::Escape => {
                self.state.help_open = false;
                self.state.measuring = Measuring::default();
                self.state.editing.lay_down();
                self.state.path.stop();
            }
        }
    }

    fn close_if_asked(&mut self, context: &Context) {
        let asked = context.input(|input| input.viewport().close_requested());
        let trains = self.state.live.as_ref().is_some_and(|live| live.end().is_none());
        let unsaved = self.state.editing.is_unsaved();
        if asked && (trains || unsaved) && !self.may_close {
            context.send_viewport_cmd(ViewportCommand::CancelClose);
            self.closing = trains;
            self.leaving = unsaved.then_some(Leaving::Close);
        }
    }

    fn close(&mut self, context: &Context) {
        self.may_close = true;
        context.send_viewport_cmd(ViewportCommand::Close);
    }

    fn ask_about_edits(&mut self, context: &Context) {
        if self.leaving.is_none() {
            return;
        }
        let text = "What was deleted is not saved: the scene file stays as it is.";
        let answer = question(context, "Leave the edits?", text, &["Leave them", "Back"]);
        match answer.and_then(|answer| Some((answer, self.leaving.take()?))) {
            Some((0, Leaving::Close)) => self.close(context),
            Some((0, Leaving::Open(path))) => self.read(context, path),
            _ => {}
        }
    }

    fn ask_about_training(&mut self, context: &Context) {
        let Some(live) = self.state.live.clone() else { return };
        let text = "What is to become of it? Stopped, it saves its state first, and `--resume` goes on.";
        let answers = ["Stop training", "Keep training without window", "Back"];
        let Some(answer) = question(context, "The training is not over", text, &answers) else { return };
        if answer == 0 {
            live.stop();
        }
        if answer < 2 {
            self.close(context);
        }
        self.closing = false;
    }
}

impl eframe::App for Viewer {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        self.show(ui);
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        eframe::set_value(storage, RecentFiles::KEY, &self.recent);
    }

    fn on_exit(&mut self) {
        if let Some(live) = &self.state.live {
            live.leave();
        }
    }

    fn persist_egui_memory(&self) -> bool {
        false
    }
}

fn waiting(ui: &mut Ui, text: &str) {
    ui.vertical_centered(|ui| {
        ui.add_space(0.4 * ui.available_height());
        ui.add(Spinner::new().size(32.0));
        ui.add_space(8.0);
        ui.label(text);
    });
}

/// Says that files can be let go while they are dragged over the window.
fn drop_hint(context: &Context) {
    if context.input(|input| !input.raw.hovered_files.is_empty()) {
        let layer = egui::LayerId::new(egui::Order::Foreground, Id::unique("drop"));
        let (painter, rect) = (context.layer_painter(layer), context.content_rect());
        painter.rect_filled(rect, 0.0, egui::Color32::from_black_alpha(180));
        let font = egui::FontId::proportional(26.0);
        painter.text(rect.center(), egui::Align2::CENTER_CENTER, "Drop to open", font, egui::Color32::WHITE);
    }
}

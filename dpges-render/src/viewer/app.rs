//! The viewer: its state, and what happens from frame to frame.

use std::path::PathBuf;
use std::time::Instant;

use dpges_core::scene::{Rendering, SceneData, SceneInfo};
use eframe::egui_wgpu::RenderState;
use egui::{CentralPanel, Context, Frame, Id, Modal, Panel, Spinner, Ui, ViewportCommand};

use super::canvas::Canvas;
use super::comparison::Comparing;
use super::dialogs::{Answer, Dialogs, Purpose};
use super::frame_times::FrameTimes;
use super::keys::{Command, commands};
use super::live::LiveScene;
use super::loading::{Loader, Opened, Opener, ViewsLoader};
use super::measuring::Measuring;
use super::messages::Message;
use super::navigation::{Extent, Lens, Mode, Navigator, Surroundings, Viewpoint, mean_up};
use super::path_editor::PathEditor;
use super::recent::RecentFiles;
use super::resolution::ResolutionControl;
use super::screenshot::{ScreenshotForm, save_png, unused};
use super::start_page::{self, Choice};
use super::views::{DatasetViews, Views};
use super::window::{DeviceFailure, Start};
use super::{help, panels};
use crate::{Display, RenderError, RenderOptions};

/// Field of view where no camera gives one, rad.
const FIELD_OF_VIEW: f64 = 0.9;

/// The scene on the screen.
pub struct ShownScene {
    pub name: String,
    pub info: SceneInfo,
    /// Surfels and Gaussians.
    pub counts: [usize; 2],
    pub extent: Extent,
}

/// How many pixels are drawn.
pub struct Resolution {
    /// Whether the scale holds the frame rate.
    pub automatic: bool,
    /// Share of the window's pixels along an edge, where it is not automatic.
    pub scale: f64,
    pub frames_per_second: f64,
    pub control: ResolutionControl,
}

/// The viewer, for any window of egui.
pub struct Viewer {
    pub(super) canvas: Option<Canvas>,
    pub(super) scene: Option<ShownScene>,
    /// Counts the scenes that were shown.
    pub(super) generation: u64,
    pub(super) options: RenderOptions,
    pub(super) views: Option<DatasetViews>,
    /// The camera of the dataset that the view is at or on its way to.
    pub(super) at_view: Option<usize>,
    /// The camera of the dataset that was chosen last.
    pub(super) chosen_view: Option<usize>,
    pub(super) navigator: Navigator,
    pub(super) home: Viewpoint,
    pub(super) resolution: Resolution,
    pub(super) frame_times: FrameTimes,
    /// When the last frame was drawn, if another followed at once.
    pub(super) last_drawn: Option<Instant>,
    pub(super) comparing: Comparing,
    pub(super) measuring: Measuring,
    pub(super) path: PathEditor,
    pub(super) screenshot: ScreenshotForm,
    /// Size of the picture in the window, px.
    pub(super) window_px: [usize; 2],
    pub(super) dialogs: Dialogs,
    pub(super) message: Option<Message>,
    pub(super) live: Option<LiveScene>,
    pub(super) panel_open: bool,
    pub(super) help_open: bool,
    /// The views of the scene, while they are read.
    pub(super) views_loader: Option<ViewsLoader>,
    loader: Loader,
    opener: Opener,
    recent: RecentFiles,
    typed_path: String,
    /// Whether it asks what becomes of the training.
    closing: bool,
    may_close: bool,
    failure: DeviceFailure,
}

impl Viewer {
    /// # Errors
    /// The errors of the renderer on the device of `gpu`; without it, nothing is drawn.
    pub fn new(
        context: &Context,
        gpu: Option<&RenderState>,
        storage: Option<&dyn eframe::Storage>,
        start: Start,
        opener: Opener,
        failure: DeviceFailure,
    ) -> Result<Self, RenderError> {
        let recent = storage.and_then(|storage| eframe::get_value(storage, RecentFiles::KEY));
        let info = SceneInfo::default();
        let lens = Lens { vertical_field_of_view: FIELD_OF_VIEW, near: info.near };
        let surroundings = Surroundings { up: glam::DVec3::NEG_Y, size: 1.0 };
        let nothing = SceneData { surfels: Default::default(), gaussians: Default::default(), environment: None, info };
        let home = Extent::of(&nothing).overview(lens, surroundings.up);
        let mut viewer = Self {
            canvas: gpu.map(Canvas::new).transpose()?,
            scene: None,
            generation: 0,
            options: RenderOptions::from(&nothing.info),
            views: None,
            at_view: None,
            chosen_view: None,
            navigator: Navigator::new(home, surroundings),
            home,
            resolution: Resolution {
                automatic: true,
                scale: 1.0,
                frames_per_second: 30.0,
                control: ResolutionControl::default(),
            },
            frame_times: FrameTimes::default(),
            last_drawn: None,
            comparing: Comparing::default(),
            measuring: Measuring::default(),
            path: PathEditor::default(),
            screenshot: ScreenshotForm::default(),
            window_px: [0; 2],
            dialogs: Dialogs::default(),
            message: None,
            live: None,
            panel_open: true,
            help_open: false,
            views_loader: None,
            loader: Loader::default(),
            opener,
            recent: recent.unwrap_or_default(),
            typed_path: String::new(),
            closing: false,
            may_close: false,
            failure,
        };
        match start {
            Start::Page => {}
            Start::Open(path) => viewer.open(context, path),
            Start::Scene { name, opened } => viewer.take(context, name, *opened),
            Start::Live(live, views) => {
                let egui = context.clone();
                live.on_news(move || egui.request_repaint());
                viewer.live = Some(live);
                viewer.views = views;
            }
        }
        Ok(viewer)
    }

    /// One frame of the whole window.
    pub fn show(&mut self, ui: &mut Ui) {
        let context = ui.ctx().clone();
        self.take_news(&context);
        self.close_if_asked(&context);
        if !context.egui_wants_keyboard_input() {
            for command in ui.input(commands) {
                self.obey(&context, command);
            }
        }
        if self.panel_open && self.scene.is_some() {
            let panel = Panel::right("panel").default_size(316.0).size_range(250.0..=480.0);
            panel.show(ui, |ui| panels::show(self, ui));
        }
        if let Some(live) = self.live.clone() {
            Panel::bottom("training").show(ui, |ui| panels::training::show(&live, ui));
        }
        if let Some(message) = &self.message {
            let shown = Panel::top("message").frame(Frame::new()).show_separator_line(false);
            if shown.show(ui, |ui| message.show(ui)).inner {
                self.message = None;
            }
        }
        let frame = Frame::new().fill(ui.visuals().panel_fill);
        CentralPanel::no_frame().frame(frame).show(ui, |ui| self.centre(ui));
        if self.help_open {
            help::show(&context, &mut self.help_open);
        }
        if self.closing {
            self.ask_about_training(&context);
        }
        drop_hint(&context);
    }

    fn centre(&mut self, ui: &mut Ui) {
        if self.scene.is_some() {
            self.picture(ui);
        } else if self.live.is_some() {
            waiting(ui, "The first picture of the scene is on its way.");
        } else if let Some(path) = self.loader.path() {
            waiting(ui, &format!("Opening {}", path.display()));
        } else if let Some(choice) = start_page::show(ui, &self.recent, &mut self.typed_path) {
            match choice {
                Choice::Ask(purpose) => self.ask(ui.ctx(), purpose),
                Choice::Open(path) => self.open(ui.ctx(), path),
                Choice::Forget(path) => self.recent.remove(&path),
            }
        }
    }

    /// Takes messages of threads, dialogs and other windows since the last frame.
    fn take_news(&mut self, context: &Context) {
        let closes = self.live.as_ref().is_some_and(LiveScene::closes);
        if (self.failure.reason().is_some() || closes) && !self.may_close {
            self.may_close = true;
            context.send_viewport_cmd(ViewportCommand::Close);
        }
        if let Some(loaded) = self.loader.poll() {
            match loaded.result {
                Ok(opened) => {
                    self.recent.add(&loaded.path);
                    self.message = None;
                    self.take(context, loaded.path.display().to_string(), opened);
                }
                Err(reason) => self.message = Some(Message::Error(reason)),
            }
        }
        if let Some(result) = self.views_loader.as_ref().and_then(ViewsLoader::poll) {
            self.take_views(result);
        }
        if let Some(scene) = self.live.as_ref().and_then(LiveScene::take_scene) {
            let is_first = self.scene.is_none();
            self.show_scene("training".to_owned(), &scene, is_first);
        }
        match self.dialogs.poll() {
            Some(Answer::File(purpose, file)) => self.use_file(context, purpose, file),
            Some(Answer::NoDialogs) => {
                let text = "This system shows no file dialogs (no desktop portal): drop the file onto the window, or \
                            start with `dpges view FILE`.";
                self.message = Some(Message::Note(text.to_owned()));
            }
            Some(Answer::Cancelled) | None => {}
        }
        let dropped = context.input(|input| input.raw.dropped_files.first().map(|file| file.path().to_owned()));
        if let Some(path) = dropped {
            self.open(context, path);
        }
    }

    /// Begins to read a scene or a run.
    pub(super) fn open(&mut self, context: &Context, path: PathBuf) {
        if self.live.is_some() {
            let text = "This window shows a training: open other scenes in another one, with `dpges view`.";
            self.message = Some(Message::Note(text.to_owned()));
            return;
        }
        let woken = context.clone();
        self.loader.start(path, &self.opener, move || woken.request_repaint());
    }

    /// Asks for a file by a dialog.
    pub(super) fn ask(&mut self, context: &Context, purpose: Purpose) {
        if !self.dialogs.is_open() {
            let name = if purpose == Purpose::SavePath { &self.path.file } else { &self.screenshot.file };
            let woken = context.clone();
            self.dialogs.ask(purpose, name, move || woken.request_repaint());
        }
    }

    fn use_file(&mut self, context: &Context, purpose: Purpose, file: PathBuf) {
        match purpose {
            Purpose::OpenScene | Purpose::OpenRun => self.open(context, file),
            Purpose::SaveScreenshot => {
                self.screenshot.file = file.display().to_string();
                self.save_screenshot(&file);
            }
            Purpose::SavePath => {
                self.path.file = file.display().to_string();
                self.save_path();
            }
            Purpose::LoadPath => {
                self.path.file = file.display().to_string();
                self.load_path();
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
        let before = std::mem::replace(&mut self.views, views);
        if !self.show_scene(name, &opened.scene, true) {
            self.views = before;
            return;
        }
        self.comparing.forget();
        self.measuring.clear();
        self.path = PathEditor::default();
        self.views_loader = later.map(|read| {
            let woken = context.clone();
            ViewsLoader::start(read, move || woken.request_repaint())
        });
    }

    /// Takes the views that came after their scene, and goes to the first unless the view was moved since.
    fn take_views(&mut self, result: Result<DatasetViews, String>) {
        self.views_loader = None;
        match result {
            Ok(views) => {
                let untouched = *self.navigator.viewpoint() == self.home;
                let stayed = *self.navigator.viewpoint();
                self.views = Some(views);
                if let Some(shown) = self.scene.take() {
                    self.settle_in(&shown);
                    self.scene = Some(shown);
                }
                if !untouched {
                    self.navigator.jump(stayed);
                    self.at_view = None;
                }
            }
            Err(reason) => {
                self.message = Some(Message::Error(format!("there are no photographs to compare with: {reason}")));
            }
        }
    }

    /// Returns whether the scene could be shown. Goes to its first view if `is_new`.
    fn show_scene(&mut self, name: String, scene: &SceneData, is_new: bool) -> bool {
        if let Some(canvas) = &mut self.canvas
            && let Err(error) = canvas.upload(scene)
        {
            self.message = Some(Message::Error(format!("{name} cannot be shown: {error}")));
            return false;
        }
        let counts = [scene.surfels.len(), scene.gaussians.len()];
        let shown = ShownScene { name, info: scene.info.clone(), counts, extent: Extent::of(scene) };
        let kept = (self.options.display, self.options.smallest_px);
        if is_new {
            self.options = RenderOptions::from(&shown.info);
            (self.options.display, self.options.smallest_px) = kept;
        }
        if shown.info.rendering != Rendering::Peeled {
            self.options.display = Display::Image;
        }
        self.generation += 1;
        if is_new {
            self.settle_in(&shown);
        }
        self.scene = Some(shown);
        true
    }

    /// Goes to the first view of a scene.
    fn settle_in(&mut self, shown: &ShownScene) {
        let cameras = self.views.iter().flat_map(|views| &views.cameras).map(|(_, camera)| camera);
        let up = mean_up(cameras);
        self.navigator.surroundings = Surroundings { up, size: shown.extent.radius };
        let first = self.views.as_ref().and_then(|views| views.cameras.first());
        self.home = match first {
            Some((_, camera)) => shown.extent.seen_from(camera),
            None => {
                let lens = Lens { vertical_field_of_view: FIELD_OF_VIEW, near: shown.info.near };
                shown.extent.overview(lens, up)
            }
        };
        self.at_view = first.map(|_| 0);
        self.chosen_view = self.at_view;
        self.navigator.jump(self.home);
    }

    /// Goes to a camera of the dataset.
    pub(super) fn go_to_view(&mut self, index: usize, at_once: bool) {
        let (Some(views), Some(shown)) = (&self.views, &self.scene) else { return };
        let Some((_, camera)) = views.cameras.get(index) else { return };
        let viewpoint = shown.extent.seen_from(camera);
        self.path.stop();
        if at_once {
            self.navigator.jump(viewpoint);
        } else {
            self.navigator.fly(viewpoint);
        }
        self.at_view = Some(index);
        self.chosen_view = Some(index);
    }

    /// Goes to the camera `by` places farther in the list, in a ring.
    pub(super) fn step_view(&mut self, by: isize) {
        let count = self.views.as_ref().map_or(0, |views| views.cameras.len());
        if count > 0 {
            let next = match self.chosen_view {
                Some(now) => (now as isize + by).rem_euclid(count as isize) as usize,
                None => 0,
            };
            self.go_to_view(next, false);
        }
    }

    /// Leaves the cameras of the dataset for `viewpoint`.
    pub(super) fn leave_for(&mut self, viewpoint: Viewpoint) {
        self.at_view = None;
        self.navigator.fly(viewpoint);
    }

    fn obey(&mut self, context: &Context, command: Command) {
        match command {
            Command::Help => self.help_open = !self.help_open,
            Command::Open => self.ask(context, Purpose::OpenScene),
            Command::Fullscreen => {
                let now = context.input(|input| input.viewport().fullscreen.unwrap_or(false));
                context.send_viewport_cmd(ViewportCommand::Fullscreen(!now));
            }
            _ if self.scene.is_none() => {}
            Command::Display(display) => self.set_display(display),
            Command::Mode => {
                self.navigator.mode = if self.navigator.mode == Mode::Orbit { Mode::Fly } else { Mode::Orbit };
            }
            Command::Home => self.leave_for(self.home),
            Command::LevelUp => self.navigator.surroundings.up = -self.navigator.viewpoint().pose.down(),
            Command::PreviousView => self.step_view(-1),
            Command::NextView => self.step_view(1),
            Command::Compare => self.comparing.kind = self.comparing.kind.next(),
            Command::Measure => self.measuring.active = !self.measuring.active,
            Command::Screenshot => self.save_screenshot(&PathBuf::from(self.screenshot.file.clone())),
            Command::AddToPath => self.add_to_path(),
            Command::PlayPath => self.path.play_or_stop(),
            Command::Panel => self.panel_open = !self.panel_open,
            Command::Escape => {
                self.help_open = false;
                self.measuring = Measuring::default();
                self.path.stop();
            }
        }
    }

    /// Scenes that are blended have nothing but an image.
    pub(super) fn set_display(&mut self, display: Display) {
        let peeled = self.scene.as_ref().is_some_and(|scene| scene.info.rendering == Rendering::Peeled);
        if peeled || display == Display::Image {
            self.options.display = display;
        }
    }

    pub(super) fn add_to_path(&mut self) {
        if self.window_px != [0; 2] {
            self.path.cameras.push(self.navigator.viewpoint().camera(self.window_px));
        }
    }

    pub(super) fn save_path(&mut self) {
        let file = PathBuf::from(&self.path.file);
        self.message = Some(match self.path.save(&file) {
            Ok(()) => Message::Note(format!("{} cameras in {}", self.path.cameras.len(), absolute(&file))),
            Err(reason) => Message::Error(reason),
        });
    }

    pub(super) fn load_path(&mut self) {
        let near = self.navigator.viewpoint().lens.near;
        let file = PathBuf::from(&self.path.file);
        self.message = self.path.load(&file, near).err().map(Message::Error);
    }

    /// Writes what the view shows, beside files that are there already.
    pub(super) fn save_screenshot(&mut self, file: &std::path::Path) {
        let size = self.screenshot.size.unwrap_or(self.window_px);
        let camera = self.navigator.viewpoint().camera(size);
        let Some(canvas) = &mut self.canvas else { return };
        let picture = match canvas.picture(&camera, &self.options) {
            Ok(picture) => picture,
            Err(error) => {
                self.message = Some(Message::Error(format!("there is no screenshot: {error}")));
                return;
            }
        };
        let file = unused(file);
        self.message = Some(match save_png(&picture, &file) {
            Ok(()) => Message::Note(format!("{} × {} px in {}", size[0], size[1], absolute(&file))),
            Err(error) => Message::Error(error.to_string()),
        });
    }

    fn close_if_asked(&mut self, context: &Context) {
        let asked = context.input(|input| input.viewport().close_requested());
        let trains = self.live.as_ref().is_some_and(|live| live.end().is_none());
        if asked && trains && !self.may_close {
            context.send_viewport_cmd(ViewportCommand::CancelClose);
            self.closing = true;
        }
    }

    fn ask_about_training(&mut self, context: &Context) {
        let Some(live) = self.live.clone() else { return };
        let modal = Modal::new(Id::unique("closing")).show(context, |ui| {
            ui.set_width(360.0);
            ui.heading("The training is not over");
            ui.label("What is to become of it? Stopped, it saves its state first, and `--resume` goes on.");
            ui.add_space(8.0);
            ui.horizontal_wrapped(|ui| {
                let stops = ui.button("Stop training").clicked();
                let leaves = ui.button("Keep training without window").clicked();
                let stays = ui.button("Back").clicked();
                if stops {
                    live.stop();
                }
                (stops || leaves, stays)
            })
            .inner
        });
        let (closes, stays) = modal.inner;
        if closes {
            self.may_close = true;
            context.send_viewport_cmd(ViewportCommand::Close);
        }
        if closes || stays || modal.should_close() {
            self.closing = false;
        }
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
        if let Some(live) = &self.live {
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

fn absolute(path: &std::path::Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string()
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

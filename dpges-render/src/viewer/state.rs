//! The content of the window: read and changed by the panels, the picture and the viewer, which come after it.

use std::path::{Path, PathBuf};
use std::time::Instant;

use dpges_core::scene::{Rendering, SceneData, SceneInfo};
use eframe::egui_wgpu::RenderState;
use egui::Context;

use super::canvas::Canvas;
use super::comparison::Comparing;
use super::dialogs::{Dialogs, Purpose};
use super::editing::Editing;
use super::frame_times::FrameTimes;
use super::live::LiveScene;
use super::measuring::Measuring;
use super::messages::Message;
use super::path_editor::PathEditor;
use super::pending::Pending;
use super::resolution::ResolutionControl;
use super::screenshot::{ScreenshotForm, save_png, unused};
use super::views::DatasetViews;
use crate::navigation::{Navigator, Surroundings, Viewpoint, first_view, overview};
use crate::path::Extent;
use crate::stream::{Levels, StreamStatus};
use crate::{Display, RenderError, RenderOptions};

pub struct ShownScene {
    pub name: String,
    pub info: SceneInfo,
    /// Surfels and Gaussians, of the finest level.
    pub counts: [usize; 2],
    pub extent: Extent,
}

pub struct Resolution {
    /// Whether the scale holds the frame rate.
    pub automatic: bool,
    /// Share of the window's pixels along an edge, where it is not automatic.
    pub scale: f64,
    pub frames_per_second: f64,
    pub control: ResolutionControl,
}

pub struct State {
    pub canvas: Option<Canvas>,
    pub scene: Option<ShownScene>,
    pub generation: u64,
    pub options: RenderOptions,
    pub views: Option<DatasetViews>,
    /// The camera of the dataset that the view is at or on its way to.
    pub at_view: Option<usize>,
    pub chosen_view: Option<usize>,
    pub navigator: Navigator,
    pub home: Viewpoint,
    pub resolution: Resolution,
    pub frame_times: FrameTimes,
    /// When the last frame was drawn, if another followed at once.
    pub last_drawn: Option<Instant>,
    pub comparing: Comparing,
    pub measuring: Measuring,
    pub editing: Editing,
    pub path: PathEditor,
    pub screenshot: ScreenshotForm,
    pub window_px: [usize; 2],
    pub dialogs: Dialogs,
    pub message: Option<Message>,
    pub live: Option<LiveScene>,
    pub panel_open: bool,
    pub help_open: bool,
    pub pending_views: Option<Pending<Result<DatasetViews, String>>>,
    /// How far the levels of detail are, where the scene has any.
    pub stream: Option<StreamStatus>,
}

impl State {
    /// Nothing yet.
    pub fn new(gpu: Option<&RenderState>) -> Result<Self, RenderError> {
        let info = SceneInfo::default();
        let surroundings = Surroundings { up: glam::DVec3::NEG_Y, size: 1.0 };
        let nothing = SceneData { surfels: Default::default(), gaussians: Default::default(), environment: None, info };
        let home = overview(&Extent::of(&nothing), surroundings.up, nothing.info.near);
        Ok(Self {
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
            editing: Editing::new(None),
            path: PathEditor::default(),
            screenshot: ScreenshotForm::default(),
            window_px: [0; 2],
            dialogs: Dialogs::default(),
            message: None,
            live: None,
            panel_open: true,
            help_open: false,
            pending_views: None,
            stream: None,
        })
    }

    pub fn ask(&mut self, context: &Context, purpose: Purpose) {
        if !self.dialogs.is_open() {
            let name = match purpose {
                Purpose::SavePath => &self.path.file,
                Purpose::SaveScene => &self.editing.file,
                _ => &self.screenshot.file,
            };
            self.dialogs.ask(purpose, name, waker(context));
        }
    }

    /// Returns whether the scene could be shown, as `drawn` says. Goes to its first view if `is_new`.
    pub fn show_scene(&mut self, name: String, scene: &SceneData, drawn: &SceneInfo, is_new: bool) -> bool {
        let counts = [scene.surfels.len(), scene.gaussians.len()];
        let upload = |canvas: &mut Canvas| canvas.upload(scene).map_err(|error| error.to_string());
        let shown = ShownScene { name, info: drawn.clone(), counts, extent: Extent::of(scene) };
        self.show(shown, upload, is_new)
    }

    /// The same for a scene in levels of detail, with `scene` as the coarsest.
    pub fn show_levels(&mut self, context: &Context, name: String, scene: &SceneData, levels: Levels) -> bool {
        let counts = levels.scene().counts();
        let stream = |canvas: &mut Canvas| canvas.stream(levels, waker(context)).map_err(|error| error.to_string());
        let shown = ShownScene { name, info: scene.info.clone(), counts, extent: Extent::of(scene) };
        self.show(shown, stream, true)
    }

    fn show(
        &mut self,
        shown: ShownScene,
        upload: impl FnOnce(&mut Canvas) -> Result<(), String>,
        is_new: bool,
    ) -> bool {
        if let Some(Err(reason)) = self.canvas.as_mut().map(upload) {
            self.message = Some(Message::Error(format!("{} cannot be shown: {reason}", shown.name)));
            return false;
        }
        self.stream = None;
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

    pub fn settle_in(&mut self, shown: &ShownScene) {
        let views = self.views.as_ref().map_or(&[][..], |views| &views.cameras);
        (self.navigator.surroundings, self.home) = first_view(&shown.info, &shown.extent, views, None);
        self.at_view = (!views.is_empty()).then_some(0);
        self.chosen_view = self.at_view;
        self.navigator.jump(self.home);
    }

    pub fn go_to_view(&mut self, index: usize, at_once: bool) {
        let (Some(views), Some(shown)) = (&self.views, &self.scene) else { return };
        let Some((_, camera)) = views.cameras.get(index) else { return };
        let viewpoint = Viewpoint::of(camera, shown.extent.depth_before(camera));
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
    pub fn step_view(&mut self, by: isize) {
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
    pub fn leave_for(&mut self, viewpoint: Viewpoint) {
        self.at_view = None;
        self.navigator.fly(viewpoint);
    }

    /// Scenes that are blended have nothing but an image.
    pub fn set_display(&mut self, display: Display) {
        let peeled = self.scene.as_ref().is_some_and(|scene| scene.info.rendering == Rendering::Peeled);
        if peeled || display == Display::Image {
            self.options.display = display;
        }
    }

    pub fn add_to_path(&mut self) {
        if self.window_px != [0; 2] {
            self.path.cameras.push(self.navigator.viewpoint().camera(self.window_px));
        }
    }

    fn info(&self) -> SceneInfo {
        self.scene.as_ref().map_or_else(SceneInfo::default, |shown| shown.info.clone())
    }

    pub fn save_path(&mut self) {
        let file = PathBuf::from(&self.path.file);
        let note = |()| format!("{} cameras in {}", self.path.cameras.len(), absolute(&file));
        let saved = self.path.save(&file, &self.info()).map(note).map_err(|error| error.to_string());
        self.message = Some(saved.into());
    }

    pub fn load_path(&mut self) {
        let info = SceneInfo { near: self.navigator.viewpoint().lens.near, ..self.info() };
        let file = PathBuf::from(&self.path.file);
        self.message = self.path.load(&file, &info).err().map(|error| Message::Error(error.to_string()));
    }

    /// Writes what the view shows, beside files that are there already.
    pub fn save_screenshot(&mut self, file: &Path) {
        let size = self.screenshot.size.unwrap_or(self.window_px);
        let camera = self.navigator.viewpoint().camera(size);
        let Some(canvas) = &mut self.canvas else { return };
        let picture = canvas.picture(&camera, &self.options);
        let saved = picture.map_err(|error| format!("there is no screenshot: {error}")).and_then(|picture| {
            let file = unused(file);
            save_png(&picture, &file).map_err(|error| error.to_string())?;
            Ok(format!("{} × {} px in {}", size[0], size[1], absolute(&file)))
        });
        self.message = Some(saved.into());
    }
}

/// Asks for another frame.
pub fn waker(context: &Context) -> impl Fn() + Send + Sync + Clone + 'static + use<> {
    let context = context.clone();
    move || context.request_repaint()
}

fn absolute(path: &Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string()
}

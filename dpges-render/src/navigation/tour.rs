//! A visit to a scene by hands, named views and a camera path: what the page for browsers does between two frames.

use dpges_core::camera::Camera;
use dpges_core::scene::{SceneData, SceneInfo};
use glam::DVec2;

use super::first_view::first_view;
use super::hands::{Drag, Input, Keys};
use super::navigator::Navigator;
use super::viewpoint::Viewpoint;
use crate::path::{CameraPath, Extent, NamedCamera, cameras_from_json};
use crate::up::Up;

/// Time from one camera of a path to the next, s.
const SECONDS_PER_SEGMENT: f64 = 2.0;

#[derive(Clone, Debug)]
pub struct Tour {
    info: SceneInfo,
    extent: Extent,
    views: Vec<NamedCamera>,
    path: Option<CameraPath>,
    /// Time since the path began, s; `None`: it does not play.
    playing: Option<f64>,
    navigator: Navigator,
    /// Hands and keys since the last frame.
    input: Input,
    /// Width over height of what the view shows at least: narrower pictures show more above and below.
    aspect: f64,
    size_px: [usize; 2],
}

impl Tour {
    /// Of `scene`, which stands for its finer levels if it has any.
    pub fn new(scene: &SceneData) -> Self {
        let (info, extent) = (scene.info.clone(), Extent::of(scene));
        let (surroundings, home) = first_view(&info, &extent, &[], None);
        let navigator = Navigator::new(home, surroundings);
        let (views, path, playing, input) = (Vec::new(), None, None, Input::default());
        Self { info, extent, views, path, playing, navigator, input, aspect: 1.0, size_px: [1; 2] }
    }

    /// Takes the views of a `cameras.json`; the first is the first view after [`reset`](Self::reset).
    ///
    /// # Errors
    /// A message that names the problem. The views before stay.
    pub fn set_views(&mut self, json: &str) -> Result<(), String> {
        self.views = cameras_from_json(json, &self.info)?;
        Ok(())
    }

    /// Takes the camera path of a file, as the window saves it.
    ///
    /// # Errors
    /// A message that names the problem. The path before stays.
    pub fn set_path(&mut self, json: &str) -> Result<(), String> {
        let keys = cameras_from_json(json, &self.info)?.into_iter().map(|(_, camera)| camera).collect();
        self.path = Some(CameraPath::new(keys, false).map_err(|error| error.to_string())?);
        Ok(())
    }

    pub fn view_names(&self) -> impl Iterator<Item = &str> {
        self.views.iter().map(|(name, _)| name.as_str())
    }

    pub fn has_path(&self) -> bool {
        self.path.is_some()
    }

    pub fn is_playing(&self) -> bool {
        self.playing.is_some()
    }

    /// The first view, with `up` upwards, or what the scene or its views have upwards.
    pub fn reset(&mut self, up: Option<Up>) {
        let (surroundings, home) = first_view(&self.info, &self.extent, &self.views, up);
        self.aspect = self.views.first().map_or(1.0, |(_, camera)| aspect(camera));
        self.playing = None;
        self.navigator.surroundings = surroundings;
        self.navigator.jump(home);
    }

    /// Flies to the view of that number, or is there `at_once`.
    pub fn go_to(&mut self, view: usize, at_once: bool) {
        let Some((_, camera)) = self.views.get(view) else { return };
        let viewpoint = Viewpoint::of(camera, self.extent.depth_before(camera));
        self.aspect = aspect(camera);
        self.playing = None;
        if at_once {
            self.navigator.jump(viewpoint);
        } else {
            self.navigator.fly(viewpoint);
        }
    }

    pub fn play_or_stop(&mut self) {
        self.playing = (self.playing.is_none() && self.path.is_some()).then_some(0.0);
    }

    /// Vertical field of view, rad.
    pub fn field_of_view(&self) -> f64 {
        self.navigator.viewpoint().lens.vertical_field_of_view
    }

    pub fn set_field_of_view(&mut self, angle: f64) {
        self.navigator.lens_mut().vertical_field_of_view = angle;
    }

    /// A way of the hand, in heights of the picture.
    pub fn drag(&mut self, drag: Drag, heights: DVec2) {
        // a point at the focus stays below the finger
        let scale = if drag == Drag::Pan { self.size_px[1] as f64 / self.fitted_height(self.size_px) } else { 1.0 };
        self.input.drag = self.input.drag + drag.motion(scale * heights);
    }

    /// The wheel and fingers, see [`Input`].
    pub fn input_mut(&mut self) -> &mut Input {
        &mut self.input
    }

    pub fn hold(&mut self, keys: &Keys) {
        self.input.keys = keys.motion(self.navigator.mode);
    }

    /// Ends what goes on after the hands have let go.
    pub fn stop(&mut self) {
        self.navigator.stop();
    }

    /// Turns from now on about what is at that share of the width and height of the picture.
    pub fn focus_at(&mut self, [x, y]: [f64; 2]) {
        let [width, height] = self.size_px;
        let (x, y) = (x * width as f64, y * height as f64);
        if let Some(point) = self.extent.point_at(&self.camera(self.size_px), x, y) {
            self.playing = None;
            self.navigator.focus_on(point);
        }
    }

    /// Goes on by `seconds` for a picture of `size` px. Returns whether the view changes by itself from here, so that another
    /// frame is wanted. Hands end a path.
    pub fn advance(&mut self, seconds: f64, size: [usize; 2]) -> bool {
        self.size_px = size;
        let input = self.input;
        self.input = Input { dragging: input.dragging, keys: input.keys, ..Input::default() };
        if input.is_active() {
            self.playing = None;
        }
        if let (Some(elapsed), Some(path)) = (self.playing, &self.path) {
            let total = SECONDS_PER_SEGMENT * (path.keys().len() - 1) as f64;
            let now = elapsed + seconds;
            let camera = path.at(if total > 0.0 { now / total } else { 1.0 });
            self.playing = (now < total).then_some(now);
            self.aspect = aspect(&camera);
            self.navigator.jump(Viewpoint::of(&camera, self.navigator.viewpoint().focus_distance));
            return self.is_playing();
        }
        self.navigator.advance(&input, seconds) || input.is_active()
    }

    /// The camera of the view for a picture of `size` px.
    pub fn camera(&self, size: [usize; 2]) -> Camera {
        let view = self.navigator.viewpoint();
        let focal = self.fitted_height(size) / view.lens.height_at_one();
        Camera { fx: focal, fy: focal, ..view.camera(size) }
    }

    /// Height of the field of view in a picture of `size`, px.
    fn fitted_height(&self, [width, height]: [usize; 2]) -> f64 {
        (width as f64 / self.aspect).min(height as f64)
    }
}

fn aspect(camera: &Camera) -> f64 {
    (camera.width as f64 / camera.fx) / (camera.height as f64 / camera.fy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{camera, neutral};
    use crate::path::to_json;

    const WIDE: [usize; 2] = [640, 480];

    /// Two views, and a path through three cameras, all of 64 × 48 px.
    fn tour() -> Tour {
        let mut tour = Tour::new(&neutral(SceneInfo::default(), [4, 4]));
        let named = |name: &str, centre| (name.to_owned(), camera(centre, 50.0));
        tour.set_views(&to_json(&[named("door", [4.0, 0.0, 1.0]), named("window", [0.0, 4.0, 1.0])])).unwrap();
        tour.set_path(&to_json(&[[4.0, 0.0, 1.0], [0.0, 4.0, 2.0], [-4.0, 0.0, 1.0]].map(|at| named("", at)))).unwrap();
        tour.reset(None);
        tour
    }

    fn eye(tour: &Tour) -> [f64; 3] {
        tour.camera(WIDE).centre().to_array()
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        (glam::DVec3::from(a) - glam::DVec3::from(b)).length() < 1e-9
    }

    #[test]
    fn it_begins_at_the_first_view_and_goes_to_others() {
        let mut tour = tour();
        assert_eq!(tour.view_names().collect::<Vec<_>>(), ["door", "window"]);
        assert!(near(eye(&tour), [4.0, 0.0, 1.0]));
        assert!(!tour.advance(0.02, WIDE), "it rests");
        tour.go_to(1, false);
        let mut frames = 0;
        while tour.advance(0.02, WIDE) {
            frames += 1;
        }
        assert!(frames > 5 && near(eye(&tour), [0.0, 4.0, 1.0]), "{frames}");
        tour.go_to(0, true);
        assert!(near(eye(&tour), [4.0, 0.0, 1.0]));
        tour.go_to(7, true);
        assert!(near(eye(&tour), [4.0, 0.0, 1.0]), "there are two");
    }

    #[test]
    fn a_path_plays_to_its_end_and_hands_end_it() {
        let mut tour = tour();
        tour.play_or_stop();
        assert!(tour.advance(SECONDS_PER_SEGMENT, WIDE) && near(eye(&tour), [0.0, 4.0, 2.0]));
        assert!(!tour.advance(SECONDS_PER_SEGMENT, WIDE) && near(eye(&tour), [-4.0, 0.0, 1.0]));
        assert!(!tour.is_playing());
        tour.play_or_stop();
        tour.advance(0.5, WIDE);
        tour.input_mut().wheel(1.0);
        tour.advance(0.02, WIDE);
        assert!(!tour.is_playing());
    }

    #[test]
    fn narrow_pictures_show_the_whole_width_of_a_view() {
        let mut tour = tour();
        let across = |camera: &Camera| camera.width as f64 / camera.fx;
        let [wide, narrow] = [WIDE, [390, 844]].map(|size| tour.camera(size));
        assert!((across(&wide) - 64.0 / 50.0).abs() < 1e-9 && (across(&narrow) - across(&wide)).abs() < 1e-9);
        // what is at the focus follows the finger
        let size = [390, 844];
        tour.advance(0.02, size);
        let focus = tour.navigator.viewpoint().focus();
        tour.input_mut().dragging = true;
        tour.drag(Drag::Pan, DVec2::new(39.0, 0.0) / 844.0);
        tour.advance(0.02, size);
        let (x, y, _) = tour.camera(size).project(focus).unwrap();
        assert!((x - 234.0).abs() < 1e-6 && (y - 422.0).abs() < 1e-6, "{x} {y}");
    }

    #[test]
    fn wrong_files_are_refused_and_change_nothing() {
        let mut tour = tour();
        assert!(tour.set_views("{}").unwrap_err().contains("camera_path"));
        assert!(tour.set_path("[]").unwrap_err().contains("at least one camera"));
        assert_eq!((tour.view_names().count(), tour.has_path()), (2, true));
    }
}

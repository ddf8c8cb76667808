//! Moving through the scene: events of the page become those of [`Tour`].

use dpges_render::navigation::{Drag, Keys, Tour};
use wasm_bindgen::prelude::*;

use super::{Viewer, json};

impl Viewer {
    fn tour(&mut self) -> Result<&mut Tour, JsError> {
        self.tour.as_mut().ok_or_else(|| JsError::new("no scene is loaded"))
    }
}

#[wasm_bindgen]
impl Viewer {
    /// Takes the views of a `cameras.json` for the scene. Returns their names as JSON.
    pub fn set_views(&mut self, cameras: &str) -> Result<String, JsError> {
        let tour = self.tour()?;
        tour.set_views(cameras).map_err(|cause| JsError::new(&cause))?;
        json(&tour.view_names().collect::<Vec<_>>())
    }

    /// Takes the camera path of a file for the scene.
    pub fn set_path(&mut self, path: &str) -> Result<(), JsError> {
        self.tour()?.set_path(path).map_err(|cause| JsError::new(&cause))
    }

    /// Back to the first view, with `up` upwards: `z`, `-y`, …, or empty for what the scene says. Returns the vertical field of
    /// view, degrees.
    pub fn reset(&mut self, up: &str) -> Result<f64, JsError> {
        let up = if up.is_empty() { None } else { Some(up.parse().map_err(|cause: String| JsError::new(&cause))?) };
        let tour = self.tour()?;
        tour.reset(up);
        Ok(tour.field_of_view().to_degrees())
    }

    /// Flies to a view, or is there `at_once`.
    pub fn go_to(&mut self, view: usize, at_once: bool) -> Result<(), JsError> {
        self.tour()?.go_to(view, at_once);
        Ok(())
    }

    pub fn play_or_stop(&mut self) -> Result<(), JsError> {
        self.tour()?.play_or_stop();
        Ok(())
    }

    pub fn is_playing(&self) -> bool {
        self.tour.as_ref().is_some_and(Tour::is_playing)
    }

    /// Sets the vertical field of view.
    pub fn set_field(&mut self, degrees: f64) -> Result<(), JsError> {
        self.tour()?.set_field_of_view(degrees.to_radians());
        Ok(())
    }

    /// Whether a hand holds the view.
    pub fn hold(&mut self, holds: bool) -> Result<(), JsError> {
        self.tour()?.input_mut().dragging = holds;
        Ok(())
    }

    /// A way of the hand, in heights of the canvas, that is to do `what`: "orbit", "look" or "pan".
    pub fn drag(&mut self, what: &str, right: f64, down: f64) -> Result<(), JsError> {
        let drag = match what {
            "look" => Drag::Look,
            "pan" => Drag::Pan,
            _ => Drag::Orbit,
        };
        self.tour()?.drag(drag, [right, down].into());
        Ok(())
    }

    pub fn wheel(&mut self, notches: f64) -> Result<(), JsError> {
        self.tour()?.input_mut().wheel(notches);
        Ok(())
    }

    pub fn pinch(&mut self, factor: f64) -> Result<(), JsError> {
        self.tour()?.input_mut().pinch(factor);
        Ok(())
    }

    /// The keys that are held, −1, 0 or 1: walking right, down, forward; turning right, down; nearer.
    pub fn keys(&mut self, axes: &[f64], faster: bool) -> Result<(), JsError> {
        let &[x, y, z, right, down, approach] = axes else { return Err(JsError::new("keys have six axes")) };
        self.tour()?.hold(&Keys { walk: [x, y, z].into(), turn: [right, down].into(), approach, faster });
        Ok(())
    }

    /// Ends what goes on after the hands have let go.
    pub fn stop(&mut self) -> Result<(), JsError> {
        self.tour()?.stop();
        Ok(())
    }

    /// Turns from now on about what is at that share of the width and height of the canvas.
    pub fn focus_at(&mut self, x: f64, y: f64) -> Result<(), JsError> {
        self.tour()?.focus_at([x, y]);
        Ok(())
    }

    /// Goes on by `seconds`: the next frame shows the view in a picture of `width` × `height` px, with options as JSON. Returns
    /// whether another frame is wanted.
    pub fn advance(&mut self, seconds: f64, width: usize, height: usize, options: &str) -> Result<bool, JsError> {
        let tour = self.tour()?;
        let moves = tour.advance(seconds, [width, height]);
        let camera = tour.camera([width, height]);
        camera.validate()?;
        self.look(camera, options)?;
        Ok(moves)
    }

    /// Where the view is, world units.
    pub fn eye(&mut self) -> Result<Vec<f64>, JsError> {
        Ok(self.tour()?.camera([1; 2]).centre().to_array().to_vec())
    }
}

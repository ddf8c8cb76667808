//! The scene beside the photograph that its camera took.

use dpges_core::camera::Camera;
use egui::{Color32, ColorImage, Context, Painter, Pos2, Rect, Sense, Stroke, TextureHandle, TextureOptions, Ui};

use super::views::DatasetViews;
use crate::{RenderOptions, Rgb8Image, false_colour};

/// Points between two pictures.
const GAP: f32 = 2.0;
/// Width of the part of the divider that can be caught, points.
const HANDLE: f32 = 14.0;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Comparison {
    #[default]
    Off,
    SideBySide,
    /// The photograph on the right of a divider.
    Wipe,
    Error,
}

impl Comparison {
    pub const ALL: [Self; 4] = [Self::Off, Self::SideBySide, Self::Wipe, Self::Error];

    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::SideBySide => "side by side",
            Self::Wipe => "wipe",
            Self::Error => "error",
        }
    }

    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::ALL.iter().position(|&other| other == self).unwrap_or_default();
        Self::ALL[(at + 1) % Self::ALL.len()]
    }

    /// Where the scene, seen by `camera`, is shown in `rect`.
    pub fn place(self, rect: Rect, camera: &Camera) -> Rect {
        let aspect = camera.width as f32 / camera.height as f32;
        match self {
            Self::Off => rect,
            Self::SideBySide => {
                let left = Rect::from_min_size(rect.min, egui::vec2(0.5 * (rect.width() - GAP), rect.height()));
                fitted(left, aspect)
            }
            Self::Wipe | Self::Error => fitted(rect, aspect),
        }
    }
}

pub struct Comparing {
    pub kind: Comparison,
    /// Place of the divider, share of the width.
    pub divider: f32,
    photograph: Option<Photograph>,
    error: Option<ErrorPicture>,
}

struct Photograph {
    /// Place in the list of views.
    view: usize,
    picture: Rgb8Image,
    texture: TextureHandle,
}

struct ErrorPicture {
    /// The view, the options and the number of the scene that it was made of.
    of: (usize, RenderOptions, u64),
    texture: TextureHandle,
    /// Mean over pixels and channels, of full scale 1.
    mean: f64,
}

impl Default for Comparing {
    fn default() -> Self {
        Self { kind: Comparison::Off, divider: 0.5, photograph: None, error: None }
    }
}

impl Comparing {
    pub fn forget(&mut self) {
        self.photograph = None;
        self.error = None;
    }

    /// Loads the photograph of `view` unless it is here. Returns whether there is one.
    pub fn load(&mut self, context: &Context, views: &DatasetViews, view: usize) -> bool {
        if self.photograph.as_ref().is_none_or(|photograph| photograph.view != view) {
            self.photograph = (views.photograph)(view).map(|picture| {
                let texture = texture(context, "photograph", &picture);
                Photograph { view, picture, texture }
            });
        }
        self.photograph.is_some()
    }

    /// The difference between the photograph and what `draw` makes of the scene at its size, with `options`;
    /// `generation` counts the scenes. Drawn anew only if one of them is another.
    pub fn update_error<E>(
        &mut self,
        context: &Context,
        options: &RenderOptions,
        generation: u64,
        draw: impl FnOnce([usize; 2]) -> Result<Rgb8Image, E>,
    ) -> Result<(), E> {
        let Some(photograph) = &self.photograph else { return Ok(()) };
        let of = (photograph.view, *options, generation);
        if self.error.as_ref().is_none_or(|error| error.of != of) {
            let expected = &photograph.picture;
            let found = draw([expected.width, expected.height])?;
            let texture = texture(context, "error", &false_colour::error(&found, expected));
            self.error = Some(ErrorPicture { of, texture, mean: mean_error(&found, expected) });
        }
        Ok(())
    }

    /// Mean absolute error of what is shown, of full scale 1.
    pub fn mean_error(&self) -> Option<f64> {
        self.error.as_ref().map(|error| error.mean)
    }

    /// Shows the scene (`scene`, seen by `camera`) and the photograph in `rect` as `kind` says. Returns where the scene is.
    pub fn show(&mut self, kind: Comparison, ui: &Ui, rect: Rect, camera: &Camera, scene: egui::TextureId) -> Rect {
        let painter = ui.painter().with_clip_rect(rect);
        let place = kind.place(rect, camera);
        let photograph = self.photograph.as_ref().map(|photograph| photograph.texture.id());
        let shown = match (kind, &self.error, photograph) {
            (Comparison::Error, Some(error), Some(_)) => error.texture.id(),
            _ => scene,
        };
        image(&painter, shown, place, FULL);
        match (kind, photograph) {
            (Comparison::SideBySide, Some(photograph)) => {
                let right = place.translate(egui::vec2(0.5 * (rect.width() + GAP), 0.0));
                image(&painter, photograph, right, FULL);
                caption(&painter, place, egui::Align2::LEFT_TOP, "scene");
                caption(&painter, right, egui::Align2::LEFT_TOP, "photograph");
            }
            (Comparison::Wipe, Some(photograph)) => {
                let mut behind = place;
                behind.min.x = self.divide(ui, place);
                image(&painter, photograph, behind, Rect::from_min_max(egui::pos2(self.divider, 0.0), FULL.max));
                painter.vline(behind.min.x, place.y_range(), Stroke::new(3.0, Color32::from_black_alpha(150)));
                painter.vline(behind.min.x, place.y_range(), Stroke::new(1.0, Color32::WHITE));
                caption(&painter, place, egui::Align2::LEFT_TOP, "scene");
                caption(&painter, place, egui::Align2::RIGHT_TOP, "photograph");
            }
            _ => {}
        }
        place
    }

    /// Lets the divider be dragged. Returns where it is.
    fn divide(&mut self, ui: &Ui, place: Rect) -> f32 {
        let at = |divider: f32| place.left() + divider * place.width();
        let centre = egui::pos2(at(self.divider), place.center().y);
        let handle = Rect::from_center_size(centre, egui::vec2(HANDLE, place.height()));
        let response = ui.interact(handle, ui.scope_id().with("divider"), Sense::drag());
        if let Some(pointer) = response.interact_pointer_pos() {
            self.divider = ((pointer.x - place.left()) / place.width()).clamp(0.0, 1.0);
        }
        if response.hovered() || response.dragged() {
            ui.set_cursor_icon(egui::CursorIcon::ResizeHorizontal);
        }
        at(self.divider)
    }
}

const FULL: Rect = Rect { min: Pos2::ZERO, max: Pos2 { x: 1.0, y: 1.0 } };

fn image(painter: &Painter, texture: egui::TextureId, place: Rect, part: Rect) {
    painter.image(texture, place, part, Color32::WHITE);
}

fn caption(painter: &Painter, place: Rect, align: egui::Align2, text: &str) {
    let text = painter.layout_no_wrap(text.to_owned(), egui::FontId::proportional(13.0), Color32::WHITE);
    let rect = align.align_size_within_rect(text.size(), place.shrink2(egui::vec2(8.0, 6.0)));
    painter.rect_filled(rect.expand(3.0), 3.0, Color32::from_black_alpha(150));
    painter.galley(rect.min, text, Color32::WHITE);
}

/// The largest part of `rect`, in its middle, whose width is `aspect` times its height.
pub fn fitted(rect: Rect, aspect: f32) -> Rect {
    let width = rect.width().min(aspect * rect.height());
    Rect::from_center_size(rect.center(), egui::vec2(width, width / aspect))
}

fn texture(context: &Context, name: &str, picture: &Rgb8Image) -> TextureHandle {
    let image = ColorImage::from_rgb([picture.width, picture.height], &picture.bytes);
    context.load_texture(name, image, TextureOptions::LINEAR)
}

fn mean_error(found: &Rgb8Image, expected: &Rgb8Image) -> f64 {
    let differences = found.bytes.iter().zip(&expected.bytes).map(|(&a, &b)| f64::from(a.abs_diff(b)));
    differences.sum::<f64>() / (255.0 * expected.bytes.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_fitted_into_the_middle() {
        let rect = Rect::from_min_size(egui::pos2(10.0, 20.0), egui::vec2(400.0, 200.0));
        let wide = fitted(rect, 4.0);
        assert_eq!((wide.size(), wide.center()), (egui::vec2(400.0, 100.0), rect.center()));
        let high = fitted(rect, 0.5);
        assert_eq!((high.size(), high.center()), (egui::vec2(100.0, 200.0), rect.center()));
    }

    #[test]
    fn comparisons_follow_one_another() {
        let [off, side_by_side, wipe, error] = Comparison::ALL;
        assert_eq!(Comparison::ALL.map(Comparison::next), [side_by_side, wipe, error, off]);
    }

    #[test]
    fn photograph_and_error_are_made_once() {
        let context = Context::default();
        let photograph = |view| (view < 2).then(|| Rgb8Image { width: 1, height: 1, bytes: vec![view as u8; 3] });
        let views = DatasetViews { cameras: Vec::new(), photograph: Box::new(photograph) };
        let options = RenderOptions::from(&dpges_core::scene::SceneInfo::default());
        let mut comparing = Comparing::default();
        assert!(comparing.load(&context, &views, 1) && !comparing.load(&context, &views, 2));
        assert!(comparing.load(&context, &views, 0));
        let mut drawn = 0;
        for (generation, count) in [(1, 1), (1, 1), (2, 2)] {
            let draw = |size: [usize; 2]| {
                drawn += 1;
                Ok::<_, ()>(Rgb8Image { width: size[0], height: size[1], bytes: vec![51; 3] })
            };
            comparing.update_error(&context, &options, generation, draw).unwrap();
            assert_eq!((drawn, comparing.mean_error()), (count, Some(0.2)));
        }
    }
}

//! Selecting primitives in the picture by a box or a brush.

mod edited;
mod marks;
mod region;

use std::path::PathBuf;

use dpges_core::camera::Camera;
use egui::{Color32, Mesh, Modifiers, Painter, Pos2, Rect, Response, Shape, Stroke, StrokeKind, Ui};
use glam::DVec2;

pub use edited::EditedScene;
pub use marks::Combine;
use region::Region;

/// Radii of the brush, points.
pub const RADII: [f32; 2] = [3.0, 200.0];
const COLOUR: Color32 = Color32::from_rgb(255, 0, 255);
/// Side of the square that marks a selected primitive, points.
const DOT: f32 = 3.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tool {
    Box,
    Brush,
}

/// An edit that the user asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Edit {
    /// Takes the tool, or lays it down.
    Tool(Tool),
    SmallerBrush,
    LargerBrush,
    SelectAll,
    SelectNothing,
    Invert,
    Delete,
    Undo,
    Redo,
    Save,
}

pub struct Editing {
    /// `None` for scenes in levels of detail or in training, and before the first.
    pub scene: Option<EditedScene>,
    pub tool: Option<Tool>,
    /// Radius of the brush, points.
    pub radius: f32,
    /// Whether what a surface hides is left out.
    pub seen_only: bool,
    /// The name of the file to save.
    pub file: String,
    /// A file that would be replaced: the user is asked.
    pub asks_for: Option<PathBuf>,
    drag: Option<Drag>,
}

/// A drag of a tool.
struct Drag {
    /// Where the box begins, or the brush was in the last frame.
    from: Pos2,
    to: Pos2,
    combine: Combine,
    /// A camera and the depths of what it shows, where only what is seen counts.
    seen: Option<(Camera, Vec<f32>)>,
}

impl Editing {
    pub fn new(scene: Option<EditedScene>) -> Self {
        let file = "edited.safetensors".to_owned();
        Self { scene, tool: None, radius: 24.0, seen_only: false, file, asks_for: None, drag: None }
    }

    pub fn lay_down(&mut self) {
        (self.tool, self.drag) = (None, None);
    }

    pub fn resize_brush(&mut self, by: f32) {
        self.radius = (self.radius * by).clamp(RADII[0], RADII[1]);
    }

    pub fn is_unsaved(&self) -> bool {
        self.scene.as_ref().is_some_and(|scene| !scene.is_saved())
    }

    /// Follows the pointer with the tool over the picture in `place` that `camera` sees. `surfaces` has its depths.
    pub fn follow(
        &mut self,
        ui: &Ui,
        response: &Response,
        place: Rect,
        camera: &Camera,
        surfaces: impl FnOnce() -> Option<Vec<f32>>,
    ) {
        let (Some(tool), Some(scene)) = (self.tool, &mut self.scene) else { return };
        let (down, pressed_at, now) = ui.input(|input| {
            let pointer = &input.pointer;
            (pointer.primary_down(), pointer.press_origin(), pointer.latest_pos())
        });
        let begins = (down && response.is_pointer_button_down_on()) || response.clicked();
        let start = pressed_at.or(now).filter(|start| begins && place.contains(*start));
        if let (None, Some(from)) = (&self.drag, start) {
            self.drag = Some(Drag { from, to: from, combine: combine(ui.input(|input| input.modifiers)), seen: None });
        }
        let Some(drag) = &mut self.drag else { return };
        drag.to = place.clamp(now.unwrap_or(drag.to));
        let px_per_point = camera.width as f64 / f64::from(place.width());
        let px = |at: Pos2| px_per_point * DVec2::new((at.x - place.min.x).into(), (at.y - place.min.y).into());
        let way = [px(drag.from), px(drag.to)];
        let region = match tool {
            Tool::Brush => Some(Region::Brush { way, radius: px_per_point * f64::from(self.radius) }),
            Tool::Box => (!down).then_some(Region::Box(way)),
        };
        if let Some(region) = region {
            if self.seen_only && drag.seen.as_ref().is_none_or(|(seen_by, _)| seen_by != camera) {
                drag.seen = surfaces().map(|depths| (*camera, depths));
            }
            let seen = drag.seen.as_ref().map(|(_, depths)| &**depths);
            scene.select(&region, camera, seen, drag.combine);
            drag.from = drag.to;
            if drag.combine == Combine::Replace {
                drag.combine = Combine::Add;
            }
        }
        if !down {
            scene.marks.end_stroke();
            self.drag = None;
        }
    }

    /// Marks what is selected over the picture in `place` that `camera` sees, and shows the tool at `pointer`.
    pub fn paint(&self, painter: &Painter, place: Rect, camera: &Camera, pointer: Option<Pos2>) {
        if let Some(scene) = &self.scene {
            let scale = egui::vec2(place.width() / camera.width as f32, place.height() / camera.height as f32);
            let mut dots = Mesh::default();
            for at in scene.selected_at(camera) {
                let at = place.min + scale * egui::vec2(at.x as f32, at.y as f32);
                dots.add_colored_rect(Rect::from_center_size(at, egui::Vec2::splat(DOT)), COLOUR);
            }
            painter.add(Shape::mesh(dots));
        }
        let line = Stroke::new(1.5, COLOUR);
        match (self.tool, &self.drag, pointer) {
            (Some(Tool::Box), Some(drag), _) => {
                let corners = Rect::from_two_pos(drag.from, drag.to);
                painter.rect(corners, 0.0, COLOUR.gamma_multiply(0.12), line, StrokeKind::Middle);
            }
            (Some(Tool::Brush), _, Some(pointer)) => {
                painter.circle_stroke(pointer, self.radius, line);
            }
            _ => {}
        }
    }
}

/// Shift adds, ctrl or alt subtracts.
fn combine(modifiers: Modifiers) -> Combine {
    if modifiers.command || modifiers.alt {
        Combine::Subtract
    } else if modifiers.shift {
        Combine::Add
    } else {
        Combine::Replace
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use dpges_core::scene::SceneInfo;
    use egui::{Event, PointerButton, pos2};
    use egui_kittest::Harness;
    use glam::DVec3;

    use super::*;
    use crate::fixtures::{neutral, pinhole};

    const MIDDLE: Pos2 = pos2(160.0, 110.0);

    /// A picture of 600 × 400 px in 300 × 200 points: surfels in its middle and 50 points to the right, a Gaussian far behind
    /// them, 15 points to the right.
    fn harness(tool: Tool) -> Harness<'static, Editing> {
        let pose = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y);
        let camera = pinhole(pose, 400.0, [600, 400]);
        let mut scene = neutral(SceneInfo::default(), [2, 1]);
        scene.surfels.positions = vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
        scene.gaussians.positions = vec![1.0, 0.0, 9.0];
        let editing = Editing { tool: Some(tool), ..Editing::new(Some(EditedScene::new(scene))) };
        let app = move |ui: &mut Ui, editing: &mut Editing| {
            let place = Rect::from_center_size(MIDDLE, egui::vec2(300.0, 200.0));
            let response = ui.allocate_rect(place, egui::Sense::click_and_drag());
            editing.follow(ui, &response, place, &camera, || Some(vec![4.0; 600 * 400]));
            editing.paint(ui.painter(), place, &camera, response.hover_pos());
        };
        Harness::builder().with_size(egui::vec2(320.0, 220.0)).build_ui_state(app, editing)
    }

    /// Drags from `places` to place, relative to the middle of the picture. Returns the selected rows.
    fn drag(harness: &mut Harness<'_, Editing>, modifiers: Modifiers, places: &[[f32; 2]]) -> Vec<usize> {
        harness.event(Event::ModifiersChanged(modifiers));
        let at = |place: [f32; 2]| MIDDLE + place.into();
        let button = PointerButton::Primary;
        harness.event(Event::PointerMoved(at(places[0])));
        harness.step();
        harness.event(Event::PointerButton { pos: at(places[0]), button, pressed: true, modifiers });
        harness.step();
        for &place in places {
            harness.event(Event::PointerMoved(at(place)));
            harness.step();
        }
        let end = at(places[places.len() - 1]);
        harness.event(Event::PointerButton { pos: end, button, pressed: false, modifiers });
        harness.step();
        let selected = harness.state().scene.as_ref().unwrap().marks.selected();
        (0..selected.len()).filter(|&row| selected[row]).collect()
    }

    #[test]
    fn boxes_are_dragged_and_shift_adds_and_ctrl_subtracts() {
        let mut harness = harness(Tool::Box);
        assert_eq!(drag(&mut harness, Modifiers::NONE, &[[-9.0, -9.0], [9.0, 9.0]]), [0]);
        assert_eq!(drag(&mut harness, Modifiers::NONE, &[[60.0, 9.0], [-9.0, -9.0]]), [0, 1, 2], "however far away");
        assert_eq!(drag(&mut harness, Modifiers::CTRL | Modifiers::COMMAND, &[[40.0, -9.0], [60.0, 9.0]]), [0, 2]);
        assert_eq!(drag(&mut harness, Modifiers::SHIFT, &[[40.0, -9.0], [60.0, 9.0]]), [0, 1, 2]);
        assert_eq!(drag(&mut harness, Modifiers::NONE, &[[-90.0, -90.0]]), [0; 0], "a click on nothing");
        harness.state_mut().seen_only = true;
        assert_eq!(drag(&mut harness, Modifiers::NONE, &[[-99.0, -99.0], [9999.0, 9999.0]]), [0, 1], "and no farther");
    }

    #[test]
    fn a_stroke_of_the_brush_is_one_change() {
        let mut harness = harness(Tool::Brush);
        harness.state_mut().radius = 5.0;
        assert_eq!(
            drag(&mut harness, Modifiers::NONE, &[[-40.0, 3.0], [0.0, 3.0], [20.0, 3.0], [60.0, 3.0]]),
            [0, 1, 2]
        );
        assert_eq!(drag(&mut harness, Modifiers::COMMAND, &[[1.0, 0.0]]), [1, 2], "a press alone");
        let marks = &mut harness.state_mut().scene.as_mut().unwrap().marks;
        marks.undo();
        marks.undo();
        assert!(!marks.can_undo() && !marks.selected().contains(&true));
    }
}

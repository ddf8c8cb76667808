//! The distance between two points on surfaces.

use dpges_core::camera::Camera;
use dpges_core::scene::length::{four_digits, in_words, parse_metres};
use egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Stroke};
use glam::DVec3;

const COLOUR: Color32 = Color32::from_rgb(255, 200, 60);

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measuring {
    pub active: bool,
    pub points: Vec<DVec3>,
    /// The true length of the distance, as it is typed.
    pub known: String,
}

impl Measuring {
    /// A third point begins anew.
    pub fn pick(&mut self, point: DVec3) {
        if self.points.len() == 2 {
            self.points.clear();
        }
        self.points.push(point);
    }

    /// World units; `None` before the second point.
    pub fn distance(&self) -> Option<f64> {
        match self.points[..] {
            [from, to] => Some((to - from).length()),
            _ => None,
        }
    }

    /// Metres per world unit by the length that is typed.
    ///
    /// # Errors
    /// A sentence if it is no length, or if there is no distance.
    pub fn scale(&self) -> Result<f64, String> {
        match self.distance() {
            Some(distance) if distance > 0.0 => Ok(parse_metres(&self.known)? / distance),
            _ => Err("Click two different points first.".to_owned()),
        }
    }

    /// The command that stores this scale in `scene`.
    pub fn command(&self, scene: &str) -> Option<String> {
        let [from, to] = self.points[..] else { return None };
        let place = |point: DVec3| point.to_array().map(|x| x.to_string()).join(",");
        let (from, to, length) = (place(from), place(to), self.known.trim());
        Some(format!("dpges scale \"{scene}\" --from={from} --to={to} --length \"{length}\""))
    }

    /// Draws points, line and distance over the picture in `rect` that `camera` sees.
    pub fn paint(&self, painter: &Painter, rect: Rect, camera: &Camera, metres_per_unit: Option<f64>) {
        let place = |point: &DVec3| {
            let (x, y, _) = camera.project(*point)?;
            Some(at_pixel(rect, camera, x, y))
        };
        let places: Vec<Option<Pos2>> = self.points.iter().map(place).collect();
        for place in places.iter().flatten() {
            painter.circle(*place, 4.0, COLOUR, Stroke::new(1.0, Color32::BLACK));
        }
        if let ([Some(from), Some(to)], Some(distance)) = (&places[..], self.distance()) {
            painter.line_segment([*from, *to], Stroke::new(3.5, Color32::from_black_alpha(160)));
            painter.line_segment([*from, *to], Stroke::new(2.0, COLOUR));
            let middle = from.lerp(*to, 0.5) + egui::vec2(0.0, -8.0);
            let text = painter.layout_no_wrap(text_of(distance, metres_per_unit), FontId::proportional(15.0), COLOUR);
            let place = Align2::CENTER_BOTTOM.anchor_size(middle, text.size());
            painter.rect_filled(place.expand(3.0), 3.0, Color32::from_black_alpha(190));
            painter.galley(place.min, text, COLOUR);
        }
    }
}

/// `distance` in metres, or in world units where nobody knows how long one is.
pub fn text_of(distance: f64, metres_per_unit: Option<f64>) -> String {
    metres_per_unit.map_or_else(|| format!("{} units", four_digits(distance)), |metres| in_words(metres * distance))
}

/// Where in `rect` the pixel position (`x`, `y`) of a picture of `camera`'s size is shown.
pub fn at_pixel(rect: Rect, camera: &Camera, x: f64, y: f64) -> Pos2 {
    let share = egui::vec2((x / camera.width as f64) as f32, (y / camera.height as f64) as f32);
    rect.min + share * rect.size()
}

/// Pixel position of `place` in a picture of `camera`'s size that is shown in `rect`; `None` outside.
pub fn pixel_at(rect: Rect, camera: &Camera, place: Pos2) -> Option<(f64, f64)> {
    let share = (place - rect.min) / rect.size();
    let inside = |share: f32| (0.0..1.0).contains(&share);
    let inside = inside(share.x) && inside(share.y);
    inside.then(|| (f64::from(share.x) * camera.width as f64, f64::from(share.y) * camera.height as f64))
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::dvec3;

    use super::*;
    use crate::fixtures::pinhole;

    #[test]
    fn two_points_have_a_distance_and_a_third_begins_anew() {
        let mut measuring = Measuring::default();
        measuring.pick(dvec3(1.0, 0.0, 0.0));
        assert_eq!(measuring.distance(), None);
        measuring.pick(dvec3(1.0, 3.0, 4.0));
        assert_eq!(measuring.distance(), Some(5.0));
        measuring.pick(DVec3::ZERO);
        assert_eq!((&measuring.points[..], measuring.distance()), (&[DVec3::ZERO][..], None));
    }

    #[test]
    fn a_known_length_gives_the_scale_and_the_command_that_stores_it() {
        let mut measuring = Measuring { known: "250 cm".to_owned(), ..Measuring::default() };
        measuring.pick(dvec3(0.5, 0.0, -1.0));
        assert!(measuring.scale().is_err() && measuring.command("runs/a").is_none());
        measuring.pick(dvec3(0.5, 3.0, 3.0));
        assert_eq!(measuring.scale(), Ok(0.5));
        let command = "dpges scale \"runs/a\" --from=0.5,0,-1 --to=0.5,3,3 --length \"250 cm\"";
        assert_eq!(measuring.command("runs/a").unwrap(), command);
        measuring.known = "2.5".to_owned();
        assert!(measuring.scale().unwrap_err().contains("unit"));
        measuring.points = vec![DVec3::ONE; 2];
        assert!(measuring.scale().unwrap_err().contains("different points"));
    }

    #[test]
    fn distances_are_in_metres_where_the_scale_is_known() {
        assert_eq!(text_of(0.012345, None), "0.01235 units");
        assert_eq!(text_of(5.0, Some(0.25)), "1.250 m");
    }

    #[test]
    fn pixels_and_places_in_the_window_agree() {
        let pose = CameraFromWorld::look_at(DVec3::X, DVec3::ZERO, DVec3::Z);
        let camera = pinhole(pose, 100.0, [320, 180]);
        let rect = Rect::from_min_size(egui::pos2(20.0, 10.0), egui::vec2(640.0, 360.0));
        let place = at_pixel(rect, &camera, 80.0, 45.0);
        assert_eq!(place, egui::pos2(180.0, 100.0));
        assert_eq!(pixel_at(rect, &camera, place), Some((80.0, 45.0)));
        assert_eq!(pixel_at(rect, &camera, egui::pos2(19.0, 100.0)), None);
        assert_eq!(pixel_at(rect, &camera, egui::pos2(180.0, 371.0)), None);
    }
}

//! Cameras and points from above and from the side, upright, as SVG.

use std::fmt::Write;

use dpges_core::camera::Camera;
use glam::{DMat3, DVec3};

use super::Report;
use super::findings::middle;
use crate::{Dataset, Split, upwards};

/// Points on a map at most.
const MOST_POINTS: usize = 4000;
/// Side of a picture, and height of what stands above and below it, px.
const SIDE: f64 = 540.0;
const TEXT: f64 = 28.0;
/// Length of the line along which a camera looks, relative to the side.
const LOOK: f64 = 0.04;
/// The map reaches beyond the cameras by this share of their size, or as far as most points do, but no farther than
/// this many times the cameras.
const BEYOND: f64 = 0.3;
const FARTHEST: f64 = 3.0;
/// Colours of training, held-out and validation cameras, and of cameras with a finding.
const COLOURS: [(&str, &str); 4] =
    [("#286ebe", "training"), ("#e68c14", "held out"), ("#7850aa", "validation"), ("#dc1e1e", "something was found")];

/// Both pictures beside each other: cameras and points around the middle of the cameras of `dataset`, of which `report` is.
/// Points outside are drawn at the border.
pub fn svg(dataset: &Dataset, report: &Report) -> String {
    let map_from_world = upright(report.views.iter().map(|view| &view.camera));
    let origin = middle(&report.views);
    let place = |world: DVec3| map_from_world * (world - origin);
    let eyes: Vec<DVec3> = report.views.iter().map(|view| place(view.camera.centre())).collect();
    let points = &dataset.points;
    let step = points.positions.len().div_ceil(MOST_POINTS).max(1);
    let chosen = points.positions.iter().zip(&points.colours).step_by(step);
    let points: Vec<(DVec3, [f32; 3])> =
        chosen.map(|(position, &colour)| (place(DVec3::from_array(position.map(f64::from))), colour)).collect();
    let half = half_side(&eyes, points.iter().map(|(position, _)| *position));
    let (width, height) = (2.0 * SIDE, SIDE + 2.0 * TEXT);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" font-family=\"sans-serif\" \
         font-size=\"14\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    let mut line = |arguments: std::fmt::Arguments| writeln!(svg, "{arguments}").expect("memory takes any text");
    for (left, title, upwards) in [(0.0, "from above", 1), (SIDE, "from the side", 2)] {
        let at = |position: DVec3| {
            let [x, y] = [position[0], position[upwards]].map(|value| value.clamp(-half, half) / half);
            (left + 0.5 * SIDE * (1.0 + x), TEXT + 0.5 * SIDE * (1.0 - y))
        };
        line(format_args!("<text x=\"{}\" y=\"20\" text-anchor=\"middle\">{title}</text>", left + 0.5 * SIDE));
        for &(position, colour) in &points {
            let [r, g, b] = colour.map(|value| (255.0 * value.clamp(0.0, 1.0)) as u8);
            let (x, y) = at(position);
            line(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1\" fill=\"#{r:02x}{g:02x}{b:02x}\"/>"));
        }
        for (view, &eye) in report.views.iter().zip(&eyes) {
            let forward = map_from_world * view.camera.camera_from_world.rotation.row(2);
            let flagged = report.is_flagged(&view.name);
            let (colour, _) = COLOURS[match view.role {
                _ if flagged => 3,
                Split::Train => 0,
                Split::Test => 1,
                Split::Validation => 2,
            }];
            let ((x, y), (to_x, to_y)) = (at(eye), at(eye + LOOK * 2.0 * half * forward));
            line(format_args!("<path d=\"M{x:.1} {y:.1}L{to_x:.1} {to_y:.1}\" stroke=\"{colour}\"/>"));
            line(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{colour}\"/>"));
            if flagged {
                let name = view.name.replace('&', "&amp;").replace('<', "&lt;");
                line(format_args!("<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{colour}\">{name}</text>"));
            }
        }
    }
    let y = SIDE + 1.5 * TEXT;
    for (x, (colour, text)) in (0..).map(|column| 12 + 150 * column).zip(COLOURS) {
        line(format_args!("<circle cx=\"{x}\" cy=\"{y}\" r=\"4\" fill=\"{colour}\"/>"));
        line(format_args!("<text x=\"{}\" y=\"{}\">{text}</text>", x + 12, y + 5.0));
    }
    svg + "</svg>\n"
}

/// Turns the world so that z points up.
fn upright<'a>(cameras: impl Iterator<Item = &'a Camera>) -> DMat3 {
    let up = upwards(cameras).normalize_or(DVec3::Z);
    let right = up.any_orthonormal_vector();
    DMat3::from_cols(right, up.cross(right), up).transpose()
}

/// Half of the side of what is shown, world units.
fn half_side(eyes: &[DVec3], points: impl Iterator<Item = DVec3>) -> f64 {
    let most_of = |reaches: &mut dyn Iterator<Item = f64>| {
        let mut reaches: Vec<f64> = reaches.collect();
        reaches.sort_unstable_by(f64::total_cmp);
        reaches.get(reaches.len().saturating_sub(1) * 9 / 10).copied().unwrap_or(0.0)
    };
    let cameras = most_of(&mut eyes.iter().map(|eye| eye.abs().max_element()));
    let points = most_of(&mut points.map(|point| point.abs().max_element()));
    let side = ((1.0 + BEYOND) * cameras).max(points.min(FARTHEST * cameras));
    if side > 0.0 { side } else { points.max(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::Effort;
    use crate::check::tests::finding;
    use crate::fixtures::assert_says;
    use crate::{BuiltinOptions, builtin};

    #[test]
    fn both_pictures_have_all_cameras_upright_and_name_those_that_were_found() {
        let dataset = builtin(&BuiltinOptions { points: 50, ..BuiltinOptions::default() });
        let mut report = Report::of(&dataset, Effort::Quick).unwrap();
        report.findings = vec![finding("train_005")];
        let svg = svg(&dataset, &report);
        assert_says(&svg, &["<svg ", "from above", "from the side", "held out", "</svg>\n"]);
        assert_eq!(svg.matches("<circle").count(), 2 * (30 + 50) + 4);
        assert_eq!((svg.matches("train_005").count(), svg.matches("train_004").count()), (2, 0));
        // the cameras of the dome look down into the room
        let map_from_world = upright(report.views.iter().map(|view| &view.camera));
        let falls = |view: &super::super::ViewFacts| map_from_world * view.camera.camera_from_world.rotation.row(2);
        assert!(report.views.iter().all(|view| falls(view).z < -0.1));
    }

    #[test]
    fn a_camera_far_away_makes_nothing_small() {
        let side = |eyes: &[DVec3], point: f64| half_side(eyes, std::iter::once(DVec3::Y * point));
        let mut eyes = vec![DVec3::X; 20];
        assert_eq!(half_side(&eyes, std::iter::empty()), 1.3);
        eyes[3] = 900.0 * DVec3::X;
        assert_eq!([0.0, 2.0, 50.0].map(|point| side(&eyes, point)), [1.3, 2.0, 3.0]);
        assert_eq!([side(&[], 50.0), half_side(&[], std::iter::empty())], [50.0, 1.0]);
    }
}

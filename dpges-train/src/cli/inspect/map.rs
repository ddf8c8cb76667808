//! Cameras and points from above and from the side, as SVG.

use dpges_train::dataset::check::Role;
use dpges_train::dataset::check::map::{Map, MapCamera};
use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, ChartBuilder, Circle, Color, DrawingArea, DrawingAreaErrorKind, DrawingBackend, IntoDrawingArea, IntoFont,
    PathElement, RGBColor, SVGBackend, Text, WHITE,
};

use dpges_train::study::plot_font::{self, FAMILY};

/// Sizes, px: of a view, of its title, of its margin, of letters, of the legend.
const SIDE: i32 = 560;
const TITLE: u32 = 28;
const MARGIN: u32 = 8;
const LETTERS: i32 = 14;
const LEGEND: i32 = 28;
/// Length of the line along which a camera looks, relative to the side.
const LOOK: f64 = 0.04;
/// What is shown reaches beyond the cameras by this share of their size, or as far as most points do, but no farther than
/// this many times the cameras.
const BEYOND: f64 = 0.3;
const FARTHEST: f64 = 3.0;

const TRAIN: RGBColor = RGBColor(40, 110, 190);
const TEST: RGBColor = RGBColor(230, 140, 20);
const VALIDATION: RGBColor = RGBColor(120, 80, 170);
const MARK: RGBColor = RGBColor(220, 30, 30);

/// What is seen in one of the two pictures: its title, the axis to the right and the axis upwards.
const VIEWS: [(&str, [usize; 2]); 2] = [("from above", [0, 1]), ("from the side", [0, 2])];

/// Both views beside each other. What lies outside is drawn at the border.
///
/// # Errors
/// What cannot be drawn.
pub fn svg(map: &Map) -> Result<String, String> {
    plot_font::register()?;
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, (2 * SIDE as u32, (SIDE + LEGEND) as u32)).into_drawing_area();
        draw(map, &area).map_err(|error| error.to_string())?;
        area.present().map_err(|error| error.to_string())?;
    }
    Ok(text)
}

fn draw<B: DrawingBackend>(map: &Map, area: &DrawingArea<B, Shift>) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    area.fill(&WHITE)?;
    let letters = (FAMILY, LETTERS).into_font();
    let (views, legend) = area.split_vertically(SIDE);
    let (left, right) = views.split_horizontally(SIDE);
    let half = half_side(map);
    for ((title, axes), part) in VIEWS.into_iter().zip([left, right]) {
        let mut chart = ChartBuilder::on(&part)
            .caption(title, letters.clone())
            .margin(MARGIN)
            .margin_bottom(TITLE)
            .build_cartesian_2d(-half..half, -half..half)?;
        let at = |position: [f64; 3]| {
            let [x, y] = axes.map(|axis| position[axis].clamp(-half, half));
            (x, y)
        };
        chart.draw_series(map.points.iter().map(|point| {
            let [r, g, b] = point.colour.map(|value| (255.0 * value.clamp(0.0, 1.0)) as u8);
            Circle::new(at(point.position), 1, RGBColor(r, g, b).filled())
        }))?;
        for camera in &map.cameras {
            let colour = colour(camera);
            let eye = at(camera.position);
            let end: [f64; 3] =
                std::array::from_fn(|axis| camera.position[axis] + LOOK * 2.0 * half * camera.forward[axis]);
            chart.draw_series([PathElement::new(vec![eye, at(end)], colour)])?;
            chart.draw_series([Circle::new(eye, 3, colour.filled())])?;
            if camera.is_flagged {
                chart.draw_series([Text::new(camera.name.clone(), eye, letters.color(&MARK))])?;
            }
        }
    }
    let kinds = [(TRAIN, "training"), (TEST, "held out"), (VALIDATION, "validation"), (MARK, "something was found")];
    for (column, (colour, text)) in (0..).zip(kinds) {
        let (x, y) = (MARGIN as i32 + 4 + 150 * column, LEGEND / 2);
        legend.draw(&Circle::new((x, y), 4, colour.filled()))?;
        legend.draw(&Text::new(text, (x + 12, y - LETTERS / 2), letters.color(&BLACK)))?;
    }
    Ok(())
}

fn colour(camera: &MapCamera) -> RGBColor {
    match camera.role {
        _ if camera.is_flagged => MARK,
        Role::Train => TRAIN,
        Role::Test => TEST,
        Role::Validation => VALIDATION,
    }
}

/// Half the side of what is shown, world units: most cameras and most points, but one far away makes nothing small.
fn half_side(map: &Map) -> f64 {
    let reach = |position: &[f64; 3]| position.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let most_of = |mut reaches: Vec<f64>| {
        reaches.sort_unstable_by(f64::total_cmp);
        reaches.get(reaches.len().saturating_sub(1) * 9 / 10).copied().unwrap_or(0.0)
    };
    let cameras = most_of(map.cameras.iter().map(|camera| reach(&camera.position)).collect());
    let points = most_of(map.points.iter().map(|point| reach(&point.position)).collect());
    let side = ((1.0 + BEYOND) * cameras).max(points.min(FARTHEST * cameras));
    if side > 0.0 { side } else { points.max(1.0) }
}

#[cfg(test)]
mod tests {
    use dpges_train::dataset::check::map::MapPoint;

    use super::*;

    fn camera(name: &str, position: [f64; 3]) -> MapCamera {
        MapCamera {
            name: name.to_owned(),
            role: Role::Train,
            is_flagged: false,
            position,
            forward: position.map(|value| -value),
        }
    }

    #[test]
    fn both_views_have_all_cameras_and_name_those_that_were_found() {
        let ring = [[1.0, 0.0, 0.2], [0.0, 1.0, 0.2], [-1.0, 0.0, 0.2], [0.0, -1.0, 0.2]];
        let mut map = Map {
            cameras: ring.iter().zip(["a", "b", "c", "d"]).map(|(&position, name)| camera(name, position)).collect(),
            points: vec![MapPoint { position: [0.0, 0.1, 0.0], colour: [1.0, 0.5, 0.0] }],
        };
        map.cameras[2].role = Role::Test;
        map.cameras.push(camera("stray", [900.0, 0.0, 0.0]));
        map.cameras[4].is_flagged = true;
        let svg = svg(&map).unwrap();
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"), "{svg}");
        for part in ["from above", "from the side", "held out"] {
            assert!(svg.contains(part), "{part}: {svg}");
        }
        // in both views five cameras and a point, and four in the legend
        assert_eq!(svg.matches("<circle").count(), 2 * 6 + 4);
        assert_eq!(svg.matches("stray").count(), 2);
        assert!(svg.contains("#FF7F00"), "the point has its colour: {svg}");
    }

    #[test]
    fn a_camera_far_away_makes_nothing_small() {
        let mut map = Map { cameras: (0..20).map(|_| camera("a", [1.0, 0.0, 0.0])).collect(), points: Vec::new() };
        assert_eq!(half_side(&map), 1.3);
        map.cameras[3].position = [900.0, 0.0, 0.0];
        assert_eq!(half_side(&map), 1.3);
        map.points = vec![MapPoint { position: [0.0, 2.0, 0.0], colour: [0.0; 3] }];
        assert_eq!(half_side(&map), 2.0);
        map.points[0].position = [0.0, 50.0, 0.0];
        assert_eq!(half_side(&map), 3.0);
        map.cameras.clear();
        assert_eq!(half_side(&map), 50.0);
        map.points.clear();
        assert_eq!(half_side(&map), 1.0);
    }
}

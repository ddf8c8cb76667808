//! PSNR against a cost, as SVG and as PNG: every point, and a line through those that no other beats.

use dpges_render::Rgb8Image;
use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, BitMapBackend, ChartBuilder, Circle, Color, DrawingArea, DrawingAreaErrorKind, DrawingBackend,
    IntoDrawingArea, IntoFont, PathElement, RGBColor, SVGBackend, Text, WHITE,
};

use super::super::series::statistics::Spread;
use super::pareto::frontier;
use super::point::{Kind, Point};
use super::store::groups;
use crate::study::plot_font::{self, FAMILY};

/// Sizes, px: of the picture, of the column of names at its right, of the margin, of letters, between two names.
const WIDTH: i32 = 1100;
const HEIGHT: i32 = 620;
const NAMES: i32 = 330;
const MARGIN: i32 = 14;
const LETTERS: i32 = 15;
const SPACING: i32 = 21;
/// Half the length of the ends of a bar that shows a spread, px; radius of a point, px.
const CAP: i32 = 4;
const RADIUS: i32 = 4;

const FRONTIER: RGBColor = RGBColor(200, 80, 20);
const RENDERING: RGBColor = RGBColor(70, 130, 190);
const TRAINING: RGBColor = RGBColor(60, 150, 80);
const LEADER: RGBColor = RGBColor(190, 190, 190);

/// What stands on the horizontal axis.
pub struct Axis {
    /// Of its files: `trade_NAME.svg`.
    pub name: &'static str,
    pub title: &'static str,
    /// `None` where a point does not have it.
    pub cost: fn(&Point) -> Option<f64>,
}

/// The four plots, of which those are made that have points.
pub const AXES: [Axis; 4] = [
    Axis { name: "frame_time", title: "median frame time, ms", cost: |point| Some(point.frame_ms) },
    Axis { name: "bytes", title: "scene file, MB", cost: |point| Some(point.bytes as f64 / 1e6) },
    Axis { name: "training_time", title: "training time, s", cost: |point| point.training_seconds },
    Axis {
        name: "training_memory",
        title: "largest memory of the process in training, MB",
        cost: |point| point.training_peak_bytes.map(|bytes| bytes as f64 / 1e6),
    },
];

/// A label's mean over its seeds.
#[derive(Clone, Debug, PartialEq)]
struct Mark {
    label: String,
    kind: Kind,
    cost: Spread,
    psnr: Spread,
}

/// One of the plots.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    title: &'static str,
    marks: Vec<Mark>,
    /// Indices of the marks on the frontier, by ascending cost.
    frontier: Vec<usize>,
}

impl Plot {
    /// `None` if no point has the cost. Points with numbers that are not finite are left out.
    pub fn new(points: &[Point], axis: &Axis) -> Option<Self> {
        let mark = |group: &super::store::Group| {
            let costs: Option<Vec<f64>> = group.points.iter().map(|point| (axis.cost)(point)).collect();
            let psnr: Vec<f64> = group.points.iter().map(|point| point.psnr).collect();
            let (cost, psnr) = (Spread::of(&costs?), Spread::of(&psnr));
            let is_finite = cost.mean.is_finite() && psnr.mean.is_finite();
            is_finite.then(|| Mark { label: group.label.to_owned(), kind: group.points[0].kind, cost, psnr })
        };
        let marks: Vec<Mark> = groups(points).iter().filter_map(mark).collect();
        let pairs: Vec<(f64, f64)> = marks.iter().map(|mark| (mark.cost.mean, mark.psnr.mean)).collect();
        let frontier = frontier(&pairs).expect("they are finite");
        (!marks.is_empty()).then_some(Self { title: axis.title, marks, frontier })
    }

    /// The plot as SVG.
    ///
    /// # Errors
    /// What cannot be drawn.
    pub fn svg(&self) -> Result<String, String> {
        let mut text = String::new();
        self.draw(&SVGBackend::with_string(&mut text, (WIDTH as u32, HEIGHT as u32)).into_drawing_area())?;
        Ok(text)
    }

    /// The plot as a picture.
    ///
    /// # Errors
    /// What cannot be drawn.
    pub fn picture(&self) -> Result<Rgb8Image, String> {
        let (width, height) = (WIDTH as usize, HEIGHT as usize);
        let mut bytes = vec![0; 3 * width * height];
        self.draw(&BitMapBackend::with_buffer(&mut bytes, (WIDTH as u32, HEIGHT as u32)).into_drawing_area())?;
        Ok(Rgb8Image { width, height, bytes })
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<(), String> {
        plot_font::register()?;
        self.draw_on(area).map_err(|error| error.to_string())?;
        area.present().map_err(|error| error.to_string())
    }

    fn draw_on<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        area.fill(&WHITE)?;
        let letters = (FAMILY, LETTERS).into_font();
        let (left, _) = area.split_horizontally(WIDTH - NAMES);
        let [costs, psnrs] = [self.range(|mark| mark.cost), self.range(|mark| mark.psnr)];
        let mut chart = ChartBuilder::on(&left)
            .margin(MARGIN)
            .x_label_area_size(48)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..costs.1, psnrs.0..psnrs.1)?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .label_style(letters.clone())
            .axis_desc_style(letters.clone())
            .x_desc(self.title)
            .y_desc("PSNR, dB")
            .draw()?;
        let at = |index: &usize| (self.marks[*index].cost.mean, self.marks[*index].psnr.mean);
        let line: Vec<(f64, f64)> = self.frontier.iter().map(at).collect();
        chart.draw_series([PathElement::new(line, FRONTIER.stroke_width(2))])?;
        for (index, mark) in self.marks.iter().enumerate() {
            let on_frontier = self.frontier.contains(&index);
            let colour = match mark.kind {
                _ if on_frontier => FRONTIER,
                Kind::Rendering => RENDERING,
                Kind::Training => TRAINING,
            };
            let (x, y) = (mark.cost.mean, mark.psnr.mean);
            chart.draw_series([Circle::new((x, y), RADIUS, colour.filled())])?;
            let pixel = |x: f64, y: f64| chart.backend_coord(&(x, y));
            if let Some(by) = mark.psnr.deviation {
                let [low, high] = [pixel(x, y - by), pixel(x, y + by)];
                area.draw(&PathElement::new(vec![low, high], colour))?;
                for (x, y) in [low, high] {
                    area.draw(&PathElement::new(vec![(x - CAP, y), (x + CAP, y)], colour))?;
                }
            }
            if let Some(by) = mark.cost.deviation {
                let [low, high] = [pixel((x - by).max(0.0), y), pixel(x + by, y)];
                area.draw(&PathElement::new(vec![low, high], colour))?;
                for (x, y) in [low, high] {
                    area.draw(&PathElement::new(vec![(x, y - CAP), (x, y + CAP)], colour))?;
                }
            }
        }
        let places: Vec<(i32, i32)> = self.frontier.iter().map(|index| chart.backend_coord(&at(index))).collect();
        let rows = spaced(&places.iter().map(|place| place.1).collect::<Vec<_>>(), SPACING, HEIGHT);
        let column = WIDTH - NAMES + MARGIN;
        for ((index, place), row) in self.frontier.iter().zip(&places).zip(rows) {
            let (from, to) = ((place.0 + RADIUS + 2, place.1), (column - 4, row));
            area.draw(&PathElement::new(vec![from, to], LEADER))?;
            let text = self.marks[*index].label.clone();
            area.draw(&Text::new(text, (column, row - LETTERS / 2), letters.color(&BLACK)))?;
        }
        let legend =
            [(FRONTIER, "no other point beats it"), (RENDERING, "other rendering"), (TRAINING, "other training")];
        let top = HEIGHT - SPACING * legend.len() as i32 - 4;
        for (row, (colour, text)) in legend.into_iter().enumerate() {
            let y = top + SPACING * row as i32;
            area.draw(&Circle::new((column + RADIUS, y), RADIUS, colour.filled()))?;
            area.draw(&Text::new(text, (column + 16, y - LETTERS / 2), letters.color(&BLACK)))?;
        }
        Ok(())
    }

    /// From the least to the largest value with its deviation, and a little more.
    fn range(&self, of: impl Fn(&Mark) -> Spread) -> (f64, f64) {
        let ends = |mark: &Mark| {
            let Spread { mean, deviation } = of(mark);
            [mean - deviation.unwrap_or(0.0), mean + deviation.unwrap_or(0.0)]
        };
        let all = self.marks.iter().flat_map(ends);
        let (least, most) = all.fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
        let more = 0.06 * (most - least).max(1e-3 * most.abs()).max(1e-9);
        (least - more, most + more)
    }
}

/// Rows near `wanted` px, at least `spacing` apart in the order of `wanted`, within `height` less the legend where there
/// is room.
fn spaced(wanted: &[i32], spacing: i32, height: i32) -> Vec<i32> {
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    order.sort_by_key(|&index| wanted[index]);
    let bottom = height - 4 * spacing;
    let mut rows = vec![0; wanted.len()];
    let mut next = spacing / 2;
    for (rank, &index) in order.iter().enumerate() {
        let others_below = (order.len() - 1 - rank) as i32;
        let row = wanted[index].min(bottom - others_below * spacing).max(next);
        rows[index] = row;
        next = row + spacing;
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::super::point::tests::point;
    use super::*;

    fn points() -> Vec<Point> {
        let mut points = vec![
            point("as trained", 30.0, 10.0, 4_000_000),
            point("layers=1", 29.0, 5.0, 4_000_000),
            point("detail=0", 28.0, 9.0, 1_000_000),
        ];
        for (seed, psnr) in [(0, 26.0), (1, 27.0)] {
            let mut trained = point("budget=half", psnr, 4.0, 2_000_000);
            (trained.kind, trained.seed, trained.training_seconds) = (Kind::Training, Some(seed), Some(60.0));
            points.push(trained);
        }
        points
    }

    #[test]
    fn a_plot_has_every_label_once_and_knows_its_frontier() {
        let plot = Plot::new(&points(), &AXES[0]).unwrap();
        let labels: Vec<&str> = plot.marks.iter().map(|mark| mark.label.as_str()).collect();
        assert_eq!(labels, ["as trained", "layers=1", "detail=0", "budget=half"]);
        assert_eq!(plot.frontier, [3, 1, 0]);
        assert_eq!((plot.marks[3].psnr.mean, plot.marks[3].psnr.deviation), (26.5, Some(0.5f64.sqrt())));
        let of_training = Plot::new(&points(), &AXES[2]).unwrap();
        assert_eq!(of_training.marks.len(), 1);
        assert_eq!(Plot::new(&points(), &AXES[3]), None);
        assert_eq!(Plot::new(&[point("a", f64::NAN, 1.0, 1)], &AXES[0]), None);
    }

    #[test]
    fn both_files_show_the_points_and_the_names_of_the_frontier() {
        let plot = Plot::new(&points(), &AXES[0]).unwrap();
        let svg = plot.svg().unwrap();
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"), "{svg}");
        for part in ["as trained", "layers=1", "budget=half", "median frame time, ms", "PSNR, dB"] {
            assert!(svg.contains(part), "{part}: {svg}");
        }
        assert!(!svg.contains("detail=0"), "it is off the frontier");
        assert_eq!(svg.matches("<circle").count(), 4 + 3);
        let picture = plot.picture().unwrap();
        assert_eq!((picture.width, picture.height), (1100, 620));
        let count = |colour: RGBColor| {
            let bytes = [colour.0, colour.1, colour.2];
            picture.bytes.as_chunks::<3>().0.iter().filter(|&&pixel| pixel == bytes).count()
        };
        assert!(count(WHITE) > 400_000 && count(FRONTIER) > 200 && count(RENDERING) > 40);
        let in_names = |x: usize| x > 780 && x < 900;
        let dark = (0..1100 * 620).filter(|i| in_names(i % 1100) && picture.bytes[3 * i] < 100).count();
        assert!(dark > 100, "names have letters: {dark}");
    }

    #[test]
    fn one_point_and_equal_points_are_drawn() {
        for count in [1, 3] {
            let equal = vec![point("as trained", 30.0, 10.0, 0); count];
            Plot::new(&equal, &AXES[0]).unwrap().svg().unwrap();
            Plot::new(&equal, &AXES[1]).unwrap().picture().unwrap();
        }
    }

    #[test]
    fn names_do_not_overlap_and_stay_near() {
        assert_eq!(spaced(&[100, 200], 20, 600), [100, 200]);
        assert_eq!(spaced(&[100, 105, 101], 20, 600), [100, 140, 120]);
        assert_eq!(spaced(&[590, 595], 20, 600), [500, 520]);
        let many = spaced(&[300; 40], 20, 600);
        assert!(many.windows(2).all(|pair| pair[1] - pair[0] == 20), "{many:?}");
    }
}

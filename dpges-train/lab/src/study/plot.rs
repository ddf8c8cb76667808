//! PSNR against a cost, as SVG and as PNG: every label, and a line through those that no other beats.

use dpges_render::Rgb8Image;
use plotters::coord::Shift;
use plotters::prelude::{
    BLACK, BitMapBackend, ChartBuilder, Circle, Color, DrawingArea, DrawingAreaErrorKind, DrawingBackend,
    IntoDrawingArea, IntoFont, PathElement, RGBColor, SVGBackend, Text, WHITE,
};

use super::measure::Measure;
use super::plot_font::{self, FAMILY};
use super::row::{Group, Row, groups};
use super::spread::Spread;
use super::store::on_frontier;
use super::{Result, StudyError};

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
/// Most labels whose names are all shown; of more those on the frontier are.
const NAMED: usize = 20;

const FRONTIER: RGBColor = RGBColor(200, 80, 20);
const DRAWN: RGBColor = RGBColor(70, 130, 190);
const TRAINED: RGBColor = RGBColor(60, 150, 80);
const LEADER: RGBColor = RGBColor(190, 190, 190);

/// A label's mean over its seeds.
#[derive(Clone, Debug, PartialEq)]
struct Mark {
    label: String,
    /// Whether runs made it.
    is_trained: bool,
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
    /// Against `cost`, of the labels that have it in all rows; `None` if there is none, or no plot of that measure.
    pub fn new(rows: &[Row], cost: &Measure) -> Option<Self> {
        let (_, title) = cost.plot?;
        let mut groups = groups(rows);
        groups.retain(|group| group.spread(cost.key).is_some() && group.spread("psnr").is_some());
        let mark = |group: &Group| {
            let (label, is_trained) = (group.label.to_owned(), group.rows[0].seed.is_some());
            Some(Mark { label, is_trained, cost: cost.scaled(group.spread(cost.key)?), psnr: group.spread("psnr")? })
        };
        let marks: Vec<Mark> = groups.iter().filter_map(mark).collect();
        (!marks.is_empty()).then(|| Self { title, marks, frontier: on_frontier(&groups, cost.key) })
    }

    /// The plot as SVG.
    ///
    /// # Errors
    /// The drawing error.
    pub fn svg(&self) -> Result<String> {
        let mut text = String::new();
        self.draw(&SVGBackend::with_string(&mut text, (WIDTH as u32, HEIGHT as u32)).into_drawing_area())?;
        Ok(text)
    }

    /// The plot as a picture.
    ///
    /// # Errors
    /// The drawing error.
    pub fn picture(&self) -> Result<Rgb8Image> {
        let (width, height) = (WIDTH as usize, HEIGHT as usize);
        let mut bytes = vec![0; 3 * width * height];
        self.draw(&BitMapBackend::with_buffer(&mut bytes, (WIDTH as u32, HEIGHT as u32)).into_drawing_area())?;
        Ok(Rgb8Image { width, height, bytes })
    }

    fn draw<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Result<()> {
        plot_font::register().map_err(StudyError::Plot)?;
        self.draw_on(area).and_then(|()| area.present()).map_err(|error| StudyError::Plot(error.to_string()))
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
            let colour = self.colour(index);
            let (x, y) = (mark.cost.mean, mark.psnr.mean);
            chart.draw_series([Circle::new((x, y), RADIUS, colour.filled())])?;
            let pixel = |x: f64, y: f64| chart.backend_coord(&(x, y));
            let bars = [
                mark.psnr.deviation.map(|by| ([pixel(x, y - by), pixel(x, y + by)], (CAP, 0))),
                mark.cost.deviation.map(|by| ([pixel((x - by).max(0.0), y), pixel(x + by, y)], (0, CAP))),
            ];
            for (ends, (across, along)) in bars.into_iter().flatten() {
                area.draw(&PathElement::new(ends.to_vec(), colour))?;
                for (x, y) in ends {
                    let cap = vec![(x - across, y - along), (x + across, y + along)];
                    area.draw(&PathElement::new(cap, colour))?;
                }
            }
        }
        let named = self.named();
        let places: Vec<(i32, i32)> = named.iter().map(|index| chart.backend_coord(&at(index))).collect();
        let rows = spaced(&places.iter().map(|place| place.1).collect::<Vec<_>>(), SPACING, HEIGHT);
        let column = WIDTH - NAMES + MARGIN;
        for ((index, place), row) in named.iter().zip(&places).zip(rows) {
            let (from, to) = ((place.0 + RADIUS + 2, place.1), (column - 4, row));
            area.draw(&PathElement::new(vec![from, to], LEADER))?;
            let text = self.marks[*index].label.clone();
            area.draw(&Text::new(text, (column, row - LETTERS / 2), letters.color(&BLACK)))?;
        }
        let all = [(FRONTIER, "nothing else beats it"), (DRAWN, "drawn otherwise"), (TRAINED, "trained otherwise")];
        let is_there = |colour: RGBColor| (0..self.marks.len()).any(|index| self.colour(index) == colour);
        let legend: Vec<_> = all.into_iter().filter(|(colour, _)| is_there(*colour)).collect();
        let top = HEIGHT - SPACING * legend.len() as i32 - 4;
        for (row, (colour, text)) in legend.into_iter().enumerate() {
            let y = top + SPACING * row as i32;
            area.draw(&Circle::new((column + RADIUS, y), RADIUS, colour.filled()))?;
            area.draw(&Text::new(text, (column + 16, y - LETTERS / 2), letters.color(&BLACK)))?;
        }
        Ok(())
    }

    fn colour(&self, index: usize) -> RGBColor {
        match self.marks[index].is_trained {
            _ if self.frontier.contains(&index) => FRONTIER,
            true => TRAINED,
            false => DRAWN,
        }
    }

    /// Indices of the marks whose names are shown.
    fn named(&self) -> Vec<usize> {
        if self.marks.len() <= NAMED { (0..self.marks.len()).collect() } else { self.frontier.clone() }
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
    use super::super::measure::measure;
    use super::super::row::tests::drawn;
    use super::*;

    fn rows() -> Vec<Row> {
        let mut rows = vec![
            drawn("as trained", 30.0, 10.0, 4_000_000),
            drawn("layers=1", 29.0, 5.0, 4_000_000),
            drawn("detail=0", 28.0, 9.0, 1_000_000),
        ];
        for (seed, psnr) in [(0, 26.0), (1, 27.0)] {
            let mut trained = drawn("budget-half", psnr, 4.0, 2_000_000);
            trained.seed = Some(seed);
            trained.set("training_seconds", Some(60.0));
            rows.push(trained);
        }
        rows
    }

    #[test]
    fn a_plot_has_every_label_once_and_knows_its_frontier() {
        let plot = Plot::new(&rows(), measure("frame_ms")).unwrap();
        let labels: Vec<&str> = plot.marks.iter().map(|mark| mark.label.as_str()).collect();
        assert_eq!(labels, ["as trained", "layers=1", "detail=0", "budget-half"]);
        assert_eq!(plot.frontier, [3, 1, 0]);
        assert_eq!((plot.marks[3].psnr.mean, plot.marks[3].psnr.deviation), (26.5, Some(0.5f64.sqrt())));
        assert_eq!(Plot::new(&rows(), measure("bytes")).unwrap().marks[2].cost.mean, 1.0, "MB");
        assert_eq!(Plot::new(&rows(), measure("training_seconds")).unwrap().marks.len(), 1);
        assert_eq!(Plot::new(&rows(), measure("training_peak_bytes")), None);
    }

    #[test]
    fn both_files_show_the_points_and_their_names() {
        let plot = Plot::new(&rows(), measure("frame_ms")).unwrap();
        let svg = plot.svg().unwrap();
        assert!(svg.starts_with("<svg ") && svg.trim_end().ends_with("</svg>"), "{svg}");
        let named = ["as trained", "layers=1", "detail=0", "budget-half", "drawn otherwise"];
        for part in named.iter().chain(&["median frame time, ms", "PSNR, dB"]) {
            assert!(svg.contains(part), "{part}: {svg}");
        }
        assert!(!svg.contains("trained otherwise"), "the only run is on the frontier");
        assert_eq!(svg.matches("<circle").count(), 4 + 2);
        let picture = plot.picture().unwrap();
        assert_eq!((picture.width, picture.height), (1100, 620));
        let count = |colour: RGBColor| {
            let bytes = [colour.0, colour.1, colour.2];
            picture.bytes.as_chunks::<3>().0.iter().filter(|&&pixel| pixel == bytes).count()
        };
        assert!(count(WHITE) > 400_000 && count(FRONTIER) > 200 && count(DRAWN) > 40);
        let in_names = |x: usize| x > 780 && x < 900;
        let dark = (0..1100 * 620).filter(|i| in_names(i % 1100) && picture.bytes[3 * i] < 100).count();
        assert!(dark > 100, "names have letters: {dark}");
    }

    #[test]
    fn of_many_labels_those_on_the_frontier_are_named() {
        let row = |index: u32| drawn(&format!("row {index}"), f64::from(index.min(3)), f64::from(index + 1), 1);
        let svg = Plot::new(&(0..30).map(row).collect::<Vec<_>>(), measure("frame_ms")).unwrap().svg().unwrap();
        assert!(svg.contains("row 3") && !svg.contains("row 4"), "{svg}");
    }

    #[test]
    fn one_point_and_equal_points_are_drawn() {
        for count in [1, 3] {
            let equal: Vec<Row> = (0..count).map(|index| drawn(&format!("row {index}"), 30.0, 10.0, 0)).collect();
            Plot::new(&equal, measure("frame_ms")).unwrap().svg().unwrap();
            Plot::new(&equal, measure("bytes")).unwrap().picture().unwrap();
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

//! A plan as files: its numbers, and points, blocks and cameras from above.

use std::path::Path;

use dpges_core::scene::atomic::make_folder;
use dpges_render::Rgb8Image;
use dpges_train::dataset::{Dataset, View};
use dpges_train::eval::pictures::save_png;
use dpges_train::run::folder::write_json;
use plotters::prelude::{
    BLACK, BitMapBackend, ChartBuilder, Circle, Color, DrawingAreaErrorKind, DrawingBackend, HSLColor, IntoDrawingArea,
    IntoFont, PathElement, RGBColor, Rectangle, Text, WHITE,
};

use super::plan::{Plan, PlannedBlock};
use super::split::percentiles;
use super::{BlocksError, Result};
use crate::study::plot_font::{self, FAMILY};

/// Longest side, px.
const LONGEST: f32 = 1000.0;
const LETTERS: i32 = 16;
/// Width of a label with points and views, and of a number alone, px.
const LABEL: i32 = 200;
const NUMBER: i32 = 36;
/// Largest radius of a camera, px.
const CAMERA: f64 = 4.0;
/// Points and cameras that are drawn, at most.
const SHOWN: usize = 20_000;
/// Share of the points and cameras beyond the picture at each side, and the margin relative to the rest.
const BEYOND: f32 = 0.01;
const MARGIN: f32 = 0.05;
const POINT: RGBColor = RGBColor(200, 200, 200);
const SHARED: RGBColor = RGBColor(60, 60, 60);

type Drawn<T, B> = std::result::Result<T, DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

/// The axes of the world that run to the right and up in the picture, and what is seen of them, world units.
struct Ground {
    axes: [usize; 2],
    ranges: [[f32; 2]; 2],
}

impl Ground {
    /// Seen along the axis in which points and cameras have the least extent.
    fn new(points: &[[f32; 3]], cameras: &[[f32; 3]]) -> Self {
        let range = |axis: usize| {
            let of =
                |positions: &[[f32; 3]]| percentiles(positions.iter().map(|position| position[axis]).collect(), BEYOND);
            let [points, cameras] = [of(points), of(cameras)];
            [points[0].min(cameras[0]), points[1].max(cameras[1])]
        };
        let all = [0, 1, 2].map(range);
        let extent = |axis: &usize| all[*axis][1] - all[*axis][0];
        let least = (0..3).min_by(|a, b| extent(a).total_cmp(&extent(b))).unwrap_or(2);
        let axes = [[1, 2], [0, 2], [0, 1]][least];
        let longest = axes.iter().map(extent).fold(1e-6, f32::max);
        let wider = |axis: usize| [all[axis][0] - MARGIN * longest, all[axis][1] + MARGIN * longest];
        Self { axes, ranges: axes.map(wider) }
    }

    fn of(&self, position: [f32; 3]) -> (f32, f32) {
        (position[self.axes[0]], position[self.axes[1]])
    }

    /// Width and height of the picture, px.
    fn size(&self) -> [u32; 2] {
        let extents = self.ranges.map(|[least, most]| most - least);
        let longest = extents[0].max(extents[1]);
        extents.map(|extent| ((LONGEST * extent / longest) as u32).max(200))
    }

    /// The corners of a box, whose open sides end with the picture.
    fn corners(&self, [min, max]: [[Option<f32>; 3]; 2]) -> [(f32, f32); 2] {
        let [[left, right], [bottom, top]] = self.ranges;
        let [x, y] = self.axes;
        [(min[x].unwrap_or(left), min[y].unwrap_or(bottom)), (max[x].unwrap_or(right), max[y].unwrap_or(top))]
    }
}

impl Plan {
    /// Writes `plan.json` and `plan.png` to `folder`.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn save(&self, folder: &Path, dataset: &Dataset) -> Result<()> {
        make_folder(folder)?;
        save_png(&draw(self, dataset)?, &folder.join("plan.png"))?;
        Ok(write_json(&Self::path(folder), self)?)
    }
}

/// The picture: points grey; every block a rectangle in a colour of its own, with its number and, where there is room, its points
/// and its cameras, and grown in a thinner line; cameras in the colour of their block, or dark if they have several.
fn draw(plan: &Plan, dataset: &Dataset) -> Result<Rgb8Image> {
    plot_font::register().map_err(BlocksError::Picture)?;
    let views: Vec<&View> = dataset.train.iter().chain(&dataset.validation).chain(&dataset.test).collect();
    let thinned = |count: usize| count.div_ceil(SHOWN).max(1);
    let points = &dataset.points.positions;
    let points: Vec<[f32; 3]> = points.iter().step_by(thinned(points.len())).copied().collect();
    let centres: Vec<[f32; 3]> = views.iter().map(|view| view.camera.centre().as_vec3().to_array()).collect();
    let ground = Ground::new(&points, &centres);
    let cameras: Vec<(&str, [f32; 3])> =
        views.iter().zip(&centres).step_by(thinned(views.len())).map(|(view, &centre)| (&*view.name, centre)).collect();
    let [width, height] = ground.size();
    let mut bytes = vec![0; 3 * width as usize * height as usize];
    draw_on(BitMapBackend::with_buffer(&mut bytes, (width, height)), &ground, plan, &points, &cameras)
        .map_err(|error| BlocksError::Picture(error.to_string()))?;
    Ok(Rgb8Image { width: width as usize, height: height as usize, bytes })
}

fn draw_on<B: DrawingBackend>(
    backend: B,
    ground: &Ground,
    plan: &Plan,
    points: &[[f32; 3]],
    cameras: &[(&str, [f32; 3])],
) -> Drawn<(), B> {
    let area = backend.into_drawing_area();
    area.fill(&WHITE)?;
    let [across, up] = ground.ranges.map(|[least, most]| least..most);
    let mut chart = ChartBuilder::on(&area).build_cartesian_2d(across, up)?;
    let dot = |position: &[f32; 3]| Circle::new(ground.of(*position), 1, POINT.filled());
    chart.draw_series(points.iter().map(dot))?;
    let colour = |block: usize| HSLColor((block as f64 * 0.618).fract(), 0.7, 0.42);
    let mut of_cameras = std::collections::HashMap::<&str, Vec<usize>>::new();
    for (number, PlannedBlock { cameras, .. }) in plan.blocks.iter().enumerate() {
        cameras.iter().for_each(|name| of_cameras.entry(name).or_default().push(number));
    }
    for (number, block) in plan.blocks.iter().enumerate() {
        let [core, grown] = [block.core, block.grown].map(|bounds| ground.corners([bounds.min, bounds.max]));
        chart.draw_series([Rectangle::new(core, colour(number).stroke_width(3))])?;
        chart.draw_series([Rectangle::new(grown, colour(number).stroke_width(1))])?;
    }
    let [width, height] = ground.size().map(f64::from);
    // a quarter of the distance to the next one
    let radius = (0.25 * (width * height / cameras.len().max(1) as f64).sqrt()).clamp(1.0, CAMERA) as i32;
    chart.draw_series(cameras.iter().map(|(name, centre)| {
        let place = ground.of(*centre);
        match of_cameras.get(name).map(Vec::as_slice) {
            Some(&[only]) => Circle::new(place, radius, colour(only).filled()),
            _ => Circle::new(place, radius, SHARED.filled()),
        }
    }))?;
    let letters = (FAMILY, LETTERS).into_font().color(&BLACK);
    for (number, block) in plan.blocks.iter().enumerate() {
        let [(left, bottom), (right, top)] = ground.corners([block.core.min, block.core.max]);
        let [(from, _), (to, _)] = [(left, bottom), (right, top)].map(|corner| chart.backend_coord(&corner));
        let (x, y) = chart.backend_coord(&(0.5 * (left + right), 0.5 * (bottom + top)));
        let (text, width) = if to - from < LABEL {
            (number.to_string(), NUMBER)
        } else {
            (format!("{number}: {} points, {} views", block.points, block.cameras.len()), LABEL)
        };
        let start = x - width / 2;
        area.draw(&PathElement::new(
            vec![(start, y), (start + width, y)],
            WHITE.mix(0.7).stroke_width(LETTERS as u32 + 4),
        ))?;
        area.draw(&Text::new(text, (start + 4, y - LETTERS / 2), letters.clone()))?;
    }
    area.present()
}

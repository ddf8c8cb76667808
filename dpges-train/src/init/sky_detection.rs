//! Sky in the photographs: pixels above the scene that no point of the dataset explains, or of those about which views agree
//! if it has none.
//!
//! A cell of a photograph is *open sky* if no point of the dataset projects into it, at whatever depth, if such cells
//! connect it with the upper border, and if it lies above the horizon. White walls and close photographs of one surface
//! have few points as well, but points that other views found project into them, or they lie below the horizon.

use std::borrow::Cow;
use std::sync::OnceLock;

use dpges_core::Result;
use dpges_core::camera::Camera;
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::{FEW_POINTS, agreed_points};
use crate::dataset::{Dataset, Picture, sampled, upwards};

/// Points that project into a cell of a view, on average: a cell without any is no accident.
const POINTS_PER_CELL: f64 = 64.0;

/// The open sky of the training views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenSky {
    /// Share of all pixels that count, 0 to 1.
    pub share: f64,
    /// Mean colour, display-referred; `None` without open sky.
    pub colour: Option<[f64; 3]>,
}

/// Largest difference of a channel between the sky and the median of the open sky of a view. Leaves and roofs in open cells
/// differ by more.
const OF_THE_SKY: f32 = 0.15;

/// The open sky of the training views of `dataset`, of a sample of many; none where no point is known.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn open_sky(dataset: &Dataset) -> Result<OpenSky> {
    let (up, points) = (upwards(dataset.train.iter().map(|view| &view.camera)), points_of(dataset)?);
    // numbers of pixels that count and of open ones, and the sums of their colours
    let of_view = |index: usize| -> Result<[f64; 5]> {
        let view = &dataset.train[index];
        let (picture, open) = (view.picture()?, open_cells(&view.camera, &points, up));
        let (pixels, mut colours) = (open.pixels(&picture), [0.0; 3]);
        for &pixel in &pixels {
            colours.iter_mut().zip(picture.colour(pixel)).for_each(|(sum, channel)| *sum += f64::from(channel));
        }
        let [red, green, blue] = colours;
        Ok([(picture.area() - picture.ignored_pixels()) as f64, pixels.len() as f64, red, green, blue])
    };
    let sample: Vec<usize> = sampled(dataset.train.len()).collect();
    let sums: Vec<[f64; 5]> = sample.into_par_iter().map(of_view).collect::<Result<_>>()?;
    let add = |sum: [f64; 5], view: [f64; 5]| std::array::from_fn(|at| sum[at] + view[at]);
    let [counted, open, colours @ ..] = sums.into_iter().fold([0.0; 5], add);
    Ok(OpenSky { share: open / counted.max(1.0), colour: (open > 0.0).then(|| colours.map(|sum| sum / open)) })
}

/// The same at every call.
fn points_of(dataset: &Dataset) -> Result<Cow<'_, [[f32; 3]]>> {
    if !dataset.points.positions.is_empty() {
        return Ok(Cow::Borrowed(&dataset.points.positions));
    }
    agreed_points(dataset, FEW_POINTS, &mut ChaCha8Rng::seed_from_u64(0)).map(|points| Cow::Owned(points.positions))
}

/// The sky of a view: pixels of its open sky that have about the colour that most of it has in this view.
#[derive(Clone, Debug)]
pub struct ViewSky {
    open: OpenCells,
    /// Median of each channel.
    colour: [f32; 3],
}

impl ViewSky {
    /// `None` if nothing in the `picture` is open sky.
    fn new(picture: &Picture, open: OpenCells) -> Option<Self> {
        let pixels = open.pixels(picture);
        if pixels.is_empty() {
            return None;
        }
        let colour = std::array::from_fn(|channel| {
            let mut values: Vec<f32> = pixels.iter().map(|&pixel| picture.colour(pixel)[channel]).collect();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f32::total_cmp).1
        });
        let sky = Self { open, colour };
        pixels.iter().any(|&pixel| sky.has_colour_of(picture, pixel)).then_some(sky)
    }

    fn has_colour_of(&self, picture: &Picture, pixel: usize) -> bool {
        picture.colour(pixel).iter().zip(self.colour).all(|(colour, sky)| (colour - sky).abs() <= OF_THE_SKY)
    }

    /// The pixels of the `picture` of this view that count and show nothing but sky.
    pub fn pixels(&self, picture: &Picture) -> Vec<usize> {
        let mut pixels = self.open.pixels(picture);
        pixels.retain(|&pixel| self.has_colour_of(picture, pixel));
        pixels
    }
}

/// The sky of each training view, which is found when it is first asked for.
#[derive(Debug)]
pub struct Skies {
    cameras: Vec<Camera>,
    points: Vec<[f32; 3]>,
    up: DVec3,
    /// `None` for views that show none.
    found: Vec<OnceLock<Option<ViewSky>>>,
}

impl Skies {
    /// Skies of the training views of `dataset`.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if a photograph cannot be read again.
    pub fn new(dataset: &Dataset) -> Result<Self> {
        let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
        Ok(Self {
            up: upwards(cameras.iter()),
            points: points_of(dataset)?.into_owned(),
            found: cameras.iter().map(|_| OnceLock::new()).collect(),
            cameras,
        })
    }

    /// The sky of the training view with index `index`, whose picture is `picture`; `None` if it shows none.
    pub fn of(&self, index: usize, picture: &Picture) -> Option<&ViewSky> {
        let find = || ViewSky::new(picture, open_cells(&self.cameras[index], &self.points, self.up));
        self.found[index].get_or_init(find).as_ref()
    }
}

/// A view in cells, row by row from the upper border.
#[derive(Clone, Debug)]
struct Cells {
    columns: usize,
    rows: usize,
    /// px
    width: usize,
    /// px
    height: usize,
}

impl Cells {
    fn new(camera: &Camera, points: usize) -> Self {
        let (width, height) = (camera.width, camera.height);
        let side = ((width * height) as f64 * POINTS_PER_CELL / points.max(1) as f64).sqrt();
        let along = |length: usize| ((length as f64 / side).round() as usize).clamp(1, length);
        Self { columns: along(width), rows: along(height), width, height }
    }

    /// The cell of a position in px.
    fn at(&self, x: f64, y: f64) -> usize {
        let along = |position: f64, length: usize, cells: usize| {
            ((position / length as f64 * cells as f64) as usize).min(cells - 1)
        };
        along(y, self.height, self.rows) * self.columns + along(x, self.width, self.columns)
    }

    /// px
    fn centre(&self, cell: usize) -> (f64, f64) {
        let along = |at: usize, length: usize, cells: usize| (at as f64 + 0.5) / cells as f64 * length as f64;
        (along(cell % self.columns, self.width, self.columns), along(cell / self.columns, self.height, self.rows))
    }

    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let left = (column > 0).then(|| cell - 1);
        let right = (column + 1 < self.columns).then(|| cell + 1);
        let above = (row > 0).then(|| cell - self.columns);
        let below = (row + 1 < self.rows).then(|| cell + self.columns);
        [left, right, above, below].into_iter().flatten()
    }

    /// Which of the cells that are `empty` such cells connect with the upper border.
    fn connected_with_top(&self, empty: &[bool]) -> Vec<bool> {
        let mut connected = vec![false; empty.len()];
        let mut next: Vec<usize> = (0..self.columns).filter(|&cell| empty[cell]).collect();
        next.iter().for_each(|&cell| connected[cell] = true);
        while let Some(cell) = next.pop() {
            for cell in self.neighbours(cell).filter(|&cell| empty[cell]) {
                if !std::mem::replace(&mut connected[cell], true) {
                    next.push(cell);
                }
            }
        }
        connected
    }
}

/// The cells of a view that are open sky.
#[derive(Clone, Debug)]
struct OpenCells {
    cells: Cells,
    open: Vec<bool>,
}

impl OpenCells {
    /// The pixels of the `picture` in open cells that count, row by row.
    fn pixels(&self, picture: &Picture) -> Vec<usize> {
        let Cells { columns, width, height, .. } = self.cells;
        let columns_of: Vec<usize> = (0..width).map(|x| self.cells.at(x as f64 + 0.5, 0.5)).collect();
        let mut pixels = Vec::new();
        for y in 0..height {
            let first = self.cells.at(0.5, y as f64 + 0.5);
            let row = &self.open[first..first + columns];
            let open = (0..width).filter(|&x| row[columns_of[x]]).map(|x| y * width + x);
            pixels.extend(open.filter(|&pixel| picture.counts(pixel)));
        }
        pixels
    }
}

fn open_cells(camera: &Camera, points: &[[f32; 3]], up: DVec3) -> OpenCells {
    let (width, height) = (camera.width, camera.height);
    let inside = |&(x, y, _): &(f64, f64, f64)| x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
    let seen: Vec<(f64, f64, f64)> = points
        .iter()
        .filter_map(|point| camera.project(DVec3::from_array(point.map(f64::from))).filter(inside))
        .collect();
    let cells = Cells::new(camera, seen.len());
    // a view that sees no point says nothing, and would be one empty cell
    let mut empty = vec![!seen.is_empty(); cells.columns * cells.rows];
    seen.iter().for_each(|&(x, y, _)| empty[cells.at(x, y)] = false);
    let mut open = cells.connected_with_top(&empty);
    let world_from_pixel = camera.world_from_pixel();
    for (cell, open) in open.iter_mut().enumerate() {
        let (x, y) = cells.centre(cell);
        let direction = match camera.lens {
            None => world_from_pixel * DVec3::new(x, y, 1.0),
            Some(_) => camera.unproject(x, y, 1.0) - camera.centre(),
        };
        *open &= direction.dot(up) > 0.0;
    }
    OpenCells { cells, open }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::dataset::{BuiltinOptions, PointCloud, View, builtin};
    use crate::init::plane_sweep;

    const SIZE: usize = 64;
    pub const BLUE: [u8; 3] = [51, 102, 255];

    /// A ring of cameras around the origin that look at it from a height of `height`. Their photographs are plain blue.
    pub fn ring(height: f64, points: Vec<[f32; 3]>) -> Dataset {
        let options = BuiltinOptions { train_views: 12, test_views: 1, points: 0, ..Default::default() };
        let mut dataset = builtin(&BuiltinOptions { width: SIZE, height: SIZE, ..options });
        for (index, view) in dataset.train.iter_mut().enumerate() {
            let angle = index as f64 / 12.0 * std::f64::consts::TAU;
            let eye = DVec3::new(5.0 * angle.cos(), 5.0 * angle.sin(), height);
            view.camera = plane_sweep::tests::camera(eye, SIZE, SIZE as f64);
            view.repaint(|picture| picture.bytes = BLUE.repeat(SIZE * SIZE)).unwrap();
        }
        dataset.points = PointCloud { positions: points, ..PointCloud::default() };
        dataset
    }

    /// A wall of points around the origin, up to a height of `top`.
    pub fn tower(top: f32) -> Vec<[f32; 3]> {
        let mut points = Vec::new();
        for layer in 0..100 {
            for at in 0..100 {
                let angle = at as f32 / 100.0 * std::f32::consts::TAU;
                points.push([angle.cos() * 20.0, angle.sin() * 20.0, top - layer as f32 * 0.4]);
            }
        }
        points
    }

    #[test]
    fn up_is_perpendicular_to_level_cameras_whatever_their_tilt() {
        for height in [-3.0, 0.0, 4.0] {
            let dataset = ring(height, Vec::new());
            let half = upwards(dataset.train[..5].iter().map(|view| &view.camera));
            assert!(half.dot(DVec3::Z) > 0.998, "{height}: {half}");
            let one = upwards(dataset.train[..1].iter().map(|view| &view.camera));
            assert!(one.dot(DVec3::Z) > 0.7, "{height}: {one}");
        }
    }

    #[test]
    fn open_sky_is_what_lies_above_all_points_and_has_its_colour() {
        // level cameras whose horizon is the middle of the picture: the points reach it, and the half above is empty but
        // for the cells that they share
        let sky = open_sky(&ring(0.0, tower(0.0))).unwrap();
        assert!((0.3..=0.5).contains(&sky.share), "{sky:?}");
        let colour = sky.colour.unwrap();
        assert!(colour.iter().zip([0.2, 0.4, 1.0]).all(|(a, b)| (a - b).abs() < 1e-6), "{colour:?}");
        // points everywhere
        assert!(open_sky(&ring(0.0, tower(20.0))).unwrap().share < 0.02);
    }

    #[test]
    fn leaves_in_open_sky_are_not_sky() {
        let mut dataset = ring(0.0, tower(0.0));
        let up = upwards(dataset.train.iter().map(|view| &view.camera));
        let open_of =
            |view: &View| open_cells(&view.camera, &dataset.points.positions, up).pixels(&view.picture().unwrap());
        let open: Vec<Vec<usize>> = dataset.train.iter().map(open_of).collect();
        let first = open[0][0];
        let leaf = |picture: &mut Picture| picture.bytes[3 * first..][..3].copy_from_slice(&[64, 51, 26]);
        dataset.train[0].repaint(leaf).unwrap();
        let sky: Vec<Vec<usize>> = sky_of(&dataset);
        assert!(sky[0][..] == open[0][1..] && sky[1..] == open[1..]);
        dataset.train[1].repaint(|picture| picture.counted = Some(vec![false; SIZE * SIZE])).unwrap();
        assert!(sky_of(&dataset)[1].is_empty(), "what does not count is no sky");
        assert!(sky_of(&ring(5.0, tower(-8.0))).iter().all(Vec::is_empty));
    }

    /// The pixels of every view that show nothing but sky.
    fn sky_of(dataset: &Dataset) -> Vec<Vec<usize>> {
        let skies = Skies::new(dataset).unwrap();
        let of_view = |(index, view): (usize, &View)| {
            let picture = view.picture().unwrap();
            skies.of(index, &picture).map(|sky| sky.pixels(&picture)).unwrap_or_default()
        };
        dataset.train.iter().enumerate().map(of_view).collect()
    }

    #[test]
    fn what_lies_below_the_horizon_or_is_enclosed_by_points_is_no_sky() {
        // cameras high above look down: the horizon is above the pictures, whose upper parts have no points
        let sky = open_sky(&ring(5.0, tower(-8.0))).unwrap();
        assert_eq!((sky.share, sky.colour), (0.0, None));
        // a hole in the points that does not reach the upper border
        let mut window = tower(20.0);
        window.retain(|point| !(3.0..9.0).contains(&point[2]));
        assert!(open_sky(&ring(0.0, window)).unwrap().share < 0.02);
        // cameras that look up
        assert_eq!(open_sky(&ring(-3.0, Vec::new())).unwrap().share, 0.0, "without points nothing is known");
    }
}

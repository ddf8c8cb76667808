//! Surfels on surfaces that are known: depth and normals of the built-in scene.

use std::sync::Arc;

use dpges_core::Result;
use dpges_core::scene::SurfelData;
use dpges_train::config::Config;
use dpges_train::dataset::neighbours::{as_points, nearest_to};
use dpges_train::dataset::{Dataset, Picture, View, builtin_geometry};
use dpges_train::init::placement::{OrientedPoints, Placement, surfels};
use glam::{DVec3, Vec3};
use rand_chacha::ChaCha8Rng;

use super::pixels::is_before_edge;

/// A point is seen by a view whose depth there is not smaller than its own by more than this, relative to its own.
const TOLERANCE: f64 = 0.01;

/// A view and what it shows.
#[derive(Clone, Debug)]
pub struct KnownView<'a> {
    pub view: &'a View,
    pub picture: Arc<Picture>,
    /// [H × W], world units.
    pub depth: Vec<f32>,
    /// [3, H, W] unit vectors in the world, towards the camera.
    pub normal: Vec<f32>,
}

/// Points on surfaces, and the camera centres from which they were seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfacePoints {
    pub points: OrientedPoints,
    pub eyes: Vec<DVec3>,
}

/// Surfels on true surfaces, with true normals.
#[derive(Clone, Debug, PartialEq)]
pub struct TrueSurfels {
    /// Margins are zero.
    pub surfels: SurfelData,
    /// Camera centre from which the place of each was seen.
    pub eyes: Vec<DVec3>,
    /// Whether the opaque part of each reaches a point behind which, for some view, the depth jumps.
    pub at_silhouette: Vec<bool>,
}

impl<'a> KnownView<'a> {
    /// A `view` of the built-in scene.
    pub fn of_builtin(view: &'a View) -> Result<Self> {
        let (depth, normal) = builtin_geometry(&view.camera);
        Ok(Self { view, picture: view.picture()?, depth, normal })
    }

    fn world(&self, pixel: usize) -> DVec3 {
        let (x, y) = (pixel % self.view.camera.width, pixel / self.view.camera.width);
        self.view.camera.unproject(x as f64 + 0.5, y as f64 + 0.5, f64::from(self.depth[pixel]))
    }

    fn normal(&self, pixel: usize) -> DVec3 {
        let component = |axis: usize| f64::from(self.normal[axis * self.depth.len() + pixel]);
        DVec3::from_array(std::array::from_fn(component)).normalize()
    }

    /// Columns and rows of squares with a side of `stride_px`.
    fn squares(&self, stride_px: usize) -> [usize; 2] {
        [self.view.camera.width.div_ceil(stride_px), self.view.camera.height.div_ceil(stride_px)]
    }

    /// Which squares show one of `positions`.
    fn covered(&self, positions: &[[f32; 3]], stride_px: usize) -> Vec<bool> {
        let [columns, rows] = self.squares(stride_px);
        let mut covered = vec![false; columns * rows];
        for &position in positions {
            let Some((pixel, depth)) = self.view.camera.pixel(Vec3::from_array(position).as_dvec3()) else { continue };
            if depth * (1.0 - TOLERANCE) <= f64::from(self.depth[pixel]) {
                let (x, y) = (pixel % self.view.camera.width, pixel / self.view.camera.width);
                covered[y / stride_px * columns + x / stride_px] = true;
            }
        }
        covered
    }
}

/// A point in every square of a view, `stride_px` wide, that shows none of the points of earlier views.
pub fn points_every(views: &[KnownView<'_>], stride_px: usize) -> SurfacePoints {
    let mut found = SurfacePoints::default();
    for view in views {
        let (width, height) = (view.view.camera.width, view.view.camera.height);
        let covered = view.covered(&found.points.positions, stride_px);
        let [columns, _] = view.squares(stride_px);
        for square in (0..covered.len()).filter(|&square| !covered[square]) {
            let middle = |at: usize, size: usize| (at * stride_px + stride_px / 2).min(size - 1);
            let pixel = middle(square / columns, height) * width + middle(square % columns, width);
            found.points.positions.push(view.world(pixel).as_vec3().to_array());
            found.points.colours.push(view.picture.colour(pixel));
            found.points.normals.push(view.normal(pixel));
            found.eyes.push(view.view.camera.centre());
        }
    }
    found
}

/// The densest of these points that are no more than `most`.
pub fn points_within(views: &[KnownView<'_>], most: usize) -> SurfacePoints {
    let fits = |stride_px: &usize| points_every(views, *stride_px).eyes.len() <= most.max(views.len());
    let stride_px = (1..).find(fits).expect("a square as large as a view holds one point at most");
    points_every(views, stride_px)
}

impl TrueSurfels {
    /// At most `most` surfels, placed as a run of `config` places them at points.
    pub fn place(
        views: &[KnownView<'_>],
        most: usize,
        dataset: &Dataset,
        config: &Config,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let SurfacePoints { points, eyes } = points_within(views, most);
        let surfels = surfels(&points, &Placement::new(config, dataset.extent), rng);
        let at_silhouette = reach(&surfels, &edges(views), opaque_radius(config.model.modulation));
        Self { surfels, eyes, at_silhouette }
    }
}

/// Points before which, in some view, the depth jumps: the near sides of edges.
fn edges(views: &[KnownView<'_>]) -> Vec<[f32; 3]> {
    let of_view = |view: &KnownView<'_>| -> Vec<[f32; 3]> {
        let pixels = 0..view.depth.len();
        let near = pixels.filter(|&pixel| is_before_edge(&view.depth, view.view.camera.width, pixel));
        near.map(|pixel| view.world(pixel).as_vec3().to_array()).collect()
    };
    views.iter().flat_map(of_view).collect()
}

/// Radius of the opaque part of a surfel, min(1, w G) = 1, in standard deviations.
fn opaque_radius(modulation: f64) -> f64 {
    (2.0 * modulation.max(1.0).ln()).sqrt()
}

/// Whether one of `points` is within `radius` standard deviations of the middle of each surfel.
fn reach(surfels: &SurfelData, points: &[[f32; 3]], radius: f64) -> Vec<bool> {
    let nearest = nearest_to(as_points(&surfels.positions), points, 1);
    let scales = surfels.log_scales.as_chunks::<2>().0;
    let reaches = |(nearest, scales): (Vec<(u32, f32)>, &[f32; 2])| {
        let reach = radius * f64::from(scales[0].max(scales[1])).exp();
        nearest.first().is_some_and(|&(_, squared)| f64::from(squared) <= reach * reach)
    };
    nearest.into_iter().zip(scales).map(reaches).collect()
}

#[cfg(test)]
mod tests {
    use dpges_train::dataset::{BuiltinOptions, builtin};
    use rand::SeedableRng;

    use super::*;

    fn dataset() -> Dataset {
        let options =
            BuiltinOptions { width: 48, height: 48, train_views: 6, test_views: 1, points: 0, ..Default::default() };
        builtin(&options)
    }

    fn known(dataset: &Dataset) -> Vec<KnownView<'_>> {
        dataset.train.iter().map(|view| KnownView::of_builtin(view).unwrap()).collect()
    }

    #[test]
    fn every_square_of_every_view_shows_a_point_and_none_is_placed_twice() {
        let dataset = dataset();
        let views = known(&dataset);
        let found = points_every(&views, 6);
        let count = found.eyes.len();
        assert!((64..6 * 64).contains(&count), "{count}");
        assert_eq!([found.points.positions.len(), found.points.colours.len(), found.points.normals.len()], [count; 3]);
        for view in &views {
            assert!(view.covered(&found.points.positions, 6).iter().all(|&covered| covered));
        }
    }

    #[test]
    fn points_lie_on_surfaces_that_face_the_camera_that_saw_them() {
        let dataset = dataset();
        let found = points_every(&known(&dataset), 8);
        let mut on_floor = 0;
        for ((position, normal), eye) in found.points.positions.iter().zip(&found.points.normals).zip(&found.eyes) {
            let position = Vec3::from_array(*position).as_dvec3();
            assert!(normal.dot(*eye - position) > 0.0);
            if position.z.abs() < 1e-5 {
                assert!((*normal - DVec3::Z).length() < 1e-6);
                on_floor += 1;
            }
        }
        assert!(on_floor > 10, "{on_floor}");
    }

    #[test]
    fn points_become_sparser_until_they_fit() {
        let dataset = dataset();
        let views = known(&dataset);
        for most in [400, 100] {
            let count = points_within(&views, most).eyes.len();
            assert!(count <= most && count > most / 4, "{count} of {most}");
        }
        assert!(points_within(&views, 0).eyes.len() <= views.len());
    }

    #[test]
    fn surfels_at_silhouettes_are_some_and_have_an_edge_in_reach() {
        let dataset = dataset();
        let views = known(&dataset);
        let config = Config::default();
        let found = TrueSurfels::place(&views, 200, &dataset, &config, &mut ChaCha8Rng::seed_from_u64(1));
        let count = found.at_silhouette.iter().filter(|&&is_at| is_at).count();
        assert!(count > 10 && count < found.surfels.len(), "{count} of {}", found.surfels.len());
        assert_eq!([found.eyes.len(), found.at_silhouette.len()], [found.surfels.len(); 2]);
    }

    #[test]
    fn what_is_opaque_reaches_as_far_as_its_scale_says() {
        let mut surfels = SurfelData::neutral(Config::default().model.colour, 3);
        surfels.positions = vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0];
        surfels.log_scales = [0.1_f32, 0.05, 0.1, 0.1, 0.2, 0.1].map(f32::ln).to_vec();
        let radius = opaque_radius(30.0);
        assert!((30.0 * (-0.5 * radius * radius).exp() - 1.0).abs() < 1e-12);
        assert_eq!(reach(&surfels, &[[0.25, 0.0, 0.0], [1.5, 0.0, 0.0]], radius), [true, false, true]);
        assert_eq!(reach(&surfels, &[], radius), [false; 3]);
    }
}

//! The first scene of a run.
//!
//! A method of initialisation consists of a module that returns an [`InitialScene`], an [`InitMethod`] that names it,
//! and an arm of [`initialise`]. Most methods find [`OrientedPoints`] on the surfaces of the scene, and [`placement`]
//! turns these into primitives. [`promote`] turns trained discs into surfels.

pub mod agreement;
pub mod flatten;
pub mod fusion;
pub mod placement;
pub mod promote;
pub mod random;
pub mod region;
pub mod sfm;
pub mod silhouette;
pub mod sky_detection;

use dpges_core::camera::Camera;
use dpges_core::scene::{GaussianData, SurfelData};
use rand_chacha::ChaCha8Rng;

use crate::config::{Config, InitMethod};
use crate::dataset::{Dataset, PointCloud};
use crate::refine::margins::margins;
pub use placement::PrimitiveStart;
use placement::{OrientedPoints, Placement};
use region::Region;
use silhouette::{Silhouettes, TOLERANCE};

/// The largest size of an initial scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PrimitiveQuota {
    /// Points, each of which becomes a surfel and a Gaussian.
    points: usize,
    /// Gaussians of a scene without surfels.
    gaussians: usize,
}

impl PrimitiveQuota {
    /// Rounds down, to at least 1.
    pub fn new(points: f64, gaussians: f64) -> Self {
        Self { points: (points as usize).max(1), gaussians: (gaussians as usize).max(1) }
    }
}

/// The primitives that training starts from. Surfels have their margins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InitialScene {
    pub surfels: SurfelData,
    pub gaussians: GaussianData,
}

#[derive(Debug, thiserror::Error)]
pub enum InitError {
    #[error("no training views: nothing to start from")]
    NoViews,
    #[error("init.method is `sfm`, but the dataset has no points with finite coordinates")]
    NoPoints,
    #[error("init.method is `silhouette`, but no training picture has transparent pixels")]
    NoSilhouettes,
    #[error("the silhouettes of the training views share no volume: check the cameras and the alpha of the pictures")]
    EmptyHull,
    /// A photograph cannot be read again.
    #[error(transparent)]
    Picture(#[from] dpges_core::Error),
}

/// The initial scene of a dataset, within the limits of `quota`, of primitives as large and opaque as `start` says.
/// `init.method` "auto" starts from points if the dataset has some, else from silhouettes, else from random Gaussians.
///
/// # Errors
/// [`InitError`] if there are no training views or the dataset lacks what the method needs.
pub fn initialise(
    dataset: &Dataset,
    config: &Config,
    start: PrimitiveStart,
    quota: PrimitiveQuota,
    rng: &mut ChaCha8Rng,
) -> Result<InitialScene, InitError> {
    if dataset.train.is_empty() {
        return Err(InitError::NoViews);
    }
    match config.init.method {
        InitMethod::Sfm => from_points(dataset, config, start, quota, rng),
        InitMethod::Silhouette => from_silhouettes(dataset, config, start, quota, rng),
        InitMethod::Random => Ok(random_gaussians(dataset, config, start, quota, rng)),
        InitMethod::Auto => {
            match from_points(dataset, config, start, quota, rng)
                .or_else(|_| from_silhouettes(dataset, config, start, quota, rng))
            {
                Err(reason @ (InitError::NoSilhouettes | InitError::EmptyHull)) => {
                    tracing::warn!("no points, and no hull ({reason}): starting from random Gaussians without surfels");
                    Ok(random_gaussians(dataset, config, start, quota, rng))
                }
                result => result,
            }
        }
    }
}

fn from_points(
    dataset: &Dataset,
    config: &Config,
    start: PrimitiveStart,
    quota: PrimitiveQuota,
    rng: &mut ChaCha8Rng,
) -> Result<InitialScene, InitError> {
    let points = sfm::usable_points(&dataset.points, config.init.max_points.min(quota.points), rng);
    if points.positions.is_empty() {
        return Err(InitError::NoPoints);
    }
    let centres: Vec<_> = dataset.train.iter().map(|view| view.camera.centre()).collect();
    Ok(place(&sfm::orient(points, &centres), dataset, config, start, rng))
}

fn from_silhouettes(
    dataset: &Dataset,
    config: &Config,
    start: PrimitiveStart,
    quota: PrimitiveQuota,
    rng: &mut ChaCha8Rng,
) -> Result<InitialScene, InitError> {
    let silhouettes = Silhouettes::new(&dataset.train).ok_or(InitError::NoSilhouettes)?;
    let region = in_sight(dataset);
    let (resolution, count) = (config.init.hull_resolution, config.init.max_points.min(quota.points));
    let points = silhouette::hull_points(&silhouettes, region, resolution, TOLERANCE, count, rng)?;
    if points.is_empty() {
        return Err(InitError::EmptyHull);
    }
    Ok(place(&points, dataset, config, start, rng))
}

fn random_gaussians(
    dataset: &Dataset,
    config: &Config,
    start: PrimitiveStart,
    quota: PrimitiveQuota,
    rng: &mut ChaCha8Rng,
) -> InitialScene {
    let count = config.init.random_gaussians.min(quota.gaussians);
    let half_side = config.init.random_half_side;
    let region = if half_side > 0.0 { Region::cube(-dataset.offset, half_side) } else { in_sight(dataset) };
    let points = random::points(region, count, rng);
    let placement = Placement { start, ..Placement::new(config, dataset.extent) };
    let gaussians = placement::gaussians(&points, &placement, rng);
    InitialScene { surfels: SurfelData::neutral(gaussians.colour.model, 0), gaussians }
}

/// A surfel at every point. Margins are zero.
pub fn surfels_at(points: PointCloud, dataset: &Dataset, config: &Config, rng: &mut ChaCha8Rng) -> SurfelData {
    let centres: Vec<_> = dataset.train.iter().map(|view| view.camera.centre()).collect();
    placement::surfels(&sfm::orient(points, &centres), &Placement::new(config, dataset.extent), rng)
}

/// A surfel and a faint Gaussian at every point.
fn place(
    points: &OrientedPoints,
    dataset: &Dataset,
    config: &Config,
    start: PrimitiveStart,
    rng: &mut ChaCha8Rng,
) -> InitialScene {
    let placement = Placement { start, ..Placement::new(config, dataset.extent) };
    let mut surfels = placement::surfels(points, &placement, rng);
    surfels.margins = margins(&surfels.positions, &surfels.log_scales, config.model.margin);
    InitialScene { surfels, gaussians: placement::gaussians(points, &placement, rng) }
}

fn in_sight(dataset: &Dataset) -> Region {
    let cameras: Vec<&Camera> = dataset.train.iter().map(|view| &view.camera).collect();
    Region::in_sight(&cameras, dataset.extent)
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::DVec3;
    use rand::SeedableRng;

    use super::*;
    use crate::dataset::{Format, Picture, Tracks, View};

    const SIZE: usize = 40;

    /// Cameras on a ring around the origin; where `alpha` is given it is that of a disc of 12 px radius.
    fn dataset(views: usize, alpha: bool, points: Vec<[f32; 3]>) -> Dataset {
        let view = |i: usize| {
            let turn = i as f64 / views as f64 * std::f64::consts::TAU;
            let eye = 4.0 * DVec3::new(turn.cos(), turn.sin(), 0.5 * (3.0 * turn).sin());
            let camera_from_world = CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z);
            let (f, c) = (50.0, SIZE as f64 / 2.0);
            let camera = Camera {
                camera_from_world,
                fx: f,
                fy: f,
                cx: c,
                cy: c,
                width: SIZE,
                height: SIZE,
                near: 0.01,
                lens: None,
            };
            let radius = |pixel: usize| ((pixel % SIZE) as f64 + 0.5 - c).hypot((pixel / SIZE) as f64 + 0.5 - c);
            let disc = (0..SIZE * SIZE).map(|pixel| if radius(pixel) < 12.0 { 255 } else { 0 }).collect();
            let (bytes, alpha) = (vec![64; 3 * SIZE * SIZE], alpha.then_some(disc));
            let picture = Picture { width: SIZE, height: SIZE, bytes, alpha, counted: None };
            View { name: i.to_string(), camera, photograph: picture.into(), depth: None }
        };
        let colours = vec![[0.75; 3]; points.len()];
        Dataset {
            train: (0..views).map(view).collect(),
            test: vec![],
            validation: vec![],
            points: PointCloud { positions: points, colours, seen_by: Tracks::default() },
            offset: DVec3::ZERO,
            extent: 4.4,
            background: [0.0; 3],
            format: Format::Builtin,
            near: 0.01,
            spare_memory: usize::MAX,
        }
    }

    fn start(dataset: &Dataset, method: InitMethod) -> Result<InitialScene, InitError> {
        let mut config = Config::default();
        config.init.method = method;
        config.init.hull_resolution = 24;
        config.init.random_gaussians = 300;
        initialise(
            dataset,
            &config,
            PrimitiveStart::default(),
            PrimitiveQuota::new(1e6, 1e6),
            &mut ChaCha8Rng::seed_from_u64(4),
        )
    }

    #[test]
    fn auto_takes_the_best_there_is() {
        let points = start(&dataset(6, true, vec![[0.0; 3], [1.0, 0.0, 0.0]]), InitMethod::Auto).unwrap();
        assert_eq!((points.surfels.len(), points.gaussians.len()), (2, 2));
        let hull = start(&dataset(20, true, vec![]), InitMethod::Auto).unwrap();
        assert!(hull.surfels.len() > 100 && hull.surfels.len() == hull.gaussians.len());
        assert!(hull.surfels.margins.iter().all(|&margin| margin > 0.0));
        let random = start(&dataset(6, false, vec![[f32::NAN; 3]]), InitMethod::Auto).unwrap();
        assert_eq!((random.surfels.len(), random.gaussians.len()), (0, 300));
        assert!(random.gaussians.positions.iter().all(|x| x.abs() < 4.4));
    }

    #[test]
    fn random_gaussians_fill_the_cube_that_is_asked_for() {
        let mut moved = dataset(6, false, vec![]);
        moved.offset = DVec3::new(1.0, -2.0, 0.5);
        let mut config = Config::default();
        (config.init.method, config.init.random_half_side) = (InitMethod::Random, 1.3);
        let quota = PrimitiveQuota::new(1e6, 5000.0);
        let scene =
            initialise(&moved, &config, PrimitiveStart::default(), quota, &mut ChaCha8Rng::seed_from_u64(4)).unwrap();
        assert_eq!((scene.surfels.len(), scene.gaussians.len()), (0, 5000));
        assert_eq!(scene.surfels.colour.model, scene.gaussians.colour.model);
        for (axis, offset) in moved.offset.to_array().into_iter().enumerate() {
            let along = scene.gaussians.positions.iter().skip(axis).step_by(3);
            let (low, high) = along.fold((f64::MAX, f64::MIN), |(low, high), &x| {
                (low.min(f64::from(x) + offset), high.max(f64::from(x) + offset))
            });
            assert!((-1.3..-1.29).contains(&low) && (1.29..1.3001).contains(&high), "{low}, {high}");
        }
    }

    #[test]
    fn what_a_method_lacks_is_said() {
        let bare = dataset(6, false, vec![]);
        assert!(matches!(start(&bare, InitMethod::Sfm), Err(InitError::NoPoints)));
        assert!(matches!(start(&bare, InitMethod::Silhouette), Err(InitError::NoSilhouettes)));
        assert!(matches!(start(&dataset(0, false, vec![]), InitMethod::Auto), Err(InitError::NoViews)));
        let mut empty = dataset(6, true, vec![]);
        for view in &mut empty.train {
            view.repaint(|picture| picture.alpha.as_mut().unwrap().fill(0)).unwrap();
        }
        assert!(matches!(start(&empty, InitMethod::Silhouette), Err(InitError::EmptyHull)));
        assert_eq!(start(&empty, InitMethod::Auto).unwrap().surfels.len(), 0);
    }

    #[test]
    fn the_same_seed_gives_the_same_scene_within_its_room() {
        let cloud = (0..200).map(|i| [(i as f32).sin(), (i as f32 * 1.7).cos(), i as f32 * 0.01]).collect();
        let dataset = dataset(6, false, cloud);
        let config = Config::default();
        let quota = PrimitiveQuota::new(30.0, 60.0);
        let start = |seed| {
            initialise(&dataset, &config, PrimitiveStart::default(), quota, &mut ChaCha8Rng::seed_from_u64(seed))
                .unwrap()
        };
        assert_eq!(start(1), start(1));
        assert_ne!(start(1), start(2));
        assert_eq!((start(1).surfels.len(), start(1).gaussians.len()), (30, 30));
        let finite = |values: &[f32]| values.iter().all(|x| x.is_finite());
        let InitialScene { surfels, gaussians } = start(3);
        assert!(finite(&surfels.log_scales) && finite(&surfels.quaternions) && finite(&gaussians.log_scales));
    }
}

//! The first scene of a run.
//!
//! A method of initialisation consists of a module that returns an [`InitialScene`], an [`InitMethod`] that names it,
//! and an arm of `Init::by`. Most methods find [`placement::OrientedPoints`] on the surfaces of the scene, and [`placement`]
//! turns these into primitives. [`promote`] turns trained discs into surfels.

pub mod chance;
pub mod flatten;
pub mod fusion;
pub mod placement;
pub mod plane_sweep;
pub mod promote;
pub mod random;
pub mod region;
pub mod sfm;
pub mod silhouette;
pub mod sky_detection;

use dpges_core::camera::Camera;
use dpges_core::scene::{GaussianData, SurfelData};
use glam::DVec3;
use rand_chacha::ChaCha8Rng;

use crate::config::{Config, InitMethod};
use crate::dataset::{Dataset, PointCloud, View};
use crate::refine::margins::margins;
use placement::Placement;
pub use placement::PrimitiveStart;
use plane_sweep::{Acceptance, Sweep, Volume};
use region::Region;
use silhouette::TOLERANCE;

/// Fewer points of structure from motion are joined by points about which views agree.
const FEW_POINTS: usize = 3_000;
/// A start by plane sweep alone needs this share of the points that it asks for.
const LEAST_SHARE_FOUND: f64 = 0.25;
/// Compared points of a ray along the longest side of a region.
const SAMPLES_OF_A_SIDE: usize = 192;
/// Compared points of a ray where no points say where a scene is.
const SAMPLES_OF_A_RAY: usize = 512;
/// The distance of the nearest of these, relative to the extent of the cameras.
const NEAREST: f64 = 0.2;

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
    #[error(
        "the silhouettes of the training views share no volume, or no pixel is opaque: check the cameras and the alpha of the pictures"
    )]
    EmptyHull,
    #[error(
        "views agree nowhere about colours: photographs lack texture, are too far apart, or have wrong cameras; give points of structure from motion"
    )]
    NoAgreement,
    /// A photograph cannot be read again.
    #[error(transparent)]
    Picture(#[from] dpges_core::Error),
}

/// The initial scene of a dataset, within the limits of `quota`, of primitives as large and opaque as `start` says.
/// `init.method` "auto" starts from points if the dataset has some, else from silhouettes, else where views agree about colours,
/// else from random Gaussians.
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
    let init = Init { dataset, config, start, quota };
    if config.init.method != InitMethod::Auto {
        return init.by(config.init.method, rng);
    }
    for method in [InitMethod::Sfm, InitMethod::Silhouette, InitMethod::PlaneSweep] {
        match init.by(method, rng) {
            Err(InitError::NoPoints | InitError::NoSilhouettes) => {}
            Err(reason @ (InitError::EmptyHull | InitError::NoAgreement)) => tracing::warn!("{reason}"),
            result => return result,
        }
    }
    tracing::warn!("starting from random Gaussians without surfels");
    init.by(InitMethod::Random, rng)
}

/// The inputs of every method.
struct Init<'a> {
    dataset: &'a Dataset,
    config: &'a Config,
    start: PrimitiveStart,
    quota: PrimitiveQuota,
}

impl Init<'_> {
    fn by(&self, method: InitMethod, rng: &mut ChaCha8Rng) -> Result<InitialScene, InitError> {
        match method {
            InitMethod::Sfm => self.by_points(rng),
            InitMethod::Silhouette => self.by_silhouettes(rng),
            InitMethod::PlaneSweep => self.by_agreement(rng),
            InitMethod::Auto | InitMethod::Random => Ok(self.random_gaussians(rng)),
        }
    }

    fn max_points(&self) -> usize {
        self.config.init.max_points.min(self.quota.points)
    }

    fn by_points(&self, rng: &mut ChaCha8Rng) -> Result<InitialScene, InitError> {
        let mut points = sfm::usable_points(&self.dataset.points, self.max_points(), rng);
        if points.positions.is_empty() {
            return Err(InitError::NoPoints);
        }
        let wanted = self.max_points().min(FEW_POINTS).saturating_sub(points.positions.len());
        if wanted > 0 {
            let region = Region::around(&points.positions).unwrap_or_else(|| in_sight(self.dataset));
            let step = region.size().max_element() / SAMPLES_OF_A_SIDE as f64;
            let around = Sweep::Volume(Volume { region, step, contains: &|_| true });
            let more = where_views_agree(self.dataset, &around, wanted, rng)?;
            tracing::info!(
                "{} points are few: {} more where views agree about a colour",
                points.positions.len(),
                more.positions.len()
            );
            points.append(&more);
        }
        Ok(self.place(points, &centres(&self.dataset.train), rng))
    }

    fn by_silhouettes(&self, rng: &mut ChaCha8Rng) -> Result<InitialScene, InitError> {
        let views = self.dataset.train.iter().filter(|view| view.photograph.has_transparency());
        let views: Vec<&View> = views.collect();
        if views.is_empty() {
            return Err(InitError::NoSilhouettes);
        }
        let (region, resolution) = (in_sight(self.dataset), self.config.init.hull_resolution);
        let points = silhouette::hull_points(&views, region, resolution, TOLERANCE, self.max_points(), rng)?;
        if points.positions.is_empty() {
            return Err(InitError::EmptyHull);
        }
        Ok(self.place(points, &centres(views), rng))
    }

    fn by_agreement(&self, rng: &mut ChaCha8Rng) -> Result<InitialScene, InitError> {
        let count = self.max_points().min(FEW_POINTS);
        let points = agreed_points(self.dataset, count, rng)?;
        if (points.positions.len() as f64) < LEAST_SHARE_FOUND * count as f64 {
            return Err(InitError::NoAgreement);
        }
        Ok(self.place(points, &centres(&self.dataset.train), rng))
    }

    fn random_gaussians(&self, rng: &mut ChaCha8Rng) -> InitialScene {
        let count = self.config.init.random_gaussians.min(self.quota.gaussians);
        let half_side = self.config.init.random_half_side;
        let around_origin = || Region::cube(-self.dataset.offset, half_side);
        let region = if half_side > 0.0 { around_origin() } else { in_sight(self.dataset) };
        let points = random::points(region, count, rng);
        let gaussians = placement::gaussians(&points, &self.placement(), rng);
        InitialScene { surfels: SurfelData::neutral(gaussians.colour.model, 0), gaussians }
    }

    fn placement(&self) -> Placement {
        Placement { start: self.start, ..Placement::new(self.config, self.dataset.extent) }
    }

    /// A surfel and a faint Gaussian at every point, which cameras at `centres` saw.
    fn place(&self, points: PointCloud, centres: &[DVec3], rng: &mut ChaCha8Rng) -> InitialScene {
        let (points, placement) = (sfm::orient(points, centres), self.placement());
        let mut surfels = placement::surfels(&points, &placement, rng);
        surfels.margins = margins(&surfels.positions, &surfels.log_scales, self.config.model.margin);
        InitialScene { surfels, gaussians: placement::gaussians(&points, &placement, rng) }
    }
}

/// A surfel at every point. Margins are zero.
pub fn surfels_at(points: PointCloud, dataset: &Dataset, config: &Config, rng: &mut ChaCha8Rng) -> SurfelData {
    placement::surfels(&sfm::orient(points, &centres(&dataset.train)), &Placement::new(config, dataset.extent), rng)
}

/// At most `count` points about which views of a dataset without points agree.
fn agreed_points(dataset: &Dataset, count: usize, rng: &mut ChaCha8Rng) -> dpges_core::Result<PointCloud> {
    let anywhere = Sweep::Open { nearest: NEAREST * dataset.extent, steps: SAMPLES_OF_A_RAY };
    where_views_agree(dataset, &anywhere, count, rng)
}

/// At most `count` points about which views agree.
fn where_views_agree(
    dataset: &Dataset,
    sweep: &Sweep<'_>,
    count: usize,
    rng: &mut ChaCha8Rng,
) -> dpges_core::Result<PointCloud> {
    let views: Vec<&View> = dataset.train.iter().collect();
    plane_sweep::draw(&views, sweep, Acceptance::DISTINCT, count, rng)
}

fn centres<'a>(views: impl IntoIterator<Item = &'a View>) -> Vec<DVec3> {
    views.into_iter().map(|view| view.camera.centre()).collect()
}

fn in_sight(dataset: &Dataset) -> Region {
    let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
    Region::in_sight(&cameras, dataset.extent)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::dataset::{BuiltinOptions, Picture, Tracks, builtin};

    const SIZE: usize = 40;

    /// Cameras on a ring around the origin; where `alpha` is given it is that of a disc of 12 px radius.
    fn dataset(views: usize, alpha: bool, points: Vec<[f32; 3]>) -> Dataset {
        let view = |i: usize| {
            let turn = i as f64 / views as f64 * std::f64::consts::TAU;
            let eye = 4.0 * DVec3::new(turn.cos(), turn.sin(), 0.5 * (3.0 * turn).sin());
            let (camera, c) = (plane_sweep::tests::camera(eye, SIZE, 50.0), SIZE as f64 / 2.0);
            let radius = |pixel: usize| ((pixel % SIZE) as f64 + 0.5 - c).hypot((pixel / SIZE) as f64 + 0.5 - c);
            let disc = (0..SIZE * SIZE).map(|pixel| if radius(pixel) < 12.0 { 255 } else { 0 }).collect();
            let (bytes, alpha) = (vec![64; 3 * SIZE * SIZE], alpha.then_some(disc));
            let picture = Picture { width: SIZE, height: SIZE, bytes, alpha, counted: None };
            View { name: i.to_string(), camera, photograph: picture.into(), depth: None, face: None }
        };
        let colours = vec![[0.75; 3]; points.len()];
        let points = PointCloud { positions: points, colours, seen_by: Tracks::default() };
        let none = BuiltinOptions { train_views: 0, test_views: 0, points: 0, ..Default::default() };
        Dataset { train: (0..views).map(view).collect(), points, extent: 4.4, ..builtin(&none) }
    }

    fn start(dataset: &Dataset, method: InitMethod) -> Result<InitialScene, InitError> {
        let mut config = Config::default();
        config.init.method = method;
        config.init.hull_resolution = 24;
        config.init.random_gaussians = 300;
        seeded(dataset, &config, PrimitiveQuota::new(1e6, 1e6), 4)
    }

    fn seeded(dataset: &Dataset, config: &Config, quota: PrimitiveQuota, seed: u64) -> Result<InitialScene, InitError> {
        initialise(dataset, config, PrimitiveStart::default(), quota, &mut ChaCha8Rng::seed_from_u64(seed))
    }

    #[test]
    fn auto_takes_the_best_there_is() {
        let points = start(&dataset(6, false, vec![[0.0; 3], [1.0, 0.0, 0.0]]), InitMethod::Auto).unwrap();
        assert_eq!((points.surfels.len(), points.gaussians.len()), (2, 2));
        let hull = start(&dataset(20, true, vec![]), InitMethod::Auto).unwrap();
        assert!(hull.surfels.len() > 100 && hull.surfels.len() == hull.gaussians.len());
        assert!(hull.surfels.margins.iter().all(|&margin| margin > 0.0));
        // of one colour, so that nothing tells their distances
        let random = start(&dataset(6, false, vec![[f32::NAN; 3]]), InitMethod::Auto).unwrap();
        assert_eq!((random.surfels.len(), random.gaussians.len()), (0, 300));
        assert!(random.gaussians.positions.iter().all(|x| x.abs() < 4.4));
    }

    #[test]
    fn points_that_are_few_are_joined_by_those_that_views_agree_about() {
        let mosaic = plane_sweep::tests::photos(plane_sweep::tests::mosaic, |_| false);
        let corners =
            (0..60).map(|i| [(i % 8) as f32 / 4.0 - 1.0, (i / 8) as f32 / 4.0 - 1.0, 0.3 * (i % 3 - 1) as f32]);
        let few = Dataset { train: mosaic.clone(), ..dataset(0, false, corners.collect()) };
        let scene = start(&few, InitMethod::Auto).unwrap();
        assert!(scene.surfels.len() > 1000 && scene.surfels.len() <= FEW_POINTS, "{}", scene.surfels.len());
        let on_the_floor = |scene: &InitialScene| {
            let added = scene.surfels.positions.iter().skip(2).step_by(3).skip(60);
            added.clone().filter(|z| z.abs() < 0.1).count() as f64 / added.count() as f64
        };
        assert!(on_the_floor(&scene) > 0.8, "{}", on_the_floor(&scene));
        let none = Dataset { points: PointCloud::default(), ..few };
        let scene = start(&none, InitMethod::Auto).unwrap();
        assert!(scene.surfels.len() > 1000 && on_the_floor(&scene) > 0.7, "{}", on_the_floor(&scene));
        assert!(matches!(start(&dataset(6, false, vec![]), InitMethod::PlaneSweep), Err(InitError::NoAgreement)));
    }

    #[test]
    fn random_gaussians_fill_the_cube_that_is_asked_for() {
        let mut moved = dataset(6, false, vec![]);
        moved.offset = DVec3::new(1.0, -2.0, 0.5);
        let mut config = Config::default();
        (config.init.method, config.init.random_half_side) = (InitMethod::Random, 1.3);
        let quota = PrimitiveQuota::new(1e6, 5000.0);
        let scene = seeded(&moved, &config, quota, 4).unwrap();
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
        let start = |seed| seeded(&dataset, &Config::default(), PrimitiveQuota::new(30.0, 60.0), seed).unwrap();
        assert_eq!(start(1), start(1));
        assert_ne!(start(1), start(2));
        assert_eq!((start(1).surfels.len(), start(1).gaussians.len()), (30, 30));
        let finite = |values: &[f32]| values.iter().all(|x| x.is_finite());
        let InitialScene { surfels, gaussians } = start(3);
        assert!(finite(&surfels.log_scales) && finite(&surfels.quaternions) && finite(&gaussians.log_scales));
    }
}

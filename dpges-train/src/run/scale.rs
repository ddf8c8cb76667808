//! The scale of a scene, metres per world unit, from two points whose distance is known.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::SceneData;
use dpges_core::scene::length::{four_digits, in_words};
use glam::DVec3;

use super::scene::{Reading, Scene};
use crate::dataset::View;
use crate::dataset::names::list;
use crate::eval::rendered::TrainingRenderer;

/// Sides of the picture in which the surface at a pixel is looked for, px. Odd: a pixel is in its middle.
const SIDE_PX: usize = 513;
/// Names that are proposed for one that is unknown.
const PROPOSED: usize = 3;

/// A point of the scene, as it is named.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// In the coordinates of the scene, world units.
    Point(DVec3),
    /// The surface at a position on a photograph, px from its upper left corner.
    Pixel { photograph: String, position: [f64; 2] },
}

/// Why there is no scale.
#[derive(Debug, thiserror::Error)]
pub enum ScaleError {
    #[error(
        "{} holds splats, which have no place for a scale: name a scene file or the folder of a run", .path.display()
    )]
    Splats { path: PathBuf },
    #[error("there is no photograph `{name}`; the nearest names are {nearest}")]
    Unknown { name: String, nearest: String },
    #[error("`{name}` may be each of {found}: write more of the name")]
    Ambiguous { name: String, found: String },
    #[error("{x},{y} is outside of photograph `{name}`, which has {width} x {height} px")]
    Outside { name: String, x: f64, y: f64, width: usize, height: usize },
    #[error("there is no surface at {x},{y} of photograph `{name}`: choose a pixel of something opaque")]
    NoSurface { name: String, x: f64, y: f64 },
    #[error("--from and --to are the same point: the length is that between two")]
    SamePoint,
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}

impl ScaleError {
    /// Whether it was asked for wrongly, and nothing failed.
    pub fn is_usage(&self) -> bool {
        !matches!(self, Self::Core(_))
    }
}

impl FromStr for Place {
    type Err = String;

    /// `x,y,z`, or `NAME@x,y`.
    fn from_str(text: &str) -> Result<Self, String> {
        let expected = "x,y,z in coordinates of the scene, or NAME@x,y for a pixel of a photograph";
        let wrong = || format!("this is no point: write {expected}");
        let (name, numbers) = text.rsplit_once('@').map_or((None, text), |(name, numbers)| (Some(name), numbers));
        let parse = |number: &str| number.trim().parse::<f64>().ok().filter(|number| number.is_finite());
        let numbers: Option<Vec<f64>> = numbers.split(',').map(parse).collect();
        match (name, numbers.as_deref()) {
            (None, Some(&[x, y, z])) => Ok(Self::Point(DVec3::new(x, y, z))),
            (Some(name), Some(&[x, y])) if !name.is_empty() => {
                Ok(Self::Pixel { photograph: name.to_owned(), position: [x, y] })
            }
            _ => Err(wrong()),
        }
    }
}

impl Place {
    pub fn is_on_photograph(&self) -> bool {
        matches!(self, Self::Pixel { .. })
    }

    /// How the photographs of a dataset are read: as they are, whatever the run was trained with.
    pub fn reading() -> Reading {
        let whole = ["data.image_scale=1", "data.max_resolution=0", "data.undistort=false"];
        Reading { assignments: whole.map(str::to_owned).to_vec(), ..Reading::default() }
    }

    /// The point in the scene of `renderer`, world units; `views` are those of the dataset, in its coordinates.
    ///
    /// # Errors
    /// [`ScaleError`] but for [`ScaleError::SamePoint`].
    pub fn find<'a>(
        &self,
        views: impl Iterator<Item = &'a View> + Clone,
        renderer: Option<&TrainingRenderer>,
    ) -> Result<DVec3, ScaleError> {
        match (self, renderer) {
            (Self::Point(point), _) => Ok(*point),
            (Self::Pixel { photograph, position }, Some(renderer)) => {
                surface_at(named(views, photograph)?, *position, renderer)
            }
            (Self::Pixel { photograph: name, .. }, None) => {
                Err(ScaleError::Unknown { name: name.clone(), nearest: "none, as there is no dataset".to_owned() })
            }
        }
    }
}

/// Stores in the file of `scene` that two `places` are `length` metres apart. Returns what was found, for people. `views` and
/// `renderer` are for [places](Place::find) on photographs.
///
/// # Errors
/// [`ScaleError`]; then the file is as it was.
pub fn store(
    scene: &Scene,
    places: [&Place; 2],
    length: f64,
    views: &[&View],
    renderer: Option<&TrainingRenderer>,
) -> Result<Vec<(&'static str, String)>, ScaleError> {
    if SceneData::load(&scene.path).is_err() {
        return Err(ScaleError::Splats { path: scene.path.clone() });
    }
    let find = |place: &Place| place.find(views.iter().copied(), renderer);
    let [from, to] = [find(places[0])?, find(places[1])?];
    let scale = metres_per_unit(from, to, length)?;
    SceneData::set_metres_per_unit(&scene.path, scale)?;
    let point = |DVec3 { x, y, z }: DVec3| format!("{x:.4} {y:.4} {z:.4}");
    let mut rows = vec![
        ("file", scene.path.display().to_string()),
        ("from", point(from)),
        ("to", point(to)),
        ("length", format!("{} world units are {}", four_digits(from.distance(to)), in_words(length))),
        ("scale", format!("1 world unit is {}", in_words(scale))),
    ];
    if let Some(before) = scene.data.info.metres_per_unit {
        rows.push(("before", format!("1 world unit was {}", in_words(before))));
    }
    Ok(rows)
}

/// Metres per world unit if `from` and `to` are `length` metres apart.
fn metres_per_unit(from: DVec3, to: DVec3, length: f64) -> Result<f64, ScaleError> {
    let scale = length / from.distance(to);
    if scale.is_finite() { Ok(scale) } else { Err(ScaleError::SamePoint) }
}

/// The view with that name, or the only one whose file is called so, with or without its ending.
fn named<'a>(views: impl Iterator<Item = &'a View> + Clone, name: &str) -> Result<&'a View, ScaleError> {
    if let Some(view) = views.clone().find(|view| view.name == name) {
        return Ok(view);
    }
    let is_called = |view: &&View| {
        let path = Path::new(&view.name);
        path.ends_with(name) || path.file_stem().is_some_and(|stem| stem == name)
    };
    let found: Vec<&View> = views.clone().filter(is_called).collect();
    match found[..] {
        [view] => Ok(view),
        [] => {
            let mut names: Vec<&str> = views.map(|view| &*view.name).collect();
            let unlike = |other: &str| 1.0 - strsim::jaro_winkler(name, other);
            names.sort_by(|a, b| unlike(a).total_cmp(&unlike(b)));
            names.truncate(PROPOSED);
            Err(ScaleError::Unknown { name: name.to_owned(), nearest: list(&names) })
        }
        _ => {
            let names: Vec<&str> = found.iter().map(|view| &*view.name).collect();
            Err(ScaleError::Ambiguous { name: name.to_owned(), found: list(&names) })
        }
    }
}

/// The point of the surface that `view` shows at a position on its photograph, px: where a pinhole camera in its place finds one
/// that looks along the ray of this position.
fn surface_at(view: &View, [x, y]: [f64; 2], renderer: &TrainingRenderer) -> Result<DVec3, ScaleError> {
    let (camera, name) = (&view.camera, || view.name.clone());
    let (width, height) = (camera.width, camera.height);
    if !(0.0..=width as f64).contains(&x) || !(0.0..=height as f64).contains(&y) {
        return Err(ScaleError::Outside { name: name(), x, y, width, height });
    }
    let no_surface = || ScaleError::NoSurface { name: name(), x, y };
    let ray = camera.ray(x, y).ok_or_else(no_surface)?.normalize();
    // any direction across the ray will do
    let across = if ray.y.abs() < 0.9 { DVec3::NEG_Y } else { DVec3::X };
    let [forward, up] = [ray, across].map(|axis| camera.camera_from_world.rotation.transpose() * axis);
    let centre = camera.centre();
    let pose = CameraFromWorld::look_at(centre, centre + forward, up);
    let focal_px = SIDE_PX as f64 * camera.fx / width as f64;
    let (_, depths) = renderer.render_with_depth(&Camera::pinhole(pose, focal_px, [SIDE_PX; 2], camera.near))?;
    let depth = f64::from(depths[depths.len() / 2]);
    if depth > 0.0 { Ok(centre + depth * forward) } else { Err(no_surface()) }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, GaussianData, SceneInfo, SurfelData};

    use super::*;
    use crate::dataset::builtin;
    use crate::run::fixtures::{device, fisheye_dataset, options};

    #[test]
    fn places_are_points_or_pixels() {
        assert_eq!("1, -2,0.5".parse(), Ok(Place::Point(DVec3::new(1.0, -2.0, 0.5))));
        let position = [10.5, 20.0];
        let photograph = "a@b,c/img.png".to_owned();
        assert_eq!("a@b,c/img.png@10.5,20".parse(), Ok(Place::Pixel { photograph, position }));
        for wrong in ["1,2", "1,2,3,4", "a@1", "@1,2", "a@1,2,3", "1,nan,2", "a@inf,1", "", "x,y,z"] {
            assert!(wrong.parse::<Place>().unwrap_err().contains("NAME@x,y"), "{wrong}");
        }
    }

    #[test]
    fn a_length_is_between_two_points() {
        let [from, to] = [DVec3::ZERO, DVec3::new(0.0, 3.0, 4.0)];
        assert_eq!(metres_per_unit(from, to, 1.25).unwrap(), 0.25);
        assert!(matches!(metres_per_unit(to, to, 1.25), Err(ScaleError::SamePoint)));
    }

    /// A view along z from 4 before a large surfel in the plane z = 0, through a lens if asked for, and the surfel.
    fn wall() -> (Vec<View>, SceneData) {
        let mut views = builtin(&options(32, [3, 0], 10)).train;
        for view in &mut views {
            let pose = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y);
            view.camera = Camera { camera_from_world: pose, near: 0.1, ..view.camera };
        }
        for (view, name) in views.iter_mut().zip(["left/img_1.jpg", "right/img_1.jpg", "right/img_2.jpg"]) {
            view.name = name.to_owned();
        }
        let model = ColourModel::SphericalBeta { lobes: 0 };
        let mut surfels = SurfelData::neutral(model, 1);
        surfels.log_scales.fill(0.5f32.ln());
        let info = SceneInfo { colour_model: model, ..SceneInfo::default() };
        (views, SceneData { info, surfels, gaussians: GaussianData::neutral(model, 0), environment: None })
    }

    #[test]
    fn a_pixel_is_where_its_ray_meets_the_surface() {
        let (views, scene) = wall();
        let renderer = TrainingRenderer::new(&scene, &device());
        let find = |text: &str| text.parse::<Place>().unwrap().find(views.iter(), Some(&renderer));
        let camera = &views[0].camera;
        for expected in [DVec3::ZERO, DVec3::new(0.3, 0.2, 0.0), DVec3::new(-0.1, 0.4, 0.0)] {
            let (x, y, _) = camera.project(expected).unwrap();
            let found = find(&format!("left/img_1.jpg@{x},{y}")).unwrap();
            assert!(found.distance(expected) < 1e-4, "{found}, {expected}");
        }
        let text = |text: &str| find(text).unwrap_err().to_string();
        assert!(text("img_2@0,0").contains("no surface at 0,0 of photograph `right/img_2.jpg`"));
        assert!(text("img_2.jpg@33,1").contains("32 x 32 px"));
        assert!(text("img_1@1,1").contains("left/img_1.jpg, right/img_1.jpg"));
        assert!(
            text("right/img_3.jpg@1,1").contains("nearest names are right/img_1.jpg, right/img_2.jpg, left/img_1.jpg")
        );
        assert_eq!(find("1,2,3").unwrap(), DVec3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn a_lens_bends_the_ray() {
        let (mut views, scene) = wall();
        views[0].camera.lens = fisheye_dataset().train[0].camera.lens;
        assert!(views[0].camera.lens.is_some());
        let expected = DVec3::new(0.4, -0.3, 0.0);
        let (x, y, _) = views[0].camera.project(expected).unwrap();
        let found = surface_at(&views[0], [x, y], &TrainingRenderer::new(&scene, &device())).unwrap();
        assert!(found.distance(expected) < 1e-4, "{found}");
    }
}

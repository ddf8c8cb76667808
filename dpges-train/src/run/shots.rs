//! Where pictures are taken from: the views of a dataset, or a way of cameras.

use std::path::PathBuf;
use std::str::FromStr;

use dpges_core::camera::Camera;
use dpges_render::path::{Extent, NamedCamera, PathError, Size, in_scene, load_cameras};
use dpges_render::{CameraPath, Up};

use super::scene::{Scene, SceneError};
use super::view_choice::ViewChoice;
use crate::dataset::camera_file::cameras;
use crate::dataset::{DatasetError, Face, Split};
use crate::eval::pictures::file_stems;
use crate::eval::stitched::{self, PictureLens};

/// Frames along a path, unless they are given.
const FRAMES: usize = 120;

/// A way of cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PathChoice {
    /// The views of a dataset.
    Views,
    /// A smooth path through them.
    Interpolated,
    Orbit,
    Spiral,
    /// A file of another program, or of the window.
    File(PathBuf),
}

impl FromStr for PathChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(match text {
            "views" => Self::Views,
            "interpolated" => Self::Interpolated,
            "orbit" => Self::Orbit,
            "spiral" => Self::Spiral,
            file if PathBuf::from(file).is_file() => Self::File(file.into()),
            other => {
                let expected = "expected views, interpolated, orbit, spiral or a file of cameras";
                return Err(format!("there is no file {other}; {expected}"));
            }
        })
    }
}

/// Why there are no pictures to take.
#[derive(Debug, thiserror::Error)]
pub enum ShotsError {
    #[error("{option}: {reason}")]
    Ignored { option: String, reason: &'static str },
    #[error("--size {width}x{height}: a panorama is twice as wide as high, such as {}x{height}", 2 * height)]
    Panorama { width: usize, height: usize },
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(transparent)]
    Path(#[from] PathError),
}

impl ShotsError {
    /// Whether it was asked for wrongly, and nothing failed.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Scene(error) => error.is_usage(),
            Self::Ignored { .. } | Self::Panorama { .. } => true,
            Self::Dataset(_) | Self::Path(_) => false,
        }
    }
}

/// A picture that is to be taken.
pub struct Shot {
    pub camera: Camera,
    /// Stem of the name of its file.
    pub stem: String,
    /// Name of the view in the dataset, of the camera in its file, or number of the frame.
    pub name: String,
}

impl PathChoice {
    /// The pictures of `scene` along the path, in its coordinates: one for each of the views and of the cameras of a file, unless
    /// `frames` along a path through these are asked for. Of the views of a panorama one is taken where `lens` makes panoramas.
    ///
    /// # Errors
    /// [`ShotsError::Ignored`] for options that make no difference; [`ShotsError::Panorama`]; those of reading the dataset of `choice`, without which
    /// only orbits and files have cameras.
    pub fn shots(
        &self,
        frames: Option<usize>,
        size: Option<Size>,
        lens: Option<PictureLens>,
        choice: &ViewChoice,
        scene: &mut Scene,
    ) -> Result<Vec<Shot>, ShotsError> {
        let named = match self {
            Self::File(file) => {
                choice.refuse_split()?;
                scene.show_as(&choice.reading)?;
                if choice.data.is_some() {
                    choice.dataset(scene)?;
                }
                let info = &scene.data.info;
                match cameras(file)? {
                    Some(cameras) => cameras
                        .into_iter()
                        .map(|(name, camera)| (name, in_scene(Camera { near: info.near, ..camera }, info)))
                        .collect(),
                    None => load_cameras(file, info)?,
                }
            }
            _ => match choice.load(scene) {
                Ok((_, views)) if lens.is_none() => views.into_iter().map(|view| (view.name, view.camera)).collect(),
                Ok((_, views)) => {
                    let of_all = views.iter().filter(|view| view.face.is_none_or(|face| face == Face::Front));
                    of_all.map(|view| (view.photograph_name(), view.camera)).collect()
                }
                Err(SceneError::NoDataset { .. }) if *self == Self::Orbit => {
                    choice.refuse_split()?;
                    Extent::ring(&scene.data).into_iter().map(|camera| (String::new(), camera)).collect()
                }
                Err(error) => return Err(error.into()),
            },
        };
        let keys: Vec<Camera> = named.iter().map(|(_, camera)| *camera).collect();
        let up = Up::of(&scene.data.info);
        let path = match (self, frames) {
            (Self::Views, Some(_)) => {
                let reason = "the views are as many as they are; --path interpolated goes through them";
                return Err(ShotsError::Ignored { option: "--frames".to_owned(), reason });
            }
            (Self::Orbit, _) => Some(CameraPath::orbit(&keys, up)?),
            (Self::Spiral, _) => Some(CameraPath::spiral(&keys, up)?),
            (Self::Interpolated, _) | (Self::File(_), Some(_)) => Some(CameraPath::new(keys, false)?),
            (Self::Views | Self::File(_), None) if keys.is_empty() => return Err(PathError::Empty.into()),
            (Self::Views | Self::File(_), None) => None,
        };
        let named = match path {
            Some(path) => {
                numbered(path.frames(frames.unwrap_or(FRAMES)).into_iter().map(|camera| (String::new(), camera)))
            }
            None => numbered(named.into_iter()),
        };
        let stems = file_stems(named.iter().map(|(name, _)| &**name));
        if let (Some(Size { width, height }), Some(_)) = (size, lens)
            && width != 2 * height
        {
            return Err(ShotsError::Panorama { width, height });
        }
        let sized = |camera: Camera| match lens {
            Some(PictureLens::Equirectangular) => {
                let size = size.map_or_else(|| stitched::natural_size(&camera), |size| [size.width, size.height]);
                stitched::camera(&camera, size)
            }
            None => size.map_or(camera, |size| size.apply(&camera)),
        };
        let shots = named.into_iter().zip(stems);
        Ok(shots.map(|((name, camera), stem)| Shot { camera: sized(camera), stem, name }).collect())
    }
}

/// The same with numbers for those without a name.
fn numbered(cameras: impl Iterator<Item = NamedCamera>) -> Vec<NamedCamera> {
    let name =
        |(at, (name, camera)): (usize, NamedCamera)| (if name.is_empty() { format!("{at:05}") } else { name }, camera);
    cameras.enumerate().map(name).collect()
}

impl ViewChoice {
    /// Refuses options that choose views of a dataset, or how they are read, where none are.
    fn refuse_split(&self) -> Result<(), ShotsError> {
        let split = self.split.map(|split: Split| format!("--split {split}"));
        let shown = |set: &&String| !set.starts_with("data.background") && !set.starts_with("data.up");
        let read = self.reading.assignments.iter().find(shown).cloned();
        match split.or(read) {
            Some(option) => Err(ShotsError::Ignored { option, reason: "these cameras are no views of a dataset" }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, GaussianData, SceneData, SceneInfo, SurfelData};

    use super::*;

    #[test]
    fn words_are_paths_and_the_rest_is_files() {
        assert_eq!("orbit".parse(), Ok(PathChoice::Orbit));
        let file = tempfile::NamedTempFile::new().unwrap();
        assert_eq!(file.path().to_str().unwrap().parse(), Ok(PathChoice::File(file.path().into())));
        let message = "way.json".parse::<PathChoice>().unwrap_err();
        assert!(message.contains("way.json") && message.contains("orbit"), "{message}");
    }

    #[test]
    fn a_scene_alone_has_orbits_and_cameras_of_files_with_their_names() {
        let (folder, model) = (tempfile::tempdir().unwrap(), ColourModel::SphericalBeta { lobes: 0 });
        let info = SceneInfo {
            colour_model: model,
            offset: [5e5, 4e6, 0.0],
            up: Some([0.0, 0.0, 1.0]),
            ..SceneInfo::default()
        };
        let mut gaussians = GaussianData::neutral(model, 2);
        gaussians.positions = vec![-1.0, 0.0, 0.0, 1.0, 0.0, 0.0];
        let data = SceneData { info, surfels: SurfelData::neutral(model, 0), gaussians, environment: None };
        let [scene, file] = ["scene.safetensors", "cameras.json"].map(|name| folder.path().join(name));
        data.save(&scene).unwrap();
        let camera = |id: usize, x: f64| {
            format!(
                r#"{{"id": {id}, "img_name": "a b{id}.jpg", "width": 8, "height": 6, "position": [{x}, 4000000, 1],
                "rotation": [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], "fy": 9, "fx": 9}}"#
            )
        };
        std::fs::write(&file, format!("[{}, {}]", camera(1, 499_995.0), camera(2, 499_996.0))).unwrap();
        let shots = |path: PathChoice, frames, choice: &ViewChoice| {
            path.shots(frames, None, None, choice, &mut Scene::load(&scene).unwrap())
        };
        let plain = ViewChoice::default();
        let panoramas = |size: Option<Size>| {
            let lens = Some(PictureLens::Equirectangular);
            PathChoice::File(file.clone()).shots(None, size, lens, &plain, &mut Scene::load(&scene).unwrap())
        };
        let orbit = shots(PathChoice::Orbit, Some(5), &plain).unwrap();
        assert!(
            orbit.len() == 5 && orbit.iter().all(|shot| shot.camera.camera_from_world.rotation.row(0).z.abs() < 1e-2)
        );
        let of_file = shots(PathChoice::File(file.clone()), None, &plain).unwrap();
        assert_eq!((of_file.len(), &*of_file[1].stem, &*of_file[1].name), (2, "a_b2", "a b2.jpg"));
        assert!((of_file[0].camera.centre() - glam::DVec3::new(-5.0, 0.0, 1.0)).length() < 1e-6);
        for (size, expected) in [(None, [56, 28]), ("80x40".parse().ok(), [80, 40])] {
            let camera = panoramas(size).unwrap()[0].camera;
            assert_eq!([camera.width, camera.height], expected);
            assert_eq!(camera.camera_from_world, of_file[0].camera.camera_from_world);
        }
        let refused = panoramas("80x50".parse().ok()).err().unwrap().to_string();
        assert!(refused.contains("--size 80x50") && refused.contains("100x50"), "{refused}");
        assert_eq!(shots(PathChoice::File(file.clone()), Some(7), &plain).unwrap().len(), 7);
        let split = ViewChoice { split: Some(Split::Train), ..ViewChoice::default() };
        let ignored = shots(PathChoice::File(file), None, &split).err().unwrap().to_string();
        assert!(ignored.contains("--split train"), "{ignored}");
        assert!(matches!(shots(PathChoice::Views, None, &plain), Err(ShotsError::Scene(SceneError::NoDataset { .. }))));
    }
}

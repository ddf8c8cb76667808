//! Where pictures are taken from: the views of a dataset, or a way of cameras.

use std::path::PathBuf;
use std::str::FromStr;

use dpges_core::camera::Camera;
use dpges_render::CameraPath;
use dpges_render::path::{PathError, Size};

use super::pictures::file_stems;
use crate::dataset::View;

/// A way of cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PathChoice {
    /// Those of a dataset.
    Views,
    /// A smooth path through them.
    Interpolated,
    Orbit,
    Spiral,
    /// In the convention of the cameras.json of 3DGS.
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

/// A picture that is to be taken.
pub struct Shot {
    pub camera: Camera,
    /// Of its file.
    pub stem: String,
    /// Name of the view in the dataset, or number of the frame.
    pub name: String,
}

impl PathChoice {
    /// The pictures along the path, with `frames` unless it is of the `views`; `near` is the depth from which on a camera of a
    /// file sees, world units.
    ///
    /// # Errors
    /// Those of `views`, and [`PathError`].
    pub fn shots<E: From<PathError>>(
        &self,
        frames: usize,
        size: Option<Size>,
        near: f64,
        views: impl FnOnce() -> Result<Vec<View>, E>,
    ) -> Result<Vec<Shot>, E> {
        let sized = |camera: Camera| size.map_or(camera, |size| size.apply(&camera));
        let path = match self {
            Self::File(file) => CameraPath::load(file, near)?,
            of_views => {
                let views = views()?;
                let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
                match of_views {
                    Self::Orbit => CameraPath::orbit(&cameras)?,
                    Self::Spiral => CameraPath::spiral(&cameras)?,
                    Self::Interpolated => CameraPath::new(cameras, false)?,
                    Self::Views | Self::File(_) => {
                        let stems = file_stems(&views);
                        let shot = |(View { camera, name, .. }, stem)| Shot { camera: sized(camera), stem, name };
                        return Ok(views.into_iter().zip(stems).map(shot).collect());
                    }
                }
            }
        };
        let shot = |(frame, camera): (usize, Camera)| {
            let stem = format!("{frame:05}");
            Shot { camera: sized(camera), name: stem.clone(), stem }
        };
        Ok(path.frames(frames).into_iter().enumerate().map(shot).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_paths_and_the_rest_is_files() {
        assert_eq!("orbit".parse(), Ok(PathChoice::Orbit));
        let file = tempfile::NamedTempFile::new().unwrap();
        assert_eq!(file.path().to_str().unwrap().parse(), Ok(PathChoice::File(file.path().into())));
        let message = "way.json".parse::<PathChoice>().unwrap_err();
        assert!(message.contains("way.json") && message.contains("orbit"), "{message}");
    }
}

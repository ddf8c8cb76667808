//! Where pictures are taken from.

use std::convert::Infallible;
use std::path::PathBuf;
use std::str::FromStr;

use dpges_core::camera::Camera;
use dpges_render::CameraPath;
use dpges_render::path::Size;
use dpges_train::dataset::View;
use dpges_train::eval::pictures::file_stems;

use super::super::data::{Scene, ViewArgs};
use super::super::{Failure, Result};

/// A way of cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PathChoice {
    Views,
    Interpolated,
    Orbit,
    Spiral,
    File(PathBuf),
}

impl FromStr for PathChoice {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match text {
            "views" => Self::Views,
            "interpolated" => Self::Interpolated,
            "orbit" => Self::Orbit,
            "spiral" => Self::Spiral,
            file => Self::File(file.into()),
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

/// The pictures that `path` asks for, with `frames` along it.
pub fn shots(
    path: &PathChoice,
    frames: usize,
    size: Option<Size>,
    views: &ViewArgs,
    scene: &mut Scene,
) -> Result<Vec<Shot>> {
    let sized = |camera: &Camera| size.map_or(*camera, |size| size.apply(camera));
    let of_path = |path: CameraPath| {
        let shot = |(frame, camera): (usize, Camera)| {
            let stem = format!("{frame:05}");
            Shot { camera: sized(&camera), name: stem.clone(), stem }
        };
        path.frames(frames).into_iter().enumerate().map(shot).collect()
    };
    if let PathChoice::File(file) = path {
        if !file.is_file() {
            let message = format!(
                "--path: there is no file {}; expected views, interpolated, orbit, spiral or a file of cameras",
                file.display()
            );
            return Err(Failure::Usage(message));
        }
        return Ok(of_path(CameraPath::load(file, scene.data.info.near)?));
    }
    let (_, views) = views.load(scene)?;
    let cameras = || views.iter().map(|view: &View| view.camera).collect::<Vec<Camera>>();
    Ok(match path {
        PathChoice::Views => {
            let shot =
                |(view, stem): (&View, String)| Shot { camera: sized(&view.camera), stem, name: view.name.clone() };
            views.iter().zip(file_stems(&views)).map(shot).collect()
        }
        PathChoice::Interpolated => of_path(CameraPath::new(cameras(), false)?),
        PathChoice::Orbit => of_path(CameraPath::orbit(&cameras())?),
        PathChoice::Spiral => of_path(CameraPath::spiral(&cameras())?),
        PathChoice::File(_) => unreachable!("returned above"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_paths_and_the_rest_is_files() {
        assert_eq!("orbit".parse(), Ok(PathChoice::Orbit));
        assert_eq!("way.json".parse(), Ok(PathChoice::File("way.json".into())));
    }
}

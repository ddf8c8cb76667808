//! Where pictures are taken from.

use std::convert::Infallible;
use std::path::PathBuf;
use std::str::FromStr;

use dpges_core::camera::Camera;
use dpges_render::CameraPath;
use dpges_train::dataset::View;
use dpges_train::eval::pictures::file_stems;

use super::super::data::{Scene, ViewArgs};
use super::super::{Failure, Result};

/// Width and height, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    pub width: usize,
    pub height: usize,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = |side: &str| side.parse::<usize>().ok().filter(|&side| side > 0);
        text.split_once('x')
            .and_then(|(width, height)| Some(Self { width: parse(width)?, height: parse(height)? }))
            .ok_or_else(|| format!("`{text}` is no size: write WIDTHxHEIGHT in px, as in 1920x1080"))
    }
}

impl Size {
    /// `camera` with a picture of this size: the vertical field of view stays, and the principal point keeps its offset
    /// from the middle.
    pub fn apply(self, camera: &Camera) -> Camera {
        let scale = self.height as f64 / camera.height as f64;
        let moved = |centre: f64, old: usize, new: usize| (centre - 0.5 * old as f64) * scale + 0.5 * new as f64;
        Camera {
            fx: camera.fx * scale,
            fy: camera.fy * scale,
            cx: moved(camera.cx, camera.width, self.width),
            cy: moved(camera.cy, camera.height, self.height),
            width: self.width,
            height: self.height,
            ..*camera
        }
    }
}

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
    /// What the dataset calls the view, or the number of the frame.
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
    use dpges_core::camera::CameraFromWorld;
    use glam::{DMat3, DVec3};

    use super::*;

    #[test]
    fn sizes_are_read_and_wrong_ones_explained() {
        assert_eq!("1920x1080".parse(), Ok(Size { width: 1920, height: 1080 }));
        for text in ["1920", "0x4", "4x", "axb", "4x-1"] {
            assert!(text.parse::<Size>().unwrap_err().contains("1920x1080"), "{text}");
        }
    }

    #[test]
    fn another_size_keeps_the_vertical_field_of_view_and_what_is_in_the_middle() {
        let pose = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
        let camera = Camera {
            camera_from_world: pose,
            fx: 50.0,
            fy: 60.0,
            cx: 22.0,
            cy: 9.0,
            width: 40,
            height: 20,
            near: 0.1,
            lens: None,
        };
        let wide = Size { width: 160, height: 40 }.apply(&camera);
        assert_eq!((wide.fx, wide.fy, wide.width, wide.height), (100.0, 120.0, 160, 40));
        assert_eq!((wide.cx, wide.cy), (84.0, 18.0));
    }

    #[test]
    fn words_are_paths_and_the_rest_is_files() {
        assert_eq!("orbit".parse(), Ok(PathChoice::Orbit));
        assert_eq!("way.json".parse(), Ok(PathChoice::File("way.json".into())));
    }
}

//! Cameras alone, in files of other programs: `transforms.json` of nerfstudio, Blender and others, and the images of a COLMAP
//! model beside its cameras.

use std::path::Path;

use dpges_core::camera::Camera;

use super::error::Result;
use super::formats::{colmap, transforms};
use super::image::undistort;

/// The cameras of the file at `path` and their names, in its order and its coordinates, for pictures without a lens; `None` if
/// it is no such file. Photographs need not be there.
///
/// # Errors
/// [`DatasetError`](super::DatasetError) for what cannot be read.
pub fn cameras(path: &Path) -> Result<Option<Vec<(String, Camera)>>> {
    let is_colmap = path.extension().is_some_and(|ending| ending == "bin" || ending == "txt");
    let cameras = match is_colmap {
        true => colmap::model_cameras(path.parent().unwrap_or(path))?,
        false => match transforms::cameras(path)? {
            Some(cameras) => cameras,
            None => return Ok(None),
        },
    };
    // as far as a pinhole camera can: what it does not see is left out
    let seen = |camera: Camera| undistort::pinhole(&camera).unwrap_or(camera.without_lens());
    Ok(Some(cameras.into_iter().map(|(name, camera)| (name, seen(camera))).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_read_without_photographs() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        // 5 before the origin, looking along +x, with z up
        let matrix = "[[0, 0, -1, -5], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]";
        let frames = format!(
            r#"{{"w": 40, "h": 20, "fl_x": 30, "frames": [{{"file_path": "b.png", "transform_matrix": {matrix}}}]}}"#
        );
        std::fs::write(file("transforms.json"), frames).unwrap();
        std::fs::write(file("cameras.txt"), "# c\n1 SIMPLE_PINHOLE 40 20 30 20 10\n").unwrap();
        std::fs::write(file("images.txt"), "# i\n7 0.5 0.5 -0.5 0.5 0 0 5 1 in/b.png\n\n").unwrap();
        for name in ["transforms.json", "images.txt"] {
            let cameras = cameras(&file(name)).unwrap().unwrap();
            assert!(cameras.len() == 1 && cameras[0].0.ends_with("b.png"), "{cameras:?}");
            let (x, y, depth) = cameras[0].1.project(glam::DVec3::new(0.0, 1.0, 1.0)).unwrap();
            assert!((x - 14.0).abs() < 1e-9 && (y - 4.0).abs() < 1e-9 && (depth - 5.0).abs() < 1e-9, "{x} {y} {depth}");
        }
        // as Blender's are: the size is that of the picture
        let frames =
            format!(r#"{{"camera_angle_x": 1.2, "frames": [{{"file_path": "./b", "transform_matrix": {matrix}}}]}}"#);
        std::fs::write(file("transforms.json"), frames).unwrap();
        let error = cameras(&file("transforms.json")).unwrap_err().to_string();
        assert!(error.contains("transforms.json") && error.contains("no `w` and `h`"), "{error}");
        image::RgbImage::new(40, 20).save(file("b.png")).unwrap();
        assert_eq!(cameras(&file("transforms.json")).unwrap().unwrap()[0].1.width, 40);
        std::fs::write(file("path.json"), "[]").unwrap();
        assert!(cameras(&file("path.json")).unwrap().is_none());
    }
}

//! Panoramas of a scene: pinhole pictures of the faces of a cube, stitched.

use std::f64::consts::{PI, TAU};

use clap::ValueEnum;
use dpges_core::camera::Camera;
use dpges_render::Rgb8Image;

use super::painted::Painted;
use crate::dataset::{Face, stitched, stitched_depth};

/// Pixels per angle in the middle of a face over those of the panorama. With 1 the panorama of a room with sharp edges is blurred to
/// 31 dB, with 1.5 it has 35, with 2 for twice the pixels 37.
const FACE_DENSITY: f64 = 1.5;

/// The projection of pictures that are not those of the cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PictureLens {
    /// Panoramas of all directions, twice as wide as high; the middle is where the camera looks
    Equirectangular,
}

/// Width and height, px, of a panorama with as many pixels per angle as the middle of the picture of `camera`.
pub fn natural_size(camera: &Camera) -> [usize; 2] {
    let height = ((PI * camera.fx).round() as usize).max(1);
    [2 * height, height]
}

/// The camera of a panorama of `width` × `height` px in the place of `camera`, which looks the same way: a pinhole camera with as many
/// pixels per angle.
pub fn camera(camera: &Camera, [width, height]: [usize; 2]) -> Camera {
    Camera::pinhole(camera.camera_from_world, width as f64 / TAU, [width, height], camera.near)
}

/// The panorama of a [`camera`] of `paint`'s pictures of its faces. Depths are distances from the camera.
///
/// # Errors
/// Those of `paint`.
pub fn painted<E>(panorama: &Camera, paint: impl FnMut(&Camera) -> Result<Painted, E>) -> Result<Painted, E> {
    let width = (FACE_DENSITY * panorama.width as f64).ceil() as usize;
    let cameras = Face::ALL.map(|face| face.camera(&panorama.camera_from_world, width, panorama.near));
    let faces = cameras.iter().map(paint).collect::<Result<Vec<Painted>, E>>()?;
    let (size, side) = ([panorama.width, panorama.height], cameras[0].width);
    // colours count as much as they cover
    let value = |face: usize, pixel: usize| {
        let Painted { picture, alpha, .. } = &faces[face];
        let alpha = alpha.as_ref().map_or(1.0, |alpha| f32::from(alpha[pixel]) / 255.0);
        let [red, green, blue] = [0, 1, 2].map(|channel| alpha * f32::from(picture.bytes[3 * pixel + channel]));
        [red, green, blue, alpha]
    };
    let pixels = stitched(size, side, value);
    let colour = |[red, green, blue, alpha]: &[f32; 4]| {
        [red, green, blue].map(|sum| (sum / alpha.max(1.0 / 512.0)).round() as u8)
    };
    let bytes = pixels.iter().flat_map(colour).collect();
    let has_alpha = faces.iter().all(|face| face.alpha.is_some());
    let alpha = has_alpha.then(|| pixels.iter().map(|pixel| (255.0 * pixel[3]).round() as u8).collect());
    let depths: Option<Vec<&Vec<f32>>> = faces.iter().map(|face| face.depth.as_ref()).collect();
    let depth = depths.map(|depths| stitched_depth(size, side, |face, pixel| depths[face][pixel]));
    let picture = Rgb8Image { width: size[0], height: size[1], bytes };
    Ok(Painted { picture, alpha, depth, layers: None })
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use dpges_core::camera::CameraFromWorld;
    use glam::DVec3;

    use super::*;
    use crate::dataset::{builtin_geometry, builtin_panorama, builtin_photograph};

    fn of_room(panorama: &Camera, alpha: u8) -> Painted {
        let paint = |camera: &Camera| {
            let (depth, _) = builtin_geometry(camera);
            let picture = builtin_photograph(camera, 3, 0.0);
            let alpha = Some(vec![alpha; picture.area()]);
            let picture = Rgb8Image { width: picture.width, height: picture.height, bytes: picture.bytes };
            Ok::<Painted, Infallible>(Painted { picture, alpha, depth: Some(depth), layers: None })
        };
        let Ok(painted) = painted(panorama, paint);
        painted
    }

    #[test]
    fn stitched_faces_are_the_panorama() {
        let pose = CameraFromWorld::look_at(DVec3::new(1.4, -1.1, 1.2), DVec3::new(0.0, 0.0, 0.3), DVec3::Z);
        let pinhole = Camera::pinhole(pose, 320.0 / TAU, [40, 30], 0.01);
        assert_eq!(natural_size(&pinhole), [320, 160]);
        let found = of_room(&camera(&pinhole, [320, 160]), 255);
        let (expected, distances) = builtin_panorama(&pose, 320, 3);
        let (found_bytes, expected_bytes) = (&found.picture.bytes, &expected.bytes);
        assert_eq!(found_bytes.len(), expected_bytes.len());
        let squares = found_bytes.iter().zip(expected_bytes).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
        let quality = 10.0 * (255.0f64.powi(2) * expected_bytes.len() as f64 / squares.sum::<f64>()).log10();
        assert!(quality > 37.0, "{quality} dB");
        let is_near = |(found, expected): &(f32, f32)| (found / expected - 1.0).abs() < 0.02;
        let near = found.depth.unwrap().into_iter().zip(distances).filter(is_near).count();
        assert!(near as f64 > 0.97 * 51_200.0, "{near}");
        assert!(found.alpha.unwrap().iter().all(|&alpha| alpha == 255));
    }

    #[test]
    fn what_covers_half_keeps_its_colour() {
        let pose = CameraFromWorld::look_at(DVec3::new(1.4, -1.1, 1.2), DVec3::ZERO, DVec3::Z);
        let panorama = camera(&Camera::pinhole(pose, 10.0, [40, 30], 0.01), [64, 32]);
        let [whole, half] = [255, 128].map(|alpha| of_room(&panorama, alpha));
        assert!(half.alpha.unwrap().iter().all(|&alpha| alpha == 128));
        assert!(half.picture.bytes.iter().zip(&whole.picture.bytes).all(|(a, b)| a.abs_diff(*b) <= 1));
    }

    #[test]
    fn faces_that_differ_pass_into_each_other() {
        let pose = CameraFromWorld::look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);
        let panorama = camera(&Camera::pinhole(pose, 10.0, [40, 30], 0.01), [720, 360]);
        let mut grey = 0;
        let paint = |camera: &Camera| {
            grey += 40;
            let bytes = vec![grey; 3 * camera.width * camera.height];
            Ok::<Painted, Infallible>(Rgb8Image { width: camera.width, height: camera.height, bytes }.into())
        };
        let Ok(Painted { picture, .. }) = painted(&panorama, paint);
        let row: Vec<u8> = picture.bytes[3 * 720 * 180..][..3 * 720].iter().step_by(3).copied().collect();
        // ahead, to the right, at the border behind, to the left
        assert_eq!([360, 540, 0, 180].map(|column| row[column]), [40, 80, 120, 160]);
        let steps = row.windows(2).map(|pair| pair[0].abs_diff(pair[1])).max();
        // 120 from left to front, in ten columns
        assert!(steps <= Some(20), "{steps:?}");
    }
}

//! Fewer primitives that look like all of them.

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;

use super::TrainError;
use super::refit::refit;
use crate::dataset::{Picture, View};
use crate::eval::rendered::TrainingRenderer;
use crate::eval::simplify::Contributions;

/// Cameras whose pictures are learnt from, at most.
const CAMERAS: usize = 128;

/// A share between 0 and 1, exclusively, such as `50%`.
///
/// # Errors
/// A sentence.
pub fn share(text: &str) -> Result<f64, String> {
    let percent = text.strip_suffix('%').and_then(|percent| percent.parse::<f64>().ok());
    let percent = percent.filter(|percent| *percent > 0.0 && *percent < 100.0);
    Ok(percent.ok_or_else(|| "this is no share such as 50%".to_owned())? / 100.0)
}

/// The `share` of all primitives of `scene`, a peeled one, that contribute most to pictures from `cameras`, trained for `steps` steps to look
/// there like all of them do.
///
/// # Errors
/// [`TrainError`] if a picture cannot be rendered or learnt from.
pub fn consolidate(
    scene: &SceneData,
    share: f64,
    cameras: &[Camera],
    steps: usize,
    device: &Device,
) -> Result<SceneData, TrainError> {
    let cameras: Vec<Camera> = cameras.iter().step_by(cameras.len().div_ceil(CAMERAS).max(1)).copied().collect();
    let kept = Contributions::measure(scene, &cameras, device)?.keep_heaviest(scene, share);
    if steps == 0 {
        return Ok(kept);
    }
    let renderer = TrainingRenderer::new(scene, device);
    let view = |(number, camera): (usize, &Camera)| {
        let planes = tensor_to_rows(renderer.render(camera)?.image());
        let photograph = Picture::from_planes(&planes, camera.width, camera.height).into();
        Ok(View { name: format!("view_{number:03}"), camera: *camera, photograph, depth: None, face: None })
    };
    let views = cameras.iter().enumerate().map(view).collect::<dpges_core::Result<Vec<View>>>()?;
    refit(&kept, &views, steps, device)
}

#[cfg(test)]
mod tests {
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;
    use crate::run::fixtures::device;

    #[test]
    fn half_of_the_primitives_learn_from_pictures_of_all() {
        let (mut scene, camera) = random(7, &Recipe { surfels: 6, gaussians: 10, ..Recipe::default() }).into_scene();
        scene.info.metres_per_unit = Some(0.5);
        let of = |scene: &SceneData, steps| consolidate(scene, 0.5, &[camera], steps, &device());
        let [kept, fewer] = [0, 2].map(|steps| of(&scene, steps).unwrap());
        assert_eq!((fewer.surfels.len() + fewer.gaussians.len(), &fewer.info), (8, &scene.info));
        assert_eq!(fewer.surfels.len(), kept.surfels.len());
        assert!(fewer.gaussians != kept.gaussians, "they have learnt");
        assert_eq!(share("50%"), Ok(0.5));
        for wrong in ["0%", "100%", "-1%", "nan%", "50", "half", ""] {
            assert!(share(wrong).unwrap_err().contains("such as 50%"), "{wrong}");
        }
    }
}

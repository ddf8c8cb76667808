//! Fewer primitives that look like all of them.

use std::str::FromStr;

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;

use super::Contributions;
use crate::dataset::{Picture, View};
use crate::eval::rendered::Renderer;
use crate::run::TrainError;
use crate::run::own_fit::fit;

/// Cameras whose pictures are learnt from, at most.
const CAMERAS: usize = 128;
/// Steps of a fit.
const STEPS: usize = 400;

/// How many primitives are to be left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fewer {
    /// At least 1.
    Count(usize),
    /// Of all of them, between 0 and 1.
    Share(f64),
}

impl FromStr for Fewer {
    type Err = String;

    /// `N`, or `N%`.
    fn from_str(text: &str) -> Result<Self, String> {
        let found = match text.strip_suffix('%') {
            Some(percent) => percent
                .parse()
                .ok()
                .filter(|percent| *percent > 0.0 && *percent < 100.0)
                .map(|p: f64| Self::Share(p / 100.0)),
            None => text.parse().ok().filter(|count| *count > 0).map(Self::Count),
        };
        found.ok_or_else(|| "write a number of primitives from 1, or a share such as 50%".to_owned())
    }
}

impl Fewer {
    /// As a share of `all` primitives, at most 1.
    fn of(self, all: usize) -> f64 {
        match self {
            Self::Count(count) => (count as f64 / all.max(1) as f64).min(1.0),
            Self::Share(share) => share,
        }
    }
}

/// The primitives of `scene` that contribute most to pictures from `cameras`, trained to look there like all of them do.
///
/// # Errors
/// [`TrainError`] if a picture cannot be rendered or learnt from.
pub fn consolidate(
    scene: &SceneData,
    fewer: Fewer,
    cameras: &[Camera],
    device: &Device,
) -> Result<SceneData, TrainError> {
    let share = fewer.of(scene.surfels.len() + scene.gaussians.len());
    let cameras: Vec<Camera> = cameras.iter().step_by(cameras.len().div_ceil(CAMERAS).max(1)).copied().collect();
    let kept = Contributions::measure(scene, &cameras, device)?.keep_heaviest(scene, share);
    let renderer = Renderer::new(scene, device);
    let view = |(number, camera): (usize, &Camera)| {
        let planes = tensor_to_rows(renderer.render(camera)?.image());
        let photograph = Picture::from_planes(&planes, camera.width, camera.height).into();
        Ok(View { name: format!("view_{number:03}"), camera: *camera, photograph, depth: None, face: None })
    };
    let views = cameras.iter().enumerate().map(view).collect::<dpges_core::Result<Vec<View>>>()?;
    fit(&kept, &views, STEPS, device)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_a_number_or_a_share() {
        assert_eq!(("1200".parse(), "50%".parse()), (Ok(Fewer::Count(1200)), Ok(Fewer::Share(0.5))));
        assert_eq!(
            [Fewer::Count(50), Fewer::Count(500), Fewer::Share(0.25)].map(|fewer| fewer.of(200)),
            [0.25, 1.0, 0.25]
        );
        for wrong in ["0", "-1", "0%", "100%", "nan%", "half", "1.5", ""] {
            assert!(wrong.parse::<Fewer>().unwrap_err().contains("such as 50%"), "{wrong}");
        }
    }
}

//! Views after something was fitted to their left halves, measured on their right halves: the fit has not seen what is
//! measured.

use std::ops::Range;

use burn::tensor::{Device, Tensor};
use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::losses::{Mask, Target};

use super::LARGEST_PSNR;
use super::pose_fit::fitted_pose;
use crate::dataset::{Picture, View};
use crate::eval::rendered::TrainingRenderer;
use crate::metrics::{Fitted, mean_ssim, psnr, quantised};
use crate::views::exposure::Correction;
use crate::views::target::ToTarget;

/// How well the right half of `image` shows that of `picture`, both [3, H, W], with the exposure that fits their left halves.
/// Only pixels that count are in either, of `counted` [H × W] or all of them.
pub fn fitted(picture: &Tensor<3>, counted: Option<&[bool]>, image: &Tensor<3>) -> Result<Fitted> {
    let [psnr_fitted, ssim_fitted] = of_right_half(picture, counted, image, true)?;
    Ok(Fitted { psnr_fitted, ssim_fitted, ..Fitted::default() })
}

/// PSNR and SSIM of the right half of `view` from the camera that fits the left half of its `picture`, and with the
/// `exposure` that does, in every step of the fit too, if that is wanted; `None` if either half has no pixel that counts.
pub fn posed(
    renderer: &TrainingRenderer,
    view: &View,
    picture: &Picture,
    extent: f64,
    exposure: bool,
) -> Result<[Option<f64>; 2]> {
    let (device, width, counted) = (renderer.device(), picture.width, picture.counted.as_deref());
    let is_left = |pixel: usize| pixel % width < width / 2 && counted.is_none_or(|counted| counted[pixel]);
    let left: Vec<bool> = (0..picture.area()).map(is_left).collect();
    if !left.contains(&true) {
        return Ok([None; 2]);
    }
    let target = |device: &Device| -> Result<Target> {
        let mask = Some(Mask::new(&left, width, picture.height, device)?);
        Ok(Target { mask, ..picture.target(device) })
    };
    let photograph = quantised(picture.target(device).image);
    let exposed = |image: Tensor<3>| {
        if !exposure {
            return image;
        }
        Correction::fitted(&image.clone().inner(), &photograph, Some(&left)).applied(image)
    };
    let correction = fitted_pose(renderer, &view.camera, target, exposed, extent, device)?;
    let pose = correction.applied(&view.camera.camera_from_world);
    let rendered = renderer.render(&Camera { camera_from_world: pose, ..view.camera })?;
    of_right_half(&photograph, counted, rendered.image(), exposure)
}

/// PSNR and SSIM of the right half of `image`, as [`fitted`] has them, with or without the `exposure` that fits the left half;
/// `None` if either half has no pixel that counts.
fn of_right_half(
    picture: &Tensor<3>,
    counted: Option<&[bool]>,
    image: &Tensor<3>,
    exposure: bool,
) -> Result<[Option<f64>; 2]> {
    let [_, height, width] = picture.dims();
    let (left, right) = (0..width / 2, width / 2..width);
    let part = |of: &Tensor<3>, columns: &Range<usize>| of.clone().slice([0..3, 0..height, columns.clone()]);
    let counted_in = |columns: &Range<usize>| -> Vec<bool> {
        let counts = |pixel: usize| counted.is_none_or(|counted| counted[pixel]);
        (0..height).flat_map(|row| columns.clone().map(move |column| row * width + column)).map(counts).collect()
    };
    let (fitted_to, judged_by) = (counted_in(&left), counted_in(&right));
    if !fitted_to.contains(&true) || !judged_by.contains(&true) {
        return Ok([None; 2]);
    }
    let shown = part(image, &right);
    let image = quantised(if exposure {
        Correction::fitted(&part(image, &left), &part(picture, &left), Some(&fitted_to)).applied(shown)
    } else {
        shown
    });
    let mask = counted.map(|_| Mask::new(&judged_by, right.len(), height, &image.device())).transpose()?;
    let target = Target { image: part(picture, &right), mask };
    let psnr = psnr(image.clone(), target.clone()).min(LARGEST_PSNR);
    Ok([Some(psnr), Some(mean_ssim(image, target)?)])
}

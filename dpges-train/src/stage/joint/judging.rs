//! The views by which an automatic budget decides, and what renders of them are compared with.

use burn::tensor::Tensor;
use dpges_core::losses::Target;

use super::super::Context;
use crate::dataset::{Picture, View};
use crate::views::exposure::Correction;

/// Enough to see most primitives several times.
const JUDGING_VIEWS: usize = 24;

/// The views that decide: validation views, or else training views, evenly spread.
pub fn judging_views(context: &Context) -> impl Iterator<Item = &View> {
    let (validation, train) = (&context.dataset.validation, &context.dataset.train);
    let views = if validation.is_empty() { train } else { validation };
    views.iter().step_by(views.len().div_ceil(JUDGING_VIEWS).max(1))
}

/// The photograph of a judging view on the device. In a run that corrects exposures, without what the exposure that fits
/// best explains of its difference from the rendered `image` [3, H, W]: validation views have no correction of their own.
pub fn judging_target(picture: &Picture, image: &Tensor<3>, context: &Context) -> Target {
    let Target { image: photograph, mask } = picture.target(&context.device);
    if !context.exposure.is_on() {
        return Target { image: photograph, mask };
    }
    let correction = Correction::fitted(image, &photograph, picture.counted.as_deref());
    Target { image: correction.undone(photograph), mask }
}

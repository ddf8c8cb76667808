//! Cases of Gaussians that are blended: in the order of each pixel's own ray (StopThePop), or, met without a projection, as
//! a core and a tail (HTGS).

use burn::tensor::{DType, Device};

use super::{Deviation, Found, GoldenCase, golden_name, values};
use crate::ops::blend::{BlendOptions, Form};
use crate::render::blended::{BlendedOptions, BlendedRender, render_blended};
use crate::scene::schema::Columns;
use crate::scene::{BlendOrder, Gaussians, HIGHEST_ALPHA, ScreenFilter, Transparency};

/// In the order of the generator's.
const TRANSPARENCIES: [Transparency; 4] =
    [Transparency::Hybrid, Transparency::Nearest, Transparency::Sorted, Transparency::Tail];

impl GoldenCase {
    /// Renders a case without surfels in the order of rays, and compares every output and gradient that the file holds.
    pub fn compare_by_rays(&self, device: &Device, dtype: DType) -> Vec<Deviation> {
        let (filter, order) = (ScreenFilter::Plain, BlendOrder::Rays);
        let options = BlendOptions { filter, order, max_alpha: 0.99, maps: true, ..BlendOptions::default() };
        self.compare_blended(options, device, dtype)
    }

    /// The same without a projection.
    pub fn compare_whitened(&self, device: &Device, dtype: DType) -> Vec<Deviation> {
        let transparency = TRANSPARENCIES[self.arrays.array("transparency").values[0] as usize];
        let (form, order) = (Form::Whitened, BlendOrder::Whitened(transparency));
        let options = BlendOptions { form, order, max_alpha: HIGHEST_ALPHA, maps: true, ..BlendOptions::default() };
        self.compare_blended(options, device, dtype)
    }

    fn compare_blended(&self, blend: BlendOptions, device: &Device, dtype: DType) -> Vec<Deviation> {
        let device = device.clone().autodiff();
        let mut found = Found { case: self, deviations: Vec::new() };
        let gaussians = self.columns::<Gaussians>(&device, dtype).require_grad();
        let options = BlendedOptions { blend, background: self.options.background };
        let rendered = render_blended(&gaussians, &self.camera, &options);
        let BlendedRender { image, blend } = rendered.expect("golden inputs are valid");
        found.image("out.image", &image);
        found.compare("out.alpha", &values(&blend.alpha));
        found.compare("out.depth", &values(&blend.maps.expect("asked for").depth));
        let gradients = (image * self.arrays.image("upstream", &device, dtype)).sum().backward();
        let model = gaussians.model();
        let drawn = gaussians.iter().filter(|(attribute, _)| attribute.learns() && !attribute.is_left_out(model));
        for (attribute, tensor) in drawn {
            let gradient = values(&tensor.grad(&gradients).expect("it was rendered"));
            found.compare(&format!("grad_image.{}", golden_name(attribute)), &gradient);
        }
        found.deviations
    }
}

//! Cases of weighted sums.

use burn::tensor::{DType, Device};

use super::{Deviation, Found, GoldenCase, gradient, values};
use crate::render::summed::{SummedOptions, WeightedSumTensors, render_summed};
use crate::scene::schema::Columns;
use crate::scene::{ColourModel, Gaussians};

const MODEL: ColourModel = ColourModel::HarmonicsAndOpacity { degree: 3 };

impl GoldenCase {
    /// Renders a case of a weighted sum, and compares the image and every gradient that the file holds.
    pub fn compare_summed(&self, device: &Device, dtype: DType) -> Vec<Deviation> {
        let device = device.clone().autodiff();
        let mut found = Found { case: self, deviations: Vec::new() };
        let columns = Gaussians::ATTRIBUTES.iter().map(|attribute| {
            let rows = self.arrays.rows(attribute.name, &device, dtype);
            rows.reshape(attribute.shape(self.arrays.array("gaussians.opacities").shape[0], MODEL))
        });
        let gaussians = Gaussians::generate(MODEL, columns).require_grad();
        let common = self.arrays.rows("common", &device, dtype).require_grad();
        let number = |at: usize| common.clone().slice([at..at + 1, 0..1]);
        let sum = WeightedSumTensors { sigma: number(0), beta: number(1), background: number(2) };
        let weight = self.weight.expect("a case of a weighted sum");
        let options = SummedOptions { weight, background: self.options.background, depth: false };
        let view = render_summed(&gaussians, &sum, &self.camera, &options);
        let view = view.expect("golden inputs are valid");
        found.image("out.image", &view.image);
        found.compare("out.alpha", &values(&view.alpha));
        let gradients = (view.image * self.arrays.image("upstream", &device, dtype)).sum().backward();
        let named = gaussians.iter().map(|(attribute, leaf)| (attribute.name, leaf)).chain([("common", &common)]);
        for (name, leaf) in named {
            found.compare(&format!("grad_image.{name}"), &gradient(leaf, &gradients));
        }
        found.deviations
    }
}

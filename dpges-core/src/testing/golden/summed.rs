//! Golden cases of weighted sums.

use std::path::Path;

use burn::tensor::{DType, Device};

use super::{Arrays, Deviation, File, values};
use crate::camera::Camera;
use crate::render::Values;
use crate::render::blended::Probes;
use crate::render::summed::{SummedOptions, WeightedSumTensors, render_summed};
use crate::scene::schema::Columns;
use crate::scene::{ColourModel, DepthWeight, Gaussians};

const MODEL: ColourModel = ColourModel::HarmonicsAndOpacity { degree: 3 };

/// One case.
pub struct SummedCase {
    arrays: Arrays,
    camera: Camera,
    options: SummedOptions,
}

impl SummedCase {
    /// # Errors
    /// A message naming the file and what is missing or malformed.
    pub fn load(path: &Path) -> Result<Self, String> {
        let origin = path.display().to_string();
        let bytes = std::fs::read(path).map_err(|e| format!("{origin}: {e}"))?;
        let file = File::parse(&origin, &bytes)?;
        let weight = match file.text("weight")? {
            "dir" => DepthWeight::Direct,
            "exp" => DepthWeight::Exponential,
            "lc" => DepthWeight::Linear,
            other => return Err(format!("{origin}: weight {other}")),
        };
        let options = SummedOptions { weight, background: file.background()?, depth: false };
        Ok(Self { camera: file.camera()?, options, arrays: file.arrays })
    }

    /// The same case with every input rounded to f32.
    #[must_use]
    pub fn rounded_to_f32(mut self) -> Self {
        self.arrays.round(&["gaussians.", "common", "upstream"]);
        self
    }

    /// The same case with one tensor multiplied by `factor`.
    ///
    /// # Panics
    /// If there is no such tensor.
    #[must_use]
    pub fn perturbed(mut self, name: &str, factor: f64) -> Self {
        self.arrays.multiply(name, factor);
        self
    }

    /// Names of the expected values.
    pub fn expected(&self) -> impl Iterator<Item = &str> {
        self.arrays.expected()
    }

    /// Renders the case and compares the image and every gradient that the file holds.
    pub fn compare(&self, device: &Device, dtype: DType) -> Vec<Deviation> {
        let device = device.clone().autodiff();
        let columns = Gaussians::ATTRIBUTES.iter().map(|attribute| {
            let rows = self.arrays.rows(attribute.name, &device, dtype);
            rows.reshape(attribute.shape(self.arrays.array("gaussians.opacities").shape[0], MODEL))
        });
        let gaussians = Gaussians::generate(MODEL, columns).require_grad();
        let common = self.arrays.rows("common", &device, dtype).require_grad();
        let number = |at: usize| common.clone().slice([at..at + 1, 0..1]);
        let sum = WeightedSumTensors { sigma: number(0), beta: number(1), background: number(2) };
        let (probes, camera) = (Probes::default(), &self.camera);
        let view = render_summed(&gaussians, &sum, probes, camera, &self.options, Values::Unknown);
        let view = view.expect("golden inputs are valid");
        let of_image = values(&view.image.clone().permute([1, 2, 0]));
        let mut found = vec![self.arrays.deviation("out.image", &of_image)];
        found.push(self.arrays.deviation("out.alpha", &values(&view.alpha)));
        let gradients = (view.image * self.arrays.image("upstream", &device, dtype)).sum().backward();
        for (name, leaf) in
            gaussians.iter().map(|(attribute, leaf)| (attribute.name, leaf)).chain([("common", &common)])
        {
            let zeros = || vec![0.0; leaf.dims().iter().product()];
            let gradient = leaf.grad(&gradients).map_or_else(zeros, |gradient| values(&gradient));
            found.push(self.arrays.deviation(&format!("grad_image.{name}"), &gradient));
        }
        found.into_iter().flatten().collect()
    }
}

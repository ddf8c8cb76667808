//! Golden cases: inputs, outputs, losses and gradients of the float64 specification of the model, as
//! safetensors files, and their comparison with this crate.

mod blended;
mod summed;

use std::collections::HashMap;
use std::path::Path;

use burn::tensor::{DType, Device, Gradients, Int, Tensor};
use glam::{DMat3, DVec3};
use safetensors::{Dtype, SafeTensors};

use super::compare::relative_l2;
use crate::camera::{Camera, CameraFromWorld};
use crate::counters::transfers::uploaded;
use crate::losses::{self, LossWeights, Losses};
use crate::ops::composite::geometry;
use crate::ops::environment::environment;
use crate::ops::peel::PeelOptions;
use crate::ops::photometric::ssim;
use crate::render::{Render, RenderOptions, render};
use crate::scene::schema::{Attribute, Columns, ENVIRONMENT, Width};
use crate::scene::{ColourModel, DepthWeight, Footprint, Gaussians, Peeling, Surfels};

struct Array {
    shape: Vec<usize>,
    values: Vec<f64>,
}

struct Arrays(HashMap<String, Array>);

impl Arrays {
    fn array(&self, name: &str) -> &Array {
        self.0.get(name).unwrap_or_else(|| panic!("golden case has no tensor `{name}`"))
    }

    fn rows(&self, name: &str, device: &Device, dtype: DType) -> Tensor<2> {
        let array = self.array(name);
        let count = array.shape[0];
        let width = array.shape[1..].iter().product();
        uploaded(array.values.clone(), [count, width], device, dtype)
    }

    /// [H, W, C] in the file to [C, H, W].
    fn image(&self, name: &str, device: &Device, dtype: DType) -> Tensor<3> {
        let array = self.array(name);
        let shape: [usize; 3] = array.shape.clone().try_into().expect("an image has three axes");
        uploaded(array.values.clone(), shape, device, dtype).permute([2, 0, 1])
    }

    /// How far `found` is from what the file says, if it says something.
    fn deviation(&self, name: &str, found: &[f64]) -> Option<Deviation> {
        let expected = self.0.get(name)?;
        Some(Deviation { tensor: name.to_owned(), distance: relative_l2(found, &expected.values), is_id: false })
    }
}

struct File<'a> {
    /// Its name in messages.
    origin: &'a str,
    arrays: Arrays,
    metadata: HashMap<String, String>,
}

impl<'a> File<'a> {
    fn parse(origin: &'a str, bytes: &[u8]) -> Result<Self, String> {
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| format!("{origin}: {e}"))?;
        let file = SafeTensors::deserialize(bytes).map_err(|e| format!("{origin}: {e}"))?;
        let mut arrays = HashMap::new();
        for (name, view) in file.iter() {
            let numbers: Vec<f64> = match view.dtype() {
                Dtype::F64 => view.data().as_chunks().0.iter().map(|&b| f64::from_le_bytes(b)).collect(),
                Dtype::I32 => view.data().as_chunks().0.iter().map(|&b| f64::from(i32::from_le_bytes(b))).collect(),
                other => return Err(format!("{origin}: {name} has element type {other:?}")),
            };
            arrays.insert(name.to_owned(), Array { shape: view.shape().to_vec(), values: numbers });
        }
        let metadata = header.metadata().clone().ok_or_else(|| format!("{origin}: no metadata"))?;
        Ok(Self { origin, arrays: Arrays(arrays), metadata })
    }

    fn text(&self, key: &str) -> Result<&str, String> {
        let text = self.metadata.get(key).map(String::as_str);
        text.ok_or_else(|| format!("{}: no metadata `{key}`", self.origin))
    }

    fn number(&self, key: &str) -> Result<f64, String> {
        self.text(key)?.parse::<f64>().map_err(|e| format!("{}: {key}: {e}", self.origin))
    }

    fn values(&self, name: &str) -> Result<&[f64], String> {
        let array = self.arrays.0.get(name).map(|array| array.values.as_slice());
        array.ok_or_else(|| format!("{}: no tensor `{name}`", self.origin))
    }

    fn background(&self) -> Result<[f64; 3], String> {
        self.values("background")?.try_into().map_err(|_| format!("{}: background", self.origin))
    }

    fn peel(&self) -> Result<PeelOptions, String> {
        Ok(PeelOptions {
            layer_count: self.number("layer_count")? as usize,
            modulation: self.number("modulation")?,
            footprint: if self.text("footprint")? == "opacity" { Footprint::Opacity } else { Footprint::Kernel },
            peeling: match self.text("peeling")? {
                "nearest" => Peeling::Nearest,
                "literal" => Peeling::Literal,
                _ => Peeling::Continuous,
            },
        })
    }

    /// How a weighted sum weighs; `None` of another case.
    fn weight(&self) -> Result<Option<DepthWeight>, String> {
        match self.metadata.get("weight").map(String::as_str) {
            None => Ok(None),
            Some("dir") => Ok(Some(DepthWeight::Direct)),
            Some("exp") => Ok(Some(DepthWeight::Exponential)),
            Some("lc") => Ok(Some(DepthWeight::Linear)),
            Some(other) => Err(format!("{}: weight {other}", self.origin)),
        }
    }

    fn camera(&self) -> Result<Camera, String> {
        let camera_from_world = CameraFromWorld {
            rotation: DMat3::from_cols_slice(self.values("camera.rotation")?).transpose(),
            translation: DVec3::from_slice(self.values("camera.translation")?),
        };
        let &[fx, fy, cx, cy] = self.values("camera.intrinsics")? else {
            return Err(format!("{}: camera.intrinsics", self.origin));
        };
        let [width, height] = [self.number("width")? as usize, self.number("height")? as usize];
        Ok(Camera { camera_from_world, fx, fy, cx, cy, width, height, near: self.number("near")?, lens: None })
    }
}

pub struct GoldenCase {
    arrays: Arrays,
    camera: Camera,
    /// Options of a peeled scene; those of any other have its background only.
    options: RenderOptions,
    /// Of a weighted sum.
    weight: Option<DepthWeight>,
}

/// How far one tensor is from its golden values.
#[derive(Debug, Clone)]
pub struct Deviation {
    pub tensor: String,
    /// Relative L2 distance; for layer ids the number of pixels that differ although their depths do not tie.
    pub distance: f64,
    pub is_id: bool,
}

/// Tensors of one case on one device.
struct Inputs {
    surfels: Surfels,
    gaussians: Gaussians,
    /// [16, 3]
    environment: Option<Tensor<2>>,
    upstream: Tensor<3>,
    target: Tensor<3>,
}

impl GoldenCase {
    pub fn load(path: &Path) -> Result<Self, String> {
        let bytes = std::fs::read(path).map_err(|e| format!("{}: {e}", path.display()))?;
        Self::from_bytes(&path.display().to_string(), &bytes)
    }

    /// From the content of a file, `origin` being what messages call it.
    pub fn from_bytes(origin: &str, bytes: &[u8]) -> Result<Self, String> {
        let file = File::parse(origin, bytes)?;
        let (camera, weight) = (file.camera()?, file.weight()?);
        let peel = if weight.is_some() { PeelOptions::default() } else { file.peel()? };
        let options = RenderOptions { peel, background: file.background()?, ..RenderOptions::default() };
        Ok(Self { arrays: file.arrays, camera, options, weight })
    }

    /// The same case with every input rounded to f32: what f32 can be expected to reproduce is no
    /// nearer than this, since a nearly edge-on surfel magnifies the rounding of its parameters.
    #[must_use]
    pub fn rounded_to_f32(mut self) -> Self {
        const INPUTS: [&str; 6] = ["surfels.", "gaussians.", "common", "environment", "upstream", "target"];
        for (name, array) in &mut self.arrays.0 {
            if INPUTS.iter().any(|input| name.starts_with(input)) {
                array.values.iter_mut().for_each(|value| *value = f64::from(*value as f32));
            }
        }
        self
    }

    /// The same case with one tensor multiplied by `factor`.
    #[must_use]
    pub fn perturbed(mut self, name: &str, factor: f64) -> Self {
        let array = self.arrays.0.get_mut(name).unwrap_or_else(|| panic!("golden case has no tensor `{name}`"));
        array.values.iter_mut().for_each(|value| *value *= factor);
        self
    }

    pub fn expected(&self) -> impl Iterator<Item = &str> {
        let is_expected = |name: &&str| ["out.", "loss.", "grad_"].iter().any(|output| name.starts_with(output));
        self.arrays.0.keys().map(String::as_str).filter(is_expected)
    }

    fn columns<C: Columns>(&self, device: &Device, dtype: DType) -> C::With<Tensor<2>> {
        let detail = C::ATTRIBUTES.iter().find(|attribute| attribute.width == Width::Detail).expect("colours have it");
        let model = ColourModel::SphericalBeta { lobes: self.arrays.array(&golden_name(detail)).shape[1] };
        let rows = |attribute: &'static Attribute| {
            if attribute.is_left_out(model) {
                let count = self.arrays.array(&golden_name(&C::ATTRIBUTES[0])).shape[0];
                return attribute.tensor(&[], count, model, device, dtype);
            }
            self.arrays.rows(&golden_name(attribute), device, dtype)
        };
        C::generate(model, C::ATTRIBUTES.iter().map(rows))
    }

    fn environment(&self, device: &Device, dtype: DType) -> Option<Tensor<2>> {
        let name = ENVIRONMENT.name;
        self.arrays.0.contains_key(name).then(|| self.arrays.rows(name, device, dtype).require_grad())
    }

    fn inputs(&self, device: &Device, dtype: DType) -> Inputs {
        Inputs {
            surfels: self.columns::<Surfels>(device, dtype).require_grad(),
            gaussians: self.columns::<Gaussians>(device, dtype).require_grad(),
            environment: self.environment(device, dtype),
            upstream: self.arrays.image("upstream", device, dtype),
            target: self.arrays.image("target", device, dtype),
        }
    }

    /// Renders the case and compares every output, loss and gradient that the file holds.
    pub fn compare(&self, device: &Device, dtype: DType) -> Vec<Deviation> {
        let device = device.clone().autodiff();
        let mut found = Found { case: self, deviations: Vec::new() };
        let inputs = self.inputs(&device, dtype);
        let rendered = self.render(&inputs, false);
        found.outputs(&rendered, &inputs);
        found.losses(&rendered, &inputs);
        let image_loss =
            |inputs: &Inputs, detach| (self.render(inputs, detach).composite.image * inputs.upstream.clone()).sum();
        found.gradients("grad_image", &inputs, &image_loss(&inputs, false).backward());
        let inputs = self.inputs(&device, dtype);
        found.gradients("grad_detached", &inputs, &image_loss(&inputs, true).backward());
        let inputs = self.inputs(&device, dtype);
        found.gradients("grad_total", &inputs, &self.total(&inputs).backward());
        found.deviations
    }

    fn render(&self, inputs: &Inputs, detach_transmittance: bool) -> Render {
        let options = RenderOptions { detach_transmittance, ..self.options };
        let rendered =
            render(&inputs.surfels, &inputs.gaussians, &self.camera, &options).expect("golden inputs are valid");
        match &inputs.environment {
            Some(coefficients) => {
                rendered.in_front_of(environment(coefficients, &self.camera).expect("16 coefficients"))
            }
            None => rendered,
        }
    }

    fn total(&self, inputs: &Inputs) -> Tensor<1> {
        let rendered = self.render(inputs, false);
        if inputs.surfels.is_empty() {
            return losses::rgb(&rendered.composite.image, inputs.target.clone(), 0.2).expect("shapes agree").total;
        }
        self.terms(&rendered, inputs).total
    }

    fn terms(&self, rendered: &Render, inputs: &Inputs) -> Losses {
        let (log_scales, target) = (inputs.surfels.log_scales.clone(), inputs.target.clone());
        losses::losses(rendered, log_scales, target, &LossWeights::default()).expect("shapes agree")
    }
}

/// The values of a tensor as f64, row-major.
pub fn values<const D: usize>(tensor: &Tensor<D>) -> Vec<f64> {
    tensor.clone().into_data().iter::<f64>().collect()
}

/// The gradient with respect to `leaf` as f64, row-major; zeros if nothing reached it.
pub fn gradient<const D: usize>(leaf: &Tensor<D>, gradients: &Gradients) -> Vec<f64> {
    leaf.grad(gradients).map_or_else(|| vec![0.0; leaf.dims().iter().product()], |gradient| values(&gradient))
}

struct Found<'a> {
    case: &'a GoldenCase,
    deviations: Vec<Deviation>,
}

impl Found<'_> {
    fn compare(&mut self, name: &str, found: &[f64]) {
        self.deviations.extend(self.case.arrays.deviation(name, found));
    }

    /// [C, H, W] against [H, W, C] (or [H, W]) in the file.
    fn image(&mut self, name: &str, image: &Tensor<3>) {
        self.compare(name, &values(&image.clone().permute([1, 2, 0])));
    }

    fn outputs(&mut self, rendered: &Render, inputs: &Inputs) {
        let composite = &rendered.composite;
        self.image("out.image", &composite.image);
        self.image("out.surfel_image", &composite.surfel_image);
        self.image("out.weights", &rendered.seen.weights);
        self.image("out.transmittance", &rendered.seen.transmittance);
        self.image("out.gaussian_colour", &composite.gaussian_colour);
        self.image("out.gaussian_weight", &composite.gaussian_weight);
        let shape = geometry(&inputs.surfels, &rendered.layers, &rendered.seen.weights, &self.case.camera);
        self.image("out.surfel_depth", &shape.depth);
        self.image("out.surfel_normal", &shape.normal);
        self.image("out.layers.alpha", &rendered.layers.alpha);
        self.image("out.layers.depth", &rendered.layers.depth);
        self.ids(&rendered.layers.ids);
    }

    /// Counts pixels whose ids differ although no two of the expected depths there tie within f32 rounding.
    fn ids(&mut self, ids: &Tensor<3, Int>) {
        let found: Vec<i64> = ids.clone().permute([1, 2, 0]).into_data().iter::<i64>().collect();
        let expected = &self.case.arrays.array("out.layers.ids").values;
        let depths = &self.case.arrays.array("out.layers.depth").values;
        let layers = self.case.options.peel.layer_count;
        let differing = (0..found.len() / layers).filter(|pixel| {
            let range = pixel * layers..(pixel + 1) * layers;
            let differ = found[range.clone()].iter().zip(&expected[range.clone()]).any(|(&a, &b)| a != b as i64);
            let tie = depths[range].windows(2).any(|d| d[1] - d[0] <= 1e-6 * d[0].abs());
            differ && !tie
        });
        let distance = differing.count() as f64;
        self.deviations.push(Deviation { tensor: "out.layers.ids".into(), distance, is_id: true });
    }

    fn losses(&mut self, rendered: &Render, inputs: &Inputs) {
        let case = self.case;
        self.compare("loss.ssim", &values(&ssim(&rendered.composite.image, &inputs.target).expect("shapes agree")));
        for (name, value) in case.terms(rendered, inputs).terms {
            self.compare(&format!("loss.{name}"), &values(&value));
        }
        self.compare("loss.total", &values(&case.total(inputs)));
    }

    fn gradients(&mut self, prefix: &str, inputs: &Inputs, gradients: &Gradients) {
        let environment = inputs.environment.iter().map(|coefficients| (&ENVIRONMENT, coefficients));
        let all = inputs.surfels.iter().chain(inputs.gaussians.iter()).chain(environment);
        for (attribute, tensor) in all.filter(|(attribute, _)| attribute.learns()) {
            self.compare(&format!("{prefix}.{}", golden_name(attribute)), &gradient(tensor, gradients));
        }
    }
}

/// The name of an attribute in the files, where detail is called lobes.
fn golden_name(attribute: &Attribute) -> String {
    attribute.name.replace(".detail", ".lobes")
}

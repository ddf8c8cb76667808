//! LPIPS: the distance of the features that a network for recognising images finds in two pictures (Zhang, Isola, Efros,
//! Shechtman, Wang: *The Unreasonable Effectiveness of Deep Features as a Perceptual Metric*. CVPR 2018; version 0.1).
//!
//! At five levels of the network the features of each pixel are scaled to length 1; the squared differences of the channels
//! are weighted by a linear layer, averaged over the pixels, and summed over the levels.
//!
//! The weights do not come with the program: [`Weights::load`] reads them from a file, and [`installed`] says where it may be.

pub mod choice;
pub mod installed;
mod network;
#[cfg(test)]
mod tests;
mod weights;

use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, MaxPoolOptions};
use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::Result;
use dpges_core::scene::tensors::check_shape;

use network::{Convolution, linear};
pub use network::{Network, TensorShape};
pub use weights::{LpipsError, Weights};

/// Mean and deviation of the channels of pictures from −1 to 1 that the networks were trained on.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Keeps features of length 0 from dividing by 0.
const EPSILON: f32 = 1e-10;

/// A network on a device.
#[derive(Debug)]
pub struct Lpips {
    pub network: Network,
    layers: Vec<Layer>,
    /// [1, 3, 1, 1]
    shift: Tensor<4>,
    /// [1, 3, 1, 1]
    scale: Tensor<4>,
    /// Factor and summand that pictures from 0 to 1 are given to the network with.
    range: [f32; 2],
}

#[derive(Debug)]
struct Layer {
    convolution: &'static Convolution,
    /// [channels out, channels in, kernel, kernel]
    weight: Tensor<4>,
    /// [channels out]
    bias: Tensor<1>,
    /// [1, channels out, 1, 1], of the squared differences; `None` if the features are not compared.
    linear: Option<Tensor<4>>,
}

impl Lpips {
    /// Uploads `weights` to `device`.
    pub fn new(weights: &Weights, device: &Device) -> Self {
        let mut level = 0;
        let layer = |convolution: &'static Convolution| {
            let Convolution { channels: [from, to], kernel, is_compared, .. } = *convolution;
            let linear = is_compared.then(|| {
                level += 1;
                tensor(weights.values(&linear(level - 1)), [1, to, 1, 1], device)
            });
            Layer {
                convolution,
                weight: tensor(weights.values(&convolution.weight()), [to, from, kernel, kernel], device),
                bias: tensor(weights.values(&convolution.bias()), [to], device),
                linear,
            }
        };
        Self {
            network: weights.network,
            layers: weights.network.convolutions().iter().map(layer).collect(),
            shift: tensor(&SHIFT, [1, 3, 1, 1], device),
            scale: tensor(&SCALE, [1, 3, 1, 1], device),
            range: [2.0, -1.0],
        }
    }

    /// The same network, which takes pictures from 0 to 1 as if they were from −1 to 1. This is what the script that came with
    /// 3DGS does, and most papers on splats report.
    #[must_use]
    pub fn unscaled(self) -> Self {
        Self { range: [1.0, 0.0], ..self }
    }

    /// LPIPS of two pictures [3, H, W] in f32 on the device of the network, display-referred (sRGB) from 0 to 1: 0 if they
    /// are equal. `None` for pictures that are too small, see [`Network::fits`].
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if they differ in shape or have other than three channels.
    pub fn distance(&self, reference: &Tensor<3>, test: &Tensor<3>) -> Result<Option<f64>> {
        let [_, height, width] = reference.dims();
        check_shape("reference", reference, [3, height, width])?;
        check_shape("test", test, [3, height, width])?;
        if !self.network.fits(width, height) {
            return Ok(None);
        }
        let mut features = [reference, test].map(|picture| self.scaled(picture.clone()));
        let mut distance = 0.0;
        for layer in &self.layers {
            features = features.map(|features| layer.forward(features));
            if let Some(linear) = &layer.linear {
                let [a, b] = features.clone().map(unit_length);
                let difference = a - b;
                let [_, _, height, width] = difference.dims();
                let of_pixels = (difference.clone() * difference * linear.clone()).sum_dim(1);
                // in f64, since there are many
                distance += of_pixels.into_data().iter::<f64>().sum::<f64>() / (height * width) as f64;
            }
        }
        Ok(Some(distance))
    }

    /// The input of the first convolution, [1, 3, H, W].
    fn scaled(&self, picture: Tensor<3>) -> Tensor<4> {
        let [factor, summand] = self.range;
        (picture.unsqueeze::<4>() * factor + summand - self.shift.clone()) / self.scale.clone()
    }
}

impl Layer {
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let Convolution { stride, padding, pool, .. } = *self.convolution;
        let input = match pool {
            Some(window) => max_pool2d(input, MaxPoolOptions::new([window; 2]).with_stride([2; 2])),
            None => input,
        };
        let options = ConvOptions::new([stride; 2], [padding; 2], [1; 2], 1);
        relu(conv2d(input, self.weight.clone(), Some(self.bias.clone()), options))
    }
}

/// `features` [1, C, H, W] divided by their length over the channels.
fn unit_length(features: Tensor<4>) -> Tensor<4> {
    let length = (features.clone() * features.clone()).sum_dim(1).sqrt();
    features / (length + EPSILON)
}

fn tensor<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), (device, DType::F32))
}

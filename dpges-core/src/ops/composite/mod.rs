//! `composite`: the image from the surfel layers and the sums of the Gaussians.
//!
//! Weights [K, H, W] and transmittances T [K + 1, H, W] of the layers, ids [K, H, W], surfel colours [N, 3] and sums
//! [K, 4, H, W] → the surfel image `C_s = Σ w_i C_i + T_K C_b`, the Gaussians' `C_G = Σ T_{i−1} X_i` and `W_G = Σ T_{i−1} Y_i`,
//! and the image `C = (C_s + C_G) / (1 + W_G)` (DP-GES). Colour images are [3, H, W], not clamped; the weight is [1, H, W].
//!
//! Gradients: from every output to weights, transmittances, colours and sums. `detach_transmittance` cuts the path from the
//! Gaussians' image to the transmittances. All outputs of a call go back together: a loss of several of them is one
//! `backward`, not one for each.
//!
//! Compositing is an operation because burn-ndarray takes over ten times as long for the same tensor
//! operations (burn-flex does not): see `dpges-train/docs/log/2026-11-24-benchmarks.md`.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
mod geometry;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use crate::error::Result;
use crate::ops::peel::Layers;
use crate::ops::visibility::Visibility;
use crate::scene::tensors::check_shape;

pub(crate) use geometry::uploaded;
pub use geometry::{Geometry, geometry, layer_depth, normals};

/// Options without gradients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompositeOptions {
    /// C_b, display-referred.
    pub background: [f64; 3],
    /// Stop the gradient from the Gaussians to the surfels (ablation).
    pub detach_transmittance: bool,
}

#[derive(ExtensionType, Debug, Clone)]
pub struct CompositeInput<B: Backend> {
    /// [K, H, W]
    pub weights: FloatTensor<B>,
    /// [K + 1, H, W]
    pub transmittance: FloatTensor<B>,
    /// [N, 3]
    pub colours: FloatTensor<B>,
    /// [K, 4, H, W]
    pub sums: FloatTensor<B>,
    /// [K, H, W]
    pub ids: IntTensor<B>,
}

#[derive(ExtensionType, Debug, Clone)]
pub struct CompositeOutput<B: Backend> {
    pub image: FloatTensor<B>,
    pub surfel_image: FloatTensor<B>,
    pub gaussian_colour: FloatTensor<B>,
    pub gaussian_weight: FloatTensor<B>,
}

/// The state for the backward pass.
#[derive(Debug, Clone)]
pub struct CompositeState<B: Backend> {
    input: CompositeInput<B>,
    image: FloatTensor<B>,
    gaussian_weight: FloatTensor<B>,
    options: CompositeOptions,
}

/// Gradients with respect to the outputs, in the order of the fields of [`CompositeOutput`]; `None` where none arrived.
type Grads<B> = [Option<FloatTensor<B>>; 4];

/// The outputs for which gradients have arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Reached {
    image: bool,
    surfel_image: bool,
    gaussian_colour: bool,
    gaussian_weight: bool,
}

impl Reached {
    fn new<B: Backend>(grads: &Grads<B>) -> Self {
        let [image, surfel_image, gaussian_colour, gaussian_weight] = grads.each_ref().map(Option::is_some);
        Self { image, surfel_image, gaussian_colour, gaussian_weight }
    }

    /// Whether gradients go on to the weights and colours of surfels.
    fn surfels(self) -> bool {
        self.image || self.surfel_image
    }

    /// Whether gradients go on to the sums of Gaussians.
    fn sums(self) -> bool {
        self.image || self.gaussian_colour || self.gaussian_weight
    }
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait CompositeOps: Backend {
    fn composite(#[extension_type] input: CompositeInput<Self>, options: CompositeOptions) -> CompositeOutput<Self>;
}

/// A composited view.
#[derive(Clone, Debug)]
pub struct Composite {
    /// [3, H, W] C
    pub image: Tensor<3>,
    /// [3, H, W] C_s
    pub surfel_image: Tensor<3>,
    /// [3, H, W] C_G
    pub gaussian_colour: Tensor<3>,
    /// [1, H, W] W_G
    pub gaussian_weight: Tensor<3>,
}

impl Composite {
    /// The same view with an [`environment`](mod@crate::ops::environment) [3, H, W] behind everything, which adds to the
    /// background where T_K [1, H, W] is `open`: `T_K E` to the surfel image, `T_K E / (1 + W_G)` to the image.
    #[must_use]
    pub fn in_front_of(mut self, environment: Tensor<3>, open: Tensor<3>) -> Self {
        let behind = open * environment;
        self.image = self.image + behind.clone() / (self.gaussian_weight.clone() + 1.0);
        self.surfel_image = self.surfel_image + behind;
        self
    }
}

/// Composites `layers` by what is `seen` of them, surfel `colours` [N, 3] and Gaussian `sums` [K, 4, H, W].
///
/// # Errors
/// [`crate::Error::Shape`] if the tensors do not fit each other.
pub fn composite(
    layers: &Layers,
    seen: &Visibility,
    colours: &Tensor<2>,
    sums: &Tensor<4>,
    options: &CompositeOptions,
) -> Result<Composite> {
    let [count, height, width] = layers.ids.dims();
    check_shape("layer weights", &seen.weights, [count, height, width])?;
    check_shape("transmittance", &seen.transmittance, [count + 1, height, width])?;
    check_shape("sums", sums, [count, 4, height, width])?;
    check_shape("surfel colours", colours, [colours.dims()[0], 3])?;
    let input = CompositeInput {
        weights: seen.weights.clone().into_dispatch(),
        transmittance: seen.transmittance.clone().into_dispatch(),
        colours: colours.clone().into_dispatch(),
        sums: sums.clone().into_dispatch(),
        ids: layers.ids.clone().into_dispatch(),
    };
    let out = Dispatch::composite(input, *options);
    Ok(Composite {
        image: Tensor::from_dispatch(out.image),
        surfel_image: Tensor::from_dispatch(out.surfel_image),
        gaussian_colour: Tensor::from_dispatch(out.gaussian_colour),
        gaussian_weight: Tensor::from_dispatch(out.gaussian_weight),
    })
}

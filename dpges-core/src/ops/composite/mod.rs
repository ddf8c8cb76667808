//! `composite`: the image from the surfel layers and the sums of the Gaussians.
//!
//! Opacities [K, H, W], ids [K, H, W], surfel colours [N, 3] and sums [K, 4, H, W] →
//! `T_i = Π_{j≤i} (1 − A_j)` [K + 1, H, W] with T_0 = 1, the surfel image
//! `C_s = Σ A_i T_{i−1} C_i + T_K C_b`, the Gaussians' `C_G = Σ T_{i−1} X_i` and `W_G = Σ T_{i−1} Y_i`,
//! and the image `C = (C_s + C_G) / (1 + W_G)` (DP-GES). Colour images are [3, H, W],
//! not clamped; the weight is [1, H, W].
//!
//! Gradients: from every output to opacities, colours and sums, without a division by 1 − A or T, which are
//! exactly 0 behind an opaque layer. `detach_transmittance` cuts the path from the Gaussians' image to the
//! opacities. All outputs of a call go back together: a loss of several of them is one `backward`, not one for each.
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
use crate::scene::tensors::check_shape;

pub(crate) use geometry::uploaded;
pub use geometry::{Geometry, geometry, layer_depth, layer_weights};

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
    pub alpha: FloatTensor<B>,
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
    pub transmittance: FloatTensor<B>,
    pub gaussian_colour: FloatTensor<B>,
    pub gaussian_weight: FloatTensor<B>,
}

/// The state for the way back.
#[derive(Debug, Clone)]
pub struct CompositeState<B: Backend> {
    input: CompositeInput<B>,
    image: FloatTensor<B>,
    gaussian_weight: FloatTensor<B>,
    options: CompositeOptions,
}

/// Gradients with respect to the outputs in the order of `OutputKind`; `None` where none arrived.
pub type OutputGradients<B> = [Option<FloatTensor<B>>; 5];

/// In the order of the fields of [`CompositeOutput`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OutputKind {
    Image,
    SurfelImage,
    Transmittance,
    GaussianColour,
    GaussianWeight,
}

/// The outputs for which gradients have arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Reached {
    image: bool,
    surfel_image: bool,
    transmittance: bool,
    gaussian_colour: bool,
    gaussian_weight: bool,
}

impl Reached {
    fn new<B: Backend>(grads: &OutputGradients<B>) -> Self {
        let [image, surfel_image, transmittance, gaussian_colour, gaussian_weight] =
            grads.each_ref().map(Option::is_some);
        Self { image, surfel_image, transmittance, gaussian_colour, gaussian_weight }
    }

    /// Whether gradients go on to the colours of surfels.
    fn colours(self) -> bool {
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

pub trait CompositeBackwardOps: Backend {
    /// Gradients with respect to opacities, colours and sums; `None` of those that no output with a gradient reaches.
    fn composite_backward(state: CompositeState<Self>, grads: OutputGradients<Self>) -> [Option<FloatTensor<Self>>; 3];
}

/// A composited view.
#[derive(Clone, Debug)]
pub struct Composite {
    /// [3, H, W] C
    pub image: Tensor<3>,
    /// [3, H, W] C_s
    pub surfel_image: Tensor<3>,
    /// [K + 1, H, W] T_0 = 1 … T_K
    pub transmittance: Tensor<3>,
    /// [3, H, W] C_G
    pub gaussian_colour: Tensor<3>,
    /// [1, H, W] W_G
    pub gaussian_weight: Tensor<3>,
}

impl Composite {
    /// The same view with an [`environment`](mod@crate::ops::environment) [3, H, W] behind everything, which adds to the
    /// background: `T_K E` to the surfel image, `T_K E / (1 + W_G)` to the image.
    #[must_use]
    pub fn in_front_of(mut self, environment: Tensor<3>) -> Self {
        let [planes, height, width] = self.transmittance.dims();
        let open = self.transmittance.clone().slice([planes - 1..planes, 0..height, 0..width]);
        let behind = open * environment;
        self.image = self.image + behind.clone() / (self.gaussian_weight.clone() + 1.0);
        self.surfel_image = self.surfel_image + behind;
        self
    }
}

/// Composites `layers`, surfel `colours` [N, 3] and Gaussian `sums` [K, 4, H, W].
///
/// # Errors
/// [`crate::Error::Shape`] if the tensors do not fit each other.
pub fn composite(
    layers: &Layers,
    colours: &Tensor<2>,
    sums: &Tensor<4>,
    options: &CompositeOptions,
) -> Result<Composite> {
    let [count, height, width] = layers.alpha.dims();
    check_shape("sums", sums, [count, 4, height, width])?;
    check_shape("surfel colours", colours, [colours.dims()[0], 3])?;
    let input = CompositeInput {
        alpha: layers.alpha.clone().into_dispatch(),
        colours: colours.clone().into_dispatch(),
        sums: sums.clone().into_dispatch(),
        ids: layers.ids.clone().into_dispatch(),
    };
    let out = Dispatch::composite(input, *options);
    Ok(Composite {
        image: Tensor::from_dispatch(out.image),
        surfel_image: Tensor::from_dispatch(out.surfel_image),
        transmittance: Tensor::from_dispatch(out.transmittance),
        gaussian_colour: Tensor::from_dispatch(out.gaussian_colour),
        gaussian_weight: Tensor::from_dispatch(out.gaussian_weight),
    })
}

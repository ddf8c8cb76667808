//! Gaussians as operations take them: one tensor for each attribute, or rows in host memory.

use std::borrow::Cow;

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, ExtensionType};
use burn::tensor::Tensor;
use pulp::Simd;

use super::cpu::Parameters;
use crate::backend::host::{self, Host};
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::backend::vectors::MOST;
use crate::error::Result;
use crate::math::{V3, row};
use crate::scene::Gaussians;
use crate::scene::tensors::{check_shape, flat};

/// Gaussians, or the gradients with respect to them.
#[derive(ExtensionType, Debug, Clone)]
pub struct GaussianTensors<B: Backend> {
    /// [M, 3] world units
    pub positions: FloatTensor<B>,
    /// [M, 4]
    pub quaternions: FloatTensor<B>,
    /// [M, 3]
    pub log_scales: FloatTensor<B>,
    /// `[M]`
    pub opacities: FloatTensor<B>,
    /// [M, 3] as seen from the camera
    pub colours: FloatTensor<B>,
}

impl GaussianTensors<Dispatch> {
    /// `gaussians` in `colours` [M, 3].
    ///
    /// # Errors
    /// [`crate::Error::Shape`] naming the tensor that does not fit the others.
    pub fn new(gaussians: &Gaussians, colours: &Tensor<2>) -> Result<Self> {
        gaussians.check_shapes()?;
        check_shape("gaussian colours", colours, [gaussians.len(), 3])?;
        Ok(Self {
            positions: gaussians.positions.clone().into_dispatch(),
            quaternions: gaussians.quaternions.clone().into_dispatch(),
            log_scales: gaussians.log_scales.clone().into_dispatch(),
            opacities: flat(&gaussians.opacities).into_dispatch(),
            colours: colours.clone().into_dispatch(),
        })
    }
}

impl<B: Backend> GaussianTensors<B> {
    /// In the order of the fields.
    pub fn into_array(self) -> [FloatTensor<B>; 5] {
        [self.positions, self.quaternions, self.log_scales, self.opacities, self.colours]
    }

    /// In the order of the fields.
    pub fn from_array([positions, quaternions, log_scales, opacities, colours]: [FloatTensor<B>; 5]) -> Self {
        Self { positions, quaternions, log_scales, opacities, colours }
    }
}

impl<B: Backend, S: CheckpointStrategy> GaussianTensors<Autodiff<B, S>> {
    /// The same tensors off the tape.
    pub fn values(&self) -> GaussianTensors<B> {
        GaussianTensors::from_array(self.clone().into_array().map(|tensor| tensor.into_parts().0))
    }
}

impl<B: Host> GaussianTensors<B> {
    /// From row-major values in the order of the fields.
    pub fn from_rows<T: Real>(
        [positions, quaternions, log_scales, opacities, colours]: [Vec<T>; 5],
        device: &B::Device,
    ) -> Self {
        let count = opacities.len();
        Self {
            positions: host::float_tensor::<B, T, 2>(positions, [count, 3], device),
            quaternions: host::float_tensor::<B, T, 2>(quaternions, [count, 4], device),
            log_scales: host::float_tensor::<B, T, 2>(log_scales, [count, 3], device),
            opacities: host::float_tensor::<B, T, 1>(opacities, [count], device),
            colours: host::float_tensor::<B, T, 2>(colours, [count, 3], device),
        }
    }
}

#[cfg(feature = "gpu")]
impl GaussianTensors<burn_cubecl::CubeBackend> {
    /// Uninitialised tensors of `count` Gaussians on the device of `like`.
    pub fn empty(like: &burn_cubecl::tensor::CubeTensor, count: usize) -> Self {
        use crate::gpu::launch::empty_f32;
        Self {
            positions: empty_f32(like, [count, 3]),
            quaternions: empty_f32(like, [count, 4]),
            log_scales: empty_f32(like, [count, 3]),
            opacities: empty_f32(like, [count]),
            colours: empty_f32(like, [count, 3]),
        }
    }

    /// Row-major f32 tensors for kernels.
    pub fn contiguous(self) -> Self {
        Self::from_array(self.into_array().map(crate::gpu::launch::floats))
    }
}

/// Parameters of all Gaussians, row-major.
pub struct GaussianRows<'a, T: Real> {
    positions: Cow<'a, [T]>,
    quaternions: Cow<'a, [T]>,
    log_scales: Cow<'a, [T]>,
    opacities: Cow<'a, [T]>,
    colours: Cow<'a, [T]>,
    /// Empty for Gaussian kernels.
    degrees_of_freedom: Cow<'a, [T]>,
}

impl<'a, T: Real> GaussianRows<'a, T> {
    pub fn new<B: Host>(tensors: &'a GaussianTensors<B>) -> Self {
        Self {
            positions: host::floats::<B, T>(&tensors.positions),
            quaternions: host::floats::<B, T>(&tensors.quaternions),
            log_scales: host::floats::<B, T>(&tensors.log_scales),
            opacities: host::floats::<B, T>(&tensors.opacities),
            colours: host::floats::<B, T>(&tensors.colours),
            degrees_of_freedom: Cow::Borrowed(&[]),
        }
    }

    /// The same with Student's t kernels, unless `degrees_of_freedom` are `[0]`.
    pub fn with_kernels<B: Host>(self, degrees_of_freedom: &'a FloatTensor<B>) -> Self {
        Self { degrees_of_freedom: host::floats::<B, T>(degrees_of_freedom), ..self }
    }

    pub fn len(&self) -> usize {
        self.opacities.len()
    }

    pub fn parameters(&self, i: usize) -> Parameters<T> {
        Parameters {
            position: row(&self.positions, i),
            quaternion: row(&self.quaternions, i),
            log_scales: row(&self.log_scales, i),
            opacity: self.opacities[i],
            // a Gaussian is the limit of Student's t kernels
            degrees_of_freedom: self.degrees_of_freedom.get(i).copied().unwrap_or(T::INFINITY),
        }
    }

    pub fn colour(&self, i: usize) -> V3<T> {
        row(&self.colours, i)
    }

    /// Gaussian kernels at `rows`, one in each lane.
    #[inline(always)]
    pub fn parameters_in_lanes<S: Simd>(&self, simd: S, rows: &[usize; MOST]) -> Parameters<Lanes<T, S>> {
        let [opacity] = Lanes::from_rows(simd, |lane| [self.opacities[rows[lane]]]);
        Parameters {
            position: Lanes::from_rows(simd, |lane| row(&self.positions, rows[lane])),
            quaternion: Lanes::from_rows(simd, |lane| row(&self.quaternions, rows[lane])),
            log_scales: Lanes::from_rows(simd, |lane| row(&self.log_scales, rows[lane])),
            opacity,
            degrees_of_freedom: Lanes::splat(simd, T::INFINITY),
        }
    }

    /// Colours at `rows`, one in each lane.
    #[inline(always)]
    pub fn colours_in_lanes<S: Simd>(&self, simd: S, rows: &[usize; MOST]) -> V3<Lanes<T, S>> {
        Lanes::from_rows(simd, |lane| row(&self.colours, rows[lane]))
    }
}

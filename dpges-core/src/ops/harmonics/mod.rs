//! `harmonics`: one number of every primitive that depends on the direction it is seen from.
//!
//! Base [N, 1], detail [N, C − 1] and positions [N, 3] → `C0 k0 + Σ k_i Y_i(d)` [N, 1], the sum of spherical harmonics up to
//! the degree that has C = (degree + 1)² coefficients, 0 to 3 (3DGS). d is the unit vector from the camera to the
//! primitive, in world axes. Opacities of weighted sums have such a factor.
//!
//! Gradients: to base and detail. The direction passes none to the position, as in [`colour`](mod@super::colour).

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

use crate::error::{Error, Result};
use crate::scene::EnvironmentData;
use crate::scene::tensors::check_shape;

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait HarmonicsOps: Backend {
    fn harmonics(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
    ) -> FloatTensor<Self>;
}

/// Values [N, 1] of primitives at `positions` [N, 3] seen from `centre`, world units, for coefficients `base` [N, 1] and
/// `detail` [N, C − 1].
///
/// # Errors
/// [`Error::Shape`] if the tensors do not fit each other, or no degree has so many coefficients.
pub fn harmonics(base: &Tensor<2>, detail: &Tensor<2>, positions: &Tensor<2>, centre: [f64; 3]) -> Result<Tensor<2>> {
    let [count, higher] = detail.dims();
    if EnvironmentData::degree_of(1 + higher).is_none() {
        let expected = format!("[{count}, 0], [{count}, 3], [{count}, 8] or [{count}, 15]");
        return Err(Error::Shape { tensor: "harmonics detail".into(), expected, found: vec![count, higher] });
    }
    check_shape("harmonics base", base, [count, 1])?;
    check_shape("positions", positions, [count, 3])?;
    let [base, detail, positions] = [base, detail, positions].map(|tensor| tensor.clone().into_dispatch());
    Ok(Tensor::from_dispatch(Dispatch::harmonics(base, detail, positions, centre)))
}

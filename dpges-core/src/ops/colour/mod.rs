//! `colour`: the colour of every primitive as seen from the camera.
//!
//! Base [N, 3], detail [N, [`ColourModel::detail_len`]] and positions [N, 3] → colour [N, 3], not
//! clamped: `0.5 + C0 k0` plus, for spherical Beta, `Σ softplus(rgb) max(0, d·μ)^(4 e^β)` over the
//! lobes (DBS) or, for spherical harmonics, the higher bands (3DGS).
//! d is the unit vector from the camera to the primitive, in world axes.
//!
//! A detail in several tensors is added tensor by tensor: the base of all but the first is the colour of those before.
//!
//! Gradients: to base and detail. The direction passes none to the position (DP-GES, DBS).

mod autodiff;
pub(super) mod cpu;
#[cfg(feature = "gpu")]
pub(super) mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

use crate::error::Result;
use crate::scene::tensors::check_shape;
use crate::scene::{Colour, ColourModel};

/// Which part of the detail a tensor holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetailPart {
    pub model: ColourModel,
    /// Columns of the parts before. Where there are any, the base is the colour of these parts, not a coefficient.
    pub before: usize,
    pub width: usize,
}

/// Sharpness of the softplus of a lobe's colour: a raw value of 0 means 0.1.
const SHARPNESS: f64 = 10.0 * std::f64::consts::LN_2;
/// Raw β is bounded here: a sharper lobe is narrower than a hundredth of a degree, and e^β would overflow.
const LARGEST_BETA: f64 = 14.0;

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait ColourOps: Backend {
    fn colour(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
        part: DetailPart,
    ) -> FloatTensor<Self>;
}

/// Colours [N, 3] of primitives at `positions` [N, 3] seen from `centre`, world
/// units.
///
/// # Errors
/// [`crate::Error::Shape`] if the tensors do not fit each other or the colour model.
pub fn colour(colour: &Colour, positions: &Tensor<2>, centre: [f64; 3]) -> Result<Tensor<2>> {
    let count = positions.dims()[0];
    check_shape("positions", positions, [count, 3])?;
    check_shape("colour.base", &colour.base, [count, 3])?;
    let of_rest: usize = colour.rest.iter().map(|part| part.dims()[1]).sum();
    check_shape("colour.detail", &colour.detail, [count, colour.model.detail_len().saturating_sub(of_rest)])?;
    let (mut out, mut before) = (colour.base.clone(), 0);
    for detail in colour.details() {
        let width = detail.dims()[1];
        check_shape("colour.detail", detail, [count, width])?;
        out = Tensor::from_dispatch(Dispatch::colour(
            out.into_dispatch(),
            detail.clone().into_dispatch(),
            positions.clone().into_dispatch(),
            centre,
            DetailPart { model: colour.model, before, width },
        ));
        before += width;
    }
    Ok(out)
}

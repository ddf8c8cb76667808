//! CPU kernels: one row at a time.

pub(in crate::ops) mod model;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::autodiff::ColourState;
use super::{ColourOps, DetailPart};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::WayBack;
use crate::math::{add, row};
use crate::scene::{ColourModel, SH_C0};

const MIN_ROWS: usize = 512;

fn forward<T: Real>(base: &[T], detail: &[T], positions: &[T], centre: [f64; 3], part: DetailPart) -> Vec<T> {
    let (DetailPart { model: kind, before, width }, centre) = (part, centre.map(T::of));
    let mut out = vec![T::zero(); base.len()];
    out.par_chunks_mut(3).with_min_len(MIN_ROWS).enumerate().for_each(|(i, out)| {
        let d = model::direction(row(positions, i), centre);
        let raw = &detail[i * width..(i + 1) * width];
        let varying = match kind {
            ColourModel::SphericalBeta { .. } => model::lobes(raw, d),
            ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
                model::higher_harmonics(raw, before / kind.detail_unit(), d)
            }
        };
        // details that exceed a buffer come in parts: only the first adds the base colour
        let constant = if before == 0 { model::base(row(base, i)) } else { row(base, i) };
        out.copy_from_slice(&add(constant, varying));
    });
    out
}

/// Gradients with respect to base and detail.
fn backward<T: Real>(
    detail: &[T],
    positions: &[T],
    grad: &[T],
    centre: [f64; 3],
    part: DetailPart,
) -> (Vec<T>, Vec<T>) {
    let (DetailPart { model: kind, before, width }, centre) = (part, centre.map(T::of));
    let of_base = if before == 0 { T::of(SH_C0) } else { T::one() };
    let grad_base: Vec<T> = grad.iter().map(|&g| g * of_base).collect();
    let mut grad_detail = vec![T::zero(); detail.len()];
    if width > 0 {
        grad_detail.par_chunks_mut(width).with_min_len(MIN_ROWS).enumerate().for_each(|(i, out)| {
            let incoming = row(grad, i);
            // Gaussians out of view have no gradient: they do without sines, powers and logarithms
            if incoming == [T::zero(); 3] {
                return;
            }
            let d = model::direction(row(positions, i), centre);
            match kind {
                ColourModel::SphericalBeta { .. } => {
                    model::lobes_backward(&detail[i * width..(i + 1) * width], d, incoming, out)
                }
                ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
                    model::higher_harmonics_backward(before / kind.detail_unit(), d, incoming, out)
                }
            }
        });
    }
    (grad_base, grad_detail)
}

impl<B: Host> ColourOps for B {
    fn colour(
        base: FloatTensor<B>,
        detail: FloatTensor<B>,
        positions: FloatTensor<B>,
        centre: [f64; 3],
        part: DetailPart,
    ) -> FloatTensor<B> {
        with_real!(base.dtype(), T => {
            let [values, detail, positions] = [&base, &detail, &positions].map(host::floats::<B, T>);
            let out = forward(&values, &detail, &positions, centre, part);
            host::float_tensor::<B, T, 2>(out, [host::rows(&base), 3], &base.device())
        })
    }
}

impl<B: Host> WayBack<B, 2> for ColourState<B> {
    fn go_back(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 2] {
        let (count, device) = (host::rows(&grad), grad.device());
        with_real!(grad.dtype(), T => {
            let [detail, positions, grad] = [&self.detail, &self.positions, &grad].map(host::floats::<B, T>);
            let (base, detail) = backward(&detail, &positions, &grad, self.centre, self.part);
            [(base, 3), (detail, self.part.width)]
                .map(|(values, width)| Some(host::float_tensor::<B, T, 2>(values, [count, width], &device)))
        })
    }
}

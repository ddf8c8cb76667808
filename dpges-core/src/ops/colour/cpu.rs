//! CPU kernels: a vector of rows at a time.

pub(in crate::ops) mod model;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::autodiff::ColourState;
use super::{ColourOps, DetailPart};
use crate::backend::host::{self, Host, with_real};
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;
use crate::backend::vectorised::vectorised;
use crate::backend::vectors::MOST;
use crate::math::{V3, add, row, scale};
use crate::scene::lobes::LOBE_LEN;
use crate::scene::{ColourModel, SH_C0};

/// Rows of one task.
const CHUNK: usize = 1024;

/// Primitives seen from a point.
struct Seen<'a, T: Real> {
    base: &'a [T],
    detail: &'a [T],
    positions: &'a [T],
    centre: V3<T>,
    part: DetailPart,
}

impl<T: Real> Seen<'_, T> {
    /// Calls `visit` with the rows of a chunk that begins at `first`, in as many lanes as `S` has, the last one again in lanes
    /// that are left over, how many they are, and the directions to them.
    #[inline(always)]
    fn for_each<S: Simd>(
        &self,
        simd: S,
        first: usize,
        count: usize,
        mut visit: impl FnMut(&[usize; MOST], usize, V3<Lanes<T, S>>),
    ) {
        let centre = Lanes::splat_three(simd, self.centre);
        for start in (first..first + count).step_by(T::lane_count::<S>()) {
            let rows: [usize; MOST] = std::array::from_fn(|lane| (start + lane).min(first + count - 1));
            let positions = Lanes::from_rows(simd, |lane| row(self.positions, rows[lane]));
            visit(&rows, T::lane_count::<S>().min(first + count - start), model::direction(positions, centre));
        }
    }

    /// The numbers of detail from `offset` on.
    #[inline(always)]
    fn detail<S: Simd, const W: usize>(&self, simd: S, rows: &[usize; MOST], offset: usize) -> [Lanes<T, S>; W] {
        Lanes::from_rows(simd, |lane| row(&self.detail[rows[lane] * self.part.width + offset..], 0))
    }

    fn is_lobes(&self) -> bool {
        matches!(self.part.model, ColourModel::SphericalBeta { .. })
    }
}

/// Colours of the primitives of a chunk.
struct Forward<'a, T: Real> {
    seen: &'a Seen<'a, T>,
    first: usize,
    out: &'a mut [T],
}

impl<T: Real> WithSimd for Forward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { seen, first, out } = self;
        let DetailPart { model: kind, before, width } = seen.part;
        seen.for_each(
            simd,
            first,
            out.len() / 3,
            #[inline(always)]
            |rows, count, d| {
                let base = Lanes::from_rows(simd, |lane| row(seen.base, rows[lane]));
                // details that exceed a buffer come in parts: only the first adds the base colour
                let mut colour = if before == 0 { model::base(base) } else { base };
                if seen.is_lobes() {
                    for offset in (0..width).step_by(LOBE_LEN) {
                        colour = add(colour, model::lobe(seen.detail(simd, rows, offset), d));
                    }
                } else {
                    let harmonics = &model::harmonics(d)[before / kind.detail_unit()..];
                    for (offset, &y) in (0..width).step_by(3).zip(harmonics) {
                        colour = add(colour, scale(seen.detail(simd, rows, offset), y));
                    }
                }
                let at = (rows[0] - first) * 3;
                out[at..at + 3 * count].copy_from_slice(Lanes::to_rows(colour)[..count].as_flattened());
            },
        );
    }
}

/// Gradients with respect to the details of the primitives of a chunk.
struct Backward<'a, T: Real> {
    seen: &'a Seen<'a, T>,
    grad: &'a [T],
    first: usize,
    out: &'a mut [T],
}

impl<T: Real> WithSimd for Backward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { seen, grad, first, out } = self;
        let DetailPart { model: kind, before, width } = seen.part;
        seen.for_each(
            simd,
            first,
            out.len() / width,
            #[inline(always)]
            |rows, count, d| {
                let at = rows[0];
                // Gaussians out of view have no gradient: they do without sines and logarithms
                if grad[3 * at..3 * (at + count)].iter().all(|&grad| grad == T::zero()) {
                    return;
                }
                let incoming = Lanes::from_rows(simd, |lane| row(grad, rows[lane]));
                let out = &mut out[(at - first) * width..][..count * width];
                if seen.is_lobes() {
                    for offset in (0..width).step_by(LOBE_LEN) {
                        let found = Lanes::to_rows(model::lobe_backward(seen.detail(simd, rows, offset), d, incoming));
                        for (out, found) in out.chunks_exact_mut(width).zip(found) {
                            out[offset..offset + LOBE_LEN].copy_from_slice(&found);
                        }
                    }
                } else {
                    // directions carry no gradient to positions
                    let harmonics = &model::harmonics(d)[before / kind.detail_unit()..];
                    for (offset, &y) in (0..width).step_by(3).zip(harmonics) {
                        let found = Lanes::to_rows(scale(incoming, y));
                        for (out, found) in out.chunks_exact_mut(width).zip(found) {
                            out[offset..offset + 3].copy_from_slice(&found);
                        }
                    }
                }
            },
        );
    }
}

fn forward<T: Real>(seen: &Seen<T>) -> Vec<T> {
    let mut out = vec![T::zero(); seen.base.len()];
    out.par_chunks_mut(3 * CHUNK).enumerate().for_each(|(chunk, out)| {
        vectorised(Forward { seen, first: chunk * CHUNK, out });
    });
    out
}

/// Gradients with respect to base and detail.
fn backward<T: Real>(seen: &Seen<T>, grad: &[T]) -> (Vec<T>, Vec<T>) {
    let DetailPart { before, width, .. } = seen.part;
    let of_base = if before == 0 { T::of(SH_C0) } else { T::one() };
    let grad_base: Vec<T> = grad.iter().map(|&g| g * of_base).collect();
    let mut grad_detail = vec![T::zero(); seen.detail.len()];
    if width > 0 {
        grad_detail.par_chunks_mut(width * CHUNK).enumerate().for_each(|(chunk, out)| {
            vectorised(Backward { seen, grad, first: chunk * CHUNK, out });
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
            let seen = Seen { base: &values, detail: &detail, positions: &positions, centre: centre.map(T::of), part };
            let out = forward(&seen);
            host::float_tensor::<B, T, 2>(out, [host::rows(&base), 3], &base.device())
        })
    }
}

impl<B: Host> BackwardState<B, 2> for ColourState<B> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 2] {
        let (count, device) = (host::rows(&grad), grad.device());
        with_real!(grad.dtype(), T => {
            let [detail, positions, grad] = [&self.detail, &self.positions, &grad].map(host::floats::<B, T>);
            let centre = self.centre.map(T::of);
            let seen = Seen { base: &[], detail: &detail, positions: &positions, centre, part: self.part };
            let (base, detail) = backward(&seen, &grad);
            [(base, 3), (detail, self.part.width)]
                .map(|(values, width)| Some(host::float_tensor::<B, T, 2>(values, [count, width], &device)))
        })
    }
}

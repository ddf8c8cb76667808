//! CPU kernels.

use burn::backend::TensorMetadata;
use burn::backend::tensor::IntTensor;
use rayon::prelude::*;

use super::{FiniteOps, GateOutput};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tensor_list::TensorList;

const CHUNK: usize = 1 << 14;

fn first_non_finite<T: Real>(values: &[T]) -> i32 {
    // 0 · x is 0 for every finite x and NaN otherwise: one vectorised sum per chunk
    let suspicious = |chunk: &[T]| !chunk.iter().fold(T::zero(), |sum, &x| sum + x * T::zero()).is_finite();
    // the first, whichever thread finds one first
    let chunk = values.par_chunks(CHUNK).position_first(suspicious);
    let within =
        |chunk: usize| values[chunk * CHUNK..].iter().position(|x| !x.is_finite()).map(|at| chunk * CHUNK + at);
    chunk.and_then(within).map_or(-1, |at| i32::try_from(at).unwrap_or(i32::MAX))
}

impl<B: Host> FiniteOps for B {
    fn first_non_finite(list: TensorList<B>, count: usize, positions: IntTensor<B>, first: usize) -> IntTensor<B> {
        let mut found = host::ints::<B>(&positions).into_owned();
        for (tensor, found) in list.into_tensors().iter().take(count).zip(&mut found[first..]) {
            *found = with_real!(tensor.dtype(), T => first_non_finite(&host::floats::<B, T>(tensor)));
        }
        let shape = [found.len()];
        host::int_tensor::<B, 1>(found, shape, &positions.device())
    }

    fn gate(positions: IntTensor<B>) -> GateOutput<B> {
        let bad = host::ints::<B>(&positions).iter().filter(|&&position| position >= 0).count() as f32;
        let open = if bad == 0.0 { 1.0 } else { 0.0 };
        let [open, bad] =
            [open, bad].map(|number| host::float_tensor::<B, f32, 1>(vec![number], [1], &positions.device()));
        GateOutput { open, bad }
    }
}

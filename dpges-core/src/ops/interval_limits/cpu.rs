//! CPU kernel: pixels in parallel, layer by layer.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::LimitOps;
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::ops::peel::PeelOutput;
use crate::scene::MarginLookup;

fn limits<T: Real>(
    ids: &[i32],
    alpha: &[T],
    depth: &[T],
    margins: &[T],
    layers: usize,
    lookup: MarginLookup,
) -> Vec<T> {
    let pixels = depth.len() / layers;
    let per_pixel = |pixel: usize| {
        let (mut closed, mut last, mut present) = (false, T::INFINITY, 0);
        for at in (0..layers).map(|k| k * pixels + pixel).take_while(|&at| ids[at] >= 0) {
            last = depth[at] + margins[ids[at] as usize];
            closed |= alpha[at] >= T::one();
            present += 1;
        }
        if closed || present == layers { last } else { T::INFINITY }
    };
    let caps: Vec<T> = (0..pixels).into_par_iter().with_min_len(4096).map(per_pixel).collect();
    let mut out = vec![T::INFINITY; depth.len()];
    let mut reached = vec![-T::INFINITY; pixels];
    for (k, out) in out.chunks_mut(pixels.max(1)).enumerate() {
        out.par_iter_mut().zip(&mut reached).zip(&caps).with_min_len(4096).enumerate().for_each(
            |(pixel, ((out, reached), &cap))| {
                let at = k * pixels + pixel;
                let end = match lookup {
                    _ if ids[at] < 0 => T::INFINITY,
                    MarginLookup::Shifted => depth[at] + margins[ids[at] as usize],
                    // only the cap ends the last interval
                    MarginLookup::Literal if k + 1 == layers => T::INFINITY,
                    MarginLookup::Literal => depth[at],
                };
                *reached = reached.max(end);
                *out = reached.min(cap);
            },
        );
    }
    out
}

impl<B: Host> LimitOps for B {
    fn interval_limits(layers: PeelOutput<B>, margins: FloatTensor<B>, lookup: MarginLookup) -> FloatTensor<B> {
        let PeelOutput { ids, alpha, depth } = layers;
        let shape: [usize; 3] = depth.shape().dims();
        with_real!(depth.dtype(), T => {
            let [alpha, values, margins] = [&alpha, &depth, &margins].map(host::floats::<B, T>);
            let limits = limits(&host::ints::<B>(&ids), &alpha, &values, &margins, shape[0], lookup);
            host::float_tensor::<B, T, 3>(limits, shape, &depth.device())
        })
    }
}

//! CPU kernel: one pass over the pixels.

use burn::backend::TensorMetadata;
use burn::backend::tensor::IntTensor;

use super::CoverageOps;
use crate::backend::host::{self, Host};

impl<B: Host> CoverageOps for B {
    fn coverage(ids: IntTensor<B>, count: usize) -> IntTensor<B> {
        let [_, height, width] = ids.shape().dims();
        let mut pixels = vec![0i32; count];
        for &id in &host::ints::<B>(&ids)[..height * width] {
            if let Ok(id) = usize::try_from(id) {
                pixels[id] += 1;
            }
        }
        host::int_tensor::<B, 1>(pixels, [count], &ids.device())
    }
}

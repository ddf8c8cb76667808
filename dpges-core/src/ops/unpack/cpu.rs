//! CPU kernel: one plane after another.

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};

use super::{IN_A_WORD, UnpackOps};
use crate::backend::host::{self, Host};

impl<B: Host> UnpackOps for B {
    fn unpack(words: IntTensor<B>, shape: [usize; 3]) -> FloatTensor<B> {
        let [channels, height, width] = shape;
        let packed = host::ints::<B>(&words);
        // a CPU rounds this quotient to the nearest f32; GPUs need not, see the twin
        let value = |at: usize| f32::from(packed[at / IN_A_WORD].to_le_bytes()[at % IN_A_WORD]) / 255.0;
        let plane = |channel: usize| (0..height * width).map(move |pixel| pixel * channels + channel).map(value);
        let values: Vec<f32> = (0..channels).flat_map(plane).collect();
        host::float_tensor::<B, f32, 3>(values, shape, &words.device())
    }
}

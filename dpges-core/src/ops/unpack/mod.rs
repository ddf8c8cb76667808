//! `unpack`: an image of 8 bits per value, as files have them, as an image of f32 on its device.
//!
//! Words of 32 bits `[⌈C H W / 4⌉]` → [C, H, W]. A word has four values, the first in its lowest bits; values go row by row, and
//! all C of a pixel come after each other. A value v becomes v / 255, rounded to the nearest f32: on every device to the same
//! bits. No gradient.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::{DType, Device, Int, Tensor, TensorData};

use crate::counters::transfers::upload;
use crate::error::{Error, Result};

/// Values in a word.
const IN_A_WORD: usize = 4;

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait UnpackOps: Backend {
    fn unpack(words: IntTensor<Self>, shape: [usize; 3]) -> FloatTensor<Self>;
}

/// `values` `[n]` on `device`, four to a word: `[⌈n / 4⌉]`.
pub fn pack(values: &[u8], device: &Device) -> Tensor<1, Int> {
    let word = |values: &[u8]| {
        let mut bytes = [0; IN_A_WORD];
        bytes[..values.len()].copy_from_slice(values);
        i32::from_le_bytes(bytes)
    };
    let words: Vec<i32> = values.chunks(IN_A_WORD).map(word).collect();
    let count = words.len();
    Tensor::from_data(upload(TensorData::new(words, [count])), (device, DType::I32))
}

/// The image of `shape` C, H, W whose values are in `words`, which are [packed](pack), row by row and pixel by pixel. Nothing
/// is on a tape.
///
/// # Errors
/// [`Error::Shape`] if these are not as many words.
pub fn unpack(words: &Tensor<1, Int>, shape: [usize; 3]) -> Result<Tensor<3>> {
    let ([found], expected) = (words.dims(), shape.iter().product::<usize>().div_ceil(IN_A_WORD));
    if found != expected {
        let (tensor, expected) = ("words".to_owned(), format!("[{expected}] for an image of shape {shape:?}"));
        return Err(Error::Shape { tensor, expected, found: vec![found] });
    }
    Ok(Tensor::from_dispatch(Dispatch::unpack(words.clone().into_dispatch(), shape)))
}

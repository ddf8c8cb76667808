//! GPU kernel: one unit per pixel, in integers, because GPUs need not round quotients to the nearest f32.

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::UnpackOps;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, integers, units};

/// value / 255, of 0 to 255, rounded to the nearest f32.
///
/// Behind the binary point that is the eight bits of the value again and again. The 24 bits from the first 1 on are the
/// significand, and the bit after them says whether it is rounded up: a 1 is never followed by zeros alone, so there are no ties.
#[cube]
fn unit(value: u32) -> f32 {
    let repeated = value * 0x0101_0101u32;
    let by_four = select(repeated < 0x1000_0000u32, 4u32, 0u32);
    let by_two = select((repeated << by_four) < 0x4000_0000u32, 2u32, 0u32);
    let by_six = by_four + by_two;
    let zeros = by_six + select((repeated << by_six) < 0x8000_0000u32, 1u32, 0u32);
    let bits = repeated << zeros;
    // a significand that is rounded up to a power of two carries into the exponent
    let rounded = (bits >> 8u32) + ((bits >> 7u32) & 1u32);
    let number = ((126u32 - zeros) << 23u32) + (rounded - 0x0080_0000u32);
    f32::reinterpret(select(value == 0u32, 0u32, number))
}

#[cube(launch)]
fn unpack_kernel(words: &[i32], out: &mut [f32], pixels: u32, channels: u32) {
    let pixel = ABSOLUTE_POS as u32;
    if pixel >= pixels {
        terminate!();
    }
    for channel in 0..channels {
        let at = pixel * channels + channel;
        let word = u32::reinterpret(words[(at / 4u32) as usize]);
        let value = (word >> (8u32 * (at % 4u32))) & 0xffu32;
        out[(channel * pixels + pixel) as usize] = unit(value);
    }
}

impl UnpackOps for CubeBackend {
    fn unpack(words: IntTensor<Self>, shape: [usize; 3]) -> FloatTensor<Self> {
        let words = integers(words);
        let [channels, height, width] = shape;
        let out = empty_f32(&words, shape);
        let pixels = height * width;
        unpack_kernel::launch(
            &out.client.clone(),
            units(pixels),
            cube_dim(),
            buffer(&words),
            buffer(&out),
            pixels as u32,
            channels as u32,
        );
        out
    }
}

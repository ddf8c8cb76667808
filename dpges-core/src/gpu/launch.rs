//! Tensors and grids for kernel launches.

use burn::backend::TensorMetadata;
use burn::tensor::{DType, Shape};
use burn_cubecl::CubeBackend;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::{BufferArg, CubeCount, CubeDim};

use crate::error::Error;
use crate::tiles::capacity::exceed;

/// Units of a cube, in every kernel.
// the most invocations of a workgroup that WebGPU guarantees
pub const UNITS: u32 = 256;
/// Halvings of [`UNITS`] down to 1.
pub const HALVINGS: u32 = UNITS.ilog2();
/// Units that gather for one primitive.
pub const LANES: u32 = 32;
/// Primitives that a cube gathers for.
pub const GATHERED: usize = (UNITS / LANES) as usize;
/// Cubes along one axis of a grid that every implementation allows.
const MAX_CUBES: u32 = 65_535;

pub fn cube_dim() -> CubeDim {
    CubeDim::new_1d(UNITS)
}

/// A grid of at least `count` cubes. Kernels terminate surplus cubes.
pub fn cubes(count: usize) -> CubeCount {
    let count = u32::try_from(count).expect("fewer than 2³² cubes").max(1);
    // rows of equal length: fewer cubes than there are rows have nothing to do
    let rows = count.div_ceil(MAX_CUBES);
    CubeCount::Static(count.div_ceil(rows), rows, 1)
}

/// A grid with one unit for each of `count` items.
pub fn units(count: usize) -> CubeCount {
    cubes(count.div_ceil(UNITS as usize))
}

/// A grid with [`LANES`] units for each of `count` primitives.
pub fn gatherers(count: usize) -> CubeCount {
    cubes(count.div_ceil(GATHERED))
}

/// Bytes of the largest buffer that the device of `like` takes.
pub fn largest_buffer(like: &CubeTensor) -> usize {
    largest_page(like.client.properties().memory.max_page_size)
}

/// Bytes of the largest buffer of a device whose memory has pages of at most so many bytes.
pub fn largest_page(max_page_size: u64) -> usize {
    let largest = usize::try_from(max_page_size).unwrap_or(usize::MAX);
    #[cfg(any(test, feature = "testing"))]
    let largest = largest.min(LARGEST_BUFFER.load(std::sync::atomic::Ordering::Relaxed));
    largest
}

#[cfg(any(test, feature = "testing"))]
static LARGEST_BUFFER: std::sync::atomic::AtomicUsize = std::sync::atomic::AtomicUsize::new(usize::MAX);

/// Makes every device of this process take buffers of at most so many bytes, to test what does not fit.
#[cfg(any(test, feature = "testing"))]
pub fn limit_buffers(bytes: usize) {
    LARGEST_BUFFER.store(bytes, std::sync::atomic::Ordering::Relaxed);
}

/// An uninitialised contiguous tensor on the device of `like`. [Exceeds](exceed) the capacity if it is larger than the
/// largest buffer of the device.
pub fn empty(like: &CubeTensor, shape: impl Into<Shape>, dtype: DType) -> CubeTensor {
    let shape = shape.into();
    let (bytes, largest) = (shape.num_elements().max(1) * dtype.size(), largest_buffer(like));
    if bytes > largest {
        let what = format!("a tensor of shape {:?}", shape.as_slice());
        exceed(Error::Capacity { what, needed: bytes as u64, largest: largest as u64 });
    }
    let handle = like.client.empty(bytes);
    CubeTensor::new_contiguous(like.client.clone(), like.device.clone(), shape, handle, dtype)
}

pub fn empty_f32(like: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    empty(like, shape, DType::F32)
}

pub fn empty_u32(like: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    empty(like, shape, DType::U32)
}

/// The first `count` numbers of `tensor` `[n]`, in the same buffer.
pub fn first_of(tensor: &CubeTensor, count: usize) -> CubeTensor {
    let (client, device) = (tensor.client.clone(), tensor.device.clone());
    CubeTensor::new_contiguous(client, device, Shape::from([count]), tensor.handle.clone(), tensor.dtype)
}

/// Zeros on the device of `like`.
pub fn zeros_u32(like: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    use burn::backend::ops::IntTensorOps;
    CubeBackend::int_zeros(shape.into(), &like.device, burn::tensor::IntDType::U32)
}

/// Row-major `f32` tensor for a kernel.
///
/// # Panics
/// If the element type is not f32: only CPU backends compute in f64.
pub fn floats(tensor: CubeTensor) -> CubeTensor {
    // WGSL has no f64
    assert_eq!(tensor.dtype, DType::F32, "GPU kernels take f32 tensors");
    into_contiguous(tensor)
}

/// Row-major integer tensor for a kernel.
pub fn integers(tensor: CubeTensor) -> CubeTensor {
    assert_eq!(tensor.dtype, DType::I32, "GPU kernels take i32 indices");
    into_contiguous(tensor)
}

/// A tensor as the argument of a kernel. An empty tensor is bound as a buffer that no kernel reads.
pub fn buffer(tensor: &CubeTensor) -> BufferArg {
    if tensor.shape().num_elements() == 0 {
        // WebGPU has no bindings of no bytes
        return empty(tensor, [1], tensor.dtype).into_buffer_arg();
    }
    tensor.clone().into_buffer_arg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_cover_everything_within_the_limit() {
        for count in [0, 1, 65_535, 65_536, 70_001, 5_000_000] {
            let CubeCount::Static(x, y, 1) = cubes(count) else { panic!("static") };
            assert!(x <= MAX_CUBES && y <= MAX_CUBES && x as usize * y as usize >= count);
        }
    }
}

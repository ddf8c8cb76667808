//! Prefix sums, the sort and the pieces of GPU kernels, run by themselves.

use burn::backend::{DispatchDevice, TensorMetadata};
use burn::tensor::{DType, Device, Shape};
use burn_cubecl::tensor::CubeTensor;

pub use crate::gpu::launch::limit_buffers;
use crate::gpu::{scan, sort, work_split};

/// A piece of a rectangle: consecutive pixels, counted line by line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Index of the rectangle.
    pub owner: usize,
    /// Half open; empty at 0 where there is no piece.
    pub pixels: [usize; 2],
}

fn upload(values: &[u32], shape: impl Into<Shape>, device: &Device) -> CubeTensor {
    let DispatchDevice::Cube(device) = device.as_dispatch().clone().inner() else { panic!("a GPU") };
    let client = device.client();
    let handle = if values.is_empty() {
        client.empty(size_of::<u32>())
    } else {
        client.create_from_slice(bytemuck::cast_slice(values))
    };
    CubeTensor::new_contiguous(client, device, shape.into(), handle, DType::U32)
}

fn download(tensor: &CubeTensor) -> Vec<u32> {
    let bytes = tensor.client.read_one(tensor.handle.clone()).expect("the device answers");
    let numbers = bytes.chunks_exact(size_of::<u32>()).map(bytemuck::pod_read_unaligned);
    numbers.take(tensor.shape().num_elements()).collect()
}

/// [n + 1] sums of the numbers before each of `values` `[n]`, and of all of them; at most the largest number.
pub fn prefix_sums(values: &[u32], device: &Device) -> Vec<u32> {
    download(&scan::starts(&upload(values, [values.len()], device)))
}

/// (keys, places before) `[n]` in ascending order of `keys` `[n]` below 2^`bits`; equal ones keep their order.
pub fn sorted(keys: &[u32], bits: u32, device: &Device) -> (Vec<u32>, Vec<u32>) {
    let places: Vec<u32> = (0..).take(keys.len()).collect();
    let [keys, places] = [keys, &places].map(|values| upload(values, [values.len()], device));
    let (keys, places) = sort::sorted_pairs(keys, places, bits);
    (download(&keys), download(&places))
}

/// All pieces, those that are none last, and [n + 1] the first of each of the rectangles `[n]`: x0, x1, y0, y1, half open.
pub fn pieces_of(rects: &[[u32; 4]], device: &Device) -> (Vec<Piece>, Vec<usize>) {
    let found = work_split::split_work(&upload(rects.as_flattened(), [rects.len(), 4], device));
    let starts = download(&found.starts).into_iter().map(|start| start as usize).collect();
    let piece = |row: &[u32]| Piece { owner: row[0] as usize, pixels: [row[4], row[5]].map(|pixel| pixel as usize) };
    (download(&found.pieces).chunks_exact(found.pieces.shape()[1]).map(piece).collect(), starts)
}

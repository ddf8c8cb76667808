//! Ranks: processes that train one scene together, each with a device of its own.
//!
//! Sums of Gaussians do not depend on an order. So every rank holds some of the Gaussians of a scene and all of its surfels;
//! `joined` adds up the sums `S_k` and `w_k` of a view, 4 K numbers a pixel, after which every rank has the
//! picture, the loss and the gradient of the sums. Each goes back over its own Gaussians, and all go back over the same
//! surfels: the backward pass sends nothing.

#[cfg(test)]
mod tests;

use std::fmt::Debug;

use burn::tensor::{DType, Tensor, TensorData};

use crate::counters::transfers::{download, upload, wait};

/// The ranks of a run. All of them call the same functions in the same order: each waits for the others. A rank that is lost
/// ends the process.
pub trait Ranks: Debug + Send + Sync {
    /// The number of this one, from 0.
    fn rank(&self) -> usize;

    fn count(&self) -> usize;

    /// Adds up `sums` `[n]` element by element over all ranks. Each sum is formed once, in the order of the ranks: all of them
    /// hold the same bits, and again in the next run.
    fn join(&self, sums: &mut [f32]);

    /// The bytes of every rank, in their order. Lengths may differ.
    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>>;
}

/// The only rank of a run.
#[derive(Clone, Copy, Debug)]
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn join(&self, _: &mut [f32]) {}

    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        vec![own.to_vec()]
    }
}

impl dyn Ranks + '_ {
    pub fn is_alone(&self) -> bool {
        self.count() == 1
    }

    pub fn is_first(&self) -> bool {
        self.rank() == 0
    }

    /// The sum of the `sums` of all ranks, with the same bits on each. The gradient of the sum is that of the own `sums`.
    pub fn joined<const D: usize>(&self, sums: Tensor<D>) -> Tensor<D> {
        if self.is_alone() {
            return sums;
        }
        let (shape, device, dtype) = (sums.dims(), sums.device(), sums.dtype());
        let data = wait(|| download(sums.clone().detach().into_data()));
        let joined = if dtype == DType::F64 {
            let mut numbers = data.convert::<f64>().try_to_vec().expect("just converted");
            self.add_up(&mut numbers);
            TensorData::new(numbers, shape)
        } else {
            let mut numbers = data.convert::<f32>().try_to_vec().expect("just converted");
            self.join(&mut numbers);
            TensorData::new(numbers, shape)
        };
        let joined = Tensor::from_data(upload(joined), (&device, dtype));
        // 0, by which the gradient of the sum reaches the own sums
        joined + (sums.clone() - sums.detach())
    }

    /// Adds up `numbers`, of the same length on every rank, in the order of the ranks.
    pub fn add_up(&self, numbers: &mut [f64]) {
        if self.is_alone() {
            return;
        }
        let of_ranks = self.gather_numbers(numbers);
        numbers.fill(0.0);
        for found in of_ranks {
            numbers.iter_mut().zip(found).for_each(|(sum, number)| *sum += number);
        }
    }

    /// The numbers of every rank, in their order. Lengths may differ.
    pub fn gather_numbers<T: bytemuck::Pod>(&self, own: &[T]) -> Vec<Vec<T>> {
        let of_ranks = self.gather(bytemuck::cast_slice(own));
        of_ranks.iter().map(|bytes| bytemuck::pod_collect_to_vec(bytes)).collect()
    }

    /// The `numbers` of rank 0, whatever those of this one are: of measurements whose last bit may depend on the machine.
    pub fn of_first(&self, numbers: Vec<f64>) -> Vec<f64> {
        if self.is_alone() { numbers } else { self.gather_numbers(&numbers).swap_remove(0) }
    }

    /// Whether it is so for any rank.
    pub fn any(&self, own: bool) -> bool {
        !self.is_alone() && self.gather(&[u8::from(own)]).iter().any(|found| found == &[1]) || own
    }
}

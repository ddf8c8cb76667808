//! CPU kernel.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;

use super::JoinOps;
use crate::backend::host::{self, Host, with_real};
use crate::backend::tensor_list::TensorList;

impl<B: Host> JoinOps for B {
    fn join(list: TensorList<B>, count: usize) -> FloatTensor<B> {
        let tensors = list.into_tensors();
        let device = tensors[0].device();
        with_real!(tensors[0].dtype(), T => {
            let numbers: Vec<T> =
                tensors.iter().take(count).flat_map(|tensor| host::floats::<B, T>(tensor).into_owned()).collect();
            let shape = [numbers.len()];
            host::float_tensor::<B, T, 1>(numbers, shape, &device)
        })
    }
}

use burn::tensor::{DType, Int, Tensor, TensorData};

use super::coverage;
use crate::ops::peel::Layers;
use crate::testing::device;

#[test]
fn only_the_nearest_layer_counts() {
    let ids = vec![2i64, 0, 2, -1, 1, 1, -1, 1];
    let ids = Tensor::<3, Int>::from_data(TensorData::new(ids, [2, 2, 2]), (&device(), DType::I32));
    let empty = Tensor::<3>::zeros([2, 2, 2], (&device(), DType::F32));
    let layers = Layers { ids, alpha: empty.clone(), depth: empty };
    let found: Vec<i64> = coverage(&layers, 4).into_data().iter::<i64>().collect();
    assert_eq!(found, [1, 0, 2, 0]);
}

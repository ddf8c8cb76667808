//! How much the pictures want each Gaussian to move on the screen: what densification decides by.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::scene::tensors::tensor_to_rows;

use crate::refine::densify::GradientSums;

/// Gradients of the loss with respect to the projected centres, summed over views, on the device. NDC units.
pub struct ScreenGradients {
    /// [M] sum of their norms.
    signed: Tensor<1>,
    /// [M] sum of the norms of their absolute values, summed over pixels.
    absolute: Tensor<1>,
    /// [M] number of views in which the Gaussian took part.
    views: Tensor<1>,
}

impl ScreenGradients {
    /// Names of its columns in a checkpoint.
    pub const NAMES: [&'static str; 3] =
        ["screen_gradients.signed", "screen_gradients.absolute", "screen_gradients.views"];

    /// No view has been seen yet of `count` Gaussians.
    pub fn new(count: usize, device: &Device) -> Self {
        Self::from_columns([&vec![0.0; count], &vec![0.0; count], &vec![0.0; count]], device)
    }

    /// From what [`columns`](Self::columns) returned.
    pub fn from_columns(columns: [&Vec<f32>; 3], device: &Device) -> Self {
        let [signed, absolute, views] = columns
            .map(|column| Tensor::from_data(TensorData::new(column.clone(), [column.len()]), (device, DType::F32)));
        Self { signed, absolute, views }
    }

    /// In the order of [`NAMES`](Self::NAMES).
    pub fn columns(&self) -> [Vec<f32>; 3] {
        [&self.signed, &self.absolute, &self.views].map(tensor_to_rows)
    }

    /// Adds the gradient [M, 4] of the probe of one view.
    pub fn add(&mut self, probe: Tensor<2>) {
        let [count, _] = probe.dims();
        let squares = probe.clone() * probe.clone();
        let norm = |from: usize| squares.clone().slice([0..count, from..from + 2]).sum_dim(1).sqrt().reshape([count]);
        let (signed, absolute) = (norm(0), norm(2));
        self.views = self.views.clone() + absolute.clone().greater_elem(0.0).float();
        self.signed = self.signed.clone() + signed;
        self.absolute = self.absolute.clone() + absolute;
    }

    /// On the host, for densification.
    pub fn sums(&self) -> GradientSums {
        let [signed, absolute, views] = self.columns();
        GradientSums { signed, absolute, views: views.into_iter().map(|views| views as u32).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn screen_gradients_are_summed_by_norm_and_counted_where_there_are_any() {
        let device = Device::flex();
        let mut sums = ScreenGradients::new(2, &device);
        let probe = |rows: [f32; 8]| Tensor::from_data(TensorData::new(rows.to_vec(), [2, 4]), (&device, DType::F32));
        sums.add(probe([3.0, -4.0, 6.0, 8.0, 0.0, 0.0, 0.0, 0.0]));
        sums.add(probe([0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 1.0, 0.0]));
        let GradientSums { signed, absolute, views } = sums.sums();
        assert_eq!((signed, absolute, views), (vec![6.0, 0.0], vec![12.0, 1.0], vec![2, 1]));
    }
}

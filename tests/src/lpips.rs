//! LPIPS on a GPU, where Burn's own kernels do the convolutions.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_train::metrics::lpips::{Lpips, Network, Weights};

use crate::devices::ndarray;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
const TOLERANCE: f64 = 1e-3;

/// Convolutions of either sign, linear layers from 0 to 1.
fn weights(network: Network) -> Weights {
    let mut state = 1u32;
    let mut share = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / 2f32.powi(24)
    };
    Weights::new(network, |tensor| {
        let is_linear = tensor.shape.len() == 4 && tensor.shape[0] == 1;
        let bound = match tensor.shape[..] {
            [_, channels, height, width] => (6.0 / (channels * height * width) as f32).sqrt(),
            _ => 0.1,
        };
        let value = |share: f32| if is_linear { share } else { bound * (2.0 * share - 1.0) };
        (0..tensor.shape.iter().product()).map(|_| value(share())).collect()
    })
}

/// Slanted waves; the second ones are brighter and moved.
fn pictures(device: &Device) -> [Tensor<3>; 2] {
    [[0.0, 0.4], [0.7, 0.5]].map(|[phase, mean]| {
        let value = |i: usize| {
            let (c, y, x) = (i / (WIDTH * HEIGHT), i / WIDTH % HEIGHT, i % WIDTH);
            mean + 0.3 * ((x as f32 * 0.4) + (y as f32 * 0.23) * (c as f32 + 1.0) + phase).sin()
        };
        let values: Vec<f32> = (0..3 * WIDTH * HEIGHT).map(value).collect();
        Tensor::from_data(TensorData::new(values, [3, HEIGHT, WIDTH]), (device, DType::F32))
    })
}

pub fn a_gpu_agrees_with_a_cpu(device: Device) {
    for network in Network::ALL {
        let weights = weights(network);
        let [found, expected] = [device.clone(), ndarray()].map(|device| {
            let [reference, test] = pictures(&device);
            Lpips::new(&weights, &device).distance(&reference, &test).unwrap().unwrap()
        });
        println!("LPIPS ({network}): {found}, {expected} on the CPU");
        assert!(expected > 1e-3, "{network}: the pictures differ");
        assert!((found - expected).abs() < TOLERANCE * expected, "{network}: {found}, {expected} on the CPU");
    }
}

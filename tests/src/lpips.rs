//! LPIPS on a GPU, where Burn's own kernels do the convolutions; and with the published weights, where tools/lpips_weights.py has
//! put them.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_train::metrics::lpips::installed::installed;
use dpges_train::metrics::lpips::{Lpips, Network, Weights};
use libtest_mimic::Trial;

use crate::devices::{flex, ndarray};
use crate::test_pictures::{discs, moved, noisy, picture, tinted};
use crate::timing::trial;

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

pub fn a_gpu_agrees_with_a_cpu(device: &Device) {
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

/// A pixel of a picture, by channel, row and column.
type Pixel = fn(usize, usize, usize) -> usize;

/// Width, height, two pictures, and what `reference/make_lpips.py` prints for them, in the order of [`Network::ALL`].
const PAIRS: [(usize, usize, Pixel, Pixel, [f64; 2]); 10] = [
    (64, 48, discs, moved, [0.008_078_890, 0.028_402_162]),
    (64, 48, discs, noisy, [0.104_623_861, 0.438_843_993]),
    (64, 48, discs, tinted, [0.030_664_029, 0.033_786_682]),
    (64, 48, moved, noisy, [0.115_303_323, 0.448_173_729]),
    (64, 48, noisy, tinted, [0.124_898_637, 0.445_526_008]),
    (97, 65, discs, moved, [0.013_134_834, 0.035_867_332]),
    (97, 65, discs, noisy, [0.088_865_122, 0.351_521_607]),
    (97, 65, discs, tinted, [0.034_359_950, 0.036_327_757]),
    (97, 65, tinted, moved, [0.046_924_594, 0.076_603_494]),
    (33, 31, noisy, discs, [0.016_949_568, 0.357_239_507]),
];

/// A test for each network, ignored where it is not installed.
pub fn trials() -> Vec<Trial> {
    let trial = |network: Network| {
        let path = installed(network).ok_or_else(|| {
            eprintln!(
                "LPIPS ({network}) cannot be compared with NumPy: dpges-train/tools/lpips_weights.py {network} makes its weights"
            );
            "the network is not installed".to_owned()
        });
        let name = format!("lpips::the_formula_in_numpy_agrees_for_{network}");
        trial(&name, "weights", &path, false, |path| {
            the_formula_in_numpy_agrees(&Weights::load(&path)?);
            Ok(())
        })
    };
    Network::ALL.map(trial).into()
}

fn the_formula_in_numpy_agrees(weights: &Weights) {
    for device in [ndarray(), flex()] {
        let lpips = Lpips::new(weights, &device);
        let network = Network::ALL.iter().position(|network| *network == weights.network).expect("one of all");
        for (index, (width, height, reference, test, expected)) in PAIRS.into_iter().enumerate() {
            let expected = expected[network];
            let [reference, test] = [reference, test].map(|of| {
                let data = TensorData::new(picture(width, height, of), [3, height, width]);
                Tensor::from_data(data, (&device, DType::F32))
            });
            let found = lpips.distance(&reference, &test).unwrap().unwrap();
            println!("LPIPS ({}), {device:?}, pair {index}: {found:.9}, {expected:.9} in NumPy", weights.network);
            assert!((found - expected).abs() < 1e-4 * expected, "pair {index}, {device:?}: {found}, not {expected}");
        }
    }
}

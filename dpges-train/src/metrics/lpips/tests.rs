use super::super::test_pictures::{discs, moved, noisy, picture, tinted};
use super::*;
use crate::device::DeviceName;

/// Weights from a hash of their positions, which `tests/reference/make_metrics.py` has too: convolutions and biases of
/// either sign, linear layers from 0 to 1.
fn weights(network: Network) -> Weights {
    let mut number = 0;
    Weights::new(network, |TensorShape { shape, .. }| {
        number += 1;
        let is_linear = shape.len() == 4 && shape[0] == 1;
        let bound = match shape.len() {
            4 => (6.0 / (shape[1] * shape[2] * shape[3]) as f64).sqrt(),
            _ => 0.1,
        };
        let value =
            |index: u32| if is_linear { share(number, index) } else { bound * (2.0 * share(number, index) - 1.0) };
        (0..shape.iter().product::<usize>() as u32).map(|index| value(index) as f32).collect()
    })
}

/// From 0 to 1.
fn share(number: u32, index: u32) -> f64 {
    let mut hash = index.wrapping_mul(0x9e37_79b1) ^ number.wrapping_mul(0x85eb_ca77);
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ (hash >> 13)).wrapping_mul(0xc2b2_ae35);
    f64::from(hash ^ (hash >> 16)) / 2f64.powi(32)
}

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

fn devices() -> Vec<Device> {
    ["cpu", "cpu-ndarray"]
        .into_iter()
        .filter_map(|name| name.parse::<DeviceName>().ok())
        .map(|name| name.open().unwrap())
        .collect()
}

fn upload(planes: &[f32], device: &Device) -> Tensor<3> {
    tensor(planes, [3, HEIGHT, WIDTH], device)
}

/// Values of the published `lpips` 0.1.4 with PyTorch 2.0.1 and these weights: `tests/reference/make_metrics.py` prints
/// them.
#[test]
fn it_agrees_with_the_published_program() {
    let cases = [
        (Network::Alex, [0.027_708_050, 0.033_472_750, 0.320_045_233]),
        (Network::Vgg, [0.015_553_526, 0.025_838_643, 0.081_719_235]),
    ];
    let others: [fn(usize, usize, usize) -> usize; 3] = [moved, noisy, tinted];
    let reference = picture(WIDTH, HEIGHT, discs);
    for (network, expected) in cases {
        let weights = weights(network);
        for device in devices() {
            let lpips = Lpips::new(&weights, &device);
            let reference = upload(&reference, &device);
            for (of, expected) in others.into_iter().zip(expected) {
                let test = upload(&picture(WIDTH, HEIGHT, of), &device);
                let found = lpips.distance(&reference, &test).unwrap().unwrap();
                assert!((found - expected).abs() < 1e-3 * expected, "{network}, {device:?}: {found}, not {expected}");
            }
            assert_eq!(lpips.distance(&reference, &reference).unwrap(), Some(0.0), "{network}, {device:?}");
        }
    }
}

/// As if pictures from 0 to 1 were from −1 to 1, where they lie between a half and 1.
#[test]
fn an_unscaled_network_takes_pictures_as_they_are() {
    let device = devices().remove(0);
    let weights = weights(Network::Alex);
    let [reference, test] = [discs, noisy].map(|of| upload(&picture(WIDTH, HEIGHT, of), &device));
    let brighter = |picture: &Tensor<3>| picture.clone() * 0.5 + 0.5;
    let scaled = Lpips::new(&weights, &device);
    let expected = scaled.distance(&brighter(&reference), &brighter(&test)).unwrap().unwrap();
    let other = scaled.distance(&reference, &test).unwrap().unwrap();
    let found = scaled.unscaled().distance(&reference, &test).unwrap().unwrap();
    assert!((found - expected).abs() < 1e-5 * expected, "{found}, not {expected}");
    assert!((found - other).abs() > 1e-2 * other, "{found} is {other}");
}

#[test]
fn pictures_that_are_too_small_have_none_and_other_shapes_are_refused() {
    let device = devices().remove(0);
    let lpips = Lpips::new(&weights(Network::Alex), &device);
    let black = |channels: usize, side: usize| Tensor::<3>::zeros([channels, side, 40], &device);
    assert_eq!(lpips.distance(&black(3, 30), &black(3, 30)).unwrap(), None);
    assert_eq!(lpips.distance(&black(3, 31), &black(3, 31)).unwrap(), Some(0.0));
    assert!(lpips.distance(&black(3, 31), &black(3, 32)).unwrap_err().to_string().contains("`test`"));
    assert!(lpips.distance(&black(4, 31), &black(4, 31)).unwrap_err().to_string().contains("`reference`"));
}

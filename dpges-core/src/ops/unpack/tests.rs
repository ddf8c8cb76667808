use burn::tensor::Tensor;

use super::{pack, unpack};
use crate::backend::device::cpu;
use crate::error::Error;

fn numbers(image: Tensor<3>) -> Vec<f32> {
    image.into_data().try_to_vec().unwrap()
}

#[test]
fn every_value_is_its_share_of_255_in_its_plane() {
    for (channels, height, width) in [(1, 16, 16), (3, 7, 13), (3, 1, 1), (2, 3, 1), (1, 1, 2)] {
        let values: Vec<u8> = (0..channels * height * width).map(|at| (at * 37 % 256) as u8).collect();
        let image = unpack(&pack(&values, &cpu()), [channels, height, width]).unwrap();
        assert_eq!(image.dims(), [channels, height, width]);
        let found = numbers(image);
        for (at, &value) in values.iter().enumerate() {
            let (pixel, channel) = (at / channels, at % channels);
            assert_eq!(found[channel * height * width + pixel].to_bits(), (f32::from(value) / 255.0).to_bits());
        }
    }
}

#[test]
fn words_that_are_too_many_or_too_few_are_refused() {
    let words = pack(&[1; 27], &cpu());
    assert_eq!(words.dims(), [7]);
    for shape in [[3, 3, 4], [3, 2, 4]] {
        let Err(Error::Shape { tensor, found, .. }) = unpack(&words, shape) else { panic!("{shape:?}") };
        assert_eq!((tensor.as_str(), found), ("words", vec![7]));
    }
}

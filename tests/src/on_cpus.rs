//! Tests that run on any device, on the CPU backends.

use burn::tensor::DType;

use crate::devices::{flex, ndarray};
use crate::{extreme_training, extremes, large, poisoned};

const DTYPES: [DType; 2] = [DType::F32, DType::F64];

#[test]
fn every_hazard_alone_is_finite() {
    [ndarray(), flex()].iter().for_each(extremes::every_hazard_alone_is_finite);
}

#[test]
fn transmittances_of_exactly_0_and_1_are_finite() {
    [ndarray(), flex()].iter().for_each(extremes::transmittances_of_exactly_0_and_1_are_finite);
}

#[test]
fn gradients_of_needles_are_close() {
    [ndarray(), flex()].iter().for_each(extremes::gradients_of_needles_are_close);
}

#[test]
fn training_in_f32_ends_where_it_ends_in_f64() {
    extreme_training::training_in_f32_ends_where_it_ends_in_f64(&ndarray());
}

#[test]
fn poisoned_numbers_are_named_with_their_row() {
    for dtype in DTYPES {
        poisoned::poisoned_numbers_are_named_with_their_row(&ndarray(), dtype);
        poisoned::poisoned_numbers_are_named_with_their_row(&flex(), dtype);
    }
}

#[test]
fn poisoned_numbers_that_nobody_looked_at_do_no_harm() {
    for dtype in DTYPES {
        poisoned::poisoned_numbers_that_nobody_looked_at_do_no_harm(&ndarray(), dtype);
    }
    poisoned::poisoned_numbers_that_nobody_looked_at_do_no_harm(&flex(), DType::F32);
}

#[test]
fn each_of_a_million_has_its_pixel() {
    DTYPES.into_iter().for_each(|dtype| large::each_of_a_million_has_its_pixel(&ndarray(), dtype));
}

#[test]
fn a_million_at_one_point_add_up() {
    DTYPES.into_iter().for_each(|dtype| large::equal_primitives_add_up(large::MILLION, &ndarray(), dtype));
}

#[test]
fn pictures_of_8192_px_are_close() {
    large::pictures_of_8192_px_are_close(&ndarray());
}

#[test]
#[ignore = "takes minutes and more memory than small machines have"]
fn the_largest_picture() {
    large::the_largest_picture(&ndarray());
}

//! Tests that run on any device, on a GPU.

use burn::tensor::{DType, Device};
use dpges_core::testing::extremes::extreme;

use crate::budget::Budget;
use crate::{extreme_training, extremes, large, poisoned};

const SCENES: u64 = 24;

pub fn every_hazard_alone_is_finite(device: Device) {
    extremes::every_hazard_alone_is_finite(&device);
}

/// [`budget`](crate::budget) says how many scenes.
pub fn many_hazards_are_finite(device: Device) {
    for seed in Budget::start(SCENES).seeds() {
        extremes::finite(&format!("seed {seed}"), &extreme(seed), &device);
    }
}

pub fn transmittances_of_exactly_0_and_1_are_finite(device: Device) {
    extremes::transmittances_of_exactly_0_and_1_are_finite(&device);
}

pub fn gradients_of_needles_are_close(device: Device) {
    extremes::gradients_of_needles_are_close(&device);
}

pub fn training_in_f32_ends_where_it_ends_in_f64(device: Device) {
    extreme_training::training_in_f32_ends_where_it_ends_in_f64(&device);
}

pub fn poisoned_numbers_are_named_with_their_row(device: Device) {
    poisoned::poisoned_numbers_are_named_with_their_row(&device, DType::F32);
}

pub fn poisoned_numbers_that_nobody_looked_at_do_no_harm(device: Device) {
    poisoned::poisoned_numbers_that_nobody_looked_at_do_no_harm(&device, DType::F32);
}

pub fn each_of_a_million_has_its_pixel(device: Device) {
    large::each_of_a_million_has_its_pixel(&device, DType::F32);
}

/// As many as fit: Mesa's software driver ends every loop after 65,535 turns.
pub fn fifty_thousand_at_one_point_add_up(device: Device) {
    large::equal_primitives_add_up(50_000, &device, DType::F32);
}

pub fn pictures_of_8192_px_are_close(device: Device) {
    large::pictures_of_8192_px_are_close(&device);
}

pub fn the_largest_picture(device: Device) {
    large::the_largest_picture(&device);
}

//! The tests on a GPU: the best adapter that wgpu finds, which is a software driver where there is no other.
//!
//! Without an adapter they are ignored. With `DPGES_REQUIRE_GPU=1` they fail. On a software driver those that take long there
//! are ignored, too, unless `DPGES_REQUIRE_GPU=1`, `--ignored` or `--include-ignored` asks for them; a million primitives there, the
//! largest picture, and training at the extremes wait for `--ignored` or `--include-ignored`.

use burn::tensor::{DType, Device};
use dpges_core::testing::extremes::extreme;
use dpges_train::device::DeviceName;
use libtest_mimic::Trial;

use crate::budget::seeds;
use crate::timing::trial;
use crate::{
    buffers, extreme_training, extremes, golden, gpu, jumps, kernels, large, lpips, own_device, parity, poisoned,
    step_cost, students, training,
};

/// Scenes with several hazards, unless [`budget`](crate::budget) says otherwise.
const SCENES: u64 = 24;

/// Every function named, with its name.
macro_rules! named {
    ($($module:ident::$name:ident),* $(,)?) => {
        [$((concat!(stringify!($module), "::", stringify!($name)), $module::$name as fn(&Device))),*]
    };
}

pub fn trials() -> Vec<Trial> {
    let tests = named![
        gpu::golden_cases,
        extremes::every_hazard_alone_is_finite,
        gpu::many_hazards_are_finite,
        extremes::transmittances_of_exactly_0_and_1_are_finite,
        extremes::gradients_of_needles_are_close,
        gpu::poisoned_numbers_are_named_with_their_row,
        gpu::poisoned_numbers_that_nobody_looked_at_do_no_harm,
        gpu::fifty_thousand_at_one_point_add_up,
        large::pictures_of_8192_px_are_close,
        kernels::prefix_sums_of_any_length,
        kernels::prefix_sums_stay_at_the_largest_number,
        kernels::pairs_of_any_number_are_sorted_and_keep_their_order,
        kernels::pieces_cover_every_pixel_once,
        parity::every_operation_agrees_on_random_scenes,
        parity::every_operation_agrees_for_every_number_of_layers_and_footprint,
        parity::every_operation_agrees_on_a_realistic_scene,
        parity::every_operation_agrees_with_nothing_to_show,
        parity::every_operation_agrees_on_one_primitive_and_on_a_line_of_pixels,
        parity::weighted_sums_agree_on_random_scenes,
        parity::sorted_blending_agrees_on_random_scenes,
        parity::sorted_blending_agrees_in_a_crowd,
        parity::sorted_blending_agrees_with_little_or_nothing_to_show,
        parity::lists_that_overflow_change_nothing,
        parity::lists_whose_lengths_nothing_waits_for_change_no_bit,
        parity::primitives_larger_than_the_picture_agree,
        parity::gradients_beyond_the_largest_buffer_are_gathered_in_parts,
        parity::what_no_buffer_holds_is_refused_by_name,
        buffers::details_in_parts_change_no_bit,
        buffers::as_many_fit_as_are_said_to,
        parity::every_operation_gives_the_same_bits_every_time,
        parity::doubles_on_a_gpu_are_refused_by_name,
        parity::photographs_are_unpacked_to_the_same_bits,
        lpips::a_gpu_agrees_with_a_cpu,
        jumps::nothing_jumps_along_a_path,
        gpu::starts_once,
        training::a_run_on_a_gpu_is_the_same_bytes_every_time,
        training::a_step_that_is_not_finite_changes_no_parameter,
        training::details_that_no_buffer_holds_are_trained_in_parts,
        training::photographs_reach_a_gpu_to_the_bit,
        training::where_photographs_are_changes_no_bit_of_a_run,
        own_device::every_operation_keeps_to_the_limits_of_webgpu,
        own_device::a_device_that_is_lost_leaves_a_run_that_goes_on_elsewhere,
        step_cost::a_step_is_counted_alike_every_time,
        step_cost::a_blended_step_is_counted,
    ];
    let slow_in_software = named![
        buffers::details_beyond_the_largest_buffer_of_the_driver,
        parity::every_operation_agrees_through_lenses,
        training::a_gpu_trains_as_well_as_a_cpu,
        training::lists_without_room_change_no_bit_of_a_run,
    ];
    // minutes on a software driver, where its twin on the CPU shows the same
    let slowest_in_software = named![gpu::each_of_a_million_has_its_pixel];
    let on_request = named![large::the_largest_picture, extreme_training::training_in_f32_ends_where_it_ends_in_f64];
    let device = best();
    let required = is_required();
    let in_software = !required && is_software();
    if let Err(reason) = &device {
        eprintln!("tests on a GPU cannot run: {reason}");
    }
    let device = device.map_err(|reason| format!("DPGES_REQUIRE_GPU=1, and {reason}"));
    let trial = |(name, test): (&'static str, fn(&Device))| {
        trial(name, "GPU", &device, required, move |device| {
            test(&device);
            Ok(())
        })
    };
    let ignored = |trial: Trial, is_left_out: bool| if is_left_out { trial.with_ignored_flag(true) } else { trial };
    let slow = slow_in_software.map(|test| ignored(trial(test), in_software));
    let slowest = slowest_in_software.map(|test| ignored(trial(test), is_software()));
    let asked_for = on_request.map(|test| ignored(trial(test), true));
    tests.map(trial).into_iter().chain(slow).chain(slowest).chain(asked_for).collect()
}

/// Whether tests on a GPU fail where they cannot run, and none is left out for the time that it takes.
pub fn is_required() -> bool {
    std::env::var("DPGES_REQUIRE_GPU").is_ok_and(|value| value == "1")
}

/// Whether the adapter of the tests is a software driver.
pub fn is_software() -> bool {
    "wgpu".parse().is_ok_and(DeviceName::is_software)
}

fn best() -> Result<Device, String> {
    let best: DeviceName = "wgpu".parse()?;
    let (adapter, device) =
        best.describe().and_then(|adapter| Ok((adapter, best.open()?))).map_err(|e| e.to_string())?;
    eprintln!("tests on a GPU run on {adapter}");
    Ok(device)
}

pub fn golden_cases(device: &Device) {
    golden::check_all(device, DType::F32);
    students::check(device, DType::F32);
}

pub fn many_hazards_are_finite(device: &Device) {
    for seed in seeds(SCENES) {
        extremes::finite(&format!("seed {seed}"), &extreme(seed), device);
    }
}

pub fn poisoned_numbers_are_named_with_their_row(device: &Device) {
    poisoned::poisoned_numbers_are_named_with_their_row(device, DType::F32);
}

pub fn poisoned_numbers_that_nobody_looked_at_do_no_harm(device: &Device) {
    poisoned::poisoned_numbers_that_nobody_looked_at_do_no_harm(device, DType::F32);
}

pub fn each_of_a_million_has_its_pixel(device: &Device) {
    large::each_of_a_million_has_its_pixel(device, DType::F32);
}

/// As many as fit: Mesa's software driver ends every loop after 65,535 turns.
pub fn fifty_thousand_at_one_point_add_up(device: &Device) {
    large::equal_primitives_add_up(50_000, device, DType::F32);
}

/// Opening a device again gives the same one.
pub fn starts_once(device: &Device) {
    device.sync().unwrap();
    assert_eq!(best().unwrap(), *device);
}

//! Tests that need more than a CPU: a graphics adapter, Python, or the weights of a network. `cargo test` counts those that cannot run here as
//! ignored, and names them. `DPGES_TEST_SHARE=1/2` runs the first of every two: a software driver keeps a processor and a quarter busy.

mod budget;
mod buffers;
mod devices;
mod extreme_training;
mod extremes;
mod golden;
mod gpu;
mod jumps;
mod kernels;
mod large;
mod lpips;
mod own_device;
mod parity;
mod poisoned;
mod raster;
mod reference;
mod step_cost;
mod students;
#[path = "../../dpges-train/src/metrics/test_pictures.rs"]
mod test_pictures;
mod timing;
mod training;

use std::process::ExitCode;

use libtest_mimic::{Arguments, Trial};

fn main() -> ExitCode {
    let mut arguments = Arguments::from_args();
    // Each uses all of the device, and some limit the lists and buffers of the whole process.
    arguments.test_threads = arguments.test_threads.or(Some(1));
    let mut trials = gpu::trials();
    trials.extend(raster::trials());
    trials.extend(reference::trials());
    trials.extend(lpips::trials());
    trials.push(Trial::test("parity::a_device_that_is_off_is_found_out", || {
        parity::a_device_that_is_off_is_found_out();
        Ok(())
    }));
    trials.push(Trial::test("jumps::nothing_jumps_on_a_cpu", || {
        jumps::nothing_jumps_along_a_path(&devices::flex());
        Ok(())
    }));
    if let Ok(share) = std::env::var("DPGES_TEST_SHARE") {
        let Some((number, of)) = parse_share(&share) else {
            eprintln!("DPGES_TEST_SHARE={share}: expected a share as 1/2, the first of two");
            return ExitCode::from(2);
        };
        trials = trials.into_iter().skip(number - 1).step_by(of).collect();
    }
    let conclusion = libtest_mimic::run(&arguments, trials);
    eprint!("slowest:\n{}", timing::slowest());
    conclusion.exit_code()
}

/// Number and count of a share: `2/3` is the second of three.
fn parse_share(share: &str) -> Option<(usize, usize)> {
    let (number, of) = share.split_once('/')?;
    let (number, of) = (number.parse().ok()?, of.parse().ok()?);
    (1..=of).contains(&number).then_some((number, of))
}

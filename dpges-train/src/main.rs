//! The `dpges` binary. Exit codes: 0, 1 for failure, 2 for wrong usage.

use libmimalloc_sys::{mi_option_set_default, mi_option_t};

mod cli;

/// A training step allocates and frees images of tens of megabytes; the system's allocator returns each to the kernel,
/// which costs a quarter of the step in page faults and interrupts between cores.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// `mi_option_purge_delay` of mimalloc 2 and 3: after how many ms freed pages go back to the kernel, which fills them with
/// zeros before it hands them out again.
const PURGE_DELAY: mi_option_t = 15;
const NEVER: std::ffi::c_long = -1;

fn main() -> std::process::ExitCode {
    // SAFETY: there is no other thread yet. `MIMALLOC_PURGE_DELAY` prevails.
    unsafe { mi_option_set_default(PURGE_DELAY, NEVER) };
    cli::run()
}

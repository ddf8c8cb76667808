//! The `dpges` binary. Exit codes: 0, 1 for failure, 2 for wrong usage.

use dpges_train::device::allocator::{Allocator, explain_failures};
use libmimalloc_sys::{mi_option_set_default, mi_option_t};

mod cli;

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

/// `mi_option_purge_delay` of mimalloc 2 and 3: after how many ms freed pages go back to the kernel, which fills them with
/// zeros before it hands them out again.
const PURGE_DELAY: mi_option_t = 15;
const NEVER: std::ffi::c_long = -1;

fn main() -> std::process::ExitCode {
    // SAFETY: there is no other thread yet. `MIMALLOC_PURGE_DELAY` prevails.
    unsafe { mi_option_set_default(PURGE_DELAY, NEVER) };
    explain_failures();
    cli::run()
}

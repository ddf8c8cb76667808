//! The `dpges` binary. Exit codes: 0, 1 for failure, 2 for wrong usage.

mod cli;

/// A training step allocates and frees images of tens of megabytes; the system's allocator returns each to the kernel,
/// which costs a quarter of the step in page faults and interrupts between cores.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    cli::run()
}

//! Vector instructions for kernels that are loops.

/// Runs `kernel` compiled for the widest vector instructions of this machine. Everything it calls
/// must be `#[inline(always)]` to profit.
#[inline]
pub fn vectorised<R>(kernel: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(kernel)
}

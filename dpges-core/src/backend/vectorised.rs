//! Vector instructions for kernels.

use pulp::WithSimd;

/// Runs `kernel`, a loop or one of [lanes](super::lanes), with the widest vector instructions of this machine. Everything it
/// calls must be `#[inline(always)]` to profit.
#[inline]
pub fn vectorised<K: WithSimd>(kernel: K) -> K::Output {
    pulp::Arch::new().dispatch(kernel)
}

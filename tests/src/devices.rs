//! The CPU devices that tests run on.

use burn::tensor::Device;

#[expect(deprecated, reason = "burn-ndarray is deprecated upstream and supported here")]
pub fn ndarray() -> Device {
    Device::ndarray()
}

pub fn flex() -> Device {
    Device::flex()
}

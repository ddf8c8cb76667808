//! The device of tests.

use burn::tensor::Device;
use dpges_train::device::DeviceName;

pub fn device() -> Device {
    "cpu".parse::<DeviceName>().unwrap().open().unwrap()
}

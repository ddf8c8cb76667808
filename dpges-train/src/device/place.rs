//! Where a run computes.

use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::ranks::{Alone, Ranks};

/// A device, and the ranks that train the same scene, each on its own.
#[derive(Clone, Debug)]
pub struct Place {
    pub device: Device,
    pub ranks: Arc<dyn Ranks>,
}

/// One process.
impl From<Device> for Place {
    fn from(device: Device) -> Self {
        Self { device, ranks: Arc::new(Alone) }
    }
}

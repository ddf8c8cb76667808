//! How many primitives the buffers of a device have room for.
//!
//! A step makes buffers with a row for each primitive. The widest decides; details are [split](crate::scene::split), and
//! lists of tiles and gradients of blended primitives are made in parts where they are too long.

use burn::tensor::Device;

use crate::backend::device::largest_buffer;
use crate::ops::blend::Form;
use crate::scene::BlendOrder;

/// Primitives by what a step computes for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drawn {
    /// Surfels that are peeled.
    Surfels,
    /// Gaussians that are summed, behind surfels or alone.
    Summed,
    /// Gaussians or discs that are blended in order.
    Blended(Form, BlendOrder),
}

impl Drawn {
    /// Bytes of the widest row of a step, forward and backward, with maps and probe.
    pub fn row_bytes(self) -> usize {
        match self {
            // one and a half pieces of work for each, with the sums of a disc
            Self::Surfels => 72,
            // likewise, with moments and colour
            Self::Summed => 54,
            Self::Blended(_, BlendOrder::Rays) => 80,
            Self::Blended(..) => 72,
        }
    }

    /// Bytes of the widest buffer beside its rows: pieces of work that any number of primitives may have.
    pub fn spare_bytes(self) -> usize {
        match self {
            Self::Surfels | Self::Summed => (self.row_bytes() / 3 * 2) << 14,
            Self::Blended(..) => 0,
        }
    }

    /// The largest number of primitives for which `device` has buffers.
    pub fn most(self, device: &Device) -> usize {
        largest_buffer(device).saturating_sub(self.spare_bytes()) / self.row_bytes()
    }
}

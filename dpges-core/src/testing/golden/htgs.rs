//! Cases of Gaussians that rays meet without a projection, blended as a core and a tail (HTGS).

use burn::tensor::{DType, Device};

use super::{Deviation, GoldenCase};
use crate::ops::blend::{BlendOptions, Form};
use crate::scene::{BlendOrder, HIGHEST_ALPHA, Transparency};

/// In the order of the generator's.
const TRANSPARENCIES: [Transparency; 4] =
    [Transparency::Hybrid, Transparency::Nearest, Transparency::Sorted, Transparency::Tail];

impl GoldenCase {
    /// Renders a case without surfels, and compares every output and gradient that the file holds.
    pub fn compare_whitened(&self, device: &Device, dtype: DType) -> Vec<Deviation> {
        let transparency = TRANSPARENCIES[self.arrays.array("transparency").values[0] as usize];
        let options = BlendOptions {
            form: Form::Whitened,
            order: BlendOrder::Whitened(transparency),
            max_alpha: HIGHEST_ALPHA,
            maps: true,
            ..BlendOptions::default()
        };
        self.compare_blended(options, device, dtype)
    }
}

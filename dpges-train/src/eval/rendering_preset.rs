//! Named settings of rendering: what is left out of a trained scene so that it is drawn faster.

use clap::ValueEnum;
use dpges_core::scene::SceneInfo;

/// Limits on how a scene is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RenderingPreset {
    /// At most 2 layers, sums of Gaussians in 16 bits
    Fast,
    /// As it was trained, sums of Gaussians in 16 bits
    Balanced,
    /// As it was trained, sums of Gaussians in 32 bits where the adapter can
    Quality,
}

impl RenderingPreset {
    /// Whether the real-time renderer sums Gaussians in 16 bits.
    pub fn half_sums(self) -> bool {
        self != Self::Quality
    }

    /// Leaves out of how a scene is drawn what exceeds the preset.
    pub fn apply(self, info: &mut SceneInfo) {
        if self == Self::Fast {
            info.layer_count = info.layer_count.min(2);
        }
    }
}

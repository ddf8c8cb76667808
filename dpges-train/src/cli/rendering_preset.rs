//! Named settings of rendering: what is left out of a trained scene so that it is drawn faster.

use clap::ValueEnum;
use dpges_core::scene::SceneData;

/// What a scene is drawn with at most.
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
    /// Most layers that are peeled.
    fn most_layers(self) -> usize {
        match self {
            Self::Fast => 2,
            Self::Balanced | Self::Quality => usize::MAX,
        }
    }

    /// Whether the real-time renderer sums Gaussians in 16 bits.
    pub fn half_sums(self) -> bool {
        self != Self::Quality
    }

    /// Leaves out of `scene` what exceeds the preset.
    pub fn apply(self, scene: &mut SceneData) {
        scene.info.layer_count = scene.info.layer_count.min(self.most_layers());
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::SceneInfo;
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;

    #[test]
    fn presets_leave_out_and_never_add() {
        let of = |layer_count: usize| {
            let made = random(2, &Recipe::default());
            let info = SceneInfo { colour_model: Recipe::default().model, layer_count, ..SceneInfo::default() };
            SceneData { info, surfels: made.surfels, gaussians: made.gaussians, environment: None }
        };
        for preset in RenderingPreset::value_variants() {
            for layers in [1, 3, 4] {
                let before = of(layers);
                let mut after = before.clone();
                preset.apply(&mut after);
                assert_eq!(after.info.layer_count, layers.min(preset.most_layers()));
                assert_eq!(after.gaussians, before.gaussians);
                assert!(*preset == RenderingPreset::Fast || after == before);
            }
        }
    }
}

//! Named settings of rendering: what is left out of a trained scene so that it is drawn faster.

use clap::ValueEnum;
use dpges_core::scene::SceneData;
use dpges_train::simplify::with_detail;

/// What a scene is drawn with at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RenderingPreset {
    /// At most 2 layers and one lobe (or harmonics of degree 1), sums of Gaussians in 16 bits
    Fast,
    /// At most 3 layers and two lobes (or harmonics of degree 2)
    Balanced,
    /// As it was trained
    Quality,
}

impl RenderingPreset {
    /// Most layers that are peeled, and most lobes or largest degree.
    fn most(self) -> [usize; 2] {
        match self {
            Self::Fast => [2, 1],
            Self::Balanced => [3, 2],
            Self::Quality => [usize::MAX; 2],
        }
    }

    /// Whether the real-time renderer sums Gaussians in 16 bits.
    pub fn half_sums(self) -> bool {
        self == Self::Fast
    }

    /// Leaves out of `scene` what exceeds the preset. `camera_centres` (world units) are where it will be seen from;
    /// without any, all directions count alike.
    pub fn apply(self, scene: &mut SceneData, camera_centres: &[[f64; 3]]) {
        let [layers, detail] = self.most();
        *scene = with_detail(scene, detail, camera_centres);
        scene.info.layer_count = scene.info.layer_count.min(layers);
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, SceneInfo};
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;

    #[test]
    fn presets_leave_out_and_never_add() {
        let of = |lobes: usize, layer_count: usize| {
            let model = ColourModel::SphericalBeta { lobes };
            let made = random(2, &Recipe { model, ..Recipe::default() });
            let info = SceneInfo { colour_model: model, layer_count, ..SceneInfo::default() };
            SceneData { info, surfels: made.surfels, gaussians: made.gaussians, environment: None }
        };
        for preset in RenderingPreset::value_variants() {
            for (lobes, layers) in [(0, 1), (2, 3), (3, 4)] {
                let before = of(lobes, layers);
                let mut after = before.clone();
                preset.apply(&mut after, &[]);
                let [most_layers, most_lobes] = preset.most();
                assert_eq!(after.info.layer_count, layers.min(most_layers));
                assert_eq!(after.info.colour_model, ColourModel::SphericalBeta { lobes: lobes.min(most_lobes) });
                assert_eq!(after.gaussians.positions, before.gaussians.positions);
                assert!(*preset != RenderingPreset::Quality || after == before);
            }
        }
    }
}

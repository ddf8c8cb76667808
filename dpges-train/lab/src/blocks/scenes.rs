//! The coarse scene cut at the bounds of a block, and blocks joined at their cores.

use dpges_core::scene::SceneData;
use dpges_train::dataset::block::Bounds;

/// The parts of `scene` within `bounds` and around them. Both have its environment.
pub fn cut(scene: &SceneData, bounds: &Bounds) -> [SceneData; 2] {
    let (surfels, gaussians) =
        (bounds.rows_within(&scene.surfels.positions), bounds.rows_within(&scene.gaussians.positions));
    let others = |rows: &[usize], count: usize| -> Vec<usize> {
        (0..count).filter(|row| rows.binary_search(row).is_err()).collect()
    };
    let around = (others(&surfels, scene.surfels.len()), others(&gaussians, scene.gaussians.len()));
    [(surfels, gaussians), around].map(|(surfels, gaussians)| SceneData {
        info: scene.info.clone(),
        surfels: scene.surfels.select(&surfels),
        gaussians: scene.gaussians.select(&gaussians),
        environment: scene.environment.clone(),
    })
}

/// Adds the primitives of `block` in its `core` to `all`. Of the numbers of layers the largest remains.
pub fn join(all: &mut SceneData, block: &SceneData, core: &Bounds) {
    let [kept, _] = cut(block, core);
    all.surfels.append(kept.surfels);
    all.gaussians.append(kept.gaussians);
    all.info.layer_count = all.info.layer_count.max(block.info.layer_count);
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, EnvironmentData, GaussianData, SceneInfo, SurfelData};

    use super::*;

    #[test]
    fn what_is_cut_apart_is_joined_again() {
        let model = ColourModel::SphericalBeta { lobes: 1 };
        let mut surfels = SurfelData::neutral(model, 5);
        surfels.positions = (0..15).map(|number| number as f32).collect();
        let mut gaussians = GaussianData::neutral(model, 4);
        gaussians.positions = (0..12).map(|number| number as f32 * 1.5).collect();
        let info = SceneInfo { colour_model: model, layer_count: 2, ..SceneInfo::default() };
        let environment = Some(EnvironmentData::neutral(1));
        let scene = SceneData { info, surfels, gaussians, environment };
        let [low, high] = Bounds::ALL.split(0, 6.0);
        let [inside, outside] = cut(&scene, &low);
        assert_eq!((inside.surfels.len(), outside.surfels.len()), (2, 3));
        assert_eq!((inside.gaussians.len(), outside.gaussians.len()), (2, 2));
        assert_eq!((&inside.environment, &inside.info), (&scene.environment, &scene.info));
        let [nothing, _] = cut(&scene, &Bounds { max: [Some(f32::MIN); 3], ..Bounds::ALL });
        let mut all = nothing;
        let mut deeper = scene.clone();
        deeper.info.layer_count = 4;
        join(&mut all, &scene, &low);
        join(&mut all, &deeper, &high);
        assert_eq!((&all.surfels, &all.gaussians, all.info.layer_count), (&scene.surfels, &scene.gaussians, 4));
    }
}

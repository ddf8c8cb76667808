//! Colours that depend less on the direction they are seen from.

use dpges_core::scene::{ColourData, ColourModel, SceneData};

use crate::refine::lobes::keep_lobes;

/// Lobes, or the degree of the harmonics.
pub fn detail_of(model: ColourModel) -> usize {
    match model {
        ColourModel::SphericalBeta { lobes } => lobes,
        ColourModel::SphericalHarmonics { degree } | ColourModel::HarmonicsAndOpacity { degree } => degree,
    }
}

/// `scene` with at most `most` lobes per primitive, or harmonics of at most that degree. The most visible lobes are
/// kept: those that change most between cameras at `camera_centres` (world units). The mean of the others becomes part of
/// the base colour.
pub fn with_detail(scene: &SceneData, most: usize, camera_centres: &[[f64; 3]]) -> SceneData {
    let model = scene.info.colour_model;
    if most >= detail_of(model) {
        return scene.clone();
    }
    let reduced = |positions: &[f32], colour: &ColourData| match model {
        ColourModel::SphericalBeta { lobes } => keep_lobes(positions, colour, lobes, camera_centres, most),
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
            lower_degree(colour, model, most)
        }
    };
    let mut scene = scene.clone();
    scene.surfels.colour = reduced(&scene.surfels.positions, &scene.surfels.colour);
    scene.gaussians.colour = reduced(&scene.gaussians.positions, &scene.gaussians.colour);
    scene.info.colour_model = scene.gaussians.colour.model;
    let [all, kept] = [model, scene.info.colour_model].map(|model| model.opacity_len().saturating_sub(1));
    scene.gaussians.opacity_detail = lower(&scene.gaussians.opacity_detail, all, kept);
    scene
}

/// Harmonics are orthogonal: those that remain are the best of their degree over all directions.
fn lower_degree(colour: &ColourData, model: ColourModel, degree: usize) -> ColourData {
    let of_degree = ColourModel::SphericalHarmonics { degree };
    let of_degree = if model.opacity_len() > 0 { of_degree.with_opacity() } else { of_degree };
    let detail = lower(&colour.detail, model.detail_len(), of_degree.detail_len());
    ColourData::new(of_degree, colour.base.clone(), detail)
}

/// The first `kept` of every `width` numbers.
fn lower(values: &[f32], width: usize, kept: usize) -> Vec<f32> {
    values.chunks_exact(width.max(1)).flat_map(|row| &row[..kept]).copied().collect()
}

#[cfg(test)]
mod tests {
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;

    fn scene(model: ColourModel) -> SceneData {
        random(3, &Recipe { surfels: 4, gaussians: 5, model, ..Recipe::default() }).into_scene().0
    }

    fn is_valid(scene: &SceneData) -> bool {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene");
        scene.save(&path).unwrap();
        SceneData::load(&path).unwrap() == *scene
    }

    #[test]
    fn lobes_and_degrees_are_taken_away_and_never_added() {
        for model in [ColourModel::SphericalBeta { lobes: 2 }, ColourModel::SphericalHarmonics { degree: 2 }] {
            let before = scene(model);
            for most in 0..2 {
                let after = with_detail(&before, most, &[[0.0; 3]]);
                assert_eq!(detail_of(after.info.colour_model), most);
                assert_eq!((after.surfels.len(), after.gaussians.len()), (4, 5));
                assert!(is_valid(&after), "{model} with {most}");
            }
            assert_eq!(with_detail(&before, 2, &[[0.0; 3]]), before);
            assert_eq!(with_detail(&before, 7, &[[0.0; 3]]), before);
        }
    }

    #[test]
    fn lower_degrees_are_the_beginning_of_higher_ones() {
        let before = scene(ColourModel::SphericalHarmonics { degree: 2 });
        let after = with_detail(&before, 1, &[[0.0; 3]]);
        for row in 0..5 {
            let (long, short) =
                (&before.gaussians.colour.detail[24 * row..], &after.gaussians.colour.detail[9 * row..]);
            assert_eq!(long[..9], short[..9], "row {row}");
        }
        assert_eq!(before.gaussians.colour.base, after.gaussians.colour.base);
    }
}

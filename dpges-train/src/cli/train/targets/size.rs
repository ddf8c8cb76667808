//! The budget that keeps the scene file below a size.

use dpges_core::scene::ColourModel;
use dpges_train::config::budget::bytes_per_primitive;
use dpges_train::config::{Budget, Config};

use super::super::super::{Failure, Result};
use super::plan::Plan;

/// What a scene file has besides primitives: its header, and an environment of the highest degree.
const REST: f64 = 4096.0;
/// Fewer primitives show nothing.
pub const FEWEST: usize = 100;

/// Sets `refine.budget` to what fits into `bytes`, if all primitives are of the larger kind and have all lobes.
pub fn plan(config: &mut Config, bytes: f64) -> Result<Plan> {
    let model = config.scene_model();
    let largest = largest(model);
    let count = ((bytes - REST) / largest).max(0.0) as usize;
    if count < FEWEST {
        let least = REST + FEWEST as f64 * largest;
        let message = format!("a scene file of {bytes} bytes holds fewer than {FEWEST} primitives of {model}");
        return Err(Failure::with_help(message, format!("ask for at least {:.0}kB", (least / 1e3).ceil())));
    }
    config.refine.budget = Budget::Primitives(count);
    let expected = REST + count as f64 * largest;
    let how = format!("at most {count} primitives of {largest} bytes ({model})");
    Ok(Plan { unit: "bytes".to_owned(), expected, how, cameras: Vec::new() })
}

fn largest(model: ColourModel) -> f64 {
    bytes_per_primitive(model).into_iter().max().unwrap_or(0) as f64
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{EnvironmentData, GaussianData, SceneData, SceneInfo, SurfelData};

    use super::*;

    #[test]
    fn a_file_with_the_whole_budget_fits_and_is_nearly_as_large() {
        for (set, surfels) in [("model.colour=sb2", 0.0), ("model.colour=sb2", 1.0), ("model.colour=sh3", 0.5)] {
            let mut config = Config::resolve(None, None, &[set.to_owned()]).unwrap();
            let model = config.model.colour;
            let bytes = 2e6;
            let plan = plan(&mut config, bytes).unwrap();
            let Budget::Primitives(count) = config.refine.budget else { panic!("a number") };
            let surfels = (surfels * count as f64) as usize;
            let scene = SceneData {
                info: SceneInfo { colour_model: model, ..SceneInfo::default() },
                surfels: SurfelData::neutral(model, surfels),
                gaussians: GaussianData::neutral(model, count - surfels),
                environment: Some(EnvironmentData::neutral(EnvironmentData::MAX_DEGREE)),
            };
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("scene");
            scene.save(&path).unwrap();
            let found = std::fs::metadata(&path).unwrap().len() as f64;
            assert!(found <= plan.expected && plan.expected <= bytes && found > 0.94 * bytes, "{set}: {found}");
        }
    }

    #[test]
    fn a_file_without_room_for_primitives_is_refused() {
        let Err(Failure::Failed(report)) = plan(&mut Config::default(), 5000.0) else { panic!("not refused") };
        assert!(report.to_string().contains("fewer than 100 primitives of sb2"), "{report}");
    }
}

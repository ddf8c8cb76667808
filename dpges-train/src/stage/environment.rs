//! The environment in training: whether a run has one, what it begins with, its steps.

use std::collections::HashMap;

use burn::tensor::Device;
use dpges_core::scene::schema::ENVIRONMENT;
use dpges_core::scene::{EnvironmentData, SH_C0, SceneData};

use super::pretrained::{GAUSSIANS_FROM, SURFELS_FROM};
use super::{Context, TrainError};
use crate::config::{Background, Environment};
use crate::dataset::Format;
use crate::init::sky_detection::open_sky;
use crate::optimizer::{Parameter, ParameterRows};

/// Share of open sky above which a scene gets an environment by itself.
const SKY: f64 = 0.05;
/// The degree that it gets.
const DEGREE: usize = 3;

/// The environment of a stage, [(degree + 1)², 3]; `None` in runs without one.
pub type EnvironmentState = Option<Parameter>;

pub fn fresh(data: Option<&EnvironmentData>, device: &Device) -> EnvironmentState {
    data.map(|data| Parameter::fresh(&ENVIRONMENT, &data.coefficients, [data.len(), 3], device))
}

/// Takes the environment out of `rows`, if there is one.
///
/// # Errors
/// A message if its coefficients are those of no degree, or have no moments.
pub fn from_rows(rows: &mut HashMap<String, ParameterRows>, device: &Device) -> Result<EnvironmentState, String> {
    let is_of_a_degree = |count| EnvironmentData::degree_of(count).is_some();
    Parameter::take(&ENVIRONMENT, rows, 3, is_of_a_degree, "1, 4, 9 or 16", device)
}

pub fn to_data(state: &EnvironmentState) -> Option<EnvironmentData> {
    state.as_ref().map(|parameter| EnvironmentData { coefficients: parameter.raw_rows() })
}

impl Context {
    /// The environment that a run begins with, if it has one: that of a file that takes the place of a stage, the last
    /// that has one of the degree that is wanted; or everywhere the mean colour of the open sky, or that of the background
    /// where there is none.
    ///
    /// # Errors
    /// [`TrainError::Pretrained`] if such a file is of no use, [`TrainError::Core`] if a photograph cannot be read again.
    pub fn start_of_environment(&self) -> Result<Option<EnvironmentData>, TrainError> {
        let wanted = self.config.model.environment;
        if wanted == Environment::None {
            return Ok(None);
        }
        if wanted == Environment::Auto && self.background_is_given() {
            tracing::info!("the background is given, so the scene has no environment");
            return Ok(None);
        }
        for key in [GAUSSIANS_FROM, SURFELS_FROM] {
            let Some(SceneData { info, environment: Some(mut found), .. }) = self.pretrained(key)? else { continue };
            if wanted == Environment::Auto || EnvironmentData::degree_of(found.len()) == wanted.degree() {
                self.add(&mut found, info.background);
                return Ok(Some(found));
            }
        }
        self.environment_of_sky(wanted)
    }

    /// Whether the photographs show the background of the dataset, not a world.
    pub fn background_is_given(&self) -> bool {
        self.dataset.format == Format::Blender
            || self.dataset.train.iter().any(|view| view.photograph.has_transparency())
            || self.config.data.background != Background::Auto
    }

    /// Adds `colour` to an environment before the background of this dataset, and takes the latter away.
    fn add(&self, environment: &mut EnvironmentData, colour: [f64; 3]) {
        let pairs = colour.into_iter().zip(self.dataset.background);
        for (k, (colour, background)) in environment.coefficients.iter_mut().zip(pairs) {
            *k += ((colour - background) / SH_C0) as f32;
        }
    }

    fn environment_of_sky(&self, wanted: Environment) -> Result<Option<EnvironmentData>, TrainError> {
        let dataset = &self.dataset;
        let sky = open_sky(dataset)?;
        let percent = 100.0 * sky.share;
        let degree = match wanted.degree() {
            Some(degree) => degree,
            None if sky.share > SKY => DEGREE,
            None if dataset.points.positions.is_empty() => {
                tracing::info!(
                    "the dataset has no points, so that nothing says how far what it shows is: an environment of degree \
                     {DEGREE} for what is far away (model.environment)"
                );
                return Ok(Some(self.neutral(DEGREE, sky.colour)));
            }
            None => {
                tracing::info!(
                    "{percent:.1} % of the pixels are open sky, above all points of the dataset: no environment, which \
                     takes {} % (model.environment)",
                    100.0 * SKY
                );
                return Ok(None);
            }
        };
        tracing::info!(
            "{percent:.1} % of the pixels are open sky, above all points of the dataset: an environment of degree {degree} \
             (model.environment)"
        );
        Ok(Some(self.neutral(degree, sky.colour)))
    }

    /// Of one `colour`, or of that of the background.
    fn neutral(&self, degree: usize, colour: Option<[f64; 3]>) -> EnvironmentData {
        let mut environment = EnvironmentData::neutral(degree);
        self.add(&mut environment, colour.unwrap_or(self.dataset.background));
        environment
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use dpges_core::scene::{GaussianData, Rendering, SceneInfo, SurfelData};

    use super::*;
    use crate::dataset::Dataset;
    use crate::init::sky_detection::tests::{BLUE, ring, tower};
    use crate::run::fixtures::{config, device};

    fn start(dataset: Dataset, set: &[&str]) -> Option<EnvironmentData> {
        let context = Context::new(config(set), Arc::new(dataset), device().into());
        context.start_of_environment().unwrap()
    }

    fn outdoors() -> Dataset {
        ring(0.0, tower(0.0))
    }

    fn indoors() -> Dataset {
        ring(0.0, tower(20.0))
    }

    #[test]
    fn open_sky_decides_and_gives_its_colour() {
        let sky = start(outdoors(), &[]).unwrap();
        assert_eq!(EnvironmentData::degree_of(sky.len()), Some(DEGREE));
        for (k, colour) in sky.coefficients.iter().zip(BLUE.map(|value| f64::from(value) / 255.0)) {
            assert!((f64::from(*k) * SH_C0 - colour).abs() < 1e-6, "{k}");
        }
        assert!(sky.coefficients[3..].iter().all(|&k| k == 0.0));
        assert_eq!(start(indoors(), &[]), None);
        let without_points = start(ring(0.0, Vec::new()), &[]);
        assert_eq!(without_points, Some(EnvironmentData::neutral(DEGREE)), "nothing says how far anything is");
    }

    #[test]
    fn a_background_that_is_known_is_kept() {
        assert_eq!(start(outdoors(), &["data.background=black"]), None);
        assert_eq!(start(Dataset { format: Format::Blender, ..outdoors() }, &[]), None);
        let mut masked = outdoors();
        masked.train[2].repaint(|picture| picture.alpha = Some(vec![255; picture.area()])).unwrap();
        assert!(start(masked.clone(), &[]).is_some());
        masked.train[2].repaint(|picture| picture.alpha = Some(vec![0; picture.area()])).unwrap();
        assert_eq!(start(masked, &[]), None);
    }

    #[test]
    fn a_file_that_takes_the_place_of_a_stage_gives_its_environment() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gaussians.safetensors");
        let colour_model = config(&[]).model.colour;
        let info = SceneInfo { colour_model, rendering: Rendering::Ellipsoids, ..SceneInfo::default() };
        let coefficients: Vec<f32> = (0..12).map(|at| at as f32).collect();
        SceneData {
            info: SceneInfo { background: [0.5, 0.0, 0.0], ..info },
            surfels: SurfelData::neutral(colour_model, 0),
            gaussians: GaussianData::neutral(colour_model, 1),
            environment: Some(EnvironmentData { coefficients: coefficients.clone() }),
        }
        .save(&path)
        .unwrap();
        let from = format!("stages.gaussians_from={}", path.display());
        // the same colours before the black background of the dataset
        let expected = [&[(0.5 / SH_C0) as f32][..], &coefficients[1..]].concat();
        for set in [&[from.as_str()][..], &[&from, "model.environment=sh1"]] {
            assert_eq!(start(indoors(), set), Some(EnvironmentData { coefficients: expected.clone() }), "{set:?}");
        }
        assert_eq!(start(indoors(), &[&from, "model.environment=none"]), None);
        assert_eq!(start(indoors(), &[&from, "data.background=black"]), None);
        let other = start(indoors(), &[&from, "model.environment=sh2"]);
        assert_eq!(other, Some(EnvironmentData::neutral(2)));
    }

    #[test]
    fn what_is_asked_for_is_done() {
        assert_eq!(start(outdoors(), &["model.environment=none"]), None);
        for (degree, name) in ["sh0", "sh1", "sh2", "sh3"].into_iter().enumerate() {
            let set = format!("model.environment={name}");
            let mut dataset = indoors();
            dataset.background = [0.5; 3];
            assert_eq!(start(dataset, &[&set]), Some(EnvironmentData::neutral(degree)), "{name}");
        }
    }
}

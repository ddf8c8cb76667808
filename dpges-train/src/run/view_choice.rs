//! The views of a dataset from which a scene is shown.

use std::path::PathBuf;

use super::scene::{Reading, Scene, SceneError};
use crate::dataset::source::Source;
use crate::dataset::{Dataset, Split, View};

type Result<T, E = SceneError> = std::result::Result<T, E>;

/// Which views of which dataset.
#[derive(Clone, Debug, Default)]
pub struct ViewChoice {
    /// The dataset; a run knows its own.
    pub data: Option<PathBuf>,
    /// The split; `None` for the held-out views.
    pub split: Option<Split>,
    pub reading: Reading,
}

impl ViewChoice {
    pub fn split(&self) -> Split {
        self.split.unwrap_or(Split::Test)
    }

    /// The views of the split, as [`dataset`](Self::dataset) has them, and what they were read from.
    ///
    /// # Errors
    /// As [`load_dataset`](Self::load_dataset).
    pub fn load(&self, scene: &mut Scene) -> Result<(Source, Vec<View>)> {
        let (source, dataset) = self.load_dataset(scene)?;
        Ok((source, self.chosen(&dataset).to_vec()))
    }

    /// Like [`load_dataset`](Self::load_dataset), for a decision: with the split that is asked for, or else that of the views
    /// which the run of the scene kept for decisions, or else of the training views. Held-out views would no longer be held
    /// out.
    ///
    /// # Errors
    /// As [`load_dataset`](Self::load_dataset).
    pub fn load_to_decide(&self, scene: &mut Scene) -> Result<(Source, Dataset, Split)> {
        if let Some(split) = self.split {
            let (source, dataset) = self.load_dataset(scene)?;
            return Ok((source, dataset, split));
        }
        let (source, dataset) = self.read(scene, true)?;
        let split = if dataset.validation.is_empty() { Split::Train } else { Split::Validation };
        Ok((source, dataset, split))
    }

    /// Like [`dataset`](Self::dataset), but refuses one without views in the split.
    ///
    /// # Errors
    /// [`SceneError::NoViews`]; those of [`Scene::read`].
    pub fn load_dataset(&self, scene: &mut Scene) -> Result<(Source, Dataset)> {
        let (source, dataset) = self.dataset(scene)?;
        if self.chosen(&dataset).is_empty() {
            let other = if self.split() == Split::Train { Split::Test } else { Split::Train };
            return Err(SceneError::NoViews { dataset: source.to_string(), split: self.split(), other });
        }
        Ok((source, dataset))
    }

    /// The dataset, with cameras and points in the scene's coordinates, and what it was read from: see [`Scene::dataset`].
    ///
    /// # Errors
    /// Those of [`Scene::read`].
    pub fn dataset(&self, scene: &mut Scene) -> Result<(Source, Dataset)> {
        self.read(scene, self.split() == Split::Validation)
    }

    /// The same; the inner error says why there is none, where it is neither named nor `needed`.
    ///
    /// # Errors
    /// Those of [`Scene::read`] where it is.
    pub fn dataset_at_hand(&self, scene: &mut Scene, needed: bool) -> Result<Result<(Source, Dataset)>> {
        match self.dataset(scene) {
            Err(error) if needed || self.data.is_some() => Err(error),
            data => Ok(data),
        }
    }

    /// As [`dataset`](Self::dataset); validation views are among the training views unless `apart`.
    fn read(&self, scene: &mut Scene, apart: bool) -> Result<(Source, Dataset)> {
        scene.read(self.data.as_deref(), &self.reading, apart)
    }

    /// The views of `dataset` that are asked for.
    pub fn chosen<'a>(&self, dataset: &'a Dataset) -> &'a [View] {
        self.split().of(dataset)
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, GaussianData, SceneData, SceneInfo, SurfelData};

    use super::*;
    use crate::config::Config;
    use crate::dataset::source::BUILTIN;
    use crate::run::folder::{Origin, RunFolder};

    #[test]
    fn held_out_views_decide_only_where_they_are_asked_to() {
        let (folder, model) = (tempfile::tempdir().unwrap(), ColourModel::SphericalBeta { lobes: 0 });
        let scene = SceneData {
            info: SceneInfo { colour_model: model, ..SceneInfo::default() },
            surfels: SurfelData::neutral(model, 0),
            gaussians: GaussianData::neutral(model, 1),
            environment: None,
        };
        let decide = |set: &[&str], data: Option<&str>, split: Option<Split>| {
            let set: Vec<String> = ["data.max_resolution=4"].iter().chain(set).map(|&text| text.to_owned()).collect();
            let config = Config::resolve(None, None, &set).unwrap();
            let run = RunFolder::new(folder.path());
            run.start(&Origin::new(BUILTIN, "cpu"), &config).unwrap();
            scene.save(&run.scene()).unwrap();
            let views = ViewChoice { data: data.map(PathBuf::from), split, reading: Reading::default() };
            let (_, dataset, split) = views.load_to_decide(&mut Scene::load(folder.path()).unwrap()).unwrap();
            let names: Vec<String> = split.of(&dataset).iter().map(|view| view.name.clone()).collect();
            (split, names)
        };
        let (split, trained) = decide(&[], None, None);
        assert!(split == Split::Train && trained.iter().all(|name| name.starts_with("train_")), "{split} {trained:?}");
        let (split, kept) = decide(&["data.validation_every=4"], None, None);
        assert!(split == Split::Validation && kept.len() == trained.len() / 4, "{split} {kept:?}");
        assert!(kept.iter().all(|name| trained.contains(name)));
        assert_eq!(decide(&["data.validation_every=4"], None, Some(Split::Validation)).1, kept);
        // of another dataset nothing was kept
        assert_eq!(decide(&["data.validation_every=4"], Some("builtin:lens=fisheye"), None).0, Split::Train);
        let (split, held_out) = decide(&[], None, Some(Split::Test));
        assert!(split == Split::Test && held_out.iter().all(|name| name.starts_with("test_")), "{split} {held_out:?}");
    }
}

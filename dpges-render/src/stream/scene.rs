//! The part of a scene in levels of detail that is loaded first: index, sky, coarsest level.

use dpges_core::scene::lod::{Index, Part};
use dpges_core::scene::{GaussianData, Rendering, SceneData, SurfelData};

use super::LoadedCell;
use crate::error::RenderError;

/// Why a scene in levels of detail cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    #[error(
        "a budget of {budget} primitives is too small for the coarsest level of the scene, which has {least}: allow at \
         least {least}"
    )]
    Budget { budget: usize, least: usize },
    #[error("scenes of blended {0} cannot be streamed, only scenes of peeled surfels: open the scene file itself")]
    Blended(Rendering),
    #[error("{place}: {reason}")]
    Load { place: String, reason: String },
    #[error("a cell cannot be loaded: {0}")]
    Cell(String),
    #[error(transparent)]
    Scene(#[from] dpges_core::Error),
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// The index of a scene, its sky and its coarsest level.
#[derive(Debug)]
pub struct LodScene {
    pub(super) index: Index,
    pub(super) coarse: SceneData,
    pub(super) roots: Vec<(usize, LoadedCell)>,
}

impl LodScene {
    /// The parts that are needed first: the sky, then the roots.
    pub fn parts(index: &Index) -> impl Iterator<Item = &Part> {
        index.sky.iter().chain(index.roots().map(|root| &index.cells[root].part))
    }

    /// Reads the [`parts`](Self::parts), in this order, by `read`.
    ///
    /// # Errors
    /// The errors of `read`; [`StreamError::Blended`]; [`StreamError::Scene`] for bytes that are not what the index says.
    pub fn new(index: Index, mut read: impl FnMut(&Part) -> Result<Vec<u8>, StreamError>) -> Result<Self, StreamError> {
        if index.settings.rendering != Rendering::Peeled {
            return Err(StreamError::Blended(index.settings.rendering));
        }
        let model = index.settings.colour_model;
        let mut coarse = SceneData {
            info: index.settings.clone(),
            surfels: SurfelData::neutral(model, 0),
            gaussians: GaussianData::neutral(model, 0),
            environment: None,
        };
        if let Some(sky) = &index.sky {
            coarse.environment = index.sky(sky, &read(sky)?)?.environment;
        }
        let mut roots = Vec::new();
        for root in index.roots() {
            let scene = index.cell(root, &read(&index.cells[root].part)?)?;
            roots.push((root, LoadedCell::new(&scene)));
            coarse.surfels.append(scene.surfels);
            coarse.gaussians.append(scene.gaussians);
        }
        Ok(Self { index, coarse, roots })
    }

    pub fn index(&self) -> &Index {
        &self.index
    }

    /// The coarsest level as a scene.
    pub fn coarse(&self) -> &SceneData {
        &self.coarse
    }

    /// Surfels and Gaussians of level 0.
    pub fn counts(&self) -> [usize; 2] {
        super::counts(self.index.level(0).map(|cell| &self.index.cells[cell]))
    }
}

//! The scene around a block, which is drawn with the block, and neither learns nor changes.

use std::sync::Arc;

use burn::tensor::{DType, Tensor, TensorData};
use dpges_core::scene::schema::Columns;
use dpges_core::scene::{Gaussians, Rendering, SceneData, Surfels};

use super::TrainError;
use crate::config::Config;
use crate::dataset::Dataset;
use crate::dataset::block::{Block, Bounds};
use crate::device::place::Place;

/// Key of the file that says which block is trained.
const BLOCK: &str = "train.block";

/// The surroundings of a block. Their primitives follow those of the block, wherever both are drawn.
#[derive(Debug)]
pub struct Surroundings {
    /// Where Gaussians may be added to the block.
    pub bounds: Bounds,
    pub scene: SceneData,
    surfels: Surfels,
    /// Empty on all ranks but the first, since sums of Gaussians are joined.
    gaussians: Gaussians,
}

impl Surroundings {
    /// The surroundings of the block that `config` names, if it names one.
    ///
    /// # Errors
    /// [`TrainError::Pretrained`] if a file cannot be read, or its scene does not fit this run.
    pub fn read(config: &Config, dataset: &Dataset, place: &Place) -> Result<Option<Arc<Self>>, TrainError> {
        let Some(path) = config.block() else { return Ok(None) };
        let wrong =
            |path: &std::path::Path, reason: String| TrainError::Pretrained { key: BLOCK, path: path.into(), reason };
        let Block { bounds, surroundings, .. } = Block::read(path).map_err(|error| wrong(path, error.to_string()))?;
        let wrong = |reason: String| wrong(&surroundings, reason);
        let scene = SceneData::load(&surroundings).map_err(|error| wrong(error.to_string()))?;
        let info = &scene.info;
        if info.rendering != Rendering::Peeled || info.colour_model != config.model.colour {
            let (rendering, colours) = (info.rendering, info.colour_model);
            let expected = config.model.colour;
            return Err(wrong(format!(
                "it is a scene of {rendering} with colours {colours}, not of surfels and Gaussians with {expected}"
            )));
        }
        if info.offset != dataset.offset.to_array() {
            let (found, expected) = (info.offset, dataset.offset);
            return Err(wrong(format!("its origin is {found:?} in the dataset, that of this run {expected}")));
        }
        let drawn = if place.ranks.is_first() { scene.gaussians.clone() } else { scene.gaussians.select(&[]) };
        let surfels = Surfels::from_data(&scene.surfels, &place.device, DType::F32);
        let gaussians = Gaussians::from_data(&drawn, &place.device, DType::F32);
        Ok(Some(Arc::new(Self { bounds, surfels, gaussians, scene })))
    }

    /// Own primitives, which are on a tape, and these behind them.
    pub fn on_tape(&self, surfels: &Surfels, gaussians: &Gaussians) -> (Surfels, Gaussians) {
        (joined(surfels, &self.surfels, Tensor::autodiff), joined(gaussians, &self.gaussians, Tensor::autodiff))
    }

    /// The same without a tape.
    pub fn values(&self, surfels: &Surfels, gaussians: &Gaussians) -> (Surfels, Gaussians) {
        (joined(surfels, &self.surfels, |rows| rows), joined(gaussians, &self.gaussians, |rows| rows))
    }

    /// `scene`, the block, and these behind it.
    pub fn complete(&self, scene: &SceneData) -> SceneData {
        let mut all = scene.clone();
        all.surfels.append(self.scene.surfels.clone());
        all.gaussians.append(self.scene.gaussians.clone());
        all
    }
}

/// The rows of `own`, then those of `others`, which `lift` puts where the own ones are.
fn joined<C>(own: &C, others: &C, lift: impl Fn(Tensor<2>) -> Tensor<2>) -> C
where
    C: Columns<Value = Tensor<2>, With<Tensor<2>> = C>,
{
    let rows = |(own, other): (&Tensor<2>, &Tensor<2>)| {
        let ([count, width], [more, _]) = (own.dims(), other.dims());
        match (count, more, width) {
            (_, 0, _) => own.clone(),
            (0, ..) => lift(other.clone()),
            // no kernel copies nothing
            (.., 0) => {
                let nothing = TensorData::new(Vec::<f32>::new(), [count + more, 0]);
                lift(Tensor::from_data(nothing, (&other.device(), DType::F32)))
            }
            _ => Tensor::cat(vec![own.clone(), lift(other.clone())], 0),
        }
    };
    C::generate(own.model(), own.list().into_iter().zip(others.list()).map(rows))
}

//! The tile lists of a view.

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::ops::peel::PeelOptions;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{SceneData, ScreenFilter};
use dpges_core::tiles::work::{TileWork, gaussian_work, surfel_work};
use serde::Serialize;

use crate::config::{Blended, StageKind};
use crate::eval::rendered::Renderer;

/// The tile lists of the primitives of a view; `None` where the stage has none, or none that are counted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Lists {
    pub surfels: Option<List>,
    /// Not counted of discs.
    pub gaussians: Option<List>,
}

/// The tile lists of one kind of primitives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct List {
    #[serde(flatten)]
    pub work: TileWork,
    /// Share of the evaluated pairs that lie in a footprint; `None` without any.
    pub inside_share: Option<f64>,
}

impl From<TileWork> for List {
    fn from(work: TileWork) -> Self {
        Self { work, inside_share: work.inside_share() }
    }
}

impl Lists {
    /// Lists of `scene` seen by `camera` in a stage of `kind`; the joint stage renders it on `device`.
    pub fn new(scene: &SceneData, kind: StageKind, camera: &Camera, device: &Device) -> dpges_core::Result<Self> {
        let of_gaussians = |filter: ScreenFilter, ends: Option<&[f32]>| {
            Some(List::from(gaussian_work(&scene.gaussians, camera, filter, ends)))
        };
        Ok(match kind {
            StageKind::Blended(Blended::Discs) => Self { surfels: None, gaussians: None },
            StageKind::Blended(blended) => {
                Self { surfels: None, gaussians: of_gaussians(blended.screen_filter(), None) }
            }
            StageKind::Joint => Self {
                surfels: Some(surfel_work(&scene.surfels, camera, &PeelOptions::from(&scene.info)).into()),
                gaussians: of_gaussians(ScreenFilter::Compensated, ends(scene, camera, device)?.as_deref()),
            },
        })
    }
}

/// [H, W] the depth at and behind which a pixel sees no Gaussian; `None` of a scene that is not peeled.
fn ends(scene: &SceneData, camera: &Camera, device: &Device) -> dpges_core::Result<Option<Vec<f32>>> {
    let rendered = Renderer::new(scene, device).render(camera)?;
    Ok(rendered.peeled().map(|render| {
        let [layers, height, width] = render.limits.dims();
        tensor_to_rows(&render.limits.clone().slice([layers - 1..layers, 0..height, 0..width]))
    }))
}

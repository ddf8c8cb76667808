//! The layers of a rendered view as pictures.

use std::path::Path;

use dpges_core::camera::Camera;
use dpges_core::render::Render;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_render::{Rgb8Image, false_colour};

use super::{TrainingRenderer, to_picture};
use crate::eval::pictures::save_png;

/// The layers of a view, one picture each.
#[derive(Clone, Debug)]
pub struct LayerPictures {
    /// The surfels alone on the background.
    pub surfels: Rgb8Image,
    /// Transmittance behind the first, second, … and last peeled layer. White: all light passes.
    pub transmittance: Vec<Rgb8Image>,
    /// Depth of the surfels. Dark: near.
    pub depth: Rgb8Image,
    /// Depths at the ends of the colour ramp, world units; `None` if no surfel is visible.
    pub depth_range: Option<[f32; 2]>,
    /// Normals of the surfels: world x, y, z as red, green, blue.
    pub normal: Rgb8Image,
}

impl LayerPictures {
    /// Writes them to a folder and returns the names of the files, `STEM_surfels.png`, `STEM_depth.png`, `STEM_normal.png`,
    /// `STEM_transmittance_1.png`, ….
    ///
    /// # Errors
    /// [`Error::Io`](dpges_core::Error::Io) naming the file.
    pub fn save(&self, folder: &Path, stem: &str) -> dpges_core::Result<Vec<String>> {
        let mut named = vec![
            ("surfels".to_owned(), &self.surfels),
            ("depth".to_owned(), &self.depth),
            ("normal".to_owned(), &self.normal),
        ];
        let behind = self.transmittance.iter().zip(1..);
        named.extend(behind.map(|(picture, layer)| (format!("transmittance_{layer}"), picture)));
        let save = |(name, picture): (String, &Rgb8Image)| {
            let name = format!("{stem}_{name}.png");
            save_png(picture, &folder.join(&name))?;
            Ok(name)
        };
        named.into_iter().map(save).collect()
    }
}

/// Pictures of the layers of `view`, which `renderer` rendered from `camera`.
pub fn layer_pictures(renderer: &TrainingRenderer, camera: &Camera, view: &Render) -> LayerPictures {
    let (width, height) = (camera.width, camera.height);
    let transmittance = tensor_to_rows(&view.seen.transmittance);
    let behind: Vec<&[f32]> = transmittance.chunks_exact(width * height).skip(1).collect();
    let geometry = renderer.geometry(camera, view);
    let coverage: Vec<f32> = behind.last().into_iter().flat_map(|last| last.iter().map(|t| 1.0 - t)).collect();
    let (depth, depth_range) = false_colour::depth(&tensor_to_rows(&geometry.depth), &coverage, width, height);
    LayerPictures {
        surfels: to_picture(&view.composite.surfel_image),
        transmittance: behind.into_iter().map(|plane| false_colour::grey(plane, width, height)).collect(),
        depth,
        depth_range,
        normal: false_colour::normal(&tensor_to_rows(&geometry.normal), width, height),
    }
}

//! Pictures of a scene with what others go on with: the opacity of every pixel, and how far away what it shows is.

use dpges_core::camera::Camera;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{ColourData, ColourModel, Rendering, SH_C0, SceneData};
use dpges_render::{DepthSource, Headless, Precision, RasterRenderer, RenderOptions, Rgb8Image};

use super::rendered::{LayerPictures, TrainingRenderer, layer_pictures, to_picture};

/// What is asked for besides a picture.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wanted {
    /// Without the background. The scene must have no environment.
    pub alpha: bool,
    pub depth: bool,
    pub layers: bool,
}

/// A picture and what was asked for.
pub struct Painted {
    pub picture: Rgb8Image,
    /// [height, width]
    pub alpha: Option<Vec<u8>>,
    /// [height, width] depths of the first surfel, or of the first blended Gaussian, behind which no more than half of the light
    /// passes; of Gaussians elsewhere, the mean where they cover half. World units; 0 where there is none.
    pub depth: Option<Vec<f32>>,
    pub layers: Option<LayerPictures>,
}

impl From<Rgb8Image> for Painted {
    fn from(picture: Rgb8Image) -> Self {
        Self { picture, alpha: None, depth: None, layers: None }
    }
}

impl Painted {
    /// By the renderer that is trained with, which has `scene`.
    ///
    /// # Errors
    /// The errors of [`TrainingRenderer::render`].
    pub fn by_training(
        renderer: &TrainingRenderer,
        scene: &SceneData,
        camera: &Camera,
        wanted: Wanted,
    ) -> dpges_core::Result<Self> {
        let (render, depth) = if wanted.depth {
            let (render, depth) = renderer.render_with_depth(camera)?;
            (render, Some(depth))
        } else {
            (renderer.render(camera)?, None)
        };
        let planes = |renderer: &TrainingRenderer| Ok(tensor_to_rows(renderer.render(camera)?.image()));
        let depth = depth.map(|depth| {
            filled(depth, scene, || planes(&TrainingRenderer::new(&distances(scene, camera), renderer.device())))
        });
        let before = |colour: f64| planes(&renderer.before([colour; 3]));
        let cut = wanted.alpha.then(|| Ok(cut_out(&before(0.0)?, &before(1.0)?, camera))).transpose()?;
        let peeled = render.peeled().filter(|_| wanted.layers);
        let layers = peeled.map(|view| layer_pictures(renderer, camera, view));
        let (picture, alpha) =
            cut.map_or_else(|| (to_picture(render.image()), None), |(picture, alpha)| (picture, Some(alpha)));
        Ok(Self { picture, alpha, depth: depth.transpose()?, layers })
    }

    /// By the real-time renderer `raster`, which has `scene` and must be a [`Headless::float_renderer`]. Depths of blended
    /// Gaussians are means.
    ///
    /// # Errors
    /// The errors of [`Headless::planes`].
    pub fn by_raster(
        headless: &Headless,
        raster: &mut RasterRenderer,
        scene: &SceneData,
        camera: &Camera,
        wanted: Wanted,
    ) -> dpges_render::Result<Self> {
        let options = RenderOptions::from(&scene.info);
        let mut before = |colour: Option<f64>| {
            let background = colour.map_or(options.background, |colour| [colour; 3]);
            headless.planes(raster, camera, &RenderOptions { background, ..options })
        };
        let (width, height) = (camera.width, camera.height);
        let (picture, alpha) = if wanted.alpha {
            let (picture, alpha) = cut_out(&before(Some(0.0))?, &before(Some(1.0))?, camera);
            (picture, Some(alpha))
        } else {
            (Rgb8Image::from_planes(&before(None)?, width, height), None)
        };
        let depth = wanted.depth.then(|| {
            let of_surfels = raster.median_depths().unwrap_or_else(|| vec![0.0; width * height]);
            filled(of_surfels, scene, || {
                let precision = RasterRenderer::best_precision(headless.device());
                let mut other = headless.float_renderer(precision, DepthSource::Computed)?;
                let flat = distances(scene, camera);
                other.upload(&flat)?;
                headless.planes(&mut other, camera, &RenderOptions::from(&flat.info))
            })
        });
        Ok(Self { picture, alpha, depth: depth.transpose()?, layers: None })
    }

    /// A renderer for [`by_raster`](Self::by_raster).
    ///
    /// # Errors
    /// The errors of [`Headless::float_renderer`].
    pub fn raster(headless: &Headless, precision: Option<Precision>) -> dpges_render::Result<RasterRenderer> {
        let device = headless.device();
        let precision = precision.unwrap_or_else(|| RasterRenderer::best_precision(device));
        headless.float_renderer(precision, RasterRenderer::best_depths(device))
    }
}

/// The picture without its background, and its opacities, of planes [3, height, width] before black and before white.
fn cut_out(black: &[f32], white: &[f32], camera: &Camera) -> (Rgb8Image, Vec<u8>) {
    let (width, height, area) = (camera.width, camera.height, camera.width * camera.height);
    let through = |pixel: usize| (0..3).map(|c| white[c * area + pixel] - black[c * area + pixel]).sum::<f32>() / 3.0;
    let alpha: Vec<f32> = (0..area).map(|pixel| (1.0 - through(pixel)).clamp(0.0, 1.0)).collect();
    let colour = |at: usize| black[at] / alpha[at % area].max(1.0 / 512.0);
    let planes: Vec<f32> = (0..3 * area).map(colour).collect();
    let bytes = alpha.iter().map(|alpha| (255.0 * alpha).round() as u8).collect();
    (Rgb8Image::from_planes(&planes, width, height), bytes)
}

/// `scene` with the depth of every centre as its red, and green where anything is.
fn distances(scene: &SceneData, camera: &Camera) -> SceneData {
    let model = ColourModel::SphericalHarmonics { degree: 0 };
    let colours = |positions: &[f32]| {
        let depth = |position: &[f32; 3]| camera.depth(glam::Vec3::from(*position).as_dvec3());
        let red = positions.as_chunks::<3>().0.iter().map(|position| ((depth(position) - 0.5) / SH_C0) as f32);
        let (one, zero) = ((0.5 / SH_C0) as f32, (-0.5 / SH_C0) as f32);
        ColourData::new(model, red.flat_map(|red| [red, one, zero]).collect(), Vec::new())
    };
    let mut flat = SceneData { environment: None, ..scene.clone() };
    flat.surfels.colour = colours(&scene.surfels.positions);
    flat.gaussians.colour = colours(&scene.gaussians.positions);
    (flat.info.background, flat.info.colour_model) = ([0.0; 3], model);
    if scene.info.rendering == Rendering::Summed {
        // its opacities have harmonics of the same degree as its colours
        flat.gaussians.colour = scene.gaussians.colour.clone();
        flat.info.colour_model = scene.info.colour_model;
    }
    flat
}

/// `depth`, and where there is none the mean of what `distances` shows at least half of.
fn filled<E>(
    mut depth: Vec<f32>,
    scene: &SceneData,
    distances: impl FnOnce() -> Result<Vec<f32>, E>,
) -> Result<Vec<f32>, E> {
    let has_others = matches!(scene.info.rendering, Rendering::Peeled | Rendering::Ellipsoids | Rendering::Discs);
    if has_others && !scene.gaussians.is_empty() && depth.contains(&0.0) {
        let planes = distances()?;
        let area = depth.len();
        for (pixel, depth) in depth.iter_mut().enumerate().filter(|(_, depth)| **depth == 0.0) {
            let (sum, weight) = (planes[pixel], planes[area + pixel]);
            *depth = if weight >= 0.5 { sum / weight } else { 0.0 };
        }
    }
    Ok(depth)
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use dpges_core::scene::{GaussianData, SceneInfo, SurfelData};
    use glam::DVec3;

    use super::*;
    use crate::run::fixtures::device;

    /// A ball of radius 0.3, 4 in front of the camera, of every kind.
    fn ball(rendering: Rendering) -> SceneData {
        let model = ColourModel::default();
        let mut gaussians = GaussianData::neutral(model, 1);
        gaussians.log_scales = vec![0.3f32.ln(); 3];
        gaussians.opacities = vec![if rendering == Rendering::Peeled { 50.0 } else { 0.99 }];
        gaussians.colour.base = vec![1.0, 0.0, -1.0];
        let info = SceneInfo { colour_model: model, rendering, background: [0.2, 0.9, 0.4], ..SceneInfo::default() };
        SceneData { info, surfels: SurfelData::neutral(model, 0), gaussians, environment: None }
    }

    #[test]
    fn an_object_is_cut_out_and_its_depth_is_in_world_units() {
        let pose = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y);
        let camera = Camera::pinhole(pose, 24.0, [16, 16], 0.1);
        let wanted = Wanted { alpha: true, depth: true, layers: false };
        for rendering in [Rendering::Peeled, Rendering::Ellipsoids, Rendering::Discs] {
            let scene = ball(rendering);
            let renderer = TrainingRenderer::new(&scene, &device());
            let painted = Painted::by_training(&renderer, &scene, &camera, wanted).unwrap();
            let (alpha, depth) = (painted.alpha.unwrap(), painted.depth.unwrap());
            let middle = 8 * 16 + 8;
            assert!(alpha[middle] > 220 && alpha[0] == 0, "{rendering} {}", alpha[middle]);
            assert!((depth[middle] - 4.0).abs() < 0.05 && depth[0] == 0.0, "{rendering} {}", depth[middle]);
            // its own colour, not that of the background
            let expected = [0.5 + SH_C0, 0.5, 0.5 - SH_C0].map(|c| (255.0 * c) as u8);
            let found = &painted.picture.bytes[3 * middle..][..3];
            assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) < 5), "{rendering} {found:?} {expected:?}");
        }
    }
}

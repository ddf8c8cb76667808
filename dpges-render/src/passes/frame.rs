//! Uniforms that all passes of a frame share: `struct Frame` of `frame.wgsl`.

use bytemuck::{Pod, Zeroable};
use dpges_core::camera::Camera;
use dpges_core::scene::peeling::{ORDER, RAMP};
use dpges_core::scene::{ColourModel, EnvironmentData, Peeling, Rendering, ScreenFilter};

use crate::options::RenderOptions;
use crate::scene::SceneTextures;

/// Coefficients of an environment.
const MAX_COEFFICIENTS: usize = EnvironmentData::coefficient_count(EnvironmentData::MAX_DEGREE);

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(crate) struct Frame {
    rows: [[f32; 4]; 3],
    lens: [f32; 4],
    centre_near: [f32; 4],
    size: [f32; 4],
    background: [f32; 4],
    surfel: [f32; 4],
    margins: [f32; 4],
    counts: [u32; 4],
    colour: [u32; 4],
    environment: [[f32; 4]; MAX_COEFFICIENTS],
}

impl Frame {
    /// `encode_srgb`: the target stores what it is given as sRGB.
    pub fn new(
        scene: &SceneTextures,
        camera: &Camera,
        options: &RenderOptions,
        depths: [f64; 2],
        encode_srgb: bool,
    ) -> Self {
        let pose = &camera.camera_from_world;
        let rows = std::array::from_fn(|i| {
            let row = pose.rotation.row(i);
            [row.x, row.y, row.z, pose.translation[i]].map(|value| value as f32)
        });
        let [x, y, z] = camera.centre().to_array();
        let RenderOptions { footprint, modulation, peeling, .. } = *options;
        let steepness = if peeling.is_continuous() { footprint.rim_slope(modulation) } else { modulation };
        let model = scene.info.colour_model;
        let (kind, parts) = match model {
            ColourModel::SphericalBeta { lobes } => (0, lobes),
            ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
                (1, model.detail_len() / 3)
            }
        };
        let switched = |bit: u32, on: bool| if on { bit } else { 0 };
        let all = switched(1, peeling == Peeling::Literal)
            | switched(2, scene.info.rendering != Rendering::Peeled)
            | switched(4, encode_srgb)
            | switched(8, scene.info.screen_filter == ScreenFilter::Plain)
            | switched(16, scene.info.max_alpha() < 0.995)
            | switched(32, peeling.is_continuous());
        let [r, g, b] = options.background;
        let narrow = |values: [f64; 4]| values.map(|value| value as f32);
        let grid = scene.surfels.grid;
        let mut environment = [[0.0; 4]; MAX_COEFFICIENTS];
        for (row, &[r, g, b]) in environment.iter_mut().zip(&scene.environment) {
            *row = [r, g, b, 0.0];
        }
        Self {
            rows,
            lens: narrow([camera.fx, camera.fy, camera.cx, camera.cy]),
            centre_near: narrow([x, y, z, camera.near]),
            size: narrow([camera.width as f64, camera.height as f64, options.smallest_px, grid.log2_width.into()]),
            background: narrow([r, g, b, scene.environment.len() as f64]),
            surfel: narrow([steepness, footprint.squared_radius(modulation), depths[0], depths[1]]),
            margins: narrow([if peeling.is_continuous() { ORDER } else { 0.0 }, RAMP, 0.0, 0.0]),
            counts: [
                scene.surfels.count as u32,
                scene.gaussians.count as u32,
                options.layer_count as u32,
                options.display as u32,
            ],
            colour: [scene.colour_texels as u32, kind, parts as u32, all],
            environment,
        }
    }
}

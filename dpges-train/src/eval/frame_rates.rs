//! Frames per second of a scene at several settings of rendering.

use dpges_core::camera::Camera;
use dpges_core::scene::{Peeling, Rendering, SceneData};
use dpges_render::frame_times::{FrameTimes, PassShare, Rounds, frame_times};
use dpges_render::{Display, Headless, RenderError, RenderOptions};
use serde::Serialize;

use super::rendered::TrainingRenderer;

/// The figures of `dpges bench render`.
#[derive(Debug, Serialize)]
pub struct FrameRates {
    /// Path of the scene file.
    pub scene: String,
    pub surfels: usize,
    pub gaussians: usize,
    /// px
    pub width: usize,
    /// px
    pub height: usize,
    pub cameras: usize,
    pub rows: Vec<Row>,
}

/// The times of one renderer at one setting.
#[derive(Debug, Serialize)]
pub struct Row {
    /// `raster` or `training`
    pub renderer: &'static str,
    /// Adapter, or device.
    pub on: String,
    pub layers: Option<usize>,
    pub peeling: Option<Peeling>,
    #[serde(flatten)]
    pub times: FrameTimes,
}

impl Row {
    /// Times of the real-time renderer, a row for each number of `layers` with each of `peelings`, or with that of the scene
    /// if there is none; one row for a scene without layers.
    ///
    /// # Errors
    /// [`RenderError`] without an adapter, or if the renderer refuses the scene or the cameras.
    pub fn of_raster(
        scene: &SceneData,
        cameras: &[Camera],
        rounds: Rounds,
        layers: &[usize],
        peelings: &[Peeling],
    ) -> Result<Vec<Self>, RenderError> {
        let headless = Headless::new()?;
        let mut renderer = headless.renderer()?;
        renderer.upload(scene)?;
        let own = RenderOptions { display: Display::Image, ..RenderOptions::from(&scene.info) };
        let mut row = |layers: Option<usize>, peeling: Option<Peeling>| {
            let (layer_count, as_trained) = (layers.unwrap_or(own.layer_count), own.peeling);
            let options = RenderOptions { layer_count, peeling: peeling.unwrap_or(as_trained), ..own };
            let times = frame_times(&headless, &mut renderer, cameras, &options, rounds)?;
            Ok(Self { renderer: "raster", on: headless.adapter_name(), layers, peeling, times })
        };
        if scene.info.rendering != Rendering::Peeled {
            return Ok(vec![row(None, None)?]);
        }
        let trained = [own.peeling];
        let peelings = if peelings.is_empty() { &trained } else { peelings };
        let settings = layers.iter().flat_map(|&layers| peelings.iter().map(move |&peeling| (layers, peeling)));
        settings.map(|(layers, peeling)| row(Some(layers), Some(peeling))).collect()
    }

    /// Times of the renderer that is trained with, `on` a device.
    ///
    /// # Errors
    /// [`RenderError`] if it refuses the cameras.
    pub fn of_training(
        scene: &SceneData,
        cameras: &[Camera],
        rounds: Rounds,
        renderer: &TrainingRenderer,
        on: String,
    ) -> Result<Self, RenderError> {
        let times = renderer.frame_times(cameras, rounds)?;
        let peeled = scene.info.rendering == Rendering::Peeled;
        let (layers, peeling) = (peeled.then_some(scene.info.layer_count), peeled.then_some(scene.info.peeling));
        Ok(Self { renderer: "training", on, layers, peeling, times })
    }
}

impl FrameRates {
    /// For people.
    pub fn table(&self) -> String {
        let Self { surfels, gaussians, width, height, cameras, .. } = self;
        let mut text = format!("{surfels} surfels, {gaussians} Gaussians, {width}x{height} px, {cameras} cameras\n");
        text += "renderer  K  peeling     frames/s    p50 ms    p99 ms  passes by the GPU's clock\n";
        for row in &self.rows {
            let layers = row.layers.map_or("-".to_owned(), |layers| layers.to_string());
            let peeling = row.peeling.map_or("-".to_owned(), |peeling| peeling.to_string());
            let share = |pass: &PassShare| format!("{} {:.2} ms ({:.0} %)", pass.name, pass.p50_ms, 100.0 * pass.share);
            let passes = row.times.passes.iter().map(share).collect::<Vec<_>>().join(", ");
            let FrameTimes { frames_per_second, p50_ms, p99_ms, .. } = row.times;
            let times = format!("{frames_per_second:8.1}  {p50_ms:8.2}  {p99_ms:8.2}");
            let line = format!("{:8}  {layers}  {peeling:10}  {times}  {passes}", row.renderer);
            text += line.trim_end();
            text += "\n";
        }
        let mut places: Vec<String> = self.rows.iter().map(|row| format!("{}: {}\n", row.renderer, row.on)).collect();
        places.dedup();
        text + &places.concat()
    }
}

//! How long frames take.

use std::time::Instant;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use serde::Serialize;

use crate::error::{RenderError, Result};
use crate::headless::{Headless, PICTURE_FORMAT};
use crate::options::RenderOptions;
use crate::percentile::percentiles;
use crate::renderer::RasterRenderer;
use crate::texture::{size, texture};

/// Times of frames, ms. A frame ends when the device has finished it, so that nothing of it overlaps with the next.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameTimes {
    pub frames: usize,
    /// 1000 / mean time
    pub frames_per_second: f64,
    pub p50_ms: f64,
    pub p99_ms: f64,
    /// By the GPU's clock, in the order of the passes; empty without timestamps.
    pub passes: Vec<PassShare>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PassShare {
    pub name: &'static str,
    pub p50_ms: f64,
    pub share: f64,
}

/// How many frames are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rounds {
    /// Rounds over the cameras that are not counted.
    pub warm_up: usize,
    pub counted: usize,
}

/// Draws what `renderer` holds from each of `cameras`, again and again. `renderer` must render into [`PICTURE_FORMAT`].
///
/// # Errors
/// The errors of [`RasterRenderer::render`]; [`RenderError::Device`] if the device stops to answer.
pub fn frame_times(
    headless: &Headless,
    renderer: &mut RasterRenderer,
    cameras: &[Camera],
    options: &RenderOptions,
    rounds: Rounds,
) -> Result<FrameTimes> {
    let device = headless.device();
    let (mut times, mut passes) = (Vec::new(), Vec::new());
    for round in 0..rounds.warm_up + rounds.counted {
        for camera in cameras {
            let size = size(camera.width as u32, camera.height as u32);
            let target = texture(device, size, PICTURE_FORMAT, wgpu::TextureUsages::RENDER_ATTACHMENT);
            let start = Instant::now();
            renderer.submit(&target, camera, options)?;
            device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| RenderError::Device(error.to_string()))?;
            let milliseconds = 1e3 * start.elapsed().as_secs_f64();
            renderer.finish_frame();
            if round >= rounds.warm_up {
                times.push(milliseconds);
                passes.push(renderer.pass_times().unwrap_or_default().to_vec());
            }
        }
    }
    let mut shares: Vec<PassShare> = Vec::new();
    for pass in passes.first().into_iter().flatten() {
        let of = passes.iter().flatten().filter(|other| other.name == pass.name).map(|other| other.milliseconds);
        let [p50_ms] = percentiles(of.collect(), [0.5]).expect("the first frame has this pass");
        shares.push(PassShare { name: pass.name, p50_ms, share: 0.0 });
    }
    let sum: f64 = shares.iter().map(|pass| pass.p50_ms).sum();
    shares.iter_mut().for_each(|pass| pass.share = pass.p50_ms / sum);
    Ok(FrameTimes::new(times, shares))
}

/// [`frame_times`] of `scene` with its own options, from `cameras` without their lenses.
///
/// # Errors
/// The errors of [`frame_times`] and of [`RasterRenderer::upload`].
pub fn scene_frame_times(
    headless: &Headless,
    scene: &SceneData,
    cameras: &[Camera],
    rounds: Rounds,
) -> Result<FrameTimes> {
    let mut renderer = headless.renderer()?;
    renderer.upload(scene)?;
    let cameras: Vec<Camera> = cameras.iter().map(Camera::without_lens).collect();
    frame_times(headless, &mut renderer, &cameras, &RenderOptions::from(&scene.info), rounds)
}

impl FrameTimes {
    /// From the times of frames, ms.
    pub fn new(times: Vec<f64>, passes: Vec<PassShare>) -> Self {
        let (frames, mean) = (times.len(), times.iter().sum::<f64>() / times.len() as f64);
        let [p50_ms, p99_ms] = percentiles(times, [0.5, 0.99]).expect("there are times");
        Self { frames, frames_per_second: 1e3 / mean, p50_ms, p99_ms, passes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_sorted_times() {
        let times = FrameTimes::new((1..=101).rev().map(f64::from).collect(), Vec::new());
        assert_eq!((times.frames, times.p50_ms, times.p99_ms), (101, 51.0, 100.0));
        assert!((times.frames_per_second - 1e3 / 51.0).abs() < 1e-9);
    }
}

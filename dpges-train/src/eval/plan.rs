//! Measurements of a scene that a command asks for.

use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::Args;
use dpges_core::Result;
use dpges_core::scene::SceneData;

use super::pictures::{file_stems, save_png};
use super::popping::{Measured, Popping};
use super::rendered::{TrainingRenderer, to_picture};
use super::{Evaluation, FrameMs, Measures, evaluate_each, worst};
use crate::dataset::{Dataset, View};
use crate::metrics::lpips::Lpips;

/// Measurements besides the scores of all pictures, and folders for pictures.
#[derive(Args, Clone, Debug)]
pub struct Plan {
    /// Also measure PSNR and SSIM after a fit of exposure: of the right half of each view, with a gain and an offset per
    /// channel that fit its left half best. The default for runs that correct exposures
    #[arg(long)]
    pub fit_exposure: bool,
    /// Also measure PSNR and SSIM after a fit of the camera: of the right half of each view, from where the camera has to be
    /// for the left half to fit best. Renders each view 80 times more
    #[arg(long)]
    fit_poses: bool,
    /// Write the rendered views as PNGs to this folder
    #[arg(long, value_name = "DIR")]
    pub save_images: Option<PathBuf>,
    /// Write the view that each metric finds worst to this folder, as worst_METRIC.png: photograph, render and FLIP side by
    /// side. With --popping also the frames that pop most, as worst_flip_1.png and worst_flip_7.png: the earlier frame as the
    /// motion of the camera moves it, the later one, and FLIP
    #[arg(long, value_name = "DIR")]
    worst: Option<PathBuf>,
    /// Also measure popping: FLIP between frames of a short path that are 1 and 7 apart, where the motion of the camera does
    /// not explain it; and jumps: how often a pixel changes by more than 8 and 16 of 256 levels from one frame to the next
    /// along an arc of 6° in small steps. Renders 60 frames and up to 1,920
    #[arg(long)]
    popping: bool,
    /// Also measure the frame times of the real-time renderer, over up to 16 of the views at the size of the first. Of scenes
    /// of --method sss and sortfree, which it does not draw, those of the renderer that is trained with
    #[arg(long)]
    frame_times: bool,
}

/// Measurements by a [`Plan`].
pub struct Found {
    pub evaluation: Evaluation,
    pub popping: Option<Popping>,
    pub frame_ms: Option<FrameMs>,
    /// The worst views and frames, and where their pictures are.
    pub worst: Vec<String>,
    /// Measurements that were asked for and could not be made, with the reason.
    pub notes: Vec<(&'static str, String)>,
}

impl Plan {
    /// The folders that are written to.
    pub fn folders(&self) -> BTreeSet<&PathBuf> {
        self.save_images.iter().chain(&self.worst).collect()
    }

    /// The files of `views` in [`save_images`](Self::save_images).
    pub fn files(views: &[View]) -> Vec<String> {
        file_stems(views.iter().map(|view| &*view.name)).iter().map(|stem| format!("{stem}.png")).collect()
    }

    /// Measures `scene`, which `renderer` has, on `views` of `dataset`; `device` names the one that renders.
    ///
    /// # Errors
    /// Those of [`evaluate_each`] and of [`TrainingRenderer::render`]; if a picture cannot be written.
    pub fn measure(
        &self,
        scene: &SceneData,
        renderer: &TrainingRenderer,
        dataset: &Dataset,
        views: &[View],
        networks: &[Lpips],
        device: &str,
    ) -> Result<Found> {
        let measures = Measures { fitted: self.fit_exposure, posed: self.fit_poses, ..Measures::perceptual(networks) };
        let files = Self::files(views);
        let evaluation = evaluate_each(renderer, scene, views, measures, |index, render| {
            let Some(folder) = &self.save_images else { return Ok(()) };
            save_png(&to_picture(render.image()), &folder.join(&files[index]))
        })?;
        let popping = if self.popping { Measured::of_scene(renderer, dataset, &scene.info)? } else { None };
        let mut found = Found { evaluation, popping: None, frame_ms: None, worst: Vec::new(), notes: Vec::new() };
        if let Some(folder) = &self.worst {
            found.worst = worst::write(folder, &found.evaluation, views, renderer)?;
            for frame in popping.iter().flat_map(|measured| &measured.worst) {
                found.worst.push(format!("{frame}, {}", frame.save(folder)?.display()));
            }
        }
        if self.popping && popping.is_none() {
            found.notes.push(("popping", "not measured: no surface is seen from two frames".to_owned()));
        }
        found.popping = popping.map(|measured| measured.popping);
        if self.frame_times {
            match FrameMs::measure(scene, views, renderer, device) {
                Ok(times) => found.frame_ms = Some(times),
                Err(error) => found.notes.push(("frames", format!("not measured: {error}"))),
            }
        }
        Ok(found)
    }
}

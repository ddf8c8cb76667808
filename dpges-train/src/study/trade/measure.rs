//! Pictures and frame times of a scene, on the real-time renderer or, without an adapter, on the one that trains.

use std::path::Path;

use burn::tensor::Device;
use clap::ValueEnum;
use dpges_core::camera::Camera;
use dpges_core::scene::{Quality, SceneData, SceneInfo};
use dpges_render::frame_times::{FrameTimes, Rounds, frame_times};
use dpges_render::{Headless, Precision, RenderOptions, Rgb8Image};
use dpges_train::dataset::View;
use dpges_train::device::DeviceName;
use dpges_train::eval::compress::Compressed;
use dpges_train::eval::rendered::{Renderer, to_picture};
use dpges_train::eval::{Measures, ViewScore, score_picture};
use dpges_train::metrics::Perceptual;
use dpges_train::metrics::lpips::Lpips;
use glam::DVec3;
use image::imageops::{FilterType, resize};
use image::{ImageBuffer, Rgb};

use super::knob::Change;
use crate::cli::Result;
use crate::cli::data::in_scene;
use crate::cli::frame_times::of_training;
use crate::cli::render::Size;

/// Rounds over the cameras that are not counted.
const WARM_UP: usize = 1;

/// What draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// The real-time one, on the graphics adapter that wgpu prefers
    Raster,
    /// The one that is trained with, on --device
    Training,
}

/// Draws scenes from the views of one dataset.
pub struct Bench<'a> {
    /// In the coordinates of a scene with the offset below.
    pub views: Vec<&'a View>,
    pub offset: DVec3,
    /// Of frames.
    pub size: Size,
    pub rounds: usize,
    /// Where pictures are compared, and drawn without an adapter.
    pub name: DeviceName,
    pub device: &'a Device,
    /// On that device: LPIPS is measured by these.
    pub networks: &'a [Lpips],
    /// `None`: the renderer that is trained with.
    pub headless: Option<Headless>,
}

/// What was seen of a scene.
pub struct Seen {
    /// dB, mean over the views.
    pub psnr: f64,
    pub ssim: f64,
    pub flip: f64,
    /// LPIPS, mean over the views that all have it.
    pub perceptual: Perceptual,
    pub times: FrameTimes,
    pub bytes: u64,
    pub gpu_bytes: Option<u64>,
    /// The first view.
    pub picture: Rgb8Image,
}

impl Bench<'_> {
    /// What draws the pictures and the frames, in words.
    pub fn device_text(&self) -> Result<String> {
        Ok(match &self.headless {
            Some(headless) => headless.adapter_name(),
            None => format!("{}, by the renderer that is trained with", self.name.describe()?),
        })
    }

    /// Whether there is a choice between sums of 32 and of 16 bits.
    pub fn sums_floats(&self) -> bool {
        let best = |headless: &Headless| dpges_render::Renderer::best_precision(headless.device());
        self.headless.as_ref().map(best) == Some(Precision::Float)
    }

    /// Draws `scene` as those of `changes` say that are no part of it.
    pub fn see(&self, scene: &SceneData, changes: &[Change]) -> Result<Seen> {
        let percent = changes.iter().find_map(|change| match change {
            Change::Resolution(percent) => Some(*percent),
            _ => None,
        });
        let level = changes.iter().find_map(|change| match change {
            Change::Compression(level) => Some(Quality::LEVELS[*level].1),
            _ => None,
        });
        let (compressed, bytes) = match level {
            Some(quality) => {
                let compressed = Compressed::new(scene, &quality, Path::new("scene.safetensors"))?;
                (Some(compressed.scene()?), compressed.bytes.len() as u64)
            }
            None => (None, file_bytes(scene)?),
        };
        let scene = compressed.as_ref().unwrap_or(scene);
        let smaller = |camera: Camera| percent.map_or(camera, |percent| reduced(&camera, percent));
        let cameras: Vec<Camera> = self.views.iter().map(|view| self.camera(view, &scene.info)).collect();
        let frames: Vec<Camera> = cameras.iter().map(|camera| smaller(self.size.apply(camera))).collect();
        let drawn: Vec<Camera> = cameras.into_iter().map(smaller).collect();
        let (pictures, times, gpu_bytes) = match &self.headless {
            Some(headless) => self.raster(headless, scene, &drawn, &frames, changes.contains(&Change::HalfSums))?,
            None => self.training(scene, &drawn, &frames)?,
        };
        let shown: Vec<Rgb8Image> = pictures
            .into_iter()
            .zip(&self.views)
            .map(|(picture, view)| enlarged(picture, view.camera.width, view.camera.height))
            .collect();
        let measures = Measures::lpips(self.networks);
        let score = |(view, picture): (&&View, &Rgb8Image)| score_picture(view, picture, 0.0, self.device, measures);
        let scores = self.views.iter().zip(&shown).map(score).collect::<Result<Vec<ViewScore>, _>>()?;
        let mean = |of: fn(&ViewScore) -> f64| scores.iter().map(of).sum::<f64>() / scores.len() as f64;
        Ok(Seen {
            psnr: mean(|view| view.psnr),
            ssim: mean(|view| view.ssim),
            flip: mean(|view| view.flip),
            perceptual: Perceptual::mean(&scores.iter().map(|view| view.perceptual).collect::<Vec<_>>()),
            times,
            bytes,
            gpu_bytes,
            picture: shown.into_iter().next().expect("there is at least one view"),
        })
    }

    fn counts(&self) -> Rounds {
        Rounds { warm_up: WARM_UP, counted: self.rounds }
    }

    fn camera(&self, view: &View, info: &SceneInfo) -> Camera {
        in_scene(view.camera, self.offset, info)
    }

    fn raster(
        &self,
        headless: &Headless,
        scene: &SceneData,
        cameras: &[Camera],
        frames: &[Camera],
        half_sums: bool,
    ) -> Result<(Vec<Rgb8Image>, FrameTimes, Option<u64>)> {
        let mut renderer = headless.renderer_with(half_sums.then_some(Precision::Half))?;
        renderer.upload(scene)?;
        let options = RenderOptions::from(&scene.info);
        let draw = |camera: &Camera| headless.draw(&mut renderer, camera, &options);
        let pictures = cameras.iter().map(draw).collect::<dpges_render::Result<_>>()?;
        let times = frame_times(headless, &mut renderer, frames, &options, self.counts())?;
        Ok((pictures, times, headless.allocated_bytes()))
    }

    fn training(
        &self,
        scene: &SceneData,
        cameras: &[Camera],
        frames: &[Camera],
    ) -> Result<(Vec<Rgb8Image>, FrameTimes, Option<u64>)> {
        let renderer = Renderer::new(scene, self.device);
        let picture = |camera: &Camera| Ok(to_picture(renderer.render(camera)?.image()));
        let pictures = cameras.iter().map(picture).collect::<Result<_>>()?;
        Ok((pictures, of_training(&renderer, frames, self.counts())?, None))
    }
}

/// `camera` for a picture whose sides are `percent` of its own, at least 1 px.
fn reduced(camera: &Camera, percent: u32) -> Camera {
    let side = |length: usize| ((length as f64 * f64::from(percent) / 100.0).round() as usize).max(1);
    camera.resized(side(camera.width), side(camera.height))
}

/// `picture` at a larger size, by a Catmull-Rom filter.
fn enlarged(picture: Rgb8Image, width: usize, height: usize) -> Rgb8Image {
    if (picture.width, picture.height) == (width, height) {
        return picture;
    }
    let Rgb8Image { width: from_width, height: from_height, bytes } = picture;
    let pixels = ImageBuffer::<Rgb<u8>, _>::from_raw(from_width as u32, from_height as u32, bytes);
    let pixels = pixels.expect("three bytes for every pixel");
    let bytes = resize(&pixels, width as u32, height as u32, FilterType::CatmullRom).into_raw();
    Rgb8Image { width, height, bytes }
}

/// Size of the scene file of `scene`.
pub fn file_bytes(scene: &SceneData) -> Result<u64> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("scene.safetensors");
    scene.save(&path)?;
    Ok(std::fs::metadata(&path)?.len())
}

#[cfg(test)]
mod tests {
    use dpges_train::dataset::{BuiltinOptions, builtin};

    use super::super::knob::tests::scene;
    use super::*;

    #[test]
    fn smaller_pictures_are_compared_at_the_size_of_the_photographs() {
        let options =
            BuiltinOptions { width: 20, height: 12, train_views: 1, test_views: 2, points: 0, ..Default::default() };
        let dataset = builtin(&options);
        let (scene, _) = scene();
        let name: DeviceName = "cpu".parse().unwrap();
        let device = name.open().unwrap();
        let bench = Bench {
            views: dataset.test.iter().collect(),
            offset: DVec3::ZERO,
            size: Size { width: 16, height: 8 },
            rounds: 2,
            name,
            device: &device,
            networks: &[],
            headless: None,
        };
        let [whole, half] = [&[][..], &[Change::Resolution(50)]].map(|changes| bench.see(&scene, changes).unwrap());
        for seen in [&whole, &half] {
            assert_eq!((seen.picture.width, seen.picture.height, seen.times.frames), (20, 12, 2 * 2));
            assert!(seen.psnr.is_finite() && seen.psnr > 0.0 && seen.times.p50_ms > 0.0);
        }
        assert_eq!(whole.bytes, half.bytes);
        let compressed = bench.see(&scene, &[Change::Compression(0)]).unwrap();
        assert!(compressed.bytes != whole.bytes && (compressed.psnr - whole.psnr).abs() < 0.5, "{}", compressed.psnr);
        assert!(whole.picture != half.picture && !bench.sums_floats());
        assert!(bench.device_text().unwrap().contains("burn-ndarray"));
    }

    #[test]
    fn reduced_cameras_see_the_same() {
        let view = builtin(&BuiltinOptions { width: 21, height: 9, train_views: 1, points: 0, ..Default::default() });
        let camera = view.train[0].camera;
        let small = reduced(&camera, 25);
        assert_eq!((small.width, small.height), (5, 2));
        assert!((small.cx / 5.0 - camera.cx / 21.0).abs() < 1e-12 && (small.fy / 2.0 - camera.fy / 9.0).abs() < 1e-12);
        assert_eq!((reduced(&camera, 1).width, reduced(&camera, 1).height), (1, 1));
    }

    #[test]
    fn enlarged_pictures_keep_their_colours() {
        let picture = Rgb8Image { width: 2, height: 2, bytes: [10, 100, 200].repeat(4) };
        assert_eq!(enlarged(picture.clone(), 2, 2), picture);
        let large = enlarged(picture, 5, 3);
        assert_eq!((large.width, large.height, large.bytes), (5, 3, [10, 100, 200].repeat(15)));
    }
}

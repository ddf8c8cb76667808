//! `dpges render`: pictures of a scene, from the cameras of a dataset or along a path.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use dpges_core::camera::Camera;
use dpges_core::scene::Rendering;
use dpges_render::path::Size;
use dpges_render::stream::Loader;
use dpges_render::{Headless, Precision, RenderOptions};
use dpges_train::config::Background;
use dpges_train::device::DeviceRequest;
use dpges_train::eval::painted::{Painted, Wanted};
use dpges_train::eval::rendered::TrainingRenderer;
use dpges_train::eval::rendering_preset::RenderingPreset;
use dpges_train::eval::stitched::{self, PictureLens};
use dpges_train::eval::video::Video;
use dpges_train::run::folder::hold_file;
use dpges_train::run::hold::Hold;
use dpges_train::run::shots::{PathChoice, Shot};
use dpges_train::run::sink::Sink;

use super::data::{Scene, ViewArgs};
use super::device_choice::watched;
use super::levels::{LevelsArgs, load};
use super::logging::LogStyle;
use super::progress::Progress;
use super::{Failure, Result, device_choice, print};

/// Write pictures of a scene: PNGs or a video, of the views of a dataset or along a camera path
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Scene file, splats (PLY, SPZ, SOG, glTF), folder of a run, or scene in levels of detail: its folder or address
    scene: PathBuf,
    #[command(flatten)]
    levels: LevelsArgs,
    #[command(flatten)]
    views: ViewArgs,
    /// Folder for PNGs
    #[arg(long, value_name = "DIR", required_unless_present = "video")]
    out: Option<PathBuf>,
    /// Write a video of the frames, by the program ffmpeg; the ending chooses the format
    #[arg(long, value_name = "FILE")]
    video: Option<PathBuf>,
    /// Pictures per second of the video [default: 30]
    #[arg(long, value_name = "N", requires = "video", value_parser = clap::value_parser!(u32).range(1..=240))]
    fps: Option<u32>,
    /// The program that makes the video
    #[arg(long, value_name = "PROGRAM", default_value = "ffmpeg")]
    ffmpeg: PathBuf,
    /// Cameras: views (of the dataset), interpolated (a smooth path through them), orbit (also of a scene alone), spiral, or a
    /// file of cameras in the dataset's coordinates: cameras.json of 3DGS or of the window, transforms.json, camera_path.json of
    /// nerfstudio, images.txt or images.bin of COLMAP
    #[arg(long, value_name = "PATH", default_value = "views")]
    path: PathChoice,
    /// Frames along a smooth path [default: 120; of a file one for each of its cameras]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: Option<u32>,
    /// Size of the pictures, as in 1920x1080; the vertical field of view stays
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    size: Option<Size>,
    /// Projection of the pictures [default: that of the cameras]; --size of a panorama is twice as wide as high
    #[arg(long, value_name = "LENS", value_enum, conflicts_with = "layers")]
    lens: Option<PictureLens>,
    /// Which renderer
    #[arg(long, value_enum, default_value_t = Engine::Training)]
    renderer: Engine,
    /// Device of the training renderer: auto (a GPU that passes a check, or else the CPU), cpu, wgpu (the best
    /// GPU), or another one that `dpges devices` lists [default: auto]. The other one takes the graphics adapter that wgpu
    /// prefers
    #[arg(long, value_name = "NAME")]
    device: Option<DeviceRequest>,
    /// Draw less than was trained, in less time
    #[arg(long, value_name = "NAME", value_enum)]
    preset: Option<RenderingPreset>,
    /// Also write the surfels alone, the transmittance behind each layer, depth and normals, and their depth ranges
    /// in layers.json
    #[arg(long, requires = "out")]
    layers: bool,
    /// Also write how far away what a pixel shows is, world units, as channel Z of OpenEXR files; 0 where nothing is
    #[arg(long, requires = "out")]
    depth: bool,
}

/// The renderer of the pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// The one that is trained with, on --device: CPU or compute kernels
    Training,
    /// The real-time one, on the graphics adapter that wgpu prefers: the graphics pipeline
    Raster,
}

pub fn run(args: &RenderArgs) -> Result<()> {
    let of_levels = args.levels.are_at(&args.scene, args.preset)?;
    args.check(of_levels)?;
    let hold = args.out.as_deref().map(Hold::of_folder).transpose()?;
    let _video = args.video.as_deref().map(hold_file).transpose()?;
    let levels = args.levels.open(&args.scene)?;
    let mut scene = load(&args.scene, levels.as_ref())?;
    let rendering = scene.data.info.rendering;
    if args.layers && rendering != Rendering::Peeled {
        let of = args.scene.display();
        return Err(Failure::Usage(format!("--layers: {of} is a scene of {rendering}, which has no layers")));
    }
    match args.renderer {
        Engine::Raster => {
            scene.use_pinholes();
            scene.warn_of_order("the real-time renderer sorts");
            let shots = args.shots(&mut scene)?;
            let headless = Headless::new()?;
            tracing::info!("rendering on {}", headless.adapter_name());
            let half_sums = args.preset.is_some_and(RenderingPreset::half_sums).then_some(Precision::Half);
            let options = RenderOptions::from(&scene.data.info);
            if let Some(levels) = levels {
                let mut renderer = headless.renderer_with(half_sums)?;
                let mut loader = Loader::new(levels, &mut renderer, || {})?;
                let mut most = 0;
                args.write(hold, &shots, |camera| {
                    most = most.max(loader.complete(&mut renderer, camera)?);
                    Ok(headless.draw(&mut renderer, camera, &options)?.into())
                })?;
                tracing::info!("at most {most} of {} primitives were in memory", loader.status().budget);
                return Ok(());
            }
            if args.wanted().alpha || args.depth {
                let mut renderer = Painted::raster(&headless, half_sums)?;
                renderer.upload(&scene.data)?;
                let paint = |camera: &Camera| {
                    Ok(Painted::by_raster(&headless, &mut renderer, &scene.data, camera, args.wanted())?)
                };
                return args.write(hold, &shots, paint);
            }
            let mut renderer = headless.renderer_with(half_sums)?;
            renderer.upload(&scene.data)?;
            args.write(hold, &shots, |camera| Ok(headless.draw(&mut renderer, camera, &options)?.into()))
        }
        Engine::Training => {
            let device = device_choice::select(args.device.unwrap_or_default())?;
            watched(device, || {
                let shots = args.shots(&mut scene)?;
                let renderer = TrainingRenderer::new(&scene.data, &device.open()?);
                args.write(hold, &shots, |camera| {
                    Ok(Painted::by_training(&renderer, &scene.data, camera, args.wanted())?)
                })
            })
        }
    }
}

impl RenderArgs {
    /// Refuses options that would make no difference.
    fn check(&self, of_levels: bool) -> Result<()> {
        let raster = self.renderer == Engine::Raster;
        let message = match self {
            _ if of_levels && !raster => {
                "--renderer training: a scene in levels of detail is drawn by `--renderer raster`"
            }
            _ if of_levels && (self.depth || self.wanted().alpha) => {
                "--depth and --background transparent: a scene in levels of detail is drawn as it is"
            }
            _ if self.layers && raster => "--layers: pictures of layers are made by `--renderer training`",
            _ if self.device.is_some() && raster => {
                "--device: the real-time renderer takes the adapter that wgpu prefers (WGPU_ADAPTER_NAME names another)"
            }
            _ if self.video.is_some() && self.wanted().alpha => "--background transparent: videos have no alpha",
            _ => return Ok(()),
        };
        Err(Failure::Usage(message.to_owned()))
    }

    /// The outputs besides pictures that are asked for.
    fn wanted(&self) -> Wanted {
        let alpha = self.views.choice().reading.background == Some(Background::Transparent);
        Wanted { alpha, depth: self.depth, layers: self.layers }
    }

    /// The pictures to take; leaves out of `scene` what the preset and pictures without a background do without.
    fn shots(&self, scene: &mut Scene) -> Result<Vec<Shot>> {
        let (mut choice, alpha) = (self.views.choice(), self.wanted().alpha);
        if alpha {
            choice.reading.background = None;
            choice.reading.assignments.retain(|set| !set.starts_with("data.background="));
        }
        let shots = self.path.shots(self.frames.map(|frames| frames as usize), self.size, self.lens, &choice, scene)?;
        if let Some(preset) = self.preset {
            preset.apply(&mut scene.data.info);
        }
        if alpha {
            scene.data.environment = None;
        }
        Ok(shots)
    }

    /// Writes what `paint` makes of each camera, to the folder of `hold`.
    fn write(
        &self,
        hold: Option<Hold>,
        shots: &[Shot],
        mut paint: impl FnMut(&Camera) -> Result<Painted>,
    ) -> Result<()> {
        let sizes = shots.iter().map(|shot| (shot.name.as_str(), [shot.camera.width, shot.camera.height]));
        let video = self.video.as_deref().map(|file| Video::new(file, &self.ffmpeg, self.fps.unwrap_or(30), sizes));
        let mut sink = Sink::new(hold, video.transpose()?, shots, self.wanted())?;
        let mut progress = Progress::new(LogStyle::Bar, 0, shots.len());
        for shot in shots {
            let painted = match self.lens {
                Some(PictureLens::Equirectangular) => stitched::painted(&shot.camera, &mut paint)?,
                None => paint(&shot.camera)?,
            };
            progress.step(sink.take(shot, &painted)?, shots.len());
        }
        print(&sink.finish()?)
    }
}

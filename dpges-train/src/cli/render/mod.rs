//! `dpges render`: pictures of a scene, from the cameras of a dataset or along a path.

mod sink;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use dpges_core::camera::Camera;
use dpges_core::scene::Rendering;
use dpges_render::path::Size;
use dpges_render::stream::Loader;
use dpges_render::{Headless, Precision, RenderOptions, Rgb8Image};
use dpges_train::device::DeviceRequest;
use dpges_train::eval::rendered::{LayerPictures, Renderer, layer_pictures, to_picture};
use dpges_train::eval::rendering_preset::RenderingPreset;
use dpges_train::eval::shots::{PathChoice, Shot};

use super::data::{Scene, ViewArgs};
use super::device_choice::watched;
use super::levels::{LevelsArgs, load};
use super::{Failure, Result, device_choice, print};
use sink::Sink;

/// Write pictures of a scene: PNGs or a video, of the views of a dataset or along a camera path
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Scene file, folder of a run, or scene in levels of detail: its folder or address
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
    /// Pictures per second of the video
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=240))]
    fps: u32,
    /// The program that makes the video
    #[arg(long, value_name = "PROGRAM", default_value = "ffmpeg")]
    ffmpeg: PathBuf,
    /// Cameras: views (of the dataset), interpolated (a smooth path through them), orbit, spiral, or a file in the
    /// convention of the cameras.json of 3DGS, in the scene's coordinates
    #[arg(long, value_name = "PATH", default_value = "views")]
    path: PathChoice,
    /// Frames along the path
    #[arg(long, value_name = "N", default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: u32,
    /// Size of the pictures, as in 1920x1080; the vertical field of view stays
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    size: Option<Size>,
    /// Which renderer
    #[arg(long, value_enum, default_value_t = Engine::Training)]
    renderer: Engine,
    /// Device of the training renderer: auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex, wgpu (the best
    /// GPU), or another one that `dpges devices` lists. The other one takes the graphics adapter that wgpu prefers
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
    /// Draw less than was trained, in less time
    #[arg(long, value_name = "NAME", value_enum)]
    preset: Option<RenderingPreset>,
    /// Also write the surfels alone, the transmittance behind each layer, depth and normals, and their depth ranges
    /// in layers.json
    #[arg(long, requires = "out")]
    layers: bool,
}

/// The renderer of the pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Engine {
    /// The one that is trained with: CPU or compute kernels
    Training,
    /// The real-time one: the graphics pipeline
    Raster,
}

pub fn run(args: &RenderArgs) -> Result<()> {
    if args.levels.are_at(&args.scene, args.preset)? && args.renderer == Engine::Training {
        let message = "--renderer training: a scene in levels of detail is drawn by `--renderer raster`";
        return Err(Failure::Usage(message.to_owned()));
    }
    let levels = args.levels.open(&args.scene)?;
    let mut scene = load(&args.scene, levels.as_ref())?;
    let rendering = scene.data.info.rendering;
    if args.layers && rendering != Rendering::Peeled {
        let of = args.scene.display();
        return Err(Failure::Usage(format!("--layers: {of} is a scene of {rendering}, which has no layers")));
    }
    if args.layers && args.renderer == Engine::Raster {
        let message = "--layers: pictures of layers are made by `--renderer training`";
        return Err(Failure::Usage(message.to_owned()));
    }
    match args.renderer {
        Engine::Raster => {
            scene.use_pinholes();
            scene.warn_of_order("the real-time renderer sorts");
            let shots = args.shots(&mut scene)?;
            let headless = Headless::new()?;
            tracing::info!("rendering on {}", headless.adapter_name());
            let half_sums = args.preset.is_some_and(RenderingPreset::half_sums);
            let mut renderer = headless.renderer_with(half_sums.then_some(Precision::Half))?;
            let options = RenderOptions::from(&scene.data.info);
            let Some(levels) = levels else {
                renderer.upload(&scene.data)?;
                return args.write(&shots, |camera| Ok((headless.draw(&mut renderer, camera, &options)?, None)));
            };
            let mut loader = Loader::new(levels, &mut renderer, || {})?;
            let mut most = 0;
            args.write(&shots, |camera| {
                most = most.max(loader.complete(&mut renderer, camera)?);
                Ok((headless.draw(&mut renderer, camera, &options)?, None))
            })?;
            tracing::info!("at most {most} of {} primitives were in memory", loader.status().budget);
            Ok(())
        }
        Engine::Training => {
            let device = device_choice::select(args.device)?;
            watched(device, || {
                let shots = args.shots(&mut scene)?;
                let renderer = Renderer::new(&scene.data, &device.open()?);
                args.write(&shots, |camera| {
                    let render = renderer.render(camera)?;
                    let peeled = render.peeled().filter(|_| args.layers);
                    let layers = peeled.map(|view| layer_pictures(&renderer, camera, view));
                    Ok((to_picture(render.image()), layers))
                })
            })
        }
    }
}

/// A picture, and those of its layers where they were asked for.
type Painted = (Rgb8Image, Option<LayerPictures>);

impl RenderArgs {
    /// The pictures to take; leaves out of `scene` what the preset does without.
    fn shots(&self, scene: &mut Scene) -> Result<Vec<Shot>> {
        let near = scene.data.info.near;
        let views = || Ok::<_, Failure>(self.views.choice().load(scene)?.1);
        let shots = self.path.shots(self.frames as usize, self.size, near, views)?;
        if let Some(preset) = self.preset {
            preset.apply(&mut scene.data);
        }
        Ok(shots)
    }

    /// Writes what `paint` makes of each camera.
    fn write(&self, shots: &[Shot], mut paint: impl FnMut(&Camera) -> Result<Painted>) -> Result<()> {
        let mut sink = Sink::new(self, shots)?;
        for shot in shots {
            sink.take(shot, &paint(&shot.camera)?)?;
        }
        print(&sink.finish()?)
    }
}

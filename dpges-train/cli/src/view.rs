//! `dpges view`: a scene in a window.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;
use dpges_render::viewer::{self, DatasetViews, Opened, Start, ViewerOptions, Views};
use dpges_train::config::DataConfig;
use dpges_train::dataset::{LoadOptions, View};
use dpges_train::eval::pictures;
use dpges_train::eval::rendering_preset::RenderingPreset;
use dpges_train::views::pose::{RefinedPoses, refine};

use super::Result;
use super::data::{DataArgs, Scene, Source, in_scene};
use super::levels::{LevelsArgs, load};

/// Look at a scene in a window
///
/// Without SCENE a page says what can be done. F1 lists what mouse and keys do.
#[derive(Debug, Args)]
pub struct WindowArgs {
    /// Scene file, splats (PLY, SPZ, SOG, glTF), folder of a run, or scene in levels of detail: its folder or address
    scene: Option<PathBuf>,
    /// Folder of the dataset whose cameras and photographs are shown too, or `builtin`; a run knows its own
    #[arg(long, value_name = "DATASET", requires = "scene")]
    data: Option<PathBuf>,
    /// Draw less than was trained, in less time. The window sums Gaussians as precisely as the GPU can, whatever the
    /// preset
    #[arg(long, value_name = "NAME", value_enum)]
    preset: Option<RenderingPreset>,
    #[command(flatten)]
    levels: LevelsArgs,
    #[command(flatten)]
    options: DataArgs,
}

pub fn run(args: WindowArgs) -> Result<()> {
    let title = args.scene.as_ref().map_or_else(|| "dpges".to_owned(), |scene| format!("dpges: {}", scene.display()));
    let start = match &args.scene {
        Some(path) => {
            if !args.levels.are_at(path, args.preset)? {
                Scene::check(path)?;
            }
            Start::Open(path.clone())
        }
        None => Start::Page,
    };
    let opener = Arc::new(move |path: &Path| args.open(path).map_err(|failure| failure.text()));
    Ok(viewer::run(ViewerOptions { title, start, opener, gpu: None })?)
}

impl WindowArgs {
    /// The scene at once, the views later: reading photographs takes longer.
    fn open(&self, path: &Path) -> Result<Opened> {
        let levels = self.levels.open(path)?;
        let mut scene = load(path, levels.as_ref())?;
        let named = self.data.as_deref().filter(|_| self.scene.as_deref() == Some(path));
        let views = match scene.dataset(named, &self.options.reading())? {
            None => Views::None,
            Some((source, config)) => {
                let (info, poses) = (scene.data.info.clone(), scene.refined_poses(named)?);
                Views::Later(Box::new(move || read(&source, &config, &info, &poses).map_err(|failure| failure.text())))
            }
        };
        if let Some(levels) = levels {
            return Ok(Opened::levels(levels, views));
        }
        let mut opened = Opened::whole(scene.data, views);
        if let Some(preset) = self.preset {
            preset.apply(&mut opened.drawn);
        }
        Ok(opened)
    }
}

/// The views of a dataset, held-out ones last, in the coordinates of the scene, training views with refined `poses`.
fn read(source: &Source, config: &DataConfig, info: &SceneInfo, poses: &RefinedPoses) -> Result<DatasetViews> {
    // the window draws pinhole cameras alone
    let mut dataset = source.load(&LoadOptions { undistort: true, ..config.load_options() })?;
    refine(&mut dataset.train, poses);
    let offset = dataset.offset;
    let held_out = dataset.test.into_iter().map(|view| (format!("{} (held out)", view.name), view));
    let views = dataset.train.into_iter().map(|view| (view.name.clone(), view)).chain(held_out);
    let mut cameras: Vec<(String, Camera)> = Vec::new();
    let mut photographs = Vec::new();
    for (name, View { camera, photograph, .. }) in views {
        cameras.push((name, in_scene(camera, offset, info)));
        photographs.push(photograph);
    }
    let photograph = move |index: usize| {
        let picture = photographs.get(index)?.picture();
        picture.inspect_err(|error| tracing::warn!("{error}")).ok().map(|picture| pictures::photograph(&picture))
    };
    Ok(DatasetViews { cameras, photograph: Box::new(photograph) })
}

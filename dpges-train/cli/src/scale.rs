//! `dpges scale`: metres per world unit.

use std::path::PathBuf;

use clap::Args;
use dpges_core::scene::length::parse_metres;
use dpges_train::dataset::View;
use dpges_train::eval::rendered::TrainingRenderer;
use dpges_train::run::folder::hold_file;
use dpges_train::run::scale::{Place, store};

use super::data::Scene;
use super::device_choice::{DeviceArgs, select, watched};
use super::{Result, print, table};

/// Store in a scene how many metres a world unit has, from a length that is known
///
/// A point is x,y,z in coordinates of the scene, as the window shows those it measures, or NAME@x,y: the surface at a pixel of
/// a photograph, counted from its upper left corner in the file.
#[derive(Debug, Args)]
pub struct ScaleArgs {
    /// Scene file or folder of a run
    scene: PathBuf,
    /// One end of the length
    #[arg(long, value_name = "POINT", allow_hyphen_values = true)]
    from: Place,
    /// The other end
    #[arg(long, value_name = "POINT", allow_hyphen_values = true)]
    to: Place,
    /// How long it is, with its unit: mm, cm, m, km, in or ft, as in 1.25m
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true, value_parser = parse_metres)]
    length: f64,
    /// Folder of the dataset, or `builtin`; a run knows its own
    #[arg(long, value_name = "DATASET")]
    data: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
}

pub fn run(args: &ScaleArgs) -> Result<()> {
    let mut scene = Scene::load(&args.scene)?;
    let (_held, places) = (hold_file(&scene.path)?, [&args.from, &args.to]);
    if !places.iter().any(|place| place.is_on_photograph()) {
        return print(&table(&store(&scene, places, args.length, &[], None)?));
    }
    let device = select(args.device.request)?;
    let (_, dataset) = scene.read(args.data.as_deref(), &Place::reading(), false)?;
    let views: Vec<&View> = dataset.train.iter().chain(&dataset.test).collect();
    watched(device, || {
        let renderer = TrainingRenderer::new(&scene.data, &device.open()?);
        print(&table(&store(&scene, places, args.length, &views, Some(&renderer))?))
    })
}

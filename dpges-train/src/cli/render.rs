//! `dpges render`: pictures of a scene from the cameras of a dataset.

use std::path::PathBuf;

use clap::Args;
use dpges_core::scene::Rendering;
use dpges_train::device::{DeviceName, DeviceRequest};
use dpges_train::pictures::{file_stems, save_png};
use dpges_train::rendered::{LayerPictures, Renderer, layer_pictures, to_picture};
use dpges_train::run::folder::write_json;
use serde_json::{Value, json};

use super::data::{Scene, ViewArgs};
use super::device_failure::watched;
use super::eval::make_folder;
use super::{Failure, Result, device_choice, print};

/// Write a PNG of every view of a dataset
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Scene file or folder of a run
    scene: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// Folder for the pictures
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
    /// Also write the surfels alone, the transmittance behind each layer, depth and normals, and their depth ranges
    /// in layers.json
    #[arg(long)]
    layers: bool,
}

pub fn run(args: &RenderArgs) -> Result<()> {
    let scene = Scene::load(&args.scene)?;
    let rendering = scene.data.info.rendering;
    if args.layers && rendering != Rendering::Peeled {
        let of = args.scene.display();
        return Err(Failure::Usage(format!("--layers: {of} is a scene of {rendering}, which has no layers")));
    }
    let device = device_choice::select(args.device)?;
    watched(device, || args.write(scene, device))
}

impl RenderArgs {
    fn write(&self, mut scene: Scene, device: DeviceName) -> Result<()> {
        let (_, views) = self.views.load(&mut scene)?;
        make_folder(&self.out)?;
        let renderer = Renderer::new(&scene.data, &device.open()?);
        let mut ranges = Vec::new();
        for (view, stem) in views.iter().zip(file_stems(&views)) {
            let render = renderer.render(&view.camera)?;
            save_png(&to_picture(render.image()), &self.out.join(format!("{stem}.png")))?;
            if let (true, Some(render)) = (self.layers, render.peeled()) {
                let pictures = layer_pictures(&renderer, &view.camera, render);
                ranges.push(self.save_layers(&stem, &view.name, &pictures)?);
            }
        }
        if self.layers {
            write_json(&self.out.join("layers.json"), &ranges)?;
        }
        print(&format!("{} views in {}\n", views.len(), self.out.display()))
    }

    /// Returns the view's entry in `layers.json`.
    fn save_layers(&self, stem: &str, view: &str, pictures: &LayerPictures) -> Result<Value> {
        let mut named = vec![
            ("surfels".to_owned(), &pictures.surfels),
            ("depth".to_owned(), &pictures.depth),
            ("normal".to_owned(), &pictures.normal),
        ];
        let behind = pictures.transmittance.iter().zip(1..);
        named.extend(behind.map(|(picture, layer)| (format!("transmittance_{layer}"), picture)));
        for (name, picture) in named {
            save_png(picture, &self.out.join(format!("{stem}_{name}.png")))?;
        }
        let [near, far] = pictures.depth_range.map_or([None; 2], |range| range.map(Some));
        Ok(json!({ "name": view, "file": stem, "depth_near": near, "depth_far": far }))
    }
}

//! `dpges export`: a scene as files for other programs.

use std::io::Write;
use std::path::PathBuf;

use burn::tensor::Device;
use clap::Args;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::scene::atomic::{make_folder, write_atomically};
use dpges_lab::lod::{self, CELL_PRIMITIVES, streamed};
use dpges_render::export::Coordinates;
use dpges_train::dataset::Dataset;
use dpges_train::device::DeviceName;
use dpges_train::eval::compress::report::Psnr;
use dpges_train::eval::export::format::{ExportFormat, Filter, Origin, place_rows, splat_rows};
use dpges_train::eval::export::mesh::mesh;
use dpges_train::eval::export::page::{self, PageArgs};
use dpges_train::eval::export::splats::{SplatFormat, file, filter_of, is_changed, loss, splats};
use dpges_train::run::folder::hold_file;
use dpges_train::run::hold::Hold;

use super::data::{Scene, Source, ViewArgs};
use super::device_choice::{DeviceArgs, select, watched};
use super::{Failure, Result, print, table};

/// Steps of a fit, unless they are given.
const FIT_STEPS: usize = 300;
const LOD_FIT_STEPS: usize = 100;

/// Write a scene for other programs: splats (PLY, SPZ, SOG, glTF, OpenUSD), a mesh (PLY, glTF), a page for browsers (HTML), or
/// levels of detail for scenes larger than the memory of a viewer
///
/// Splats are an approximation. If the dataset is at hand, the PSNR of its held-out views is printed before and after.
/// A mesh is made of the surfels, seen from the training views.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Scene file, splats (PLY, SPZ, SOG, glTF) or folder of a run
    scene: PathBuf,
    /// Kind of file
    #[arg(long, value_enum)]
    format: ExportFormat,
    /// File to write, or folder of sog-lod, html and lod
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// Degree of the harmonics of splats
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: u8,
    /// Which programs splats are for, by their filter [default: that of the scene if it is blended, or else mip]
    #[arg(long, value_enum)]
    filter: Option<Filter>,
    /// Coordinates to write
    #[arg(long, value_enum, default_value_t = Origin::Scene)]
    coordinates: Origin,
    /// Train for this many steps, so that less is lost: splats on the training views [default: 300 if surfels are flattened or
    /// the filter is another one and the dataset is at hand, or else 0], each coarser level of lod on smaller pictures of the
    /// scene itself [default: 100 if the dataset is at hand, or else 0]
    #[arg(long, value_name = "STEPS")]
    fit: Option<usize>,
    /// Primitives of a cell of lod and sog-lod, at most: what is loaded at a time
    #[arg(long, value_name = "N", default_value_t = CELL_PRIMITIVES, value_parser = cell_primitives)]
    cell_primitives: usize,
    /// Distance between the voxels that a mesh is made of, world units [default: one and a half pixels at the surface, or
    /// as fine as memory allows]
    #[arg(long, value_name = "SIZE")]
    voxel: Option<f64>,
    #[command(flatten)]
    page: PageArgs,
    #[command(flatten)]
    device: DeviceArgs,
}

type Rows = Vec<(&'static str, String)>;

/// A cell has a header of some kilobytes: very small ones are mostly that.
fn cell_primitives(text: &str) -> Result<usize, String> {
    let count = text.parse::<usize>().ok().filter(|count| *count >= 64);
    count.ok_or_else(|| format!("`{text}` is no number of primitives from 64 on"))
}

pub fn run(args: &ExportArgs) -> Result<()> {
    args.page.check(args.format, &args.out).map_err(Failure::Usage)?;
    let _held = match args.format {
        ExportFormat::Html if !args.page.single_file => Some(Hold::of_folder(&args.out)?),
        ExportFormat::Lod | ExportFormat::SogLod => args.out.parent().map(make_folder).transpose()?.and(None),
        _ => hold_file(&args.out)?,
    };
    let mut scene = Scene::load(&args.scene)?;
    scene.check_is_not(&args.out).map_err(Failure::Usage)?;
    scene.use_pinholes();
    if !matches!(args.format, ExportFormat::MeshPly | ExportFormat::MeshGlb) {
        scene.warn_of_order("what shows this file sorts");
    }
    let device = match args.format {
        ExportFormat::Html | ExportFormat::Lod => None,
        _ => Some(select(args.device.request)?),
    };
    let choice = args.views.choice();
    let data = choice.dataset_at_hand(&mut scene, false)?.map_err(Failure::from);
    let coordinates = args.coordinates.of(args.format, &scene.data.info).map_err(Failure::Usage)?;
    if args.format == ExportFormat::Lod {
        return args.lod(scene.data, data.ok());
    }
    let Some(device) = device else {
        let tour = args.page.tour(data.as_ref().ok().map(|(_, data)| data), &scene.data.info)?;
        return print(&table(&page::write(&scene.data, &tour, &args.page, &args.out)?));
    };
    watched(device, || {
        print(&table(&match args.format.of_splats() {
            Some(format) => args.splats(format, coordinates, &scene.data, data, device)?,
            None => args.mesh(coordinates, &scene.data, &data?.1, device)?,
        }))
    })
}

impl ExportArgs {
    fn splats(
        &self,
        format: SplatFormat,
        coordinates: Coordinates,
        scene: &SceneData,
        data: Result<(Source, Dataset)>,
        device: DeviceName,
    ) -> Result<Rows> {
        if self.format == ExportFormat::SogLod {
            streamed::check(scene.info.rendering, &self.out)?;
        }
        let device = device.open()?;
        let filter = self.filter.map_or(filter_of(scene), Filter::filter);
        let changed = is_changed(scene, filter);
        let steps = self.fit.unwrap_or(if changed && data.is_ok() { FIT_STEPS } else { 0 });
        let views = match &data {
            Ok((_, dataset)) => &dataset.train[..],
            Err(failure) if steps > 0 => return Err(Failure::Usage(format!("--fit: {}", failure.text()))),
            Err(_) => &[],
        };
        let of = |scene: &SceneData| splats(scene, self.degree.into(), filter, steps, views, &device);
        let cloud = of(scene)?;
        let bytes = file(&cloud, format, coordinates)?;
        let mut rows = match self.format {
            ExportFormat::SogLod => streamed::write(scene, cloud.clone(), of, self.cell_primitives, &self.out)?,
            _ => self.write(&bytes)?,
        };
        rows.extend(splat_rows(scene, &cloud, filter, coordinates, self.format));
        let split = self.views.choice().split();
        let loss = match &data {
            Ok((source, dataset)) if split.of(dataset).is_empty() => {
                format!("not measured: {source} has no views in split `{split}`")
            }
            Ok((source, dataset)) => {
                let views = split.of(dataset);
                let [psnr_before, psnr_after] = loss(scene, &cloud, format, &bytes, views, &device)?;
                let (dataset, split, views) = (source.to_string(), split.to_string(), views.len());
                Psnr { dataset, split, views, psnr_before, psnr_after }.to_string()
            }
            Err(failure) => format!("not measured: {}", failure.text()),
        };
        rows.push(("PSNR", loss));
        rows.push(("fit", if steps > 0 { format!("{steps} steps") } else { "none".to_owned() }));
        Ok(rows)
    }

    fn lod(&self, scene: SceneData, data: Option<(Source, Dataset)>) -> Result<()> {
        let cameras: Vec<Camera> = data.iter().flat_map(|(_, data)| &data.train).map(|view| view.camera).collect();
        let steps = self.fit.unwrap_or(if cameras.is_empty() { 0 } else { LOD_FIT_STEPS });
        let cell_primitives = self.cell_primitives;
        let tour = self.page.tour(data.as_ref().map(|(_, data)| data), &scene.info)?;
        let write = |fit: Option<(usize, &Device)>| {
            let index = lod::write(scene, &lod::Options { cell_primitives, cameras: &cameras, fit }, &self.out)?;
            let mut rows = vec![("folder", self.out.display().to_string())];
            rows.extend(lod::describe::of(&index).rows());
            rows.push(("fit", if steps > 0 { format!("{steps} steps per level") } else { "none".to_owned() }));
            rows.push(page::write_beside_levels(&tour, &self.page, &self.out)?);
            print(&table(&rows))
        };
        if steps == 0 {
            return write(None);
        }
        let device = select(self.device.request)?;
        watched(device, || write(Some((steps, &device.open()?))))
    }

    fn mesh(&self, coordinates: Coordinates, scene: &SceneData, dataset: &Dataset, device: DeviceName) -> Result<Rows> {
        let (mesh, voxel) = mesh(scene, &dataset.train, self.voxel, &device.open()?)?;
        let (is_ply, info) = (self.format == ExportFormat::MeshPly, &scene.info);
        let mut rows = self.write(&if is_ply { mesh.to_ply(info, coordinates) } else { mesh.to_glb(info)? })?;
        rows.push(("mesh", format!("{} vertices, {} triangles", mesh.positions.len(), mesh.triangles.len())));
        rows.push(("voxel", format!("{voxel:.4e} world units, {} training views", dataset.train.len())));
        rows.extend(place_rows(info, coordinates, self.format));
        rows.push(("note", "surfels alone: what Gaussians draw is missing".into()));
        Ok(rows)
    }

    fn write(&self, bytes: &[u8]) -> Result<Rows> {
        write_atomically(&self.out, |file| file.write_all(bytes))?;
        Ok(vec![("file", self.out.display().to_string()), ("size", format!("{:.2} MB", bytes.len() as f64 / 1e6))])
    }
}

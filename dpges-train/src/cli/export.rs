//! `dpges export`: a scene as files for other programs.

use std::io::Write;
use std::path::PathBuf;

use burn::tensor::Device;
use clap::{Args, ValueEnum};
use dpges_core::camera::Camera;
use dpges_core::scene::atomic::write_atomically;
use dpges_core::scene::{Rendering, SceneData};
use dpges_render::export::UpAxis;
use dpges_render::export::spz::SpzVersion;
use dpges_train::dataset::{Dataset, Format};
use dpges_train::device::DeviceName;
use dpges_train::eval::export::mesh::{exact_error, mesh};
use dpges_train::eval::export::page;
use dpges_train::eval::export::splats::{SplatFormat, file, loss, splats};
use dpges_train::lod::{self, CELL_PRIMITIVES};

use super::data::{Scene, Source, Split, ViewArgs};
use super::device_choice::{DeviceArgs, watched};
use super::{Failure, Result, print, table};

/// Voxels along the extent of the scene, unless they are given.
const VOXELS_PER_EXTENT: f64 = 128.0;
/// Steps of a fit, unless they are given.
const FIT_STEPS: usize = 300;
const LOD_FIT_STEPS: usize = 100;

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// Splats, in the convention of 3DGS
    Ply,
    /// Splats, quantised: SPZ version 4
    Spz,
    /// Splats, quantised: SPZ version 3, for older readers
    Spz3,
    /// Splats in binary glTF with KHR_gaussian_splatting
    Glb,
    /// Triangles of the surfels
    MeshPly,
    /// Triangles of the surfels in binary glTF
    MeshGlb,
    /// A folder for any web server: the scene itself in a page for browsers
    Html,
    /// A folder for any web server: the scene in levels of detail, of which viewers load what they show
    Lod,
}

/// Which axis of the scene points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Up {
    /// The axis that the format of the dataset suggests: z of Blender, nerfstudio and the built-in scene, -y of COLMAP
    Auto,
    /// -y
    MinusY,
    Y,
    Z,
}

/// Write a scene for other programs: splats (PLY, SPZ, glTF), a mesh (PLY, glTF), a page for browsers (HTML), or levels of
/// detail for scenes larger than the memory of a viewer
///
/// Splats are an approximation. If the dataset is at hand, the PSNR of its held-out views is printed before and after.
/// A mesh is made of the surfels, seen from the training views.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Scene file or folder of a run
    scene: PathBuf,
    /// Kind of file
    #[arg(long, value_enum)]
    format: ExportFormat,
    /// File to write, or folder of html and lod
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// Degree of the harmonics of splats
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: u8,
    /// Axis of the scene that points up; files in SPZ and glTF stand upright
    #[arg(long, value_enum, default_value_t = Up::Auto)]
    up: Up,
    /// Train for this many steps, so that less is lost: splats on the training views [default: 300 if surfels are flattened
    /// and the dataset is at hand, or else 0], each coarser level of lod on smaller pictures of the scene itself [default:
    /// 100 if the dataset is at hand, or else 0]
    #[arg(long, value_name = "STEPS")]
    fit: Option<usize>,
    /// Primitives of a cell of lod, at most: what is loaded at a time
    #[arg(long, value_name = "N", default_value_t = CELL_PRIMITIVES, value_parser = cell_primitives)]
    cell_primitives: usize,
    /// Distance between the voxels that a mesh is made of, world units [default: a 128th of the extent]
    #[arg(long, value_name = "SIZE")]
    voxel: Option<f64>,
    /// Folder of the browser viewer for html and lod, as dpges-render/web/build.sh builds it [default: DPGES_WEB_PAGE,
    /// dpges-web beside the program, or that of its sources]
    #[arg(long, value_name = "DIR")]
    page: Option<PathBuf>,
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
    let mut scene = Scene::load(&args.scene)?;
    scene.use_pinholes();
    if !matches!(args.format, ExportFormat::MeshPly | ExportFormat::MeshGlb) {
        scene.warn_of_order("what shows this file sorts");
    }
    let device = match args.format {
        ExportFormat::Html | ExportFormat::Lod => None,
        _ => Some(args.device.select()?),
    };
    let choice = args.views.choice();
    let data = match choice.dataset(&mut scene) {
        Err(error) if choice.data.is_some() => return Err(error.into()),
        data => data.map_err(Failure::from),
    };
    if args.format == ExportFormat::Lod {
        return args.lod(scene.data, data.ok());
    }
    let Some(device) = device else {
        let cameras: Vec<Camera> = data.iter().flat_map(|(_, data)| &data.train).map(|view| view.camera).collect();
        let title = args.out.file_name().unwrap_or_default().to_string_lossy();
        return print(&table(&page::write(&scene.data, &cameras, &title, args.page.as_deref(), &args.out)?));
    };
    watched(device, || {
        print(&table(&match args.format.of_splats() {
            Some(format) => args.splats(format, &scene.data, data, device)?,
            None => args.mesh(&scene.data, data?, device)?,
        }))
    })
}

impl ExportFormat {
    /// `None` if it is not one of splats.
    fn of_splats(self) -> Option<SplatFormat> {
        match self {
            Self::Ply => Some(SplatFormat::Ply),
            Self::Spz => Some(SplatFormat::Spz(SpzVersion::Four)),
            Self::Spz3 => Some(SplatFormat::Spz(SpzVersion::Three)),
            Self::Glb => Some(SplatFormat::Glb),
            Self::MeshPly | Self::MeshGlb | Self::Html | Self::Lod => None,
        }
    }
}

impl ExportArgs {
    fn splats(
        &self,
        format: SplatFormat,
        scene: &SceneData,
        data: Result<(Source, Dataset)>,
        device: DeviceName,
    ) -> Result<Rows> {
        let up = self.up_axis(data.as_ref().ok().map(|(_, dataset)| dataset.format));
        let device = device.open()?;
        let peeled = scene.info.rendering == Rendering::Peeled;
        let steps = self.fit.unwrap_or(if peeled && data.is_ok() { FIT_STEPS } else { 0 });
        let views = match &data {
            Ok((_, dataset)) => &dataset.train[..],
            Err(failure) if steps > 0 => return Err(Failure::Usage(format!("--fit: {}", failure.text()))),
            Err(_) => &[],
        };
        let cloud = splats(scene, self.degree.into(), steps, views, &device)?;
        let (bytes, cloud) = file(cloud, format, up)?;
        let mut rows = self.write(&bytes)?;
        let counts = format!("{} surfels and {} Gaussians", scene.surfels.len(), scene.gaussians.len());
        rows.push(("splats", format!("{} of {counts}", cloud.len())));
        rows.push(up_row(up, format == SplatFormat::Ply));
        if peeled {
            let text = "approximation: sorted splats cannot express peeled surfels and order-free Gaussians";
            rows.push(("note", text.to_owned()));
        }
        if scene.environment.is_some() {
            let text = "missing: the format has no environment; the PSNR is that of the splats before it";
            rows.push(("sky", text.to_owned()));
        }
        let split = self.views.choice().split();
        let loss = match &data {
            Ok((source, dataset)) if split.of(dataset).is_empty() => {
                format!("not measured: {source} has no views in split `{split}`")
            }
            Ok((_, dataset)) => {
                let views = split.of(dataset);
                let [before, after] = loss(scene, &cloud, views, &device)?;
                let of = match split {
                    Split::Test => "held-out",
                    Split::Train => "training",
                    Split::Validation => "validation",
                };
                let (change, count) = (after - before, views.len());
                format!("{before:.2} dB → {after:.2} dB ({change:+.2} dB, mean of {count} {of} views)")
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
        let write = |fit: Option<(usize, &Device)>| {
            let index = lod::write(scene, &lod::Options { cell_primitives, cameras: &cameras, fit }, &self.out)?;
            let mut rows = vec![("folder", self.out.display().to_string())];
            rows.extend(lod::describe::of(&index).rows());
            rows.push(("fit", if steps > 0 { format!("{steps} steps per level") } else { "none".to_owned() }));
            let title = self.out.file_name().unwrap_or_default().to_string_lossy();
            rows.push(page::write_beside_levels(&cameras, &title, self.page.as_deref(), &self.out)?);
            print(&table(&rows))
        };
        if steps == 0 {
            return write(None);
        }
        let device = self.device.select()?;
        watched(device, || write(Some((steps, &device.open()?))))
    }

    fn mesh(&self, scene: &SceneData, (source, dataset): (Source, Dataset), device: DeviceName) -> Result<Rows> {
        let up = self.up_axis(Some(dataset.format));
        let voxel = self.voxel.unwrap_or(scene.info.extent / VOXELS_PER_EXTENT);
        let mesh = mesh(scene, &dataset.train, voxel, &device.open()?)?;
        let is_ply = self.format == ExportFormat::MeshPly;
        let offset = scene.info.offset;
        let mut rows = self.write(&if is_ply { mesh.to_ply(up, offset) } else { mesh.to_glb(up, offset)? })?;
        rows.push(("mesh", format!("{} vertices, {} triangles", mesh.positions.len(), mesh.triangles.len())));
        rows.push(("voxel", format!("{voxel:.4} world units, {} training views", dataset.train.len())));
        rows.push(up_row(up, is_ply));
        rows.push(("note", "surfels alone: what Gaussians draw is missing".into()));
        if let Source::Builtin | Source::Altered(_) = source {
            rows.push(("exact depth", exact_error(&mesh, &dataset.test)));
        }
        Ok(rows)
    }

    fn write(&self, bytes: &[u8]) -> Result<Rows> {
        write_atomically(&self.out, |file| file.write_all(bytes))?;
        Ok(vec![("file", self.out.display().to_string()), ("size", format!("{:.2} MB", bytes.len() as f64 / 1e6))])
    }

    fn up_axis(&self, format: Option<Format>) -> UpAxis {
        match (self.up, format) {
            (Up::MinusY, _) | (Up::Auto, None | Some(Format::Colmap)) => UpAxis::MinusY,
            (Up::Y, _) => UpAxis::Y,
            (Up::Z, _) | (Up::Auto, Some(Format::Blender | Format::Nerfstudio | Format::Builtin)) => UpAxis::Z,
        }
    }
}

/// PLY files are not turned.
fn up_row(up: UpAxis, is_ply: bool) -> (&'static str, String) {
    ("up", format!("{up}, {}", if is_ply { "as in the scene" } else { "turned to y" }))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: ExportArgs,
    }

    fn parse(line: &str) -> std::result::Result<ExportArgs, clap::Error> {
        Line::try_parse_from(format!("export {line}").split(' ')).map(|line| line.args)
    }

    #[test]
    fn up_follows_the_dataset_unless_it_is_given() {
        let up = |line: &str, format| parse(line).unwrap().up_axis(format);
        let plain = "scene --format spz3 --out file";
        assert_eq!(up(plain, Some(Format::Builtin)), UpAxis::Z);
        assert_eq!([up(plain, None), up(plain, Some(Format::Colmap))], [UpAxis::MinusY; 2]);
        assert_eq!(up("scene --format glb --out file --up minus-y", Some(Format::Blender)), UpAxis::MinusY);
        assert!(parse("scene --format ply --out file --degree 4").is_err());
        assert!(parse("scene --format obj --out file").unwrap_err().to_string().contains("mesh-glb"));
    }
}

//! `dpges export`: a scene as files for other programs.

use std::io::Write;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use dpges_core::camera::Camera;
use dpges_core::scene::atomic::write_atomically;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{Rendering, SceneData};
use dpges_render::export::mesh::{DepthView, Fusion, FusionOptions, TriangleMesh, depth_map};
use dpges_render::export::spz::{SpzVersion, from_spz, to_spz};
use dpges_render::export::{ExportError, SplatCloud, UpAxis, flatten, to_glb, to_ply};
use dpges_train::dataset::{Dataset, Format, View, builtin_geometry};
use dpges_train::device::{DeviceName, DeviceRequest};
use dpges_train::eval::evaluate;
use dpges_train::eval::rendered::Renderer;
use dpges_train::eval::splat_fit::fit;

use super::data::{Scene, Source, Split, ViewArgs};
use super::device_failure::watched;
use super::{Failure, Result, device_choice, export_html, print, table};

/// Voxels along the extent of the scene, unless they are given.
const VOXELS_PER_EXTENT: f64 = 128.0;
/// Surfels farther than this are not meshed, extents.
const FARTHEST_EXTENTS: f64 = 4.0;
/// Steps of a fit, unless they are given.
const FIT_STEPS: usize = 300;
/// Steps of a fit between two lines about it.
const REPORT_EVERY: usize = 50;

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
}

/// Which axis of the scene points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Up {
    /// What the format of the dataset suggests: z of Blender, nerfstudio and the built-in scene, -y of COLMAP
    Auto,
    /// -y
    MinusY,
    Y,
    Z,
}

/// Write a scene for other programs: splats (PLY, SPZ, glTF), a mesh (PLY, glTF) or a page for browsers (HTML)
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
    /// File to write, or folder of html
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
    /// Train the splats for this many steps on the training views, so that less is lost [default: 300 if surfels are
    /// flattened and the dataset is at hand, or else 0]
    #[arg(long, value_name = "STEPS")]
    fit: Option<usize>,
    /// Distance between the voxels that a mesh is made of, world units [default: a 128th of the extent]
    #[arg(long, value_name = "SIZE")]
    voxel: Option<f64>,
    /// Folder of the browser viewer for html, as dpges-render/web/build.sh builds it [default: DPGES_WEB_PAGE, dpges-web
    /// beside the program, or that of its sources]
    #[arg(long, value_name = "DIR")]
    page: Option<PathBuf>,
    /// auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
}

pub fn run(args: &ExportArgs) -> Result<()> {
    let mut scene = Scene::load(&args.scene)?;
    scene.use_pinholes();
    if args.format == ExportFormat::Html {
        return args.html(scene);
    }
    let device = device_choice::select(args.device)?;
    watched(device, || args.export(scene, device))
}

type Rows = Vec<(&'static str, String)>;

impl ExportArgs {
    fn html(&self, mut scene: Scene) -> Result<()> {
        let cameras: Vec<Camera> = match self.views.dataset(&mut scene) {
            Ok((_, dataset)) => dataset.train.iter().map(|view| view.camera).collect(),
            Err(failure) if self.views.names_dataset() => return Err(failure),
            Err(_) => Vec::new(),
        };
        let title = self.out.file_name().unwrap_or_default().to_string_lossy();
        print(&table(&export_html::write(&scene.data, &cameras, &title, self.page.as_deref(), &self.out)?))
    }

    fn export(&self, mut scene: Scene, device: DeviceName) -> Result<()> {
        let data = match self.views.dataset(&mut scene) {
            Err(failure) if self.views.names_dataset() => return Err(failure),
            data => data,
        };
        let rows = match self.format {
            ExportFormat::MeshPly | ExportFormat::MeshGlb => self.mesh(&scene.data, data?, device)?,
            _ => self.splats(&scene.data, data, device)?,
        };
        print(&table(&rows))
    }

    fn splats(&self, scene: &SceneData, data: Result<(Source, Dataset)>, device: DeviceName) -> Result<Rows> {
        let up = self.up_axis(data.as_ref().ok().map(|(_, dataset)| dataset.format));
        let degree = usize::from(self.degree);
        let device = device.open()?;
        let mut cloud = flatten(scene, degree)?;
        let peeled = scene.info.rendering == Rendering::Peeled;
        let steps = self.fit.unwrap_or(if peeled && data.is_ok() { FIT_STEPS } else { 0 });
        if steps > 0 {
            let (_, dataset) =
                data.as_ref().map_err(|failure| Failure::Usage(format!("--fit: {}", reason(failure))))?;
            let start = in_front_of(&cloud, scene);
            let fitted = fit(&start, &dataset.train, steps, &device, |completed| {
                if completed % REPORT_EVERY == 0 || completed == steps {
                    tracing::info!("splats: step {completed}/{steps}");
                }
            })?;
            cloud = flatten(&fitted, degree)?;
        }
        let bytes = match self.format {
            ExportFormat::Spz => to_spz(&cloud, up, SpzVersion::Four)?,
            ExportFormat::Spz3 => to_spz(&cloud, up, SpzVersion::Three)?,
            ExportFormat::Glb => to_glb(&cloud, up)?,
            _ => to_ply(&cloud, up),
        };
        let mut rows = self.write(&bytes)?;
        rows.push((
            "splats",
            format!("{} of {} surfels and {} Gaussians", cloud.len(), scene.surfels.len(), scene.gaussians.len()),
        ));
        let axes = if self.format == ExportFormat::Ply { "as in the scene" } else { "turned to y" };
        rows.push(("up", format!("{up}, {axes}")));
        if peeled {
            rows.push((
                "note",
                "approximation: sorted splats cannot express peeled surfels and order-free Gaussians".into(),
            ));
        }
        if scene.environment.is_some() {
            rows.push((
                "sky",
                "missing: the format has no environment; the PSNR is that of the splats before it".into(),
            ));
        }
        if let ExportFormat::Spz | ExportFormat::Spz3 = self.format {
            // what is measured is what the file holds
            cloud = SplatCloud { info: cloud.info, ..from_spz(&bytes)?.rotated(up.to_rub().transpose()) };
        }
        let loss = match &data {
            Ok((source, dataset)) if self.views.chosen(dataset).is_empty() => {
                format!("not measured: {source} has no views in split `{}`", self.views.split())
            }
            Ok((_, dataset)) => self.loss(scene, &cloud, self.views.chosen(dataset), &device)?,
            Err(failure) => format!("not measured: {}", reason(failure)),
        };
        rows.push(("PSNR", loss));
        rows.push(("fit", if steps > 0 { format!("{steps} steps") } else { "none".to_owned() }));
        Ok(rows)
    }

    /// PSNR before and after, in words.
    fn loss(
        &self,
        scene: &SceneData,
        cloud: &SplatCloud,
        views: &[View],
        device: &burn::tensor::Device,
    ) -> Result<String> {
        let before = evaluate(scene, views, device)?.psnr;
        let after = evaluate(&in_front_of(cloud, scene), views, device)?.psnr;
        let of = match self.views.split() {
            Split::Test => "held-out",
            Split::Train => "training",
            Split::Validation => "validation",
        };
        let change = after - before;
        Ok(format!("{before:.2} dB → {after:.2} dB ({change:+.2} dB, mean of {} {of} views)", views.len()))
    }

    fn mesh(&self, scene: &SceneData, (source, dataset): (Source, Dataset), device: DeviceName) -> Result<Rows> {
        if scene.surfels.is_empty() {
            return Err(ExportError::NoSurfels.into());
        }
        let up = self.up_axis(Some(dataset.format));
        let extent = scene.info.extent;
        let voxel = self.voxel.unwrap_or(extent / VOXELS_PER_EXTENT);
        let options = FusionOptions { farthest: FARTHEST_EXTENTS * extent, ..FusionOptions::new(voxel) };
        let mut fusion = Fusion::new(options)?;
        let renderer = Renderer::new(scene, &device.open()?);
        for view in &dataset.train {
            fuse(&mut fusion, &renderer, view)?;
        }
        let mesh = fusion.finish()?;
        let offset = scene.info.offset;
        let bytes = match self.format {
            ExportFormat::MeshGlb => mesh.to_glb(up, offset)?,
            _ => mesh.to_ply(up, offset),
        };
        let mut rows = self.write(&bytes)?;
        rows.push(("mesh", format!("{} vertices, {} triangles", mesh.positions.len(), mesh.triangles.len())));
        rows.push(("voxel", format!("{voxel:.4} world units, {} training views", dataset.train.len())));
        let axes = if self.format == ExportFormat::MeshPly { "as in the scene" } else { "turned to y" };
        rows.push(("up", format!("{up}, {axes}")));
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

/// The scene of `cloud` with what lies behind `scene`, which the formats have no place for.
fn in_front_of(cloud: &SplatCloud, scene: &SceneData) -> SceneData {
    SceneData { environment: scene.environment.clone(), ..cloud.to_scene() }
}

/// In words, without advice.
pub fn reason(failure: &Failure) -> String {
    match failure {
        Failure::Usage(message) => message.clone(),
        Failure::Failed(report) => report.to_string(),
    }
}

/// Renders a view and fuses the depth of its surfels.
fn fuse(fusion: &mut Fusion, renderer: &Renderer, view: &View) -> Result<()> {
    let rendered = renderer.render(&view.camera)?;
    let Some(render) = rendered.peeled() else { return Err(ExportError::NoSurfels.into()) };
    let geometry = renderer.geometry(&view.camera, render);
    let pixels = view.camera.width * view.camera.height;
    let transmittance = tensor_to_rows(&render.composite.transmittance);
    let behind = &transmittance[transmittance.len() - pixels..];
    let coverage: Vec<f32> = behind.iter().map(|transmittance| 1.0 - transmittance).collect();
    let blended = tensor_to_rows(&geometry.depth);
    // 0 / 0 where nothing is covered, which is no depth
    let depth: Vec<f32> = blended.iter().zip(&coverage).map(|(depth, coverage)| depth / coverage).collect();
    let colour = tensor_to_rows(&render.composite.image);
    Ok(fusion.add(&DepthView { camera: &view.camera, depth: &depth, coverage: &coverage, colour: &colour })?)
}

/// How far the mesh is from the ray-traced scene, in words.
fn exact_error(mesh: &TriangleMesh, views: &[View]) -> String {
    let (mut errors, mut missing) = (Vec::new(), 0);
    for view in views {
        let (exact, _) = builtin_geometry(&view.camera);
        for (found, exact) in depth_map(mesh, &view.camera).into_iter().zip(exact) {
            if found > 0.0 { errors.push((found - exact).abs()) } else { missing += 1 }
        }
    }
    if errors.is_empty() {
        return "the held-out views do not show the mesh".to_owned();
    }
    errors.sort_unstable_by(f32::total_cmp);
    let percentile = |share: f64| errors[(share * (errors.len() - 1) as f64).round() as usize];
    let holes = 100.0 * f64::from(missing) / (errors.len() as f64 + f64::from(missing));
    let (median, most) = (percentile(0.5), percentile(0.95));
    format!(
        "off by {median:.4} world units (median), {most:.4} (95th percentile), {holes:.1} % of pixels without a mesh"
    )
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use dpges_train::dataset::{BuiltinOptions, builtin};

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

    #[test]
    fn a_mesh_of_exact_depths_is_near_the_exact_scene() {
        let options =
            BuiltinOptions { width: 64, height: 64, train_views: 12, test_views: 2, points: 0, ..Default::default() };
        let data = builtin(&options);
        let mut fusion = Fusion::new(FusionOptions::new(0.06)).unwrap();
        for view in &data.train {
            let (depth, _) = builtin_geometry(&view.camera);
            let (coverage, colour) = (vec![1.0; depth.len()], &view.picture().unwrap().planes());
            fusion.add(&DepthView { camera: &view.camera, depth: &depth, coverage: &coverage, colour }).unwrap();
        }
        let text = exact_error(&fusion.finish().unwrap(), &data.test);
        let median: f64 = text.split(' ').nth(2).unwrap().parse().unwrap();
        assert!(median < 0.01, "{text}");
        assert!(exact_error(&TriangleMesh::default(), &data.test).contains("do not show"));
    }
}

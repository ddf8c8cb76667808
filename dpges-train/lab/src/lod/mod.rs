//! A scene in levels of detail, see [`dpges_core::scene::lod`]: a tree of cells by content, levels made by merging, and a
//! short fit of each to smaller pictures of the whole scene.
//!
//! | module | for |
//! |---|---|
//! | `tree` | the cells |
//! | `merge`, `pairs`, `blob`, `colours` | half as many primitives: which become one, and what one |
//! | `pictures` | a level that learns to look like the scene |
//! | `folder` | the files |
//! | [`streamed`] | levels as splats |
//! | [`describe`] | what is in a folder |

mod blob;
mod colours;
pub mod describe;
mod folder;
mod merge;
mod pairs;
mod pictures;
pub mod streamed;
#[cfg(test)]
mod tests;
mod tree;

use std::path::{Path, PathBuf};

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::lod::Index;
use dpges_core::scene::{GaussianData, Rendering, SceneData, SceneInfo, SurfelData};
use dpges_train::dataset::View;
use dpges_train::eval::evaluate;
use dpges_train::eval::export::ExportFailure;
use dpges_train::run::TrainError;
use dpges_train::run::refit::refit;
use dpges_train::run::scene::every_nth;
use glam::DVec3;
use rayon::prelude::*;

use self::folder::Folder;
use self::merge::{half_of_gaussians, half_of_surfels};
use self::pictures::{Pictures, around};

/// Primitives of a cell, at most, unless it is given.
pub const CELL_PRIMITIVES: usize = 32_768;
/// Cells that are in work at a time.
const AT_ONCE: usize = 16;
/// Views that a fit is measured by.
const MEASURED_VIEWS: usize = 8;

/// Why a folder was not written.
#[derive(Debug, thiserror::Error)]
pub enum LodError {
    #[error(
        "a scene that is rendered as {0} has no levels of detail: only surfels with order-free sums of Gaussians can be \
         merged (`dpges train` without --method trains such scenes)"
    )]
    NotPeeled(Rendering),
    #[error("the scene has no primitives")]
    Empty,
    #[error(
        "{} is there already, and is no scene in levels of detail: name another folder",
        .0.display()
    )]
    Taken(PathBuf),
    #[error("{action} {}: {source}", .path.display())]
    Io { action: &'static str, path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Export(#[from] ExportFailure),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
    #[error("fit of level {level}: {source}")]
    Fit { level: u32, source: TrainError },
}

/// Options for making a scene in levels of detail.
pub struct Options<'a> {
    /// At most in a cell of level 0; cells of other levels have about as many.
    pub cell_primitives: usize,
    /// Cameras of the scene, which the first view is taken from; none are known of a scene file alone.
    pub cameras: &'a [Camera],
    /// Steps by which each level above 0 is fitted, and the device for it; `None`: no fit.
    pub fit: Option<(usize, &'a Device)>,
}

/// Surfels and Gaussians of a cell.
pub type Primitives = (SurfelData, GaussianData);

/// Writes `scene` in levels of detail as the folder `out`, which appears when it is complete; an older one takes its place
/// until then. Returns its index.
pub fn write(scene: SceneData, options: &Options, out: &Path) -> Result<Index, LodError> {
    if scene.info.rendering != Rendering::Peeled {
        return Err(LodError::NotPeeled(scene.info.rendering));
    }
    if scene.surfels.is_empty() && scene.gaussians.is_empty() {
        return Err(LodError::Empty);
    }
    let mut folder = Folder::begin(out, &scene)?;
    let leaves = tree::leaves(&scene, options.cell_primitives);
    let coarsest = leaves.len().ilog2();
    let around = around(&scene);
    let cameras = if options.cameras.is_empty() { &around } else { options.cameras };
    let pictures = match options.fit {
        Some((steps, device)) if steps > 0 && coarsest > 0 => {
            if options.cameras.is_empty() {
                tracing::info!(
                    "no cameras are known: levels are fitted to views from around the scene (--data names a dataset)"
                );
            }
            tracing::info!("pictures of the whole scene, {} primitives", scene.surfels.len() + scene.gaussians.len());
            Some((Pictures::new(&scene, cameras, coarsest, device)?, steps, device))
        }
        _ => None,
    };
    let seen = seen_by(cameras, scene.info.extent);
    let info = scene.info.clone();
    let environment = scene.environment.clone();
    let select = |at: usize| {
        let [surfels, gaussians] = &leaves[at];
        (scene.surfels.select(surfels), scene.gaussians.select(gaussians))
    };
    let mut above = write_level(&mut folder, 0, leaves.len(), &select, &info, &seen)?;
    drop((scene, leaves));
    for level in 1..=coarsest {
        let mut cells = above;
        if let Some((pictures, steps, device)) = &pictures {
            let base = SceneData { environment: environment.clone(), ..joined(&cells, &info) };
            let views = pictures.of(level);
            let few: Vec<View> = every_nth(views, MEASURED_VIEWS).cloned().collect();
            let psnr = |scene: &SceneData| Ok::<f64, LodError>(evaluate(scene, &few, device)?.psnr);
            let fitted = refit(&base, views, *steps, device).map_err(|source| LodError::Fit { level, source })?;
            let [width, height] = [views[0].camera.width, views[0].camera.height];
            let (before, after) = (psnr(&base)?, psnr(&fitted)?);
            let kept = if after < before { ": left as it was" } else { "" };
            tracing::info!(
                "level {level}: {before:.2} dB → {after:.2} dB at {width} × {height} px by {steps} steps{kept}"
            );
            if after >= before {
                cells = split(fitted, &cells);
            }
        }
        above = write_level(&mut folder, level, cells.len(), &|at| cells[at].clone(), &info, &seen)?;
    }
    folder.finish(options.cameras)
}

/// Writes the cells of a level, and merges two by two for the next. No more than [`AT_ONCE`] are in memory besides what `cell`
/// makes them of.
fn write_level(
    folder: &mut Folder,
    level: u32,
    count: usize,
    cell: &(impl Fn(usize) -> Primitives + Sync),
    info: &SceneInfo,
    seen: &(impl Fn(DVec3) -> f64 + Sync),
) -> Result<Vec<Primitives>, LodError> {
    let mut above = Vec::with_capacity(count / 2);
    for first in (0..count).step_by(AT_ONCE) {
        let cells: Vec<Primitives> = (first..count.min(first + AT_ONCE)).into_par_iter().map(cell).collect();
        folder.write(level, &cells)?;
        above.par_extend(cells.par_chunks_exact(2).map(|pair| {
            let (mut surfels, mut gaussians) = pair[0].clone();
            surfels.append(pair[1].0.clone());
            gaussians.append(pair[1].1.clone());
            (half_of_surfels(&surfels, info.modulation, seen), half_of_gaussians(&gaussians, seen))
        }));
    }
    folder.finish_level(level)?;
    Ok(above)
}

/// How much a place counts, per world unit²: its size on the screen of a camera in the middle of `cameras`.
fn seen_by(cameras: &[Camera], extent: f64) -> impl Fn(DVec3) -> f64 + Sync + use<> {
    let middle = cameras.iter().map(Camera::centre).sum::<DVec3>() / cameras.len().max(1) as f64;
    let near = 0.25 * extent * extent;
    move |place: DVec3| near / (near + (place - middle).length_squared())
}

/// All cells as one scene.
fn joined(cells: &[Primitives], info: &SceneInfo) -> SceneData {
    let (mut surfels, mut gaussians) = (cells[0].0.select(&[]), cells[0].1.select(&[]));
    for (more_surfels, more_gaussians) in cells {
        surfels.append(more_surfels.clone());
        gaussians.append(more_gaussians.clone());
    }
    SceneData { info: info.clone(), surfels, gaussians, environment: None }
}

/// All cells of a level of `index` as one scene, with the sky.
pub fn level(index: &Index, level: u32) -> dpges_core::Result<SceneData> {
    let bytes = |part| Index::read_part(&index.place, part);
    let cell = |at: usize| {
        let SceneData { surfels, gaussians, .. } = index.cell(at, &bytes(&index.cells[at].part)?)?;
        Ok((surfels, gaussians))
    };
    let cells = index.level(level).map(cell).collect::<dpges_core::Result<Vec<Primitives>>>()?;
    let sky = index.sky.as_ref().map(|part| index.sky(part, &bytes(part)?)).transpose()?;
    Ok(SceneData { environment: sky.and_then(|sky| sky.environment), ..joined(&cells, &index.settings) })
}

/// Undoes [`joined`]: as many of each as `cells` have.
fn split(scene: SceneData, cells: &[Primitives]) -> Vec<Primitives> {
    let mut first = [0, 0];
    let cell = |(surfels, gaussians): &Primitives| {
        let [of_surfels, of_gaussians] = [(0, surfels.len()), (1, gaussians.len())].map(|(kind, count)| {
            let from: usize = first[kind];
            first[kind] += count;
            (from..from + count).collect::<Vec<usize>>()
        });
        (scene.surfels.select(&of_surfels), scene.gaussians.select(&of_gaussians))
    };
    cells.iter().map(cell).collect()
}

//! The files of a scene in levels of detail, in a folder that takes its place when it is complete.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use dpges_core::camera::Camera;
use dpges_core::scene::lod::{CAMERAS, Cell, INDEX, Index, Part};
use dpges_core::scene::{Quality, SceneData};
use dpges_render::CameraPath;
use dpges_train::dataset::neighbours::as_points;
use rayon::prelude::*;
use tempfile::TempDir;

use super::{LodError, Primitives};

/// Between `high` and `highest`: pictures of level 0 are those of the scene to 45 dB and more.
const QUALITY: Quality =
    Quality { positions: 18, quaternions: 11, log_scales: 11, opacities: 11, margins: 12, base: 11, detail: 11 };
const SKY: &str = "base.safetensors";
/// First bytes of every index that was exported.
const INDEX_BEGIN: &str = "{\"format\":\"dpges-lod\"";

/// A folder that is being written.
pub struct Folder {
    out: PathBuf,
    partial: TempDir,
    /// Without primitives.
    base: SceneData,
    index: Index,
    /// Cells of each level, from 0.
    levels: Vec<Vec<Cell>>,
    pack: Option<File>,
}

impl Folder {
    /// Begins beside `out`, where there is room for `scene` in levels of detail.
    ///
    /// # Errors
    /// [`LodError::Taken`] if there is something else, [`LodError::Io`].
    pub fn begin(out: &Path, scene: &SceneData) -> Result<Self, LodError> {
        check(out)?;
        let parent = match out.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        fs::create_dir_all(parent).map_err(|source| io_error("cannot make", parent, source))?;
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        let partial = builder.prefix(".dpges-lod-").tempdir_in(parent);
        let partial = partial.map_err(|source| io_error("cannot write into", parent, source))?;
        let base = SceneData {
            info: scene.info.clone(),
            surfels: scene.surfels.select(&[]),
            gaussians: scene.gaussians.select(&[]),
            environment: scene.environment.clone(),
        };
        let index = Index::new(scene.info.clone());
        Ok(Self { out: out.to_owned(), partial, base, index, levels: Vec::new(), pack: None })
    }

    /// Adds cells after those that the level has.
    pub fn write(&mut self, level: u32, cells: &[Primitives]) -> Result<(), LodError> {
        let name = format!("level-{level}.pack");
        let path = self.partial.path().join(&name);
        let encode = |cell: &Primitives| {
            let (surfels, gaussians) = cell.clone();
            let scene = SceneData { surfels, gaussians, info: self.base.info.clone(), environment: None };
            Ok((scene.to_compressed(&QUALITY, &path)?, shape(cell)))
        };
        let encoded: Vec<(Vec<u8>, Shape)> = cells.par_iter().map(encode).collect::<Result<_, LodError>>()?;
        let wrong = |source| io_error("cannot write", &path, source);
        if self.levels.len() <= level as usize {
            self.levels.push(Vec::new());
            self.pack = Some(File::create(&path).map_err(wrong)?);
        }
        let (pack, written) = (self.pack.as_mut().expect("just made"), &mut self.levels[level as usize]);
        for ((surfels, gaussians), (bytes, Shape { min, max, size })) in cells.iter().zip(encoded) {
            pack.write_all(&bytes).map_err(wrong)?;
            let offset = written.last().map_or(0, |cell| cell.part.offset + cell.part.bytes);
            let part = Part { file: name.clone(), offset, bytes: bytes.len() as u64 };
            let (surfels, gaussians) = (surfels.len(), gaussians.len());
            written.push(Cell { level, min, max, parent: None, children: Vec::new(), part, surfels, gaussians, size });
        }
        Ok(())
    }

    /// After the last cell of a level.
    pub fn finish_level(&mut self, level: u32) -> Result<(), LodError> {
        if let Some(pack) = self.pack.take() {
            pack.sync_all().map_err(|source| io_error("cannot write", self.partial.path(), source))?;
        }
        let cells = &self.levels[level as usize];
        let (count, bytes): (usize, u64) =
            cells.iter().fold((0, 0), |(count, bytes), cell| (count + cell.primitives(), bytes + cell.part.bytes));
        tracing::info!("level {level}: {} cells, {count} primitives, {:.2} MB", cells.len(), bytes as f64 / 1e6);
        Ok(())
    }

    /// Writes the sky, the cameras and the index, and puts the folder where it belongs.
    ///
    /// # Errors
    /// [`LodError::Taken`] if there is something else by now, [`LodError::Io`].
    pub fn finish(mut self, cameras: &[Camera]) -> Result<Index, LodError> {
        if self.base.environment.is_some() {
            let bytes = self.base.to_compressed(&QUALITY, SKY.as_ref())?;
            self.index.sky = Some(Part { file: SKY.to_owned(), offset: 0, bytes: bytes.len() as u64 });
            self.put(SKY, &bytes)?;
        }
        let path = CameraPath::new(cameras.to_vec(), false);
        self.put(CAMERAS, path.map_or_else(|_| "[]".to_owned(), |path| path.to_json()).as_bytes())?;
        // level by level from the root: the children of cell k are cells 2 k + 1 and 2 k + 2
        let coarsest = self.levels.len() - 1;
        self.index.cells = std::mem::take(&mut self.levels).into_iter().rev().flatten().collect();
        for (at, cell) in self.index.cells.iter_mut().enumerate() {
            cell.parent = (at > 0).then(|| (at - 1) / 2);
            cell.children = if cell.level == 0 { Vec::new() } else { vec![2 * at + 1, 2 * at + 2] };
        }
        debug_assert_eq!(self.index.cells.len(), (2 << coarsest) - 1);
        let json =
            serde_json::to_vec(&self.index).map_err(|error| io_error("cannot write", &self.out, error.into()))?;
        self.put(INDEX, &json)?;
        self.publish()?;
        Ok(Index { place: self.out, ..self.index })
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), LodError> {
        let path = self.partial.path().join(name);
        let write = || -> io::Result<()> {
            let mut file = File::create(&path)?;
            file.write_all(bytes)?;
            file.sync_all()
        };
        write().map_err(|source| io_error("cannot write", &path, source))
    }

    /// The folder in the place of what is there, which is removed after that.
    fn publish(&self) -> Result<(), LodError> {
        check(&self.out)?;
        let replace = || -> io::Result<()> {
            if self.out.exists() {
                let old = self.partial.path().with_extension("old");
                fs::rename(&self.out, &old)?;
                fs::rename(self.partial.path(), &self.out)?;
                return fs::remove_dir_all(old);
            }
            fs::rename(self.partial.path(), &self.out)
        };
        replace().map_err(|source| io_error("cannot write", &self.out, source))
    }
}

/// Whether `out` is absent, an empty folder, or a scene in levels of detail, a damaged one too: its message says to export
/// it again.
fn check(out: &Path) -> Result<(), LodError> {
    let is_empty = || fs::read_dir(out).is_ok_and(|mut files| files.next().is_none());
    let is_lod = || fs::read(out.join(INDEX)).is_ok_and(|bytes| bytes.starts_with(INDEX_BEGIN.as_bytes()));
    if !out.exists() || is_empty() || is_lod() { Ok(()) } else { Err(LodError::Taken(out.to_owned())) }
}

fn io_error(action: &'static str, path: &Path, source: io::Error) -> LodError {
    LodError::Io { action, path: path.to_owned(), source }
}

/// Share of the primitives that reach beyond each side of their box. One floater would otherwise put all cameras into it.
const BEYOND: f64 = 0.05;
/// Reach of a primitive, σ.
const REACH: f32 = 2.0;

/// Where most primitives are, and how large.
struct Shape {
    min: [f32; 3],
    max: [f32; 3],
    size: f32,
}

fn shape((surfels, gaussians): &Primitives) -> Shape {
    let largest = |scales: &[f32]| scales.iter().copied().fold(f32::NEG_INFINITY, f32::max).exp();
    let of_surfels = as_points(&surfels.positions).iter().zip(surfels.log_scales.chunks_exact(2).map(largest));
    let of_gaussians = as_points(&gaussians.positions).iter().zip(gaussians.log_scales.chunks_exact(3).map(largest));
    // out of the range of f32 there is no box
    let all: Vec<(&[f32; 3], f32)> =
        of_surfels.chain(of_gaussians).map(|(place, sigma)| (place, sigma.min(f32::MAX / 8.0))).collect();
    let nth = |at: usize, mut values: Vec<f32>| *values.select_nth_unstable_by(at, f32::total_cmp).1;
    let last = all.len() - 1;
    let beyond = (BEYOND * last as f64) as usize;
    let side = |at: usize, sigmas: f32| {
        [0, 1, 2].map(|axis: usize| {
            let reach = |(place, sigma): &(&[f32; 3], f32)| (place[axis] + sigmas * sigma).clamp(f32::MIN, f32::MAX);
            nth(at, all.iter().map(reach).collect())
        })
    };
    let size = nth(all.len() / 2, all.iter().map(|&(_, sigma)| sigma).collect());
    Shape { min: side(beyond, -REACH), max: side(last - beyond, REACH), size }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{ColourModel, GaussianData, SurfelData};

    use super::*;

    #[test]
    fn what_floats_far_away_is_beyond_the_box() {
        let model = ColourModel::SphericalHarmonics { degree: 0 };
        let surfels = SurfelData::neutral(model, 0);
        let mut gaussians = GaussianData::neutral(model, 101);
        // along x from 0 to 1, and one of them at 500
        gaussians.positions =
            (0..101).flat_map(|at| [if at == 50 { 500.0 } else { at as f32 / 100.0 }, 2.0, -1.0]).collect();
        gaussians.log_scales = vec![0.01f32.ln(); 303];
        let Shape { min, max, size } = shape(&(surfels.clone(), gaussians));
        assert!((min[0] - 0.03).abs() < 1e-6 && (0.96..1.0).contains(&max[0]), "{min:?} {max:?}");
        assert!((max[1] - 2.02).abs() < 1e-6 && (min[2] + 1.02).abs() < 1e-6 && (size - 0.01).abs() < 1e-6);
        let mut one = GaussianData::neutral(model, 1);
        one.positions = vec![1.0, 2.0, 3.0];
        one.log_scales = vec![f32::MAX, 0.0, 0.0];
        let Shape { min, max, .. } = shape(&(surfels, one));
        assert!(min.iter().zip(&max).all(|(low, high)| low < high && low.is_finite() && high.is_finite()), "{min:?}");
    }
}

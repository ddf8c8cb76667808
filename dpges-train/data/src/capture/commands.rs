//! Command lines of COLMAP, and its output. It has renamed options and taken up GLOMAP, so it is asked first what it knows.

use std::path::{Path, PathBuf};
use std::process::Command;

use super::Options;
use super::error::SfmError;
use super::options::{SfmMatching, SfmProgram, name_of};
use super::programs::{Programs, said};
use super::workspace::Workspace;

/// The matcher goes through blocks of photographs against blocks. Progress is known by the block, so there are about a
/// hundred pairs of them, not more: each block is read anew.
const BLOCKS: usize = 10;
const SMALLEST_BLOCK: usize = 8;
const LARGEST_BLOCK: usize = 50;

/// COLMAP as it is installed.
pub(super) struct Colmap {
    path: PathBuf,
    /// Whether it is built for NVIDIA's GPUs.
    pub has_cuda: bool,
    /// Where the options on devices and threads are: `SiftExtraction` before version 4, `FeatureExtraction` since.
    extraction: &'static str,
    matching: &'static str,
    /// The program that places the cameras, and its command.
    mapper: (PathBuf, &'static str),
}

impl Colmap {
    /// # Errors
    /// [`SfmError::MissingProgram`] for COLMAP, and for GLOMAP if it is asked for and neither is there nor within COLMAP;
    /// [`SfmError::Start`].
    pub fn find(programs: &Programs, program: SfmProgram) -> Result<Self, SfmError> {
        let path = programs.colmap()?;
        let help = |command: &[&str]| said(Command::new(&path).args(command).arg("-h"));
        let about = help(&[])?;
        let since = |command: &str, new: &'static str, old: &'static str| -> Result<&'static str, SfmError> {
            Ok(if help(&[command])?.contains(&format!("--{new}.use_gpu")) { new } else { old })
        };
        let extraction = since("feature_extractor", "FeatureExtraction", "SiftExtraction")?;
        let matching = since("exhaustive_matcher", "FeatureMatching", "SiftMatching")?;
        let mapper = match (program, programs.find("glomap")) {
            (SfmProgram::Colmap, _) => (path.clone(), "mapper"),
            (SfmProgram::Glomap, Some(glomap)) => (glomap, "mapper"),
            (SfmProgram::Glomap, None) if about.contains("global_mapper") => (path.clone(), "global_mapper"),
            (SfmProgram::Glomap, None) => {
                return Err(SfmError::MissingProgram {
                    program: "GLOMAP",
                    purpose: "which `--sfm glomap` asks for, nor is it part of the COLMAP that is installed",
                    remedy: "install it (https://github.com/colmap/glomap) or COLMAP 4, or use --sfm colmap".to_owned(),
                });
            }
        };
        let has_cuda = about.contains("with CUDA") && !about.contains("without CUDA");
        Ok(Self { path, has_cuda, extraction, matching, mapper })
    }

    /// `masks` is the folder of masks, if there are any.
    pub fn features(
        &self,
        workspace: &Workspace,
        database: &Path,
        options: &Options,
        one_camera: bool,
        masks: Option<&Path>,
        gpu: bool,
    ) -> Command {
        let mut command = begun(&self.path, "feature_extractor", database);
        command.arg("--image_path").arg(&workspace.images);
        command.args(["--ImageReader.camera_model", &name_of(options.camera)]);
        if one_camera {
            command.args(["--ImageReader.single_camera", "1"]);
        }
        if let Some(masks) = masks {
            command.arg("--ImageReader.mask_path").arg(masks);
        }
        on_device(command, self.extraction, options, gpu)
    }

    pub fn matches(
        &self,
        database: &Path,
        options: &Options,
        matching: SfmMatching,
        photographs: usize,
        gpu: bool,
    ) -> Command {
        let is_sequential = matching == SfmMatching::Sequential;
        let name = if is_sequential { "sequential_matcher" } else { "exhaustive_matcher" };
        let mut command = begun(&self.path, name, database);
        if !is_sequential {
            let block = photographs.div_ceil(BLOCKS).clamp(SMALLEST_BLOCK, LARGEST_BLOCK);
            command.args(["--ExhaustiveMatching.block_size", &block.to_string()]);
        }
        on_device(command, self.matching, options, gpu)
    }

    pub fn mapping(&self, workspace: &Workspace, database: &Path, options: &Options) -> Command {
        let (program, name) = &self.mapper;
        let mut command = begun(program, name, database);
        command.arg("--image_path").arg(&workspace.images);
        command.arg("--output_path").arg(&workspace.models);
        if let (Some(threads), SfmProgram::Colmap) = (options.threads, options.program) {
            command.args(["--Mapper.num_threads", &threads.to_string()]);
        }
        command
    }
}

fn begun(program: &Path, name: &str, database: &Path) -> Command {
    let mut command = Command::new(program);
    command.arg(name).arg("--database_path").arg(database);
    command
}

fn on_device(mut command: Command, section: &str, options: &Options, gpu: bool) -> Command {
    command.args([format!("--{section}.use_gpu"), u8::from(gpu).to_string()]);
    if let Some(threads) = options.threads {
        command.args([format!("--{section}.num_threads"), threads.to_string()]);
    }
    command
}

/// Done and total, in photographs or pairs of blocks of photographs, by a line of COLMAP's or GLOMAP's output.
/// `photographs` is how many there are. `None` for lines about something else.
pub(super) fn progress(line: &str, photographs: usize) -> Option<(usize, usize)> {
    if let Some((_, rest)) = line.split_once("Processed file [") {
        return fraction(rest);
    }
    // these begin what they name
    if let Some((_, rest)) = line.split_once("ing image [") {
        return fraction(rest).map(|(done, total)| (done.saturating_sub(1), total));
    }
    if let Some((_, rest)) = line.split_once("ing block [") {
        let (row, column) = rest.split_once(", ")?;
        let ((row, rows), (column, columns)) = (fraction(row)?, fraction(column)?);
        return Some((row.checked_sub(1)? * columns + column.checked_sub(1)?, rows * columns));
    }
    let (_, rest) = line.split_once("Registering image #")?;
    let (_, rest) = rest.split_once('(')?;
    let placed = number(rest.trim_start_matches("num_reg_frames="))?;
    Some((placed.min(photographs), photographs))
}

/// `a/b` at the beginning of `text`.
fn fraction(text: &str) -> Option<(usize, usize)> {
    let (done, total) = text.split_once('/')?;
    Some((number(done)?, number(total)?))
}

/// The digits at the beginning of `text`.
pub(super) fn number(text: &str) -> Option<usize> {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    text[..end].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::super::SfmCamera;
    use super::*;

    #[test]
    fn commands_name_the_folders_and_the_device() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Workspace::open(&folder.path().join("set")).unwrap();
        let at = folder.path().join("set").display().to_string();
        let database = &workspace.work("database.db");
        let colmap = |extraction: &'static str, matching: &'static str, mapper: &'static str| {
            let path = PathBuf::from("/bin/colmap");
            Colmap { mapper: (path.clone(), mapper), path, has_cuda: true, extraction, matching }
        };
        let is = |command: Command, expected: &str| {
            let words = std::iter::once(command.get_program()).chain(command.get_args());
            let words: Vec<_> = words.map(|word| word.to_string_lossy()).collect();
            assert_eq!(words.join(" ").replace(&at, "AT"), format!("/bin/colmap {expected}"));
        };

        let old = colmap("SiftExtraction", "SiftMatching", "mapper");
        let options = Options { threads: Some(3), ..Options::default() };
        is(
            old.features(&workspace, database, &options, true, None, false),
            "feature_extractor --database_path AT/sfm/database.db --image_path AT/images --ImageReader.camera_model OPENCV \
             --ImageReader.single_camera 1 --SiftExtraction.use_gpu 0 --SiftExtraction.num_threads 3",
        );
        is(
            old.matches(database, &options, SfmMatching::Exhaustive, 150, false),
            "exhaustive_matcher --database_path AT/sfm/database.db --ExhaustiveMatching.block_size 15 \
             --SiftMatching.use_gpu 0 --SiftMatching.num_threads 3",
        );
        is(
            old.mapping(&workspace, database, &options),
            "mapper --database_path AT/sfm/database.db --image_path AT/images --output_path AT/sfm/models \
             --Mapper.num_threads 3",
        );

        let new = colmap("FeatureExtraction", "FeatureMatching", "global_mapper");
        let (program, camera) = (SfmProgram::Glomap, SfmCamera::SimpleRadial);
        let options = Options { program, camera, threads: None, ..Options::default() };
        is(
            new.features(&workspace, database, &options, false, Some(&workspace.work("masks")), true),
            "feature_extractor --database_path AT/sfm/database.db --image_path AT/images --ImageReader.camera_model \
             SIMPLE_RADIAL --ImageReader.mask_path AT/sfm/masks --FeatureExtraction.use_gpu 1",
        );
        is(
            new.matches(database, &options, SfmMatching::Sequential, 400, true),
            "sequential_matcher --database_path AT/sfm/database.db --FeatureMatching.use_gpu 1",
        );
        is(
            new.mapping(&workspace, database, &Options { threads: Some(3), ..options }),
            "global_mapper --database_path AT/sfm/database.db --image_path AT/images --output_path AT/sfm/models",
        );
    }

    #[test]
    fn lines_of_old_and_new_versions_are_understood() {
        let cases = [
            ("Processed file [12/49]", Some((12, 49))),
            ("I20260101 10:00:00.000000 1 feature_extraction.cc:254] Processed file [1/49]", Some((1, 49))),
            ("Matching block [1/3, 2/3] in 34.321s", Some((1, 9))),
            ("I20260101 10:00:00.000000 1 pairing.cc:214] Processing block [3/3, 3/3]", Some((8, 9))),
            ("Matching image [7/49] in 1.5s", Some((6, 49))),
            ("Processing image [7/49]", Some((6, 49))),
            ("Registering image #31 (3)", Some((3, 49))),
            ("Registering image #1 (50)", Some((49, 49))),
            ("I20260101 10:00:00 1 incremental_pipeline.cc:1] Registering image #31 (num_reg_frames=7)", Some((7, 49))),
            ("  => Image sees 121 / 473 points", None),
            ("Matching block [x/3, 2/3]", None),
            ("Processed file [99999999999999999999999/1]", None),
            ("", None),
        ];
        for (line, expected) in cases {
            assert_eq!(progress(line, 49), expected, "{line}");
        }
    }
}

//! Command lines of the programs. COLMAP has renamed options and taken up GLOMAP, so it is asked first what it knows.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::Options;
use super::error::SfmError;
use super::options::{SfmMatching, SfmProgram, name_of};
use super::programs::Programs;
use super::workspace::Workspace;

/// The matcher goes through blocks of photographs against blocks. Progress is known by the block, so there are about a
/// hundred pairs of them, not more: each block is read anew.
const BLOCKS: usize = 10;
const SMALLEST_BLOCK: usize = 8;
const LARGEST_BLOCK: usize = 50;

/// COLMAP as it is installed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Colmap {
    pub path: PathBuf,
    /// Whether it is built for NVIDIA's GPUs.
    pub has_cuda: bool,
    /// Where the options on devices and threads are: `SiftExtraction` before version 4, `FeatureExtraction` since.
    pub extraction: &'static str,
    /// Likewise.
    pub matching: &'static str,
    /// The program that places the cameras, and its command.
    pub mapper: (PathBuf, &'static str),
}

/// A program and its arguments.
pub(super) type Call = (PathBuf, Vec<OsString>);

impl Colmap {
    /// # Errors
    /// [`SfmError::MissingProgram`] for COLMAP, and for GLOMAP if it is asked for and neither is there nor within COLMAP;
    /// [`SfmError::Start`].
    pub fn find(programs: &Programs, program: SfmProgram) -> Result<Self, SfmError> {
        let path = programs.colmap()?;
        let about = said(&path, &["-h".as_ref()])?;
        let since = |command: &str, new: &'static str, old: &'static str| -> Result<&'static str, SfmError> {
            let knows = said(&path, &[command.as_ref(), "-h".as_ref()])?.contains(&format!("--{new}.use_gpu"));
            Ok(if knows { new } else { old })
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
        options: &Options,
        one_camera: bool,
        masks: Option<&Path>,
        gpu: bool,
    ) -> Call {
        let mut words = begun("feature_extractor", workspace);
        add(&mut words, "--image_path", workspace.images());
        add(&mut words, "--ImageReader.camera_model", name_of(options.camera));
        if one_camera {
            add(&mut words, "--ImageReader.single_camera", "1");
        }
        if let Some(masks) = masks {
            add(&mut words, "--ImageReader.mask_path", masks);
        }
        self.on_device(words, self.extraction, options, gpu)
    }

    pub fn matches(
        &self,
        workspace: &Workspace,
        options: &Options,
        matching: SfmMatching,
        photographs: usize,
        gpu: bool,
    ) -> Call {
        let is_sequential = matching == SfmMatching::Sequential;
        let mut words = begun(if is_sequential { "sequential_matcher" } else { "exhaustive_matcher" }, workspace);
        if !is_sequential {
            let block = photographs.div_ceil(BLOCKS).clamp(SMALLEST_BLOCK, LARGEST_BLOCK);
            add(&mut words, "--ExhaustiveMatching.block_size", block.to_string());
        }
        self.on_device(words, self.matching, options, gpu)
    }

    pub fn mapping(&self, workspace: &Workspace, options: &Options) -> Call {
        let (program, command) = &self.mapper;
        let mut words = begun(command, workspace);
        add(&mut words, "--image_path", workspace.images());
        add(&mut words, "--output_path", workspace.models());
        if let (Some(threads), SfmProgram::Colmap) = (options.threads, options.program) {
            add(&mut words, "--Mapper.num_threads", threads.to_string());
        }
        (program.clone(), words)
    }

    fn on_device(&self, mut words: Vec<OsString>, section: &str, options: &Options, gpu: bool) -> Call {
        add(&mut words, &format!("--{section}.use_gpu"), if gpu { "1" } else { "0" });
        if let Some(threads) = options.threads {
            add(&mut words, &format!("--{section}.num_threads"), threads.to_string());
        }
        (self.path.clone(), words)
    }
}

fn begun(command: &str, workspace: &Workspace) -> Vec<OsString> {
    let mut words = vec![command.into()];
    add(&mut words, "--database_path", workspace.database());
    words
}

fn add(words: &mut Vec<OsString>, option: &str, value: impl AsRef<OsStr>) {
    words.extend([option.into(), value.as_ref().into()]);
}

/// The output of a program, standard output and error.
pub(super) fn said(program: &Path, arguments: &[&OsStr]) -> Result<String, SfmError> {
    let output = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .map_err(|source| SfmError::Start { program: program.to_owned(), source })?;
    Ok(String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
}

#[cfg(test)]
mod tests {
    use super::super::SfmCamera;
    use super::*;

    fn colmap(extraction: &'static str, matching: &'static str) -> Colmap {
        let path = PathBuf::from("/bin/colmap");
        Colmap { mapper: (path.clone(), "mapper"), path, has_cuda: true, extraction, matching }
    }

    fn text((program, words): (PathBuf, Vec<OsString>)) -> String {
        let words = words.iter().map(|word| word.to_string_lossy().into_owned());
        std::iter::once(program.display().to_string()).chain(words).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn commands_name_the_folders_and_the_device() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Workspace::open(&folder.path().join("set")).unwrap();
        let at = folder.path().join("set").display().to_string();
        let options = Options { threads: Some(3), ..Options::default() };
        let old = colmap("SiftExtraction", "SiftMatching");
        assert_eq!(
            text(old.features(&workspace, &options, true, None, false)),
            format!(
                "/bin/colmap feature_extractor --database_path {at}/sfm/database.db --image_path {at}/images \
                 --ImageReader.camera_model OPENCV --ImageReader.single_camera 1 --SiftExtraction.use_gpu 0 \
                 --SiftExtraction.num_threads 3"
            )
        );
        assert_eq!(
            text(old.matches(&workspace, &options, SfmMatching::Exhaustive, 150, false)),
            format!(
                "/bin/colmap exhaustive_matcher --database_path {at}/sfm/database.db --ExhaustiveMatching.block_size 15 \
                 --SiftMatching.use_gpu 0 --SiftMatching.num_threads 3"
            )
        );
        assert_eq!(
            text(old.mapping(&workspace, &options)),
            format!(
                "/bin/colmap mapper --database_path {at}/sfm/database.db --image_path {at}/images --output_path \
                 {at}/sfm/models --Mapper.num_threads 3"
            )
        );
    }

    #[test]
    fn newer_names_other_models_and_neighbours_are_asked_for_where_needed() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Workspace::open(&folder.path().join("set")).unwrap();
        let options = Options {
            program: SfmProgram::Glomap,
            camera: SfmCamera::SimpleRadial,
            threads: None,
            ..Options::default()
        };
        let mut new = colmap("FeatureExtraction", "FeatureMatching");
        new.mapper.1 = "global_mapper";
        let features = text(new.features(&workspace, &options, false, Some(&workspace.work("masks")), true));
        let at = folder.path().join("set").display().to_string();
        let end = format!("SIMPLE_RADIAL --ImageReader.mask_path {at}/sfm/masks --FeatureExtraction.use_gpu 1");
        assert!(features.ends_with(&end), "{features}");
        let matches = text(new.matches(&workspace, &options, SfmMatching::Sequential, 400, true));
        assert!(matches.starts_with("/bin/colmap sequential_matcher --database_path "), "{matches}");
        assert!(matches.ends_with("/database.db --FeatureMatching.use_gpu 1"), "{matches}");
        let mapping = text(new.mapping(&workspace, &options));
        assert!(mapping.contains(" global_mapper ") && !mapping.contains("num_threads"), "{mapping}");
    }
}

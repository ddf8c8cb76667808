//! Cameras for photographs that have none: structure from motion by programs of the user's machine.
//!
//! | step | program | result, in the folder of the dataset |
//! |---|---|---|
//! | [`Step::Pictures`] | ffmpeg, for a video | `images/`, `masks/` |
//! | [`Step::Features`] | COLMAP | `sfm/OPTIONS.db` |
//! | [`Step::Matches`] | COLMAP | `sfm/OPTIONS.db` |
//! | [`Step::Mapping`] | COLMAP or GLOMAP | `sfm/models/0`, `1`, …; `sparse/0`, that with the most photographs |
//!
//! The result is a COLMAP dataset as [`crate::load`] reads it, which undistorts the photographs if asked to. [`reconstruct`]
//! goes on where it was interrupted, since COLMAP does not look again for what its database has. The output of a program is in
//! `sfm/STEP.log`.

mod commands;
mod error;
mod exif;
mod frames;
mod input;
mod masks;
mod model;
mod options;
mod programs;
mod step;
#[cfg(test)]
mod tests;
mod unusable;
mod workspace;

use std::path::{Path, PathBuf};
use std::time::Instant;

pub use error::SfmError;
pub use input::{Input, is_begun};
pub use model::Outcome;
pub use options::{Options, SfmCamera, SfmMatching, SfmProgram};
pub use programs::Programs;
pub use step::{Observer, Step};
pub use unusable::{Unusable, unusable};

use crate::names::list;
use commands::Colmap;
use workspace::{Workspace, is_finished};

/// Up to how many photographs all pairs are compared, unless it is asked for.
const MOST_FOR_ALL_PAIRS: usize = 200;

/// Fewest photographs that a dataset can be made of.
pub const FEWEST: usize = 3;

/// The input of a reconstruction, and its destination.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    pub input: &'a Input,
    /// Folder of the dataset. It is made if it does not exist.
    pub dataset: &'a Path,
    pub options: &'a Options,
    /// Make a finished dataset anew.
    pub overwrite: bool,
    pub programs: &'a Programs,
}

/// The folder that the dataset of `input` goes to unless another is named: beside it, `NAME_colmap`.
///
/// # Errors
/// [`SfmError::NoName`] for the root of a file system.
pub fn dataset_beside(input: &Input) -> Result<PathBuf, SfmError> {
    let path = input.path();
    let name = input.name().ok_or_else(|| SfmError::NoName { path: path.to_owned() })?;
    Ok(path.with_file_name(format!("{name}_colmap")))
}

/// Makes a dataset of photographs, or goes on with it. One that is finished stays as it is, whatever the options, unless it is to be
/// overwritten.
///
/// # Errors
/// [`SfmError`]: a missing program, a program that fails, a finished dataset of other photographs, photographs that show too
/// little in common.
pub fn reconstruct(request: &Request, observer: &mut dyn Observer) -> Result<Outcome, SfmError> {
    let &Request { input, dataset, options, programs, overwrite } = request;
    input.check()?;
    let find_programs = || {
        if let Input::Video { .. } = input {
            programs.ffmpeg()?;
        }
        Colmap::find(programs, options.program)
    };
    if overwrite || !is_finished(dataset) {
        // before there is a folder
        find_programs()?;
    }
    let workspace = Workspace::open(dataset)?;
    let is_same = workspace.holds(input)?;
    if is_finished(dataset) && !overwrite {
        return if is_same {
            model::outcome(&workspace, Vec::new())
        } else {
            Err(SfmError::Changed { dataset: dataset.to_owned() })
        };
    }
    if overwrite || !is_same {
        workspace.forget()?;
    }
    let colmap = find_programs()?;
    let mut reconstruction = Reconstruction { request, workspace, colmap, observer, seconds: Vec::new() };
    reconstruction.step(Step::Pictures, Reconstruction::pictures)?;
    let one_camera = exif::have_one_camera(&reconstruction.workspace.pictures()?)?;
    for step in [Step::Features, Step::Matches, Step::Mapping] {
        reconstruction.step(step, |this| this.colmap(step, one_camera))?;
    }
    model::take_largest(&reconstruction.workspace)?;
    model::outcome(&reconstruction.workspace, reconstruction.seconds)
}

/// [`SfmMatching::Auto`] decided.
fn matching(asked: SfmMatching, names: &[String]) -> SfmMatching {
    match asked {
        SfmMatching::Auto if names.len() > MOST_FOR_ALL_PAIRS && input::are_numbered(names) => SfmMatching::Sequential,
        SfmMatching::Auto => SfmMatching::Exhaustive,
        asked => asked,
    }
}

struct Reconstruction<'a> {
    request: &'a Request<'a>,
    workspace: Workspace,
    colmap: Colmap,
    observer: &'a mut dyn Observer,
    /// How long each step took.
    seconds: Vec<(Step, f64)>,
}

impl Reconstruction<'_> {
    fn step(&mut self, step: Step, work: impl FnOnce(&mut Self) -> Result<(), SfmError>) -> Result<(), SfmError> {
        let start = Instant::now();
        self.observer.begin(step);
        work(self)?;
        let seconds = start.elapsed().as_secs_f64();
        self.seconds.push((step, seconds));
        self.observer.end(step, seconds);
        Ok(())
    }

    fn pictures(&mut self) -> Result<(), SfmError> {
        let (request, workspace) = (self.request, &self.workspace);
        let (path, folder, names, unread, masks) = match request.input {
            Input::Photographs { path, folder, names, unread, masks } => (path, folder, names, unread, masks),
            Input::Video { .. } if workspace.images.is_dir() => return Ok(()),
            Input::Video { path } => {
                let ffmpeg = request.programs.ffmpeg()?;
                return frames::extract(&ffmpeg, path, request.options.video_frames, workspace, self.observer);
            }
        };
        if !unread.is_empty() {
            self.observer.warn(&format!(
                "left out, for only JPEG, PNG and WebP are read: {}; convert them to JPEG to use them",
                list(unread)
            ));
        }
        workspace.link_pictures(folder, names)?;
        let folder_of_masks = path.join(input::MASKS);
        if !masks.is_empty() {
            // they are checked before they are in the dataset
            self.masks()?;
            let kept = workspace.copy_masks(masks)?;
            if !kept.is_empty() {
                self.observer.warn(&format!(
                    "{} has other masks than the photographs, which stay as they are: {}; remove those that are not wanted",
                    workspace.masks.display(),
                    list(&kept)
                ));
            }
        } else if folder_of_masks.is_dir() {
            self.observer.warn(&format!(
                "{} has no mask that is called like a photograph: that of NAME.jpg is NAME.jpg.png or NAME.png",
                folder_of_masks.display()
            ));
        }
        Ok(())
    }

    /// The folder of the masks as COLMAP reads them; `None` without any.
    fn masks(&self) -> Result<Option<PathBuf>, SfmError> {
        let (masks, workspace) = (self.request.input.masks(), &self.workspace);
        if masks.is_empty() {
            return Ok(None);
        }
        let (part, place) = (workspace.empty_folder("masks.part")?, workspace.work(input::MASKS));
        masks::write(masks, &workspace.images, self.request.options.invert_masks, &part)?;
        workspace::replace(&part, &place)?;
        Ok(Some(place))
    }

    /// One of the steps that are COLMAP's, on a GPU if it has been built for it. If that fails, then on the CPU.
    fn colmap(&mut self, step: Step, one_camera: bool) -> Result<(), SfmError> {
        let (workspace, options, log) = (&self.workspace, self.request.options, self.workspace.log(step));
        let names = workspace.picture_names()?;
        let matching = matching(options.matching, &names);
        let masks = if step == Step::Features { self.masks()? } else { None };
        if step == Step::Mapping {
            // the models of an interrupted mapping are not kept
            workspace.empty_folder("models")?;
        }
        let (colmap, observer) = (&self.colmap, &mut self.observer);
        let database = workspace.database(&options.of_features(one_camera));
        let mut attempt = |gpu: bool| {
            let command = match step {
                Step::Features => colmap.features(workspace, &database, options, one_camera, masks.as_deref(), gpu),
                Step::Matches => colmap.matches(&database, options, matching, names.len(), gpu),
                _ => colmap.mapping(workspace, &database, options),
            };
            programs::run(step, command, &log, &mut |line| {
                if let Some((done, total)) = commands::progress(line, names.len()) {
                    observer.progress(step, done, total);
                }
            })
        };
        let uses_gpu = colmap.has_cuda && step != Step::Mapping;
        match attempt(uses_gpu) {
            Err(SfmError::Failed { .. }) if uses_gpu => attempt(false).inspect(|()| {
                let log = log.display();
                self.observer.warn(&format!("{step}: COLMAP failed on the GPU, {log} says why; the CPU did it"));
            }),
            Err(SfmError::Failed { log, .. }) if step == Step::Mapping && model::says_nothing_fits(&log) => {
                Err(SfmError::NoModel { photographs: names.len(), log })
            }
            result => result,
        }
    }
}

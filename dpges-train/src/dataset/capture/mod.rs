//! Cameras for photographs that have none: structure from motion by programs of the user's machine.
//!
//! | step | program | result, in the folder of the dataset |
//! |---|---|---|
//! | [`Step::Pictures`] | ffmpeg, for a video | `images/`, `masks/` |
//! | [`Step::Features`] | COLMAP | `sfm/database.db` |
//! | [`Step::Matches`] | COLMAP | `sfm/database.db` |
//! | [`Step::Mapping`] | COLMAP or GLOMAP | `sfm/models/0`, `1`, … |
//! | [`Step::Model`] | | `sparse/0`, the model with the most photographs |
//!
//! The result is a COLMAP dataset as [`crate::dataset`] reads it, which undistorts the photographs if asked to.
//! `sfm/steps.json` says which steps are done, with what they depend on: [`reconstruct`] goes on where it was interrupted, and
//! repeats a step if that has changed. The output of a program is in `sfm/STEP.log`.

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

use serde_json::{Value, json};

pub use error::SfmError;
pub use input::{Input, is_begun};
pub use model::Outcome;
pub use options::{Options, SfmCamera, SfmMatching, SfmProgram};
pub use programs::Programs;
pub use step::{Observer, Step};
pub use unusable::{Unusable, unusable};

use crate::dataset::names::list;
use crate::dataset::strange_masks;
use commands::Colmap;
use options::name_of;
use workspace::Workspace;

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
    /// Replace a finished dataset where photographs or options have changed.
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

/// Makes a dataset of photographs, or goes on with it, or says what is in it if it is finished.
///
/// # Errors
/// [`SfmError`]: a missing program, a program that fails, a finished dataset that another request has made, photographs
/// that show too little in common.
pub fn reconstruct(request: &Request, observer: &mut dyn Observer) -> Result<Outcome, SfmError> {
    request.input.check()?;
    let mut reconstruction = Reconstruction { request, observer, colmap: None };
    let is_new = !is_begun(request.dataset);
    if is_new {
        reconstruction.check_programs(Step::ALL[0])?;
    }
    let mut workspace = Workspace::open(request.dataset)?;
    let Some(first) = reconstruction.first_to_do(&workspace)? else {
        return model::outcome(&workspace);
    };
    if workspace.is_finished() && !request.overwrite {
        return Err(SfmError::Changed { dataset: request.dataset.to_owned(), what: first.depends_on() });
    }
    let first = workspace.with_what_it_needs(first);
    if !is_new {
        reconstruction.check_programs(first)?;
    }
    for step in Step::ALL.into_iter().filter(|&step| step >= first) {
        let key = reconstruction.key(step, &workspace)?;
        let start = Instant::now();
        workspace.begin(step, key)?;
        reconstruction.observer.begin(step);
        reconstruction.run(step, &workspace)?;
        let seconds = start.elapsed().as_secs_f64();
        workspace.end(step, seconds)?;
        reconstruction.observer.end(step, seconds);
    }
    model::outcome(&workspace)
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
    observer: &'a mut dyn Observer,
    colmap: Option<Colmap>,
}

impl Reconstruction<'_> {
    /// The first step whose result is not there, or depends on what has changed since.
    fn first_to_do(&self, workspace: &Workspace) -> Result<Option<Step>, SfmError> {
        for step in Step::ALL {
            if !workspace.is_done(step, &self.key(step, workspace)?) {
                return Ok(Some(step));
            }
        }
        Ok(None)
    }

    /// The inputs of a step, besides the steps before it.
    fn key(&self, step: Step, workspace: &Workspace) -> Result<Value, SfmError> {
        let Request { input, options, .. } = self.request;
        Ok(match step {
            Step::Pictures => input.fingerprint(options.video_frames)?,
            Step::Features => {
                let one_camera = exif::have_one_camera(&workspace.pictures()?)?;
                let mut key = json!({ "camera": name_of(options.camera), "one_camera": one_camera });
                if options.invert_masks && !input.masks().is_empty() {
                    key["invert_masks"] = true.into();
                }
                key
            }
            Step::Matches => json!({ "matching": name_of(matching(options.matching, &workspace.picture_names()?)) }),
            Step::Mapping => json!({ "program": name_of(options.program) }),
            Step::Model => Value::Null,
        })
    }

    /// Whether the programs of `step` and of those after it are there: better now than after an hour.
    fn check_programs(&mut self, step: Step) -> Result<(), SfmError> {
        if step == Step::Pictures && matches!(self.request.input, Input::Video { .. }) {
            self.request.programs.ffmpeg()?;
        }
        if step <= Step::Mapping {
            self.colmap = Some(Colmap::find(self.request.programs, self.request.options.program)?);
        }
        Ok(())
    }

    fn run(&mut self, step: Step, workspace: &Workspace) -> Result<(), SfmError> {
        match step {
            Step::Pictures => self.pictures(workspace),
            Step::Features | Step::Matches | Step::Mapping => self.colmap(step, workspace),
            Step::Model => model::take_largest(workspace),
        }
    }

    fn pictures(&mut self, workspace: &Workspace) -> Result<(), SfmError> {
        let (path, folder, names, unread, masks) = match self.request.input {
            Input::Photographs { path, folder, names, unread, masks } => (path, folder, names, unread, masks),
            Input::Video { path } => {
                let ffmpeg = self.request.programs.ffmpeg()?;
                return frames::extract(&ffmpeg, path, self.request.options.video_frames, workspace, self.observer);
            }
        };
        if !unread.is_empty() {
            self.observer.warn(&format!(
                "left out, for only JPEG and PNG are read: {}; convert them to JPEG to use them",
                list(unread)
            ));
        }
        let folder_of_masks = path.join(input::MASKS);
        if !masks.is_empty() {
            let kept = workspace.copy_masks(masks)?;
            if !kept.is_empty() {
                self.observer.warn(&format!(
                    "{} has masks that were made by hand, which stay as they are, also where the photographs have others: \
                     {}; remove those that are not wanted",
                    workspace.masks.display(),
                    list(&kept)
                ));
            }
        } else if folder_of_masks.is_dir() {
            self.observer.warn(&strange_masks(&folder_of_masks));
        }
        workspace.link_pictures(folder, names)
    }

    /// The folder of the masks as COLMAP reads them; `None` without any.
    fn masks(&self, workspace: &Workspace) -> Result<Option<PathBuf>, SfmError> {
        let masks = self.request.input.masks();
        if masks.is_empty() {
            return Ok(None);
        }
        let (part, place) = (workspace.empty_folder("masks.part")?, workspace.work(input::MASKS));
        masks::write(masks, &workspace.images, self.request.options.invert_masks, &part)?;
        workspace::replace(&part, &place)?;
        Ok(Some(place))
    }

    /// One of the steps that are COLMAP's, on a GPU if it has been built for it. If that fails, then on the CPU.
    fn colmap(&mut self, step: Step, workspace: &Workspace) -> Result<(), SfmError> {
        let (names, options, log) = (workspace.picture_names()?, self.request.options, workspace.log(step));
        let one_camera = exif::have_one_camera(&workspace.pictures()?)?;
        let matching = matching(options.matching, &names);
        let masks = if step == Step::Features { self.masks(workspace)? } else { None };
        let colmap = self.colmap.as_ref().expect("it is looked for before the first of its steps");
        let mut attempt = |gpu: bool| {
            let command = match step {
                Step::Features => colmap.features(workspace, options, one_camera, masks.as_deref(), gpu),
                Step::Matches => colmap.matches(workspace, options, matching, names.len(), gpu),
                _ => colmap.mapping(workspace, options),
            };
            programs::run(step, command, &log, &mut |line| {
                if let Some((done, total)) = commands::progress(line, names.len()) {
                    self.observer.progress(step, done, total);
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

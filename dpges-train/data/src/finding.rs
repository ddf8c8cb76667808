//! Faults of a dataset, in words.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::names::list_up_to;

/// Names in a sentence before the rest is counted.
const NAMED: usize = 3;

/// A possible problem of a dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A camera is far from all others: structure from motion has probably put it in the wrong place.
    FarPose,
    /// The points of a view are not where its photograph shows them.
    OffPose,
    /// Focal lengths or principal points are rare.
    Intrinsics,
    NoPoints,
    FewPoints,
    /// Points are not where photographs show what they say.
    RandomPoints,
    Blurred,
    /// A view is brighter or darker than most.
    Exposure,
    /// Views differ in brightness throughout.
    ExposureSpread,
    /// A photograph shows what another one shows, from the same place.
    Duplicate,
    /// All cameras stand at one point.
    OnePlace,
    /// A photograph is not the one whose camera the view has.
    OtherPhotograph,
    /// A picture has one colour.
    Plain,
    /// A picture is far smaller than the others.
    Small,
    /// No point explains much of what pictures show.
    Unexplained,
    FewViews,
    /// Something lies in the folder that should be used, and is not.
    Unused,
    /// Something is named and is not there, or is no good.
    Missing,
    /// Something was changed to be of use.
    Changed,
    /// The pixels of photographs may be turned.
    Orientation,
    /// Something lies in the folder that is not used and does no harm.
    Aside,
}

/// Something that is wrong, and what to do about it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    pub kind: Kind,
    /// Names of the views that it is about, from the worst; none if it is about all of them.
    pub views: Vec<String>,
    pub message: String,
    pub advice: &'static str,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}; {}", self.message, self.advice)
    }
}

/// Missing parts and unused files of a dataset, in the order in which they were found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notices(pub Vec<Finding>);

impl Notices {
    pub fn add(&mut self, kind: Kind, message: String, advice: &'static str) {
        self.0.push(Finding { kind, views: Vec::new(), message, advice });
    }

    /// Adds a sentence about `what`, their number and the first of their `names`, unless there are none.
    pub fn add_names(&mut self, kind: Kind, what: &str, names: &[impl AsRef<str>], advice: &'static str) {
        if !names.is_empty() {
            self.add(kind, format!("{what} ({}): {}", names.len(), list_up_to(NAMED, names)), advice);
        }
    }

    /// The same about `files` below `root`.
    pub fn add_files(&mut self, kind: Kind, what: &str, root: &Path, files: &[PathBuf], advice: &'static str) {
        let shown = |file: &PathBuf| file.strip_prefix(root).unwrap_or(file).display().to_string();
        self.add_names(kind, what, &files.iter().map(shown).collect::<Vec<_>>(), advice);
    }
}

//! The steps, and who hears of them.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The steps of structure from motion, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Step {
    /// The photographs, or the frames of the video.
    Pictures,
    /// Conspicuous places in each photograph.
    Features,
    /// Features that two photographs share.
    Matches,
    /// Where they were taken from.
    Mapping,
    /// The largest of the models that came out.
    Model,
}

impl Step {
    pub const ALL: [Self; 5] = [Self::Pictures, Self::Features, Self::Matches, Self::Mapping, Self::Model];

    /// Its name, also that of its log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pictures => "pictures",
            Self::Features => "features",
            Self::Matches => "matches",
            Self::Mapping => "mapping",
            Self::Model => "model",
        }
    }

    /// The options that its result depends on, besides the steps before it.
    pub(super) fn depends_on(self) -> &'static str {
        match self {
            Self::Pictures => "the photographs or their masks",
            Self::Features => "the camera model (`--sfm-camera`) or what masks mean (`data.invert_masks`)",
            Self::Matches => "the pairs that are compared (`--sfm-matching`)",
            Self::Mapping => "the program (`--sfm`)",
            Self::Model => "the models",
        }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Hears of what [`reconstruct`](super::reconstruct) does. Steps that are already done are not mentioned.
pub trait Observer {
    /// A step begins or goes on.
    fn begin(&mut self, _step: Step) {}
    /// `done` of `total` photographs, pairs or frames.
    fn progress(&mut self, _step: Step, _done: usize, _total: usize) {}
    /// A step is done.
    fn end(&mut self, _step: Step, _seconds: f64) {}
    /// Something is not as it should be, and it goes on.
    fn warn(&mut self, _message: &str) {}
}

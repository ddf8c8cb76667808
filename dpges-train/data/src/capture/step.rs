//! The steps, and who hears of them.

use std::fmt;

/// The steps of structure from motion, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The photographs, or the frames of the video.
    Pictures,
    /// Conspicuous places in each photograph.
    Features,
    /// Features that two photographs share.
    Matches,
    /// Where they were taken from.
    Mapping,
}

impl Step {
    /// Its name, also that of its log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pictures => "pictures",
            Self::Features => "features",
            Self::Matches => "matches",
            Self::Mapping => "mapping",
        }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Hears of what [`reconstruct`](super::reconstruct) does.
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

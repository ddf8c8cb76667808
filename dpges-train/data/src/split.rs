//! The sets that the views of a dataset are in.

use std::fmt;

use clap::ValueEnum;
use serde::Serialize;

use super::{Dataset, View};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Views held out from training
    Test,
    /// Views trained on
    Train,
    /// Views that the run kept from training for its decisions
    Validation,
}

impl Split {
    /// Its views of `dataset`.
    pub fn of(self, dataset: &Dataset) -> &[View] {
        match self {
            Self::Test => &dataset.test,
            Self::Train => &dataset.train,
            Self::Validation => &dataset.validation,
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Test => "test",
            Self::Train => "train",
            Self::Validation => "validation",
        })
    }
}

//! Corrections of the training views that a run has learnt, beside the scene.

use std::collections::BTreeMap;

use crate::views::exposure::Correction;
use crate::views::pose::RefinedPoses;

/// Corrections of training views by their names, at one moment of a run: they belong to the scene of that moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewCorrections {
    /// `None` if photographs are taken as they are.
    pub exposure: Option<BTreeMap<String, Correction>>,
    /// `None` if cameras are where they were recorded.
    pub poses: Option<RefinedPoses>,
}

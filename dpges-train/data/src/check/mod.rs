//! Whether a dataset will do: what it consists of, and which of its views will harm the result.
//!
//! | module | content |
//! |---|---|
//! | [`facts`] | what is known of each view, from its camera, its points and its pixels |
//! | [`findings`] | what is wrong: poses, points, sharpness, brightness, duplicates |
//! | [`summary`], [`sheet`], [`map`] | the same in words and in pictures |
//!
//! Pixels that do not count have no part in any of it.

pub mod facts;
pub mod findings;
pub mod luma;
pub mod map;
mod points;
pub mod sheet;
mod statistics;
pub mod summary;
#[cfg(test)]
mod tests;

use serde::Serialize;

pub use crate::finding::{Finding, Kind};
pub use facts::ViewFacts;
pub use statistics::Range;
pub(crate) use statistics::median;

use crate::Dataset;

/// Points that are projected into views at most.
const MOST_POINTS: usize = 100_000;
/// Pixels of all views together up to which a quick check looks at them.
const QUICK_PIXELS: usize = 600_000_000;

/// How thoroughly a dataset is checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// In seconds: of very large datasets poses and points only.
    Quick,
    /// All, however long it takes.
    Full,
}

/// The content of a dataset, and its problems.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Training, then held-out, then validation views, each by name.
    pub views: Vec<ViewFacts>,
    pub points: usize,
    /// Mean number of views that saw a point; `None` if the dataset does not say.
    pub views_per_point: Option<f64>,
    /// From most to least important.
    pub findings: Vec<Finding>,
    /// Files that are not used and do no harm.
    pub notes: Vec<Finding>,
}

impl Report {
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if a photograph cannot be read again.
    pub fn of(dataset: &Dataset, effort: Effort) -> dpges_core::Result<Self> {
        let views = facts::facts(dataset, effort)?;
        let seen: usize = dataset.points.seen_by.iter().map(<[u32]>::len).sum();
        let points = dataset.points.positions.len();
        let found = dataset.notices.0.iter().cloned().chain(findings::findings(&views, dataset));
        let (notes, findings) = found.partition(|finding| finding.kind == Kind::Aside);
        let views_per_point = (seen > 0).then(|| seen as f64 / points as f64);
        Ok(Self { views, points, views_per_point, findings, notes })
    }

    /// Whether a finding names the view.
    pub fn is_flagged(&self, view: &str) -> bool {
        self.findings.iter().any(|finding| finding.views.iter().any(|name| name == view))
    }

    /// Median, 5th and 95th percentile of a number over the views that have it.
    pub fn range(&self, of: impl Fn(&ViewFacts) -> Option<f64>) -> Option<Range> {
        Range::of(self.views.iter().filter_map(of))
    }
}

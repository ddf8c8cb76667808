//! Problems of a dataset, in words.

use std::fmt;

use serde::Serialize;

use super::view::{Role, ViewFacts};
use crate::dataset::names::list;

/// Fewest training views that are no reason to say so.
const FEW_VIEWS: usize = 10;

/// A possible problem of a dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A camera is far from all others.
    FarPose,
    /// No point is seen.
    NoPoints,
    /// Few points are seen.
    FewPoints,
    Blurred,
    /// A view is brighter or darker than most.
    Exposure,
    /// Views differ in brightness throughout.
    ExposureSpread,
    /// A photograph shows what another one shows, from the same place.
    Duplicate,
    /// No point explains much of what pictures show.
    Unexplained,
    /// There are few training views.
    FewViews,
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

impl Finding {
    /// About `views`, whose names follow `what`, each with its `note`; `None` without views.
    pub(super) fn of_views(
        kind: Kind,
        views: &[&ViewFacts],
        what: [&str; 2],
        note: impl Fn(&ViewFacts) -> String,
        advice: &'static str,
    ) -> Option<Self> {
        let names: Vec<String> = views.iter().map(|view| view.name.clone()).collect();
        let notes: Vec<String> = views.iter().map(|view| format!("{}{}", view.name, note(view))).collect();
        let [one, several] = what;
        let count = match views.len() {
            0 => return None,
            1 => one.to_owned(),
            more => format!("{more} {several}"),
        };
        Some(Self { kind, views: names, message: format!("{count}: {}", list(&notes)), advice })
    }
}

pub(super) fn few_views(views: &[ViewFacts]) -> Option<Finding> {
    let count = views.iter().filter(|view| view.role == Role::Train).count();
    (count < FEW_VIEWS).then(|| Finding {
        kind: Kind::FewViews,
        views: Vec::new(),
        message: format!("there are only {count} training views"),
        advice: "expect good pictures near them only; more photographs help, and holding out fewer (--test-every)",
    })
}

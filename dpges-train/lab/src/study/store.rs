//! The rows of a study, and what they have in common: the content of its JSON.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use dpges_core::scene::atomic::write_atomically;
use dpges_train::run::folder::write_json;
use dpges_train::run::hash::Hash;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::frontier::frontier;
use super::measure::{MEASURES, Measure};
use super::row::{Group, Row, groups};
use super::{Result, StudyError};

/// Properties in which one study differs from another.
#[derive(Debug)]
pub struct Shape {
    /// Of its files, such as `NAME.json`.
    pub name: &'static str,
    pub title: &'static str,
    /// Name of a line of its table.
    pub line: &'static str,
    /// Whether the printed table leaves out what is on no frontier.
    pub frontier_alone: bool,
}

/// A picture that belongs to the whole study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// Relative to the folder of the study.
    pub file: String,
    pub caption: String,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Content {
    /// The subject that all rows share; rows of another subject cannot be compared with them.
    #[serde(flatten)]
    pub subject: Map<String, Value>,
    /// In the order in which they were measured.
    pub rows: Vec<Row>,
    /// Labels of what the time was too short for.
    pub not_run: Vec<String>,
    /// By the measure of a cost: labels of the rows that no other beats, by ascending cost. With several seeds the means count.
    pub frontiers: BTreeMap<String, Vec<String>>,
    pub figures: Vec<Figure>,
    /// Sentences below the table.
    pub notes: Vec<String>,
}

impl Content {
    /// The seeds of the rows, ascending.
    pub fn seeds(&self) -> Vec<String> {
        let seeds: BTreeSet<u64> = self.rows.iter().filter_map(|row| row.seed).collect();
        seeds.iter().map(u64::to_string).collect()
    }
}

/// A study in a folder.
#[derive(Debug)]
pub struct Study {
    pub shape: &'static Shape,
    pub folder: PathBuf,
    pub content: Content,
}

impl Study {
    /// Without rows.
    pub fn new(shape: &'static Shape, folder: &Path, subject: Map<String, Value>) -> Self {
        Self { shape, folder: folder.to_owned(), content: Content { subject, ..Content::default() } }
    }

    /// The rows that are in `folder` so far, of which there are none if it does not hold the JSON.
    ///
    /// # Errors
    /// [`StudyError::OtherRows`] if they are of another subject, or cannot be read.
    pub fn open(shape: &'static Shape, folder: &Path, subject: Map<String, Value>) -> Result<Self> {
        let mut study = Self::new(shape, folder, subject);
        let path = study.path();
        let other = |reason: String| StudyError::OtherRows { path: path.clone(), reason };
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(study),
            Err(error) => return Err(other(error.to_string())),
        };
        let found: Content = serde_json::from_str(&text).map_err(|error| other(error.to_string()))?;
        let (found_subject, asked) = (&found.subject, &study.content.subject);
        let differences: Vec<String> = asked
            .iter()
            .filter(|(key, value)| found_subject.get(*key) != Some(value))
            .map(|(key, value)| {
                let found = found_subject.get(key).unwrap_or(&Value::Null);
                format!("`{key}` is {found}, not {value}")
            })
            .collect();
        if !differences.is_empty() {
            return Err(other(differences.join(", ")));
        }
        study.content.rows = found.rows;
        Ok(study)
    }

    pub fn has(&self, label: &str, seed: Option<u64>) -> bool {
        self.content.rows.iter().any(|row| row.label == label && row.seed == seed)
    }

    /// Adds a row to the file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn add(&mut self, row: Row) -> Result<()> {
        self.content.rows.push(row);
        self.save()
    }

    /// Puts `row` in the place of that of the same label, scene and seed, or behind all others.
    pub fn replace(&mut self, row: Row) {
        let is_it = |other: &Row| (&other.label, &other.scene, other.seed) == (&row.label, &row.scene, row.seed);
        match self.content.rows.iter().position(is_it) {
            Some(at) => self.content.rows[at] = row,
            None => self.content.rows.push(row),
        }
    }

    /// Notes that there was no time for a row.
    pub fn leave_out(&mut self, label: &str, seed: Option<u64>) {
        let seed = seed.map(|seed| format!(", seed {seed}")).unwrap_or_default();
        self.content.not_run.push(format!("{label}{seed}"));
    }

    /// Completes the file.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn finish(&mut self) -> Result<()> {
        let groups = groups(&self.content.rows);
        let labels = |cost: &Measure| {
            let labels = on_frontier(&groups, cost.key).into_iter().map(|index| groups[index].label.to_owned());
            (cost.key.to_owned(), labels.collect::<Vec<_>>())
        };
        let costs = MEASURES.iter().filter(|measure| measure.plot.is_some());
        self.content.frontiers = costs.map(labels).filter(|(_, labels)| !labels.is_empty()).collect();
        self.save()
    }

    /// Of the JSON.
    pub fn path(&self) -> PathBuf {
        self.folder.join(format!("{}.json", self.shape.name))
    }

    /// Whether a label is on a frontier.
    pub fn is_best(&self, label: &str) -> bool {
        self.content.frontiers.values().flatten().any(|best| best == label)
    }

    /// # Errors
    /// If it cannot be written.
    pub fn save(&self) -> Result<()> {
        Ok(write_json(&self.path(), &self.content)?)
    }
}

/// Indices of the groups that no other beats, by ascending cost, of those that have the measure `cost`.
pub fn on_frontier(groups: &[Group], cost: &str) -> Vec<usize> {
    let pair = |group: &Group| Some((group.spread(cost)?.mean, group.spread("psnr")?.mean));
    let (known, pairs): (Vec<usize>, Vec<(f64, f64)>) =
        groups.iter().enumerate().filter_map(|(index, group)| Some((index, pair(group)?))).unzip();
    frontier(&pairs).into_iter().map(|index| known[index]).collect()
}

/// FNV-1a of `bytes`, as text: tells one scene file from another.
pub fn checksum(bytes: &[u8]) -> String {
    format!("{:016x}", Hash::of(bytes))
}

/// Writes texts into `folder`, each whole or not at all, by the names of their files. Returns the paths, one a line.
pub fn write_texts<const N: usize>(folder: &Path, files: [(&str, String); N]) -> Result<String> {
    let mut paths = String::new();
    for (name, text) in files {
        let path = folder.join(name);
        write_atomically(&path, |file| file.write_all(text.as_bytes()))?;
        _ = writeln!(paths, "{}", path.display());
    }
    Ok(paths)
}

#[cfg(test)]
pub mod tests {
    use serde_json::json;

    use super::super::row::tests::drawn;
    use super::super::trade::SHAPE;
    use super::*;

    pub fn subject() -> Map<String, Value> {
        let subject = json!({ "dataset": "builtin", "rounds": 2, "device": "<an adapter> & \"more\"" });
        subject.as_object().unwrap().clone()
    }

    #[test]
    fn rows_are_kept_and_those_of_another_subject_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut study = Study::open(&SHAPE, folder.path(), subject()).unwrap();
        study.add(drawn("as trained", 30.0, 2.0, 100)).unwrap();
        study.add(drawn("layers=1", 31.0, 1.0, 100)).unwrap();
        study.add(drawn("detail=0", 29.0, 3.0, 50)).unwrap();
        study.leave_out("budget-half", Some(3));
        study.finish().unwrap();
        let written = std::fs::read_to_string(study.path()).unwrap();
        assert!(written.contains("budget-half, seed 3"), "{written}");
        let frontiers = json!({ "frame_ms": ["layers=1"], "bytes": ["detail=0", "layers=1"] });
        assert_eq!(serde_json::from_str::<Value>(&written).unwrap()["frontiers"], frontiers);
        let again = Study::open(&SHAPE, folder.path(), subject()).unwrap();
        assert_eq!(again.content.rows, study.content.rows);
        assert!(again.has("layers=1", None) && !again.has("layers=1", Some(0)) && !again.has("layers=2", None));
        assert!(again.content.not_run.is_empty(), "it is asked for again");

        let refused = |key: &str, value: Value| {
            let mut other = subject();
            other.insert(key.to_owned(), value);
            Study::open(&SHAPE, folder.path(), other).unwrap_err().to_string()
        };
        assert!(refused("rounds", json!(3)).contains("`rounds` is 2, not 3"));
        assert!(refused("dataset", json!("/a")).contains("`dataset` is \"builtin\", not \"/a\""));
        std::fs::write(again.path(), "{").unwrap();
        assert!(refused("rounds", json!(2)).contains("trade.json"));
    }

    #[test]
    fn seeds_of_a_label_are_one_point_of_the_frontier() {
        let seeded = |label: &str, seed: u64, psnr: f64, seconds: f64| {
            let mut row = drawn(label, psnr, 1.0, 10);
            row.seed = Some(seed);
            row.set("training_seconds", Some(seconds));
            row
        };
        // means 29 dB in 10 s, 28 dB in 20 s, 30 dB in 30 s; the last has no time
        let rows = [
            seeded("a", 0, 28.0, 8.0),
            seeded("b", 0, 28.0, 20.0),
            seeded("a", 1, 30.0, 12.0),
            seeded("c", 0, 30.0, 30.0),
            drawn("d", 40.0, 1.0, 10),
        ];
        assert_eq!(on_frontier(&groups(&rows), "training_seconds"), [0, 2]);
    }

    #[test]
    fn checksums_are_those_of_the_published_algorithm() {
        assert_eq!(checksum(b""), "cbf29ce484222325");
        assert_eq!(checksum(b"a"), "af63dc4c8601ec8c");
    }
}

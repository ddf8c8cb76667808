//! `trade.json`: what is measured, of what, and every point so far. It is written anew after every point, and the same
//! command goes on with it.

use std::path::{Path, PathBuf};

use dpges_train::run::folder::write_json;
use serde::{Deserialize, Serialize};

use super::pareto::frontier;
use super::point::Point;
use crate::cli::{Failure, Result};

const FILE: &str = "trade.json";

/// What all points have in common. Points of another one cannot be compared with them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    /// Absolute path of the scene file.
    pub scene: String,
    /// Of its content.
    pub scene_checksum: String,
    /// Folder of the dataset, or `builtin`.
    pub dataset: String,
    /// `test` or `train`.
    pub split: String,
    /// Names of the views that pictures are compared with.
    pub views: Vec<String>,
    /// Of these, px.
    pub view_size: [usize; 2],
    /// Of the frames that are timed, px.
    pub frame_size: [usize; 2],
    /// Counted rounds over the views.
    pub rounds: usize,
    /// What draws pictures and frames.
    pub device: String,
}

/// The content of `trade.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trade {
    #[serde(flatten)]
    pub subject: Subject,
    /// In the order in which they were measured.
    pub points: Vec<Point>,
    /// Labels of what the time was too short for.
    pub not_run: Vec<String>,
    /// Labels of the points that no other beats, by ascending cost.
    pub frontiers: Frontiers,
}

/// PSNR against each of these. With several seeds the means count.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Frontiers {
    pub frame_ms: Vec<String>,
    pub bytes: Vec<String>,
    pub training_seconds: Vec<String>,
    pub training_peak_bytes: Vec<String>,
}

/// The points of a folder.
pub struct Store {
    path: PathBuf,
    pub trade: Trade,
}

impl Store {
    /// The points in `folder` so far, of which there are none if it holds no `trade.json`.
    ///
    /// # Errors
    /// If its points are of another subject, or cannot be read.
    pub fn open(folder: &Path, subject: Subject) -> Result<Self> {
        let path = folder.join(FILE);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                let trade = Trade { subject, points: Vec::new(), not_run: Vec::new(), frontiers: Frontiers::default() };
                return Ok(Self { path, trade });
            }
            Err(error) => return Err(other(&path, &error.to_string())),
        };
        let trade: Trade = serde_json::from_str(&text).map_err(|error| other(&path, &error.to_string()))?;
        let differences = differences(&trade.subject, &subject)?;
        if differences.is_empty() { Ok(Self { path, trade }) } else { Err(other(&path, &differences.join(", "))) }
    }

    pub fn has(&self, label: &str, seed: Option<u64>) -> bool {
        self.trade.points.iter().any(|point| point.label == label && point.seed == seed)
    }

    /// Adds a point to the file.
    pub fn add(&mut self, point: Point) -> Result<()> {
        self.trade.points.push(point);
        self.save()
    }

    /// Says in the file what could not be measured, and which points are on frontiers.
    pub fn finish(&mut self, not_run: Vec<String>) -> Result<()> {
        self.trade.not_run = not_run;
        self.trade.frontiers = Frontiers {
            frame_ms: labels(&self.trade.points, |point| Some(point.frame_ms)),
            bytes: labels(&self.trade.points, |point| Some(point.bytes as f64)),
            training_seconds: labels(&self.trade.points, |point| point.training_seconds),
            training_peak_bytes: labels(&self.trade.points, |point| {
                point.training_peak_bytes.map(|bytes| bytes as f64)
            }),
        };
        self.save()
    }

    fn save(&self) -> Result<()> {
        Ok(write_json(&self.path, &self.trade)?)
    }
}

/// The points of one label: one, or one for each seed.
pub struct Group<'a> {
    pub label: &'a str,
    pub points: Vec<&'a Point>,
}

impl Group<'_> {
    /// Mean over the points.
    pub fn mean(&self, of: impl Fn(&Point) -> f64) -> f64 {
        self.points.iter().map(|point| of(point)).sum::<f64>() / self.points.len() as f64
    }
}

/// `points` by their labels, in the order in which these occur.
pub fn groups(points: &[Point]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for point in points {
        match groups.iter_mut().find(|group| group.label == point.label) {
            Some(group) => group.points.push(point),
            None => groups.push(Group { label: &point.label, points: vec![point] }),
        }
    }
    groups
}

/// Labels on the frontier of the mean PSNR against the mean of `cost`, of the points that have one.
fn labels(points: &[Point], cost: impl Fn(&Point) -> Option<f64>) -> Vec<String> {
    let groups = groups(points);
    let of_group = |group: &Group| {
        let costs: Option<Vec<f64>> = group.points.iter().map(|point| cost(point)).collect();
        let costs = costs?;
        Some((group.label.to_owned(), (costs.iter().sum::<f64>() / costs.len() as f64, group.mean(|point| point.psnr))))
    };
    let known: Vec<(String, (f64, f64))> = groups.iter().filter_map(of_group).collect();
    let pairs: Vec<(f64, f64)> = known.iter().map(|(_, pair)| *pair).collect();
    let found = frontier(&pairs).unwrap_or_else(|error| {
        tracing::warn!("there is no frontier: {error}");
        Vec::new()
    });
    found.into_iter().map(|index| known[index].0.clone()).collect()
}

/// Says for each key in which `asked` is not `found` what the two are.
fn differences(found: &Subject, asked: &Subject) -> Result<Vec<String>> {
    let [found, asked] = [serde_json::to_value(found)?, serde_json::to_value(asked)?];
    let keys = found.as_object().into_iter().flatten();
    let different = keys.filter(|(key, value)| asked[key] != **value);
    Ok(different.map(|(key, value)| format!("`{key}` is {value}, not {}", asked[key])).collect())
}

fn other(path: &Path, reason: &str) -> Failure {
    let message = format!("{} holds other measurements: {reason}", path.display());
    Failure::with_help(message, "choose another --out, or remove that file")
}

/// FNV-1a of `bytes`, as text: tells one scene file from another.
pub fn checksum(bytes: &[u8]) -> String {
    let hash = bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325u64, |hash, &byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    format!("{hash:016x}")
}

#[cfg(test)]
pub mod tests {
    use super::super::point::tests::point;
    use super::*;

    pub fn subject() -> Subject {
        Subject {
            scene: "/runs/a/scene.safetensors".to_owned(),
            scene_checksum: checksum(b"a"),
            dataset: "builtin".to_owned(),
            split: "test".to_owned(),
            views: vec!["test_000".to_owned()],
            view_size: [32, 32],
            frame_size: [64, 36],
            rounds: 2,
            device: "<an adapter> & \"more\"".to_owned(),
        }
    }

    #[test]
    fn points_are_kept_and_those_of_another_subject_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(folder.path(), subject()).unwrap();
        store.add(point("as trained", 30.0, 2.0, 100)).unwrap();
        store.add(point("layers=1", 31.0, 1.0, 100)).unwrap();
        store.add(point("detail=0", 29.0, 3.0, 50)).unwrap();
        store.finish(vec!["budget=half".to_owned()]).unwrap();
        let again = Store::open(folder.path(), subject()).unwrap();
        assert_eq!(again.trade.points, store.trade.points);
        assert!(again.has("layers=1", None) && !again.has("layers=1", Some(0)) && !again.has("layers=2", None));
        assert_eq!(again.trade.not_run, ["budget=half"]);
        let Frontiers { frame_ms, bytes, training_seconds, .. } = &again.trade.frontiers;
        assert_eq!(
            (&frame_ms[..], &bytes[..]),
            (&["layers=1".to_owned()][..], &["detail=0", "layers=1"].map(str::to_owned)[..])
        );
        assert!(training_seconds.is_empty());

        let refused = |subject: Subject| match Store::open(folder.path(), subject) {
            Err(Failure::Failed(report)) => report.to_string(),
            _ => panic!("not refused"),
        };
        let message = refused(Subject { dataset: "/data/garden".to_owned(), rounds: 3, ..subject() });
        assert!(
            message.contains("`dataset` is \"builtin\", not \"/data/garden\"")
                && message.contains("`rounds` is 2, not 3")
        );
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        assert!(refused(subject()).contains("trade.json"));
    }

    #[test]
    fn seeds_of_a_label_are_one_point_of_the_frontier() {
        let seeded = |label: &str, seed: u64, psnr: f64, seconds: f64| {
            let mut point = point(label, psnr, 1.0, 10);
            (point.seed, point.training_seconds) = (Some(seed), Some(seconds));
            point
        };
        // means 29 dB in 10 s, 28 dB in 20 s, 30 dB in 30 s; the last has no time
        let points = [
            seeded("a", 0, 28.0, 8.0),
            seeded("b", 0, 28.0, 20.0),
            seeded("a", 1, 30.0, 12.0),
            seeded("c", 0, 30.0, 30.0),
            point("d", 40.0, 1.0, 10),
        ];
        assert_eq!(labels(&points, |point| point.training_seconds), ["a", "c"]);
        assert_eq!(groups(&points).iter().map(|group| group.points.len()).collect::<Vec<_>>(), [2, 1, 1, 1]);
    }

    #[test]
    fn checksums_are_those_of_the_published_algorithm() {
        assert_eq!(checksum(b""), "cbf29ce484222325");
        assert_eq!(checksum(b"a"), "af63dc4c8601ec8c");
    }
}

//! Measures of one scene, and rows of the same label.

use std::collections::BTreeMap;

use dpges_train::metrics::{METRICS, Scores};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use super::measure::measure;
use super::spread::Spread;

/// A scene, drawn in one way: an entry of `rows` in the JSON of a study.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Of its variant; unique but for the seed.
    pub label: String,
    /// Of the run that made it; `None` for a scene that was there.
    pub seed: Option<u64>,
    /// Of several scenes, the one that was trained: `DATASET/SCENE`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// The device that it was trained on, if rows may differ in that.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// The changes, as `name=value`.
    pub settings: Vec<String>,
    /// The run that made it, relative to the folder of the study.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<String>,
    /// One view, relative to the folder of the study.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub picture: Option<String>,
    /// Finite numbers by the keys of measures.
    #[serde(flatten, serialize_with = "numbers")]
    values: BTreeMap<String, f64>,
}

impl Row {
    pub fn new(label: &str, seed: Option<u64>) -> Self {
        Self { label: label.to_owned(), seed, ..Self::default() }
    }

    /// The value of the measure `key`; `None` if it is unknown.
    pub fn get(&self, key: &str) -> Option<f64> {
        self.values.get(measure(key).key).copied()
    }

    /// Sets the measure `key` if `value` is known and finite.
    pub fn set(&mut self, key: &str, value: Option<f64>) {
        if let Some(value) = value.filter(|value| value.is_finite()) {
            self.values.insert(measure(key).key.to_owned(), value);
        }
    }

    pub fn set_scores(&mut self, scores: &Scores) {
        for metric in &METRICS {
            self.set(metric.key, metric.of(scores));
        }
    }

    /// Sets the numbers of primitives.
    pub fn set_counts(&mut self, surfels: usize, gaussians: usize) {
        let counts = [("surfels", surfels), ("gaussians", gaussians), ("primitives", surfels + gaussians)];
        counts.into_iter().for_each(|(key, count)| self.set(key, Some(count as f64)));
    }
}

fn numbers<S: Serializer>(values: &BTreeMap<String, f64>, serializer: S) -> Result<S::Ok, S::Error> {
    let number = |(key, &value): (&String, &f64)| {
        let number = if measure(key).is_whole() { Value::from(value as u64) } else { Value::from(value) };
        (key.clone(), number)
    };
    serializer.collect_map(values.iter().map(number))
}

/// The rows of one label: one, or one for each seed.
#[derive(Clone, Debug)]
pub struct Group<'a> {
    pub label: &'a str,
    pub rows: Vec<&'a Row>,
}

/// `rows` by their labels, in the order in which these occur.
pub fn groups(rows: &[Row]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for row in rows {
        match groups.iter_mut().find(|group| group.label == row.label) {
            Some(group) => group.rows.push(row),
            None => groups.push(Group { label: &row.label, rows: vec![row] }),
        }
    }
    groups
}

impl Group<'_> {
    /// Mean and deviation over the rows; `None` if one does not have the measure.
    pub fn spread(&self, key: &str) -> Option<Spread> {
        let values: Option<Vec<f64>> = self.rows.iter().map(|row| row.get(key)).collect();
        values.map(|values| Spread::of(&values))
    }

    /// Mean and deviation of the difference to `base`, seed by seed, so that what both have in common by chance cancels. A
    /// base without seeds is subtracted from every row. `None` if a number is unknown.
    pub fn difference(&self, base: &Self, key: &str) -> Option<Spread> {
        let of_base = |seed: Option<u64>| base.rows.iter().find(|row| row.seed.is_none() || row.seed == seed)?.get(key);
        let differences = self.rows.iter().map(|row| Some(row.get(key)? - of_base(row.seed)?));
        differences.collect::<Option<Vec<f64>>>().map(|differences| Spread::of(&differences))
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Rows of seeds 0, 1, …, with a PSNR for each.
    pub fn seeded(label: &str, psnr: &[f64]) -> Vec<Row> {
        let row = |(seed, &psnr): (usize, &f64)| {
            let mut row = Row::new(label, Some(seed as u64));
            row.set("psnr", Some(psnr));
            row.set("ssim", Some(0.75));
            row.set_counts(12, 345 + 2 * seed);
            row.set("bytes", Some(6_700_000.0));
            row.set("training_seconds", Some(89.04));
            row
        };
        psnr.iter().enumerate().map(row).collect()
    }

    /// A row without a run.
    pub fn drawn(label: &str, psnr: f64, frame_ms: f64, bytes: u64) -> Row {
        let mut row = Row::new(label, None);
        row.settings = label.split(" + ").filter(|part| part.contains('=')).map(str::to_owned).collect();
        row.set("psnr", Some(psnr));
        row.set("frame_ms", Some(frame_ms));
        row.set("bytes", Some(bytes as f64));
        row
    }

    #[test]
    fn what_is_written_is_read_back_and_whole_numbers_are_whole() {
        let mut row = drawn("layers=1 + detail=0", 30.25, 1.5, 7);
        row.folder = Some("runs/a".to_owned());
        row.set("gpu_bytes", None);
        row.set("flip", Some(f64::NAN));
        let text = serde_json::to_string(&row).unwrap();
        for part in ["\"bytes\":7,", "\"psnr\":30.25", "\"settings\":[\"layers=1\",\"detail=0\"]", "\"seed\":null"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("picture") && !text.contains("gpu_bytes") && !text.contains("flip"), "{text}");
        assert_eq!(serde_json::from_str::<Row>(&text).unwrap(), row);
        assert_eq!((row.get("flip"), row.get("bytes")), (None, Some(7.0)));
    }

    #[test]
    fn groups_have_what_all_their_rows_have() {
        let mut rows = [seeded("a", &[20.0, 30.0]), seeded("b", &[21.0, 33.0])].concat();
        rows[0].set("flip", Some(0.5));
        let found = groups(&rows);
        assert_eq!(found.iter().map(|group| (group.label, group.rows.len())).collect::<Vec<_>>(), [("a", 2), ("b", 2)]);
        assert_eq!((found[0].spread("psnr").unwrap().mean, found[0].spread("flip")), (25.0, None));
        // 1 and 3
        let difference = found[1].difference(&found[0], "psnr").unwrap();
        assert_eq!((difference.mean, difference.deviation), (2.0, Some(2f64.sqrt())));
        let (as_trained, of_another) = (drawn("as trained", 19.0, 1.0, 1), seeded("c", &[20.0]));
        let base = Group { label: "as trained", rows: vec![&as_trained] };
        assert_eq!(found[0].difference(&base, "psnr").unwrap().mean, 6.0);
        let one_seed = Group { label: "c", rows: of_another.iter().collect() };
        assert_eq!(found[0].difference(&one_seed, "psnr"), None, "seed 1 is not there");
    }
}

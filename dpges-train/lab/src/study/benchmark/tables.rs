//! The tables of the paper with what was found beside what is published.

use std::collections::BTreeMap;

use super::super::row::Row;
use super::measure::LPIPS;
use super::protocol::Protocol;
use super::published::{DatasetEntry, MIPNERF360, MethodEntry, PUBLISHED, WAYS};

const PUBLISHED_ON: &str = "4090";

/// Why a number cannot be compared with the published one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mark {
    Scenes,
    Size,
    Steps,
    Stopping,
    Primitives,
    Device,
    Motion,
}

impl Mark {
    pub const ALL: [Self; 7] =
        [Self::Scenes, Self::Size, Self::Steps, Self::Stopping, Self::Primitives, Self::Device, Self::Motion];

    /// As it stands beside a number.
    pub fn letter(self) -> char {
        char::from(b'a' + self as u8)
    }

    pub fn meaning(self) -> &'static str {
        match self {
            Self::Scenes => "not the mean of all scenes of the dataset",
            Self::Size => "photographs of another size",
            Self::Steps => "another number of steps",
            Self::Stopping => "trained without the views that end the run",
            Self::Primitives => "another number of primitives than in the paper's comparison",
            Self::Device => "published on an RTX 4090",
            Self::Motion => "motion from depth and cameras instead of optical flow, and another path",
        }
    }
}

/// A column of a table.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    pub dataset: &'static DatasetEntry,
    pub title: &'static str,
    /// Of the measure in rows.
    key: &'static str,
    /// In the unit of the table, per unit of the measure.
    scale: f64,
    pub digits: usize,
    /// Of the published numbers.
    pub published_digits: usize,
    pub is_better_if_more: bool,
    /// Why its numbers may differ besides the pictures.
    mark: Option<Mark>,
    published: fn(&MethodEntry, &DatasetEntry) -> Option<f64>,
}

/// A found and a published number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Entry {
    /// Mean over scenes of means over seeds.
    pub found: Option<f64>,
    pub published: Option<f64>,
    /// Ascending.
    pub marks: Vec<Mark>,
    /// Scenes in the mean.
    pub scenes: usize,
}

#[derive(Debug)]
pub struct Line {
    pub name: &'static str,
    pub title: &'static str,
    /// One for each column.
    pub entries: Vec<Entry>,
}

#[derive(Debug)]
pub struct Table {
    pub number: usize,
    pub title: &'static str,
    pub columns: Vec<Column>,
    pub lines: Vec<Line>,
}

/// In which order a table puts the lines that have both a found and a published number in a column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Order {
    /// Titles, the best first.
    pub published: Vec<&'static str>,
    /// Likewise.
    pub found: Vec<&'static str>,
    /// Pairs of lines that differ in both, and how many of them are in the same order in both.
    pub pairs: usize,
    pub agreeing: usize,
}

/// All tables of a benchmark.
#[derive(Debug)]
pub struct Tables {
    pub tables: Vec<Table>,
    /// A line for each method and scene.
    pub scenes: Vec<SceneLine>,
}

/// A method on one scene: means over seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneLine {
    pub method: &'static str,
    pub scene: String,
    /// By title of the measure.
    pub values: Vec<(&'static str, f64)>,
}

/// Columns of the quality of pictures among those of a dataset.
const OF_QUALITY: usize = 3;

/// The columns of `dataset`: those of quality, then those of costs.
fn columns(dataset: &'static DatasetEntry) -> [Column; 8] {
    let column = |title, key, digits, published: fn(&MethodEntry, &DatasetEntry) -> Option<f64>| Column {
        dataset,
        title,
        key,
        scale: 1.0,
        digits,
        published_digits: digits,
        is_better_if_more: false,
        mark: None,
        published,
    };
    let more = |column: Column| Column { is_better_if_more: true, ..column };
    // the paper has whole numbers of costs but for FLIP
    let whole = |column: Column, scale, mark| Column { scale, published_digits: 0, mark, ..column };
    let moved = |column: Column| Column { mark: Some(Mark::Motion), ..column };
    let frames = more(column("FPS", "frames_per_second", 0, |of, _| Some(of.costs.as_ref()?.frames_per_second)));
    let megabytes = column("MB", "bytes", 1, |of, _| Some(of.costs.as_ref()?.megabytes));
    let minutes = column("min", "training_seconds", 1, |of, _| Some(of.costs.as_ref()?.minutes));
    [
        more(column("SSIM", "ssim", 3, |of, dataset| Some(of.quality.get(&dataset.name)?[0]))),
        more(column("PSNR", "psnr", 2, |of, dataset| Some(of.quality.get(&dataset.name)?[1]))),
        column("LPIPS", LPIPS, 3, |of, dataset| Some(of.quality.get(&dataset.name)?[2])),
        whole(frames, 1.0, Some(Mark::Device)),
        whole(megabytes, 1e-6, None),
        whole(minutes, 1.0 / 60.0, Some(Mark::Device)),
        moved(column("FLIP_1", "flip_1", 4, |of, _| Some(of.costs.as_ref()?.flip_1))),
        moved(column("FLIP_7", "flip_7", 4, |of, _| Some(of.costs.as_ref()?.flip_7))),
    ]
}

impl Tables {
    /// Of `rows`, which were measured by `protocol`.
    pub fn of(rows: &[Row], protocol: &Protocol) -> Self {
        let mip = PUBLISHED.dataset(MIPNERF360).expect("a dataset of the paper");
        let quality: Vec<Column> =
            PUBLISHED.datasets.iter().flat_map(|dataset| columns(dataset).into_iter().take(OF_QUALITY)).collect();
        let costs = columns(mip)[OF_QUALITY..].to_vec();
        let of_ablations = columns(mip)[..=OF_QUALITY].to_vec();
        let of_methods = |columns: &[Column]| -> Vec<Line> {
            let line = |method: &'static MethodEntry| {
                let published = |column: &Column| (column.published)(method, column.dataset);
                let is_capped = protocol.own_caps && method.matches;
                line(rows, protocol, &method.name, &method.title, columns, is_capped, published)
            };
            let has_any = |line: &Line| line.entries.iter().any(|entry| entry.published.or(entry.found).is_some());
            PUBLISHED.methods.iter().map(line).filter(has_any).collect()
        };
        let ablations = PUBLISHED.ablations.iter().map(|ablation| {
            let numbers = [&ablation.quality[..], &[ablation.frames_per_second]].concat();
            let published = |column: &Column| {
                let at = of_ablations.iter().position(|other| other.key == column.key)?;
                numbers.get(at).copied()
            };
            line(rows, protocol, &ablation.name, &ablation.title, &of_ablations, false, published)
        });
        let ablations = ablations.collect();
        let tables = vec![
            Table { number: 1, title: "Image quality", lines: of_methods(&quality), columns: quality },
            Table { number: 2, title: "Costs and popping, Mip-NeRF360", lines: of_methods(&costs), columns: costs },
            Table { number: 3, title: "Ablations of DP-GES, Mip-NeRF360", lines: ablations, columns: of_ablations },
        ];
        Self { tables, scenes: scene_lines(rows) }
    }

    /// Marks that some number has, ascending.
    pub fn marks(&self) -> Vec<Mark> {
        let entries = || self.tables.iter().flat_map(|table| &table.lines).flat_map(|line| &line.entries);
        Mark::ALL.into_iter().filter(|mark| entries().any(|entry| entry.marks.contains(mark))).collect()
    }
}

fn line(
    rows: &[Row],
    protocol: &Protocol,
    name: &'static str,
    title: &'static str,
    columns: &[Column],
    is_capped: bool,
    published: impl Fn(&Column) -> Option<f64>,
) -> Line {
    let entry = |column: &Column| {
        let of_line: Vec<&Row> = rows
            .iter()
            .filter(|row| row.label == name && dataset_of(row) == Some(&column.dataset.name))
            .filter(|row| row.get(column.key).is_some())
            .collect();
        let mut by_scene: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for row in &of_line {
            let (scene, value) = (row.scene.as_deref().unwrap_or_default(), row.get(column.key).unwrap_or_default());
            by_scene.entry(scene).or_default().push(value);
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let means: Vec<f64> = by_scene.values().map(|values| mean(values)).collect();
        let found = (!means.is_empty()).then(|| column.scale * mean(&means));
        let marks =
            if found.is_some() { marks(&of_line, means.len(), column, protocol, is_capped) } else { Vec::new() };
        Entry { found, published: published(column), marks, scenes: means.len() }
    };
    Line { name, title, entries: columns.iter().map(entry).collect() }
}

/// Of the mean over `rows` of so many `scenes`.
fn marks(rows: &[&Row], scenes: usize, column: &Column, protocol: &Protocol, is_capped: bool) -> Vec<Mark> {
    let has_published_size = |row: &&Row| {
        let scene = row.scene.as_deref().and_then(|scene| scene.split_once('/'));
        let range = scene.and_then(|(_, scene)| column.dataset.group(scene)).map(|group| group.longest_px);
        range.zip(row.get("longest_px")).is_some_and(|([least, most], px)| (least as f64..=most as f64).contains(&px))
    };
    let on_published_device =
        || rows.iter().all(|row| row.device.as_deref().is_some_and(|device| device.contains(PUBLISHED_ON)));
    let applies = |mark: &Mark| match mark {
        Mark::Scenes => scenes < column.dataset.scenes().count(),
        Mark::Size => !rows.iter().all(has_published_size),
        Mark::Steps => protocol.steps_scale != 1.0,
        Mark::Stopping => protocol.flexible_stopping,
        Mark::Primitives => is_capped,
        Mark::Device => column.mark == Some(Mark::Device) && !on_published_device(),
        Mark::Motion => column.mark == Some(Mark::Motion),
    };
    Mark::ALL.into_iter().filter(applies).collect()
}

fn dataset_of(row: &Row) -> Option<&str> {
    Some(row.scene.as_deref()?.split_once('/')?.0)
}

/// In the order of datasets, scenes and methods.
fn scene_lines(rows: &[Row]) -> Vec<SceneLine> {
    let mut lines = Vec::new();
    for (dataset, scene) in
        PUBLISHED.datasets.iter().flat_map(|dataset| dataset.scenes().map(move |name| (dataset, name)))
    {
        for way in WAYS.iter() {
            let scene = format!("{}/{scene}", dataset.name);
            let of_scene = |row: &&Row| row.label == way.name && row.scene.as_ref() == Some(&scene);
            let rows: Vec<&Row> = rows.iter().filter(of_scene).collect();
            if rows.is_empty() {
                continue;
            }
            let mean = |Column { title, key, scale, .. }| {
                let values: Vec<f64> = rows.iter().map(|row| row.get(key)).collect::<Option<_>>()?;
                Some((title, scale * values.iter().sum::<f64>() / values.len() as f64))
            };
            let values = columns(dataset).into_iter().filter_map(mean).collect();
            lines.push(SceneLine { method: way.name, scene, values });
        }
    }
    lines
}

impl Table {
    /// The orders of the lines in a column; `None` if fewer than two have both numbers.
    pub fn order(&self, column: usize) -> Option<Order> {
        let sign = if self.columns[column].is_better_if_more { -1.0 } else { 1.0 };
        let both = |line: &Line| {
            let Entry { found, published, .. } = line.entries[column];
            Some((line.title, sign * found?, sign * published?))
        };
        let known: Vec<(&'static str, f64, f64)> = self.lines.iter().filter_map(both).collect();
        if known.len() < 2 {
            return None;
        }
        let sorted = |of: fn(&(&'static str, f64, f64)) -> f64| {
            let mut sorted = known.clone();
            sorted.sort_by(|a, b| of(a).total_cmp(&of(b)));
            sorted.into_iter().map(|(title, ..)| title).collect::<Vec<_>>()
        };
        let pairs = known.iter().enumerate().flat_map(|(index, a)| known[..index].iter().map(move |b| (b, a)));
        let differing: Vec<_> = pairs.filter(|(a, b)| a.1 != b.1 && a.2 != b.2).collect();
        let agreeing = differing.iter().filter(|(a, b)| (a.1 < b.1) == (a.2 < b.2)).count();
        let (found, published) = (sorted(|line| line.1), sorted(|line| line.2));
        Some(Order { published, found, pairs: differing.len(), agreeing })
    }
}

#[cfg(test)]
pub mod tests {
    use super::super::published::DPGES;
    use super::*;

    /// A row of full size and of an RTX 4090, so that nothing but what is missing is marked.
    pub fn row(method: &str, scene: &str, seed: u64, psnr: f64) -> Row {
        let mut row = Row::new(method, Some(seed));
        let (dataset, name) = scene.split_once('/').unwrap();
        row.scene = Some(scene.to_owned());
        row.device = Some("NVIDIA GeForce RTX 4090 (discrete, vulkan)".to_owned());
        let group = PUBLISHED.dataset(dataset).unwrap().group(name).unwrap();
        row.set("longest_px", Some(group.longest_px[0] as f64));
        row.set("psnr", Some(psnr));
        row.set("frames_per_second", Some(100.0));
        row.set("flip_1", Some(0.03));
        row.set("bytes", Some(2_500_000.0));
        row.set("training_seconds", Some(90.0));
        row
    }

    fn entry<'a>(tables: &'a Tables, table: usize, name: &str, dataset: &str, title: &str) -> &'a Entry {
        let table = &tables.tables[table - 1];
        let column = table.columns.iter().position(|column| column.dataset.name == dataset && column.title == title);
        &table.lines.iter().find(|line| line.name == name).unwrap().entries[column.unwrap()]
    }

    #[test]
    fn a_mean_is_over_scenes_of_means_over_seeds_beside_the_published_number() {
        let rows = [
            row("dpges", "tanks-and-temples/truck", 0, 20.0),
            row("dpges", "tanks-and-temples/truck", 1, 22.0),
            row("dpges", "tanks-and-temples/train", 0, 31.0),
            row("dpges", "mipnerf360/garden", 0, 25.0),
        ];
        let tables = Tables::of(&rows, &Protocol::default());
        let whole = Entry { found: Some(26.0), published: Some(24.61), marks: vec![], scenes: 2 };
        assert_eq!(*entry(&tables, 1, "dpges", "tanks-and-temples", "PSNR"), whole);
        let part = Entry { found: Some(25.0), published: Some(28.11), marks: vec![Mark::Scenes], scenes: 1 };
        assert_eq!(*entry(&tables, 1, "dpges", MIPNERF360, "PSNR"), part);
        assert_eq!(*entry(&tables, 3, "dpges", MIPNERF360, "PSNR"), part, "the method is a line of its ablations");
        let none = Entry { published: Some(27.02), ..Entry::default() };
        assert_eq!(*entry(&tables, 3, "layers-2", MIPNERF360, "PSNR"), none);
        assert_eq!(entry(&tables, 1, "dpges", MIPNERF360, "LPIPS").found, None, "not measured");
        let costs: Vec<Option<f64>> =
            ["FPS", "MB", "min"].map(|title| entry(&tables, 2, "dpges", MIPNERF360, title).found).to_vec();
        assert_eq!(costs, [Some(100.0), Some(2.5), Some(1.5)]);
        assert_eq!(tables.tables[0].lines.len(), 11);
        assert!(tables.tables[1].lines.iter().all(|line| line.name != "mip-splatting"), "it has no costs in the paper");
        assert_eq!((tables.scenes.len(), tables.scenes[1].values[0]), (3, ("PSNR", 21.0)));
    }

    #[test]
    fn numbers_that_cannot_be_compared_are_marked() {
        let scenes = ["tanks-and-temples/truck", "tanks-and-temples/train"];
        let all = |method: &str| scenes.map(|scene| row(method, scene, 0, 20.0)).to_vec();
        let found = |rows: &[Row], method: &str, protocol: &Protocol| {
            entry(&Tables::of(rows, protocol), 1, method, "tanks-and-temples", "PSNR").marks.clone()
        };
        let (published, shorter) = (Protocol::default(), Protocol { steps_scale: 0.5, ..Protocol::default() });
        let flexible = Protocol { flexible_stopping: true, ..Protocol::default() };
        let capped = Protocol { own_caps: true, ..Protocol::default() };
        assert_eq!(found(&all("mcmc"), "mcmc", &published), []);
        assert_eq!(found(&all("mcmc"), "mcmc", &shorter), [Mark::Steps]);
        assert_eq!(found(&all("mcmc"), "mcmc", &flexible), [Mark::Stopping]);
        assert_eq!(found(&all("mcmc"), "mcmc", &capped), [Mark::Primitives]);
        assert_eq!(found(&all("3dgs"), "3dgs", &capped), [], "it has no cap in the paper either");
        assert_eq!(found(&all("mcmc")[..1], "mcmc", &published), [Mark::Scenes]);
        let mut small = all("mcmc");
        small[1].set("longest_px", Some(64.0));
        assert_eq!(found(&small, "mcmc", &shorter), [Mark::Size, Mark::Steps]);

        let mip: Vec<Row> = PUBLISHED
            .dataset(MIPNERF360)
            .unwrap()
            .scenes()
            .map(|scene| row("dpges", &format!("mipnerf360/{scene}"), 0, 20.0))
            .collect();
        let costs = |rows: &[Row], title: &str| {
            entry(&Tables::of(rows, &published), 2, "dpges", MIPNERF360, title).marks.clone()
        };
        assert_eq!((costs(&mip, "FPS"), costs(&mip, "MB")), (vec![], vec![]));
        assert_eq!(costs(&mip, "FLIP_1"), [Mark::Motion]);
        let mut elsewhere = mip;
        elsewhere[3].device = Some("llvmpipe".to_owned());
        assert_eq!((costs(&elsewhere, "min"), costs(&elsewhere, "MB")), (vec![Mark::Device], vec![]));
        assert_eq!(Tables::of(&elsewhere, &published).marks(), [Mark::Device, Mark::Motion]);
    }

    #[test]
    fn orders_are_of_methods_with_both_numbers_the_best_first() {
        // published: DBS 24.52, 3DGS-MCMC 24.33, 3DGS 23.62
        let rows = [("3dgs", 20.0), ("mcmc", 23.0), ("dbs", 22.0)].map(|(method, psnr)| {
            let mut row = row(method, "tanks-and-temples/truck", 0, psnr);
            row.set(LPIPS, Some(psnr / 100.0));
            row
        });
        let table = &Tables::of(&rows, &Protocol::default()).tables[0];
        let order = |title: &str| {
            let at = table.columns.iter().position(|c| c.dataset.name == "tanks-and-temples" && c.title == title);
            table.order(at.unwrap())
        };
        let psnr = Order {
            published: vec!["DBS", "3DGS-MCMC", "3DGS"],
            found: vec!["3DGS-MCMC", "DBS", "3DGS"],
            pairs: 3,
            agreeing: 2,
        };
        assert_eq!(order("PSNR"), Some(psnr));
        // published: DBS .166, 3DGS-MCMC .180, 3DGS .183
        let lpips = order("LPIPS").unwrap();
        assert_eq!((lpips.found, lpips.agreeing), (vec!["3DGS", "DBS", "3DGS-MCMC"], 1));
        assert_eq!(order("SSIM"), None);
        assert_eq!(table.lines.last().unwrap().name, DPGES);
    }
}

//! Streamed SOG, version 1 (PlayCanvas): `lod-meta.json` with a tree of boxes, whose leaves name a run of splats for each level
//! of detail, and a folder for each of the files of SOG that the runs are in.

use dpges_core::scene::along_morton_curve;
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Map, Value, json};

use super::super::{APPROXIMATION, GENERATOR, SplatCloud};
use super::{META, files};

/// The file that says what the others hold.
pub const INDEX: &str = "lod-meta.json";
const VERSION: u32 = 1;
/// A file has runs until there are so many splats in it.
const FILE_SPLATS: usize = 1 << 18;
/// Standard deviations within which a splat is drawn.
const REACH: f64 = 3.0;

/// Paths and bytes of the files of a scene in `levels` of detail, the finest first. A leaf has at most `leaf_splats` of the
/// finest, at least 1.
pub fn to_streamed_sog(levels: &[SplatCloud], leaf_splats: usize) -> Vec<(String, Vec<u8>)> {
    let mut tree = Tree { levels, leaf_splats, runs: Vec::new() };
    let all = levels.iter().map(|level| (0..level.len()).collect()).collect();
    let (root, _) = tree.node(all);
    let name = |at: usize, level: usize| {
        let before = tree.runs[..at].iter().filter(|(other, _)| *other == level).count();
        format!("{level}_{before}")
    };
    let names: Vec<String> = tree.runs.iter().enumerate().map(|(at, (level, _))| name(at, *level)).collect();
    let counts: Vec<usize> = levels.iter().map(SplatCloud::len).collect();
    let index = json!({
        "version": VERSION,
        "asset": { "generator": GENERATOR, "note": APPROXIMATION },
        "count": counts.iter().sum::<usize>(),
        "counts": counts,
        "lodLevels": levels.len(),
        "filenames": names.iter().map(|name| format!("{name}/{META}")).collect::<Vec<_>>(),
        "tree": root,
    });
    let mut written = vec![(INDEX.to_owned(), serde_json::to_vec(&index).expect("numbers and names become JSON"))];
    for (name, (level, rows)) in names.iter().zip(&tree.runs) {
        let of_file = files(&levels[*level].select(rows));
        written.extend(of_file.into_iter().map(|(file, bytes)| (format!("{name}/{file}"), bytes)));
    }
    written
}

struct Tree<'a> {
    levels: &'a [SplatCloud],
    leaf_splats: usize,
    /// Level and rows of each file.
    runs: Vec<(usize, Vec<usize>)>,
}

impl Tree<'_> {
    /// The node of the rows of each level, and its box. It is halved at the median of the finest along its longest side.
    fn node(&mut self, mut rows: Vec<Vec<usize>>) -> (Value, [DVec3; 2]) {
        if rows[0].len() <= self.leaf_splats {
            return self.leaf(rows);
        }
        let place = |level: usize, row: usize| glam::Vec3::from(self.levels[level].positions[row]);
        let start = [glam::Vec3::INFINITY, glam::Vec3::NEG_INFINITY];
        let places = rows[0].iter().map(|&row| place(0, row));
        let [low, high] = places.fold(start, |[low, high], place| [low.min(place), high.max(place)]);
        let axis = (high - low).max_position();
        let middle = rows[0].len() / 2;
        rows[0].sort_by(|&a, &b| place(0, a)[axis].total_cmp(&place(0, b)[axis]));
        let plane = place(0, rows[0][middle])[axis];
        let part = |(level, rows): (usize, Vec<usize>)| match level {
            0 => (rows[..middle].to_vec(), rows[middle..].to_vec()),
            _ => rows.into_iter().partition(|&row| place(level, row)[axis] < plane),
        };
        let (low, high): (Vec<_>, Vec<_>) = rows.into_iter().enumerate().map(part).unzip();
        let [(low, of_low), (high, of_high)] = [self.node(low), self.node(high)];
        let corners = [of_low[0].min(of_high[0]), of_low[1].max(of_high[1])];
        (json!({ "bound": bound(corners), "children": [low, high] }), corners)
    }

    fn leaf(&mut self, rows: Vec<Vec<usize>>) -> (Value, [DVec3; 2]) {
        let (mut lods, mut corners) = (Map::new(), [DVec3::INFINITY, DVec3::NEG_INFINITY]);
        for (level, rows) in rows.into_iter().enumerate().filter(|(_, rows)| !rows.is_empty()) {
            let cloud = &self.levels[level];
            for &row in &rows {
                let (place, reach) = (glam::Vec3::from(cloud.positions[row]).as_dvec3(), reach(cloud, row));
                corners = [corners[0].min(place - reach), corners[1].max(place + reach)];
            }
            let places: Vec<f32> = rows.iter().flat_map(|&row| cloud.positions[row]).collect();
            let ordered = along_morton_curve(&places).into_iter().map(|at| rows[at]);
            let file = self.file(level);
            let run = &mut self.runs[file].1;
            lods.insert(level.to_string(), json!({ "file": file, "offset": run.len(), "count": rows.len() }));
            run.extend(ordered);
        }
        (json!({ "bound": bound(corners), "lods": lods }), corners)
    }

    /// The file of the next run of `level`.
    fn file(&mut self, level: usize) -> usize {
        let last = self.runs.iter().rposition(|(other, rows)| *other == level && rows.len() < FILE_SPLATS);
        last.unwrap_or_else(|| {
            self.runs.push((level, Vec::new()));
            self.runs.len() - 1
        })
    }
}

/// Half the sides of the box around a splat.
fn reach(cloud: &SplatCloud, row: usize) -> DVec3 {
    let [w, x, y, z] = cloud.quaternions[row].map(f64::from);
    let scales = DVec3::from(cloud.log_scales[row].map(|log_scale| f64::from(log_scale).exp()));
    let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()) * DMat3::from_diagonal(scales);
    REACH * DVec3::from([0, 1, 2].map(|axis| axes.row(axis).length()))
}

fn bound([low, high]: [DVec3; 2]) -> Value {
    json!({ "min": low.as_vec3().to_array(), "max": high.as_vec3().to_array() })
}

#[cfg(test)]
mod tests {
    use super::super::super::archive::stored;
    use super::super::super::cloud::tests::sample;
    use super::super::read;
    use super::*;

    #[test]
    fn every_splat_is_in_the_box_of_a_leaf_once_and_where_the_leaf_says() {
        let levels = [sample(100, 1), sample(40, 1), sample(3, 1)];
        let files = to_streamed_sog(&levels, 30);
        let index: Value = serde_json::from_slice(&files[0].1).unwrap();
        assert_eq!((&*files[0].0, &index["version"], &index["lodLevels"]), ("lod-meta.json", &json!(1), &json!(3)));
        assert_eq!((&index["count"], &index["counts"]), (&json!(143), &json!([100, 40, 3])));
        assert_eq!(index["filenames"], json!(["0_0/meta.json", "1_0/meta.json", "2_0/meta.json"]));
        let clouds: Vec<SplatCloud> = (0..3)
            .map(|level| {
                let folder = format!("{level}_0/");
                let inside = files.iter().filter_map(|(path, bytes)| Some((path.strip_prefix(&*folder)?, &**bytes)));
                read(&stored(inside)).unwrap().0
            })
            .collect();
        let (mut leaves, mut nodes) = (0, vec![&index["tree"]]);
        let mut next = [0; 3];
        while let Some(node) = nodes.pop() {
            nodes.extend(node["children"].as_array().into_iter().flatten().rev());
            let Some(lods) = node["lods"].as_object() else { continue };
            leaves += 1;
            let corner = |name: &str| serde_json::from_value::<[f32; 3]>(node["bound"][name].clone()).unwrap();
            let (low, high) = (corner("min"), corner("max"));
            for (level, run) in lods {
                let level: usize = level.parse().unwrap();
                let [offset, count] = ["offset", "count"].map(|key| run[key].as_u64().unwrap() as usize);
                assert_eq!((offset, &run["file"]), (next[level], &json!(level)));
                next[level] += count;
                for position in &clouds[level].positions[offset..offset + count] {
                    assert!((0..3).all(|axis| low[axis] < position[axis] && position[axis] < high[axis]));
                }
            }
        }
        assert_eq!((leaves, next), (4, [100, 40, 3]));
    }

    #[test]
    fn a_box_holds_a_turned_ellipsoid() {
        let mut cloud = sample(1, 0);
        cloud.log_scales[0] = [1f32.ln(), 2f32.ln(), 0.5f32.ln()];
        cloud.quaternions[0] = [0.5f32.sqrt(), 0.0, 0.0, 0.5f32.sqrt()];
        // a quarter turn about z
        assert!((reach(&cloud, 0) - DVec3::new(6.0, 3.0, 1.5)).length() < 1e-5);
    }
}

//! Unused files of a dataset: the only place that decides whether they are reported.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

use super::conventions::{ARRAYS, DEPTHS, MASKS, POINTS, is_companion, is_picture, is_read, subject};
use super::error::{Result, read_text};
use super::finding::{Kind, Notices};
use super::folder::Folder;
use super::foreign::{self, BEGINNING};
use super::formats::source::{Frame, Source};
use super::formats::{colmap, transforms};
use super::key::{extension, key, parent, stem};
use super::layout::{Cameras, Layout};

/// Files of a model of COLMAP beside the cameras and images, and its twin in another encoding.
const OF_A_MODEL: [&str; 5] = ["cameras", "images", "points3d", "rigs", "frames"];

/// Kinds of unused files, and the advice for each.
const NOT_USED: [(Kind, &str, &str); 7] = [
    (Kind::Unused, "photographs without a camera are not used", "find their cameras too, or remove them"),
    (Kind::Unused, "pictures or masks of formats that are not read", "convert them to JPEG or PNG to use them"),
    (
        Kind::Unused,
        "masks of no photograph with a camera",
        "that of images/NAME.jpg is masks/NAME.jpg.png or masks/NAME.png",
    ),
    (
        Kind::Aside,
        "depth maps are not used",
        "data.depth=metric or relative uses those in depths/ that are called like photographs",
    ),
    (Kind::Unused, "points are not used", "--points FILE (`data.points`) uses one in place of others"),
    (
        Kind::Aside,
        "lists of views are not used",
        "train.txt and test.txt say which views are for what, where no other file does",
    ),
    (Kind::Unused, "depth maps of formats that are not read", "write them as grey PNGs of 16 bits"),
];

/// Says of everything in the folder of a dataset that might be part of it and is not `used` that it is not, and why.
pub fn survey(layout: &Layout, source: &Source, mut used: HashSet<PathBuf>, reads_depth: bool) -> Notices {
    let Layout { folder, cameras, others } = layout;
    let root = folder.root.as_path();
    let mut notices = Notices::default();
    let shown = |path: &Path| path.strip_prefix(root).unwrap_or(path).display().to_string();
    let cameras_in = shown(&source.described_in);

    // other cameras
    let pictures: HashSet<String> = source.frames.iter().map(|frame| folder.key_of(&frame.image)).collect();
    let mut elsewhere: BTreeSet<String> = BTreeSet::new();
    let mut rest: Vec<PathBuf> = others.clone();
    if let Cameras::Colmap(models) = cameras {
        rest.extend(models.iter().filter(|model| !source.described_in.starts_with(model)).cloned());
    }
    for other in rest {
        let own = views_of(folder, &other).unwrap_or_default();
        let mut apart = own.iter().filter(|key| !pictures.contains(*key)).peekable();
        let of_held_out = matches!(cameras, Cameras::Transforms { held_out: Some(_), .. }) && other.is_file();
        let message = format!("{} is not used, for {cameras_in} has the cameras", shown(&other));
        match apart.peek().cloned().filter(|_| !of_held_out) {
            Some(first) => {
                let count = apart.count();
                let message = format!("{message}; {count} photographs have theirs there alone, such as {first}");
                notices.add(
                    Kind::Unused,
                    message,
                    "join the models (COLMAP's model_merger), or find all cameras together",
                );
            }
            None => notices.add(Kind::Aside, message, "nothing is lost"),
        }
        elsewhere.extend(own);
        let is_part = |path: &&PathBuf| **path == other || path.parent() == Some(&other);
        used.extend(folder.files.values().filter(is_part).cloned());
    }

    let what = "photographs of one name lie in several folders";
    let advice = "those in the first are used; begin the names in the dataset with the folder (cam1/NAME) to say which";
    notices.add_names(Kind::Unused, what, &ambiguous(folder, source), advice);

    // all other files
    let model = source.described_in.parent().unwrap_or(root);
    let is_of_model = |key: &str, path: &Path| {
        path.parent() == Some(model) && OF_A_MODEL.contains(&stem(parent(key).1)) && extension(key) != "ply"
    };
    let photographs: HashSet<&str> = pictures.iter().map(|key| parent(key).0).collect();
    let stems: BTreeSet<&str> = pictures.iter().map(|key| stem(key)).collect();
    // r_0_normal.png to r_0.png
    let belongs = |key: &str| {
        let rest = stems.range(..stem(key)).next_back().and_then(|before| stem(key).strip_prefix(before));
        rest.is_some_and(|rest| rest.starts_with(['_', '.', '-']))
    };
    let mut found: [Vec<PathBuf>; 7] = Default::default();
    for (key, path) in folder.files.iter().filter(|(_, path)| !used.contains(*path)) {
        let is_near = path.parent() == Some(root) || path.parent() == Some(model);
        let is_array = ARRAYS.contains(&extension(key));
        let at = match extension(key) {
            _ if is_picture(key) && MASKS.is_about(key) => 2,
            _ if is_array && MASKS.is_about(key) => 1,
            _ if is_array && reads_depth && DEPTHS.is_about(key) => 6,
            _ if (is_array || is_picture(key)) && DEPTHS.is_about(key) => 3,
            _ if is_picture(key) => {
                let is_alone = photographs.contains(parent(key).0) && !elsewhere.contains(key) && !belongs(key);
                if is_alone { usize::from(!is_read(key)) } else { continue }
            }
            points if is_near && POINTS.contains(&points) => 4,
            "txt" if is_near && !is_of_model(key, path) && lists_views(path, &stems) => 5,
            _ => continue,
        };
        found[at].push(path.clone());
    }
    // masks of photographs without a camera are not amiss, nor are those in another size
    let alone: HashSet<String> =
        found[0].iter().chain(&source.missing).map(|path| subject(&folder.key_of(path))).collect();
    found[2].retain(|path| {
        let key = folder.key_of(path);
        let is_alone = |of: &str| alone.iter().any(|other| other == of || stem(other) == of);
        !MASKS.subjects(&key, "").iter().any(|(_, of)| is_alone(of)) && !key.starts_with("masks_")
    });
    if !reads_depth {
        found[3].extend(source.frames.iter().filter_map(|frame| Some(frame.depth.as_ref()?.path.clone())));
    }
    for (at, ((kind, what, advice), files)) in NOT_USED.into_iter().zip(&found).enumerate() {
        let is_redundant = at == 4 && !source.points.positions.is_empty();
        notices.add_files(if is_redundant { Kind::Aside } else { kind }, what, root, files, advice);
    }
    for (program, mut files) in foreign::cameras(folder) {
        files.retain(|path| !used.contains(path) && !is_of_model(&folder.key_of(path), path));
        let what = format!("cameras of {program} are not used, for {cameras_in} has others");
        notices.add_files(Kind::Aside, &what, root, &files, "nothing is lost");
    }
    notices
}

/// The views whose names fit photographs in several folders below that of photographs, with these, that of the used one first.
fn ambiguous(folder: &Folder, source: &Source) -> Vec<String> {
    let mut by_name: HashMap<&str, Vec<&str>> = HashMap::new();
    for key in folder.files.keys().filter(|key| is_read(key) && !is_companion(key)) {
        by_name.entry(stem(parent(key).1)).or_default().push(key);
    }
    let places = |frame: &Frame| {
        let (used, name) = (folder.key_of(&frame.image), key(&frame.name));
        let base = used.split('/').next()?;
        let name = stem(name.strip_prefix(base).and_then(|name| name.strip_prefix('/')).unwrap_or(&name));
        // what lies between the folder of photographs and the name
        let between = |key: &str| {
            let within = stem(key).strip_prefix(base)?.strip_prefix('/')?;
            within.strip_suffix(name)?.strip_suffix('/').map(str::to_owned)
        };
        let own = between(&used)?;
        let others = by_name.get(parent(name).1)?.iter().filter_map(|key| between(key)).filter(|other| *other != own);
        let others: BTreeSet<String> = others.collect();
        let all: Vec<String> = [&own].into_iter().chain(&others).map(|place| format!("{base}/{place}")).collect();
        (!others.is_empty()).then(|| format!("{} ({})", frame.name, all.join(", ")))
    };
    source.frames.iter().filter_map(places).collect()
}

/// Keys of the pictures that a model of COLMAP or a file of transforms describes.
fn views_of(folder: &Folder, cameras: &Path) -> Result<Vec<String>> {
    let pictures = if cameras.is_file() {
        let names = transforms::read_transforms(cameras)?.picture_names();
        folder.pictures(&as_strs(&names), &[""])
    } else {
        colmap::pictures(folder, cameras, &as_strs(&colmap::image_names(cameras)?))
    };
    Ok(pictures.into_iter().flatten().map(|path| folder.key_of(&path)).collect())
}

fn as_strs(names: &[String]) -> Vec<&str> {
    names.iter().map(String::as_str).collect()
}

/// Whether at least half of the lines of a file are names of pictures, by keys without extensions.
fn lists_views(path: &Path, stems: &BTreeSet<&str>) -> bool {
    let names: HashSet<&str> = stems.iter().map(|stem| parent(stem).1).collect();
    let text = if path.metadata().is_ok_and(|about| about.len() < BEGINNING) { read_text(path) } else { return false };
    let text = text.unwrap_or_default();
    let lines: Vec<String> = text.lines().filter(|line| !line.trim().is_empty()).map(|line| key(line.trim())).collect();
    let known =
        lines.iter().filter(|line| names.contains(parent(line).1) || names.contains(stem(parent(line).1))).count();
    known > 0 && 2 * known >= lines.len()
}

#[cfg(test)]
mod tests;

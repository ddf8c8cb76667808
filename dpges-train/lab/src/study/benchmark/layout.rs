//! Finds the scenes of published datasets in the folders that they are distributed in.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::PossibleValuesParser;
use dpges_train::dataset::{Format, format};

use super::published::{DatasetEntry, PUBLISHED};

/// A scene of a dataset, on disk.
#[derive(Clone, Debug)]
pub struct Scene {
    pub dataset: &'static DatasetEntry,
    pub name: &'static str,
    pub path: PathBuf,
}

/// Which datasets and scenes are wanted; all that are there where nothing is named.
#[derive(Args, Clone, Debug, Default)]
pub struct Asked {
    /// Datasets, separated by commas [default: those that are there]
    #[arg(long, value_name = "DATASET", value_delimiter = ',', value_parser = PossibleValuesParser::new(PUBLISHED.names()))]
    pub datasets: Vec<String>,
    /// Scenes, separated by commas [default: those that are there]
    #[arg(long, value_name = "SCENE", value_delimiter = ',')]
    pub scenes: Vec<String>,
}

/// Why what is wanted is not there.
#[derive(Debug, thiserror::Error)]
pub enum LayoutError {
    #[error("there is no folder {}", .0.display())]
    NoFolder(PathBuf),
    #[error(
        "{} has none of the datasets {wanted}: each is looked for as a folder with a folder for each scene ({layouts}); there are {found}",
        .data.display()
    )]
    NoDataset { data: PathBuf, wanted: String, layouts: String, found: String },
    #[error("no dataset has a scene `{scene}`; scenes are {known}")]
    UnknownScene { scene: String, known: String },
    #[error("scene `{scene}` of {dataset} {reason}; in {} there are {found}", .folder.display())]
    NoScene { scene: String, dataset: String, folder: PathBuf, reason: String, found: String },
}

type Result<T, E = LayoutError> = std::result::Result<T, E>;

impl DatasetEntry {
    /// The first folder below `data` that has one of the scenes, or else `data` itself if that has one.
    fn folder(&self, data: &Path) -> Option<PathBuf> {
        let own = self.folders.iter().map(|folder| data.join(folder));
        own.chain([data.to_owned()]).find(|folder| self.scenes().any(|scene| folder.join(scene).is_dir()))
    }

    /// Why the scene in `path` cannot be used; `None` if it can.
    fn shortcoming(&self, scene: &str, path: &Path) -> Option<String> {
        if !path.is_dir() {
            return Some("is not there".to_owned());
        }
        if self.name == "nerf-synthetic" {
            let needed = ["transforms_train.json", "transforms_test.json"];
            let missing = needed.into_iter().find(|file| !path.join(file).is_file())?;
            return Some(format!("lacks {missing}"));
        }
        if format(path) != Some(Format::Colmap) {
            return Some("lacks sparse/0".to_owned());
        }
        let images = match self.group(scene).map_or(1, |group| group.image_scale) {
            1 => "images".to_owned(),
            scale => format!("images_{scale}"),
        };
        (!path.join(&images).is_dir()).then(|| format!("lacks {images}"))
    }
}

/// Whether `asked` names `name`, or nothing at all.
fn is_wanted(asked: &[String], name: &str) -> bool {
    asked.is_empty() || asked.iter().any(|wanted| wanted == name)
}

/// The wanted scenes below `data`, in the order of the tables. Warns of scenes that are not there, unless scenes are named.
///
/// # Errors
/// [`LayoutError`] if there are none, or if something that is named is not there or is incomplete.
pub fn find(data: &Path, asked: &Asked) -> Result<Vec<Scene>> {
    if !data.is_dir() {
        return Err(LayoutError::NoFolder(data.to_owned()));
    }
    let known: Vec<&str> = PUBLISHED.datasets.iter().flat_map(DatasetEntry::scenes).collect();
    if let Some(scene) = asked.scenes.iter().find(|scene| !known.contains(&&scene[..])) {
        return Err(LayoutError::UnknownScene { scene: scene.clone(), known: known.join(", ") });
    }
    let datasets: Vec<&DatasetEntry> =
        PUBLISHED.datasets.iter().filter(|dataset| is_wanted(&asked.datasets, &dataset.name)).collect();
    let mut found = Vec::new();
    for &dataset in &datasets {
        let wanted: Vec<&'static str> = dataset.scenes().filter(|scene| is_wanted(&asked.scenes, scene)).collect();
        if wanted.is_empty() {
            continue;
        }
        let is_named = !asked.datasets.is_empty() || !asked.scenes.is_empty();
        let Some(folder) = dataset.folder(data) else {
            if is_named {
                return Err(no_dataset(data, &[dataset]));
            }
            tracing::warn!("{} has no {}", data.display(), dataset.title);
            continue;
        };
        let mut missing = Vec::new();
        for scene in wanted {
            let path = folder.join(scene);
            match dataset.shortcoming(scene, &path) {
                None => found.push(Scene { dataset, name: scene, path }),
                Some(reason) if !asked.scenes.is_empty() => {
                    let (scene, dataset, found) = (scene.to_owned(), dataset.name.clone(), folders(&folder));
                    return Err(LayoutError::NoScene { scene, dataset, folder, reason, found });
                }
                Some(reason) => missing.push(format!("{scene} {reason}")),
            }
        }
        if !missing.is_empty() {
            tracing::warn!("{} in {}: {}", dataset.title, folder.display(), missing.join(", "));
        }
    }
    if found.is_empty() {
        return Err(no_dataset(data, &datasets));
    }
    Ok(found)
}

fn no_dataset(data: &Path, wanted: &[&DatasetEntry]) -> LayoutError {
    let names = wanted.iter().map(|dataset| &dataset.name[..]).collect::<Vec<_>>().join(", ");
    let layout = |dataset: &&DatasetEntry| {
        let first = dataset.scenes().next().unwrap_or_default();
        format!("{}/{first}", dataset.folders.join(" or "))
    };
    let layouts = wanted.iter().map(layout).collect::<Vec<_>>().join("; ");
    LayoutError::NoDataset { data: data.to_owned(), wanted: names, layouts, found: folders(data) }
}

/// The names of the folders in `path`, for messages.
fn folders(path: &Path) -> String {
    let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter(|entry| entry.path().is_dir())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    if names.is_empty() { "no folders".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::super::tests::made;
    use super::*;

    fn asked(datasets: &[&str], scenes: &[&str]) -> Asked {
        let owned = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        Asked { datasets: owned(datasets), scenes: owned(scenes) }
    }

    const ALL: [&str; 11] = [
        "360_v2/garden/sparse/0",
        "360_v2/garden/images_4",
        "360_v2/room/sparse/0",
        "360_v2/room/images_2",
        "tandt/truck/sparse/0",
        "tandt/truck/images",
        "db/playroom/sparse/0",
        "db/playroom/images",
        "nerf_synthetic/lego/transforms_train.json",
        "nerf_synthetic/lego/transforms_test.json",
        "other",
    ];

    #[test]
    fn scenes_are_found_where_they_are_distributed() {
        let data = made(&ALL);
        let names = |asked: &Asked| -> Vec<(&str, &str)> {
            find(data.path(), asked).unwrap().iter().map(|scene| (&scene.dataset.name[..], scene.name)).collect()
        };
        let expected = [
            ("mipnerf360", "garden"),
            ("mipnerf360", "room"),
            ("tanks-and-temples", "truck"),
            ("deep-blending", "playroom"),
            ("nerf-synthetic", "lego"),
        ];
        assert_eq!(names(&Asked::default()), expected);
        assert_eq!(names(&asked(&["nerf-synthetic", "mipnerf360"], &["lego", "room"])), [expected[1], expected[4]]);
        let scene = &find(data.path(), &asked(&[], &["truck"])).unwrap()[0];
        assert_eq!(scene.path, data.path().join("tandt/truck"));
        let alone = made(&["truck/sparse/0", "truck/images"]);
        assert_eq!(find(alone.path(), &Asked::default()).unwrap()[0].path, alone.path().join("truck"));
    }

    #[test]
    fn what_is_not_there_is_an_error_that_lists_what_is() {
        let data = made(&ALL);
        let refused = |path: &Path, asked: &Asked| find(path, asked).unwrap_err().to_string();
        for (asked, parts) in [
            (asked(&[], &["kitchen"]), &["`kitchen` of mipnerf360 is not there", "there are garden, room"][..]),
            (asked(&[], &["castle"]), &["no dataset has a scene `castle`", "bicycle", "ship"]),
        ] {
            let message = refused(data.path(), &asked);
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        }
        std::fs::remove_dir(data.path().join("360_v2/garden/images_4")).unwrap();
        std::fs::remove_file(data.path().join("nerf_synthetic/lego/transforms_test.json")).unwrap();
        assert!(refused(data.path(), &asked(&[], &["garden"])).contains("lacks images_4"));
        assert!(refused(data.path(), &asked(&[], &["lego"])).contains("lacks transforms_test.json"));
        assert_eq!(find(data.path(), &asked(&["mipnerf360"], &[])).unwrap().len(), 1, "room alone");
        let empty = made(&["films", "photographs"]);
        let message = refused(empty.path(), &asked(&["tanks-and-temples"], &[]));
        for part in ["none of the datasets tanks-and-temples", "tandt", "/truck", "there are films, photographs"] {
            assert!(message.contains(part), "{part}: {message}");
        }
        let message = refused(empty.path(), &Asked::default());
        assert!(message.contains("mipnerf360, tanks-and-temples, deep-blending, nerf-synthetic"), "{message}");
        assert!(refused(&empty.path().join("absent"), &Asked::default()).contains("there is no folder"));
    }
}

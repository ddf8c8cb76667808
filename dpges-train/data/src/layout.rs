//! Which files of a folder are the cameras of a dataset.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::Format;
use super::conventions::is_picture;
use super::folder::Folder;
use super::foreign;
use super::key::{extension, key, parent, stem};

/// Names of the files of transforms to train on, the first that is there, and their ends.
const TRANSFORMS: [(&str, &str); 4] =
    [("transforms", "_train"), ("transform", "_train"), ("transforms", ""), ("transform", "")];
/// Ends of those of views that are held out, likewise.
const HELD_OUT: [&str; 2] = ["_test", "_val"];
/// Folders within a dataset, any of which may be named in its place.
const PARTS: [&str; 11] =
    ["images", "input", "sparse", "colmap", "dense", "distorted", "undistorted", "model", "text", "opensfm", SCANNET];
/// Folder of the transforms of ScanNet++, beside that of the photographs.
const SCANNET: &str = "nerfstudio";
/// One of which is in a folder with cameras.
const SIGNS: [&str; 8] =
    ["sparse", "colmap", "cameras.bin", "cameras.txt", "transforms.json", "transforms_train.json", "opensfm", SCANNET];

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cameras {
    /// Folders of models of COLMAP. Empty if there is a folder `sparse` without one.
    Colmap(Vec<PathBuf>),
    /// A file of transforms, and one of views that are held out.
    Transforms { train: PathBuf, held_out: Option<PathBuf> },
    /// Those of another program: a file, or one for each photograph.
    Guest { format: Format, files: Vec<PathBuf> },
}

impl Cameras {
    fn files(&self) -> Vec<PathBuf> {
        match self {
            Self::Colmap(models) => models.clone(),
            Self::Transforms { train, held_out } => [train].into_iter().chain(held_out).cloned().collect(),
            Self::Guest { files, .. } => files.clone(),
        }
    }
}

/// The files of a dataset, and the cameras among them.
#[derive(Clone, Debug)]
pub struct Layout {
    pub folder: Folder,
    pub cameras: Cameras,
    /// Models and transforms that are not used, because others are.
    pub others: Vec<PathBuf>,
}

/// Whether a place in a folder has photographs of its own, so that what is there is another dataset.
fn is_apart(folder: &Folder, at: &str) -> bool {
    let first = at.split('/').next().unwrap_or_default();
    let is_within = |key: &&String| key.strip_prefix(first).is_some_and(|rest| rest.starts_with('/'));
    !first.is_empty() && !PARTS.contains(&first) && folder.files.keys().filter(is_within).any(|key| is_picture(key))
}

impl Layout {
    /// Whether a folder is none, but has some within.
    pub fn are_within(folder: &Folder) -> bool {
        let places: BTreeSet<&str> = folder.files.keys().filter_map(|key| Some(key.split_once('/')?.0)).collect();
        let is_dataset = |at: &&str| is_apart(folder, at) && Self::find(&folder.root.join(at)).is_some();
        places.iter().any(is_dataset)
    }

    /// The dataset at `path`: its folder, a file of its cameras, or a folder within it. `None` if there is none.
    pub fn find(path: &Path) -> Option<Self> {
        let name = |path: &Path| key(&path.file_name().unwrap_or_default().to_string_lossy());
        let is_of_cameras = ["json", "bin", "txt", "xml", "csv", "out"].contains(&extension(&name(path)));
        let folder = if path.is_file() { path.parent().filter(|_| is_of_cameras)? } else { path };
        let has_pictures = |layout: &Self| {
            // OpenSfM keeps copies of photographs, without their lenses, beside its cameras
            let is_copy = |key: &str| layout.format().is_guest() && key.starts_with("undistorted/");
            layout.folder.files.keys().any(|key| is_picture(key) && !is_copy(key))
        };
        let here = Self::of(Folder::read(folder), path);
        if here.as_ref().is_some_and(has_pictures) {
            return here;
        }
        let is_part = |folder: &&Path| {
            let (own, above) = (name(folder), folder.parent().map(name).unwrap_or_default());
            PARTS.contains(&own.as_str()) || above == "sparse" && own.bytes().all(|byte| byte.is_ascii_digit())
        };
        let (mut above, mut highest) = (folder, None);
        while let Some(next) = Some(above).filter(is_part).and_then(Path::parent) {
            above = next;
            // a look, before all of it is listed
            let mut beside = std::fs::read_dir(above).into_iter().flatten().flatten().map(|entry| entry.path());
            let may_be = beside.any(|path| SIGNS.contains(&name(&path).as_str()));
            let Some(found) = may_be.then(|| Self::of(Folder::read(above), path)).flatten() else { continue };
            if has_pictures(&found) {
                return Some(found);
            }
            highest = Some(found);
        }
        highest.or(here)
    }

    /// The dataset in `folder`; where there are several, that in `named` or below it.
    fn of(folder: Folder, named: &Path) -> Option<Self> {
        let in_sparse = |at: &str| at == "sparse" || at.starts_with("sparse/");
        let is_model = |at: &str| {
            let has = |name: &str| {
                folder.within(at).any(|key| stem(parent(key).1) == name && matches!(extension(key), "bin" | "txt"))
            };
            has("cameras") && (in_sparse(at) || has("images") && !is_apart(&folder, at))
        };
        let places: BTreeSet<&str> = folder.files.keys().map(|key| parent(key).0).collect();
        let path_of = |at: &str| Some(folder.files.get(folder.within(at).next()?)?.parent()?.to_owned());
        let (sparse, elsewhere): (Vec<&str>, Vec<&str>) =
            places.into_iter().filter(|at| is_model(at)).partition(|at| in_sparse(at));
        let [sparse, elsewhere]: [Vec<PathBuf>; 2] =
            [sparse, elsewhere].map(|places| places.into_iter().filter_map(path_of).collect());
        let transforms_in = |at: &str, (name, end): (&str, &str)| {
            let file = |end: &str| folder.get(&format!("{at}{name}{end}.json")).cloned();
            Some(Cameras::Transforms { train: file(end)?, held_out: HELD_OUT.into_iter().find_map(file) })
        };
        let mut found: Vec<Cameras> = Vec::new();
        let has_sparse = !sparse.is_empty() || folder.root.join("sparse").is_dir();
        found.extend(has_sparse.then_some(Cameras::Colmap(sparse)));
        found.extend(TRANSFORMS.into_iter().filter_map(|name| transforms_in("", name)));
        found.extend((!elsewhere.is_empty()).then_some(Cameras::Colmap(elsewhere)));
        found.extend(TRANSFORMS.into_iter().filter_map(|name| transforms_in(&format!("{SCANNET}/"), name)));
        if found.is_empty()
            && let Some((format, files)) = foreign::first(&folder, |at| is_apart(&folder, at))
        {
            found.push(Cameras::Guest { format, files });
        }
        if let Some(format) = Some(named).filter(|named| named.is_file()).and_then(foreign::format_of) {
            let guest = Cameras::Guest { format, files: vec![named.to_owned()] };
            found.retain(|cameras| *cameras != guest);
            found.insert(0, guest);
        } else if extension(&key(&named.to_string_lossy())) == "json" {
            let is_it = |cameras: &Cameras| matches!(cameras, Cameras::Transforms { train, .. } if train == named);
            match found.iter().position(is_it) {
                Some(at) => found.swap(0, at),
                None => found.insert(0, Cameras::Transforms { train: named.to_owned(), held_out: None }),
            }
        }
        let model = if named.is_file() { named.parent().unwrap_or(named) } else { named };
        let is_named = |path: &Path| path.starts_with(model) && model != folder.root;
        if let Some(at) = found.iter().position(|cameras| cameras.files().iter().any(|path| is_named(path))) {
            found.swap(0, at);
            if let Cameras::Colmap(models) = &mut found[0] {
                models.retain(|path| is_named(path));
            }
        }
        let used = found.first()?.files();
        let held_out = TRANSFORMS.iter().flat_map(|(name, _)| HELD_OUT.map(|end| format!("{name}{end}.json")));
        let held_out = held_out.filter_map(|name| folder.get(&name).cloned());
        let others = found.iter().flat_map(Cameras::files).chain(held_out);
        let others: BTreeSet<PathBuf> = others.filter(|path| !used.contains(path)).collect();
        Some(Self { cameras: found.swap_remove(0), folder, others: others.into_iter().collect() })
    }

    pub fn format(&self) -> Format {
        match &self.cameras {
            Cameras::Colmap(_) => Format::Colmap,
            Cameras::Transforms { train, .. } if stem(&key(&train.to_string_lossy())).ends_with("_train") => {
                Format::Blender
            }
            Cameras::Transforms { .. } => Format::Nerfstudio,
            Cameras::Guest { format, .. } => *format,
        }
    }
}

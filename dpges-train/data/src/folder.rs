//! The files in the folder of a dataset.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

use super::conventions::{is_companion, is_picture, is_read};
use super::key::{UNKNOWN, fits, key, parent, stem};

/// Folders within folders in which files are looked for, and most files.
const DEEPEST: usize = 6;
const MOST_FILES: usize = 500_000;
/// A folder with one of these is no part of a dataset: a run has written it, or structure from motion has left it.
const FOREIGN: [&str; 2] = ["metrics.jsonl", "steps.json"];

/// The files below a folder.
#[derive(Clone, Debug)]
pub struct Folder {
    pub root: PathBuf,
    /// By their [`key`] below the root.
    pub files: BTreeMap<String, PathBuf>,
}

impl Folder {
    /// Those that cannot be listed are left out.
    pub fn read(root: &Path) -> Self {
        let mut folder = Self { root: root.to_owned(), files: BTreeMap::new() };
        folder.add(root, DEEPEST);
        folder
    }

    fn add(&mut self, at: &Path, depth: usize) {
        let mut entries: Vec<PathBuf> =
            std::fs::read_dir(at).into_iter().flatten().flatten().map(|e| e.path()).collect();
        entries.sort();
        let is_foreign = |path: &PathBuf| FOREIGN.iter().any(|name| path.file_name() == Some(name.as_ref()));
        if at != self.root && entries.iter().any(is_foreign) {
            return;
        }
        for path in entries {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if name.starts_with('.') || name.starts_with("__") || self.files.len() == MOST_FILES {
                continue;
            }
            // links to nowhere are no files, and pipes would be waited for
            let Ok(about) = path.metadata() else { continue };
            if about.is_dir() {
                if depth > 0 {
                    self.add(&path, depth - 1);
                }
            } else if about.is_file() {
                let below = path.strip_prefix(&self.root).unwrap_or(&path).to_string_lossy().into_owned();
                self.files.entry(key(&below)).or_insert(path);
            }
        }
    }

    /// The keys of the files that lie in `folder`, and not in one below it.
    pub fn within<'a>(&'a self, folder: &'a str) -> impl Iterator<Item = &'a str> {
        self.files.keys().map(String::as_str).filter(move |key| parent(key).0 == folder)
    }

    /// The file with this path below the root, whatever the case of its letters.
    pub fn get(&self, path: &str) -> Option<&PathBuf> {
        self.files.get(&key(path))
    }

    /// The key of a file below the root.
    pub fn key_of(&self, file: &Path) -> String {
        key(&file.strip_prefix(&self.root).unwrap_or(file).to_string_lossy())
    }

    /// The pictures that a dataset describes by `names`, paths that may have been written on another machine: the files with
    /// these paths below one of `bases`, or else those that are called so, but for their extensions, below the folder where most
    /// of them are. Letters of other code pages, which are unknown, may stand for any if one file alone fits.
    pub fn pictures<'a>(&'a self, names: &[&str], bases: &[&str]) -> Vec<Option<PathBuf>> {
        let exact = |name: &&str| bases.iter().map(|base| self.root.join(base).join(name)).find(|path| path.is_file());
        let found: Vec<Option<PathBuf>> = names.iter().map(exact).collect();
        if found.iter().all(Option::is_some) {
            return found;
        }
        let mut by_name: HashMap<&str, Vec<&'a str>> = HashMap::new();
        let photographs = || self.files.keys().filter(|key| is_picture(key) && !is_companion(key));
        let unclear: Vec<&str> = photographs().map(String::as_str).filter(|key| key.contains(UNKNOWN)).collect();
        for key in photographs() {
            let name = parent(key).1;
            for name in [name, stem(name)] {
                by_name.entry(name).or_default().push(key);
            }
        }
        let candidates = |key: &str| -> Vec<&'a str> {
            let name = parent(key).1;
            let names = [Some(name), is_picture(name).then(|| stem(name))];
            let alike: Vec<&str> =
                names.into_iter().flatten().filter_map(|name| by_name.get(name)).flatten().copied().collect();
            if !alike.is_empty() {
                return alike;
            }
            let is_like = |file: &&str| names.into_iter().flatten().any(|name| names_fit(name, parent(file).1));
            if name.contains(UNKNOWN) {
                photographs().map(String::as_str).filter(is_like).collect()
            } else {
                unclear.iter().copied().filter(is_like).collect()
            }
        };
        let keys: Vec<String> = names.iter().map(|name| key(name)).collect();
        // where they may be, with how many of the folders of their names are not there
        let mut places: BTreeMap<(usize, usize, &str), usize> = BTreeMap::new();
        for key in &keys {
            let folders: Vec<&str> = parent(key).0.split('/').rev().filter(|part| !part.is_empty()).collect();
            let place = |file: &'a str| {
                let (mut place, mut shared) = (parent(file).0, 0);
                while folders.get(shared).is_some_and(|folder| fits(parent(place).1, folder)) {
                    (place, shared) = (parent(place).0, shared + 1);
                }
                (folders.len() - shared, base_rank(place), place)
            };
            let own: BTreeSet<(usize, usize, &str)> = candidates(key).into_iter().map(place).collect();
            own.into_iter().for_each(|place| *places.entry(place).or_default() += 1);
        }
        let Some(((dropped, _, place), _)) = places.into_iter().rev().max_by_key(|(_, count)| *count) else {
            return found;
        };
        let mut taken: HashSet<PathBuf> = found.iter().flatten().cloned().collect();
        let mut similar = |key: &String| {
            let below = key.split('/').skip(dropped).collect::<Vec<_>>().join("/");
            let wanted = if place.is_empty() { below } else { format!("{place}/{below}") };
            let folder = parent(&wanted).0;
            let within = || candidates(key).into_iter().filter(|file| fits(parent(file).0, folder));
            let rank = |file: &&str| (**file != wanted, !fits(file, &wanted), !is_read(file));
            let file = within().min_by_key(rank)?;
            let is_unclear = [file, &wanted].iter().any(|key| key.contains(UNKNOWN));
            if is_unclear && within().filter(|other| rank(other) == rank(&file)).count() > 1 {
                return None;
            }
            self.files.get(file).filter(|file| taken.insert((*file).clone())).cloned()
        };
        found.into_iter().zip(&keys).map(|(found, key)| found.or_else(|| similar(key))).collect()
    }
}

/// Whether a file may be the one that is called `name`, perhaps but for its extension.
fn names_fit(name: &str, file: &str) -> bool {
    fits(name, file) || fits(name, stem(file))
}

/// Folders of photographs, the most usual first.
fn base_rank(place: &str) -> usize {
    match place {
        "images" => 0,
        "input" => 1,
        "" => 2,
        other if other.starts_with("images_") => 4,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_of_code_pages_may_stand_for_any() {
        let root = tempfile::tempdir().unwrap();
        let found = |names: &[&str]| -> Vec<Option<String>> {
            let folder = Folder::read(root.path());
            folder
                .pictures(names, &["images"])
                .iter()
                .map(|path| path.as_ref().map(|path| folder.key_of(path)))
                .collect()
        };
        let add = |path: &str| {
            std::fs::create_dir_all(root.path().join(path).parent().unwrap()).unwrap();
            std::fs::write(root.path().join(path), "").unwrap();
        };
        ["Küche/Tür 1.jpg", "Küche/Tür 2.jpg", "Bäder/Tür 1.jpg"]
            .iter()
            .for_each(|name| add(&format!("images/{name}")));
        let names = ["K\u{fffd}che/T\u{fffd}r 1.jpg", "K\u{fffd}che/T\u{fffd}r 2.png", "B\u{fffd}der/T\u{fffd}r 1.jpg"];
        let files = ["images/küche/tür 1.jpg", "images/küche/tür 2.jpg", "images/bäder/tür 1.jpg"];
        assert_eq!(found(&names), files.map(|file| Some(file.to_owned())));
        // two files fit
        add("images/Küche/Tor 1.jpg");
        assert_eq!(found(&names)[..2], [None, Some(files[1].to_owned())]);
        // the names on disk are of a code page
        ["Halle \u{fffd} 1.jpg", "Halle \u{fffd} 2.jpg"].iter().for_each(|name| add(&format!("images/{name}")));
        let files = ["images/halle \u{fffd} 1.jpg", "images/halle \u{fffd} 2.jpg"];
        assert_eq!(found(&["Halle Ö 1.jpg", "Halle Ö 2.jpg"]), files.map(|file| Some(file.to_owned())));
        assert_eq!(found(&["Halle Ö 1.jpg", "Halle O 3.jpg"])[1], None);
    }
}

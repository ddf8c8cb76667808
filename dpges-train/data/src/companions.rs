//! Masks and depth maps, by the photographs that they belong to.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::conventions::{Companion, is_picture, subject};
use super::folder::Folder;
use super::key::stem;

/// The files of one kind below a folder.
#[derive(Debug)]
pub struct Companions<'a> {
    folder: &'a Folder,
    /// Places among those of the same subject, and keys.
    by_subject: HashMap<String, Vec<(usize, &'a str)>>,
}

impl<'a> Companions<'a> {
    /// Those of photographs in a `scale` below the folder.
    pub fn new(folder: &'a Folder, kind: Companion, scale: Option<u32>) -> Self {
        let scale = scale.map_or_else(String::new, |scale| format!("_{scale}"));
        let mut by_subject: HashMap<String, Vec<(usize, &str)>> = HashMap::new();
        for key in folder.files.keys().filter(|key| is_picture(key)) {
            for (place, subject) in kind.subjects(key, &scale) {
                by_subject.entry(subject).or_default().push((place, key));
            }
        }
        Self { folder, by_subject }
    }

    /// The file that belongs to the photograph in file `image`: the one in the usual folder under the usual name, if there are
    /// several.
    pub fn of(&self, image: &Path) -> Option<PathBuf> {
        let key = self.folder.key_of(image);
        let subject = subject(&key);
        let found = [subject.as_str(), stem(&subject)].into_iter().filter_map(|subject| self.by_subject.get(subject));
        let others = found.enumerate().flat_map(|(at, files)| files.iter().map(move |(place, key)| (*place, at, *key)));
        let (.., found) = others.filter(|(.., other)| *other != key).min()?;
        self.folder.files.get(found).cloned()
    }
}

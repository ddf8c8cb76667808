//! Scenes that were opened lately.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::stream::is_address;

const KEPT: usize = 8;

/// Paths of scenes and runs, the last one first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RecentFiles(Vec<PathBuf>);

impl RecentFiles {
    /// Its key in eframe's storage.
    pub const KEY: &'static str = "recent";

    /// Puts `path` first: a file by its absolute name.
    pub fn add(&mut self, path: &Path) {
        let file = std::path::absolute(path).ok().filter(|_| !is_address(path));
        let path = file.unwrap_or_else(|| path.to_owned());
        self.0.retain(|other| *other != path);
        self.0.insert(0, path);
        self.0.truncate(KEPT);
    }

    pub fn remove(&mut self, path: &Path) {
        self.0.retain(|other| other != path);
    }

    pub fn iter(&self) -> impl Iterator<Item = &PathBuf> {
        self.0.iter()
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_is_first_and_named_once() {
        let mut recent = RecentFiles::default();
        (0..12).for_each(|number| recent.add(Path::new(&format!("/runs/{number}"))));
        recent.add(Path::new("/runs/7"));
        let names: Vec<_> = recent.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
        assert_eq!(names, ["7", "11", "10", "9", "8", "6", "5", "4"]);
        recent.remove(Path::new("/runs/10"));
        assert_eq!(recent.iter().count(), KEPT - 1);
        recent.add(Path::new("relative"));
        assert!(recent.iter().next().unwrap().is_absolute());
    }
}

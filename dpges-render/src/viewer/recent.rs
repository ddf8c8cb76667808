//! Scenes that were opened lately.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::stream::is_address;

const KEPT: usize = 8;

/// Paths of scenes and runs, the last one first.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RecentFiles {
    pub paths: Vec<PathBuf>,
}

impl RecentFiles {
    pub const KEY: &'static str = "recent";

    /// Puts `path` first: a file by its absolute name.
    pub fn add(&mut self, path: &Path) {
        let file = std::path::absolute(path).ok().filter(|_| !is_address(path));
        let path = file.unwrap_or_else(|| path.to_owned());
        self.remove(&path);
        self.paths.insert(0, path);
        self.paths.truncate(KEPT);
    }

    pub fn remove(&mut self, path: &Path) {
        self.paths.retain(|other| other != path);
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
        let names: Vec<_> = recent.paths.iter().map(|path| path.file_name().unwrap().to_str().unwrap()).collect();
        assert_eq!(names, ["7", "11", "10", "9", "8", "6", "5", "4"]);
        recent.remove(Path::new("/runs/10"));
        assert_eq!(recent.paths.len(), KEPT - 1);
        recent.add(Path::new("relative"));
        assert!(recent.paths[0].is_absolute());
    }
}

//! Errors for paths that are no dataset and cannot become one: what was looked for, what is there instead, and what may
//! have been meant.

use std::path::Path;

use super::input::{Input, VIDEOS, has_extension};
use crate::conventions::READ;
use crate::names::{in_folder, list, listing};

const LOOKED_FOR: &str = "looked for a dataset (sparse/ of COLMAP, transforms_train.json of Blender, transforms.json of \
                          nerfstudio, or cameras of Metashape, RealityScan, OpenSfM or Bundler), for photographs (JPEG, PNG or WebP, in the folder itself, in images/ or in input/), and for a \
                          video (such as walk.mp4)";

/// Why nothing can be trained on, in words.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}; {advice}")]
pub struct Unusable {
    pub message: String,
    pub advice: String,
}

/// The error for `path`, which is no dataset and no [`Input`].
pub fn unusable(path: &Path) -> Unusable {
    let shown = path.display();
    if path.is_file() {
        let message = format!("{shown} is a file, but no video ({}); {LOOKED_FOR}", VIDEOS.join(", "));
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let advice = if has_extension(path, &READ) {
            format!("name the folder of the photographs: {}", folder.display())
        } else {
            "name a folder or a video".to_owned()
        };
        return Unusable { message, advice };
    }
    if matches!(path.try_exists(), Ok(false)) {
        return absent(path);
    }
    let found = listing(path);
    let message = format!("{shown} is no dataset, and there is nothing to make one of: {LOOKED_FOR}, found {found}");
    Unusable { message, advice: advice(path) }
}

fn absent(path: &Path) -> Unusable {
    let shown = path.display();
    let message = match path.read_link() {
        Ok(target) => format!("{shown} is a link to {}, which is not there", target.display()),
        Err(_) => format!("there is no folder or file {shown}"),
    };
    if path.components().any(|part| part.as_os_str() == "~") {
        let advice = "the shell does not expand `~` within quotes: write it without them, or $HOME".to_owned();
        return Unusable { message, advice };
    }
    let above = path.ancestors().skip(1).find(|above| above.is_dir());
    let there = |above: &Path| format!("{} is there, with {}", above.display(), listing(above));
    Unusable { message, advice: above.map_or_else(|| advice(path), there) }
}

fn advice(path: &Path) -> String {
    let names = in_folder(path).unwrap_or_default();
    let within = names.iter().map(|name| path.join(name));
    let meant = within.filter(|within| crate::format(within).is_some() || Input::find(within, false).is_some());
    let meant: Vec<String> = meant.map(|within| within.display().to_string()).collect();
    if !meant.is_empty() {
        return format!("name what is in it: {}", list(&meant));
    }
    "name the folder of a dataset, or that of photographs or a video: `dpges train`, `dpges data` and `dpges sfm` find their \
     cameras, by COLMAP"
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{assert_says, write_png};

    #[test]
    fn what_was_looked_for_and_what_is_there_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let is_said = |path: &Path, found: &str, advice: &str| {
            let unusable = unusable(path);
            let parts = [path.to_str().unwrap(), "sparse/", "transforms.json", "JPEG, PNG or WebP", "video", found];
            assert_says(unusable.message, &parts);
            assert_says(unusable.advice, &[advice]);
        };
        is_said(at, "found an empty folder", "that of photographs or a video: `dpges train`");
        std::fs::write(at.join("notes.md"), "").unwrap();
        is_said(at, "found notes.md", "by COLMAP");
        is_said(&at.join("notes.md"), "is a file, but no video (mp4, mov,", "name a folder or a video");
    }

    #[test]
    fn a_path_that_is_not_there_is_said_to_be_so() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        std::fs::create_dir(at.join("room")).unwrap();
        let said = |path: &Path| unusable(path).to_string();
        let absent = at.join("absent/x");
        let begins = format!("there is no folder or file {}; ", absent.display());
        assert!(said(&absent).starts_with(&begins), "{}", said(&absent));
        assert_says(said(&absent), &[&format!("{} is there, with room", at.display())]);
        assert_says(said(&at.join("~/x")), &["there is no folder", "`~` within quotes"]);
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("/nowhere/x", at.join("link")).unwrap();
            assert_says(said(&at.join("link")), &["is a link to /nowhere/x, which is not there"]);
        }
    }

    #[test]
    fn what_may_have_been_meant_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        let path = |name: &str| at.join(name).display().to_string();
        for name in ["walk.mp4", "read.me"] {
            std::fs::write(at.join(name), "").unwrap();
        }
        assert_eq!(unusable(at).advice, format!("name what is in it: {}", path("walk.mp4")));
        write_png(&at.join("room/images/a.png"), 4, 4, [1, 2, 3]);
        std::fs::create_dir_all(at.join("set/sparse")).unwrap();
        std::fs::create_dir(at.join("other")).unwrap();
        let meant = [path("room"), path("set"), path("walk.mp4")].join(", ");
        assert_eq!(unusable(at).advice, format!("name what is in it: {meant}"));
        let photograph = unusable(&at.join("room/images/a.png"));
        assert_eq!(photograph.advice, format!("name the folder of the photographs: {}", path("room/images")));
    }
}

//! Cameras of other programs among the files of a folder.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::Format;
use super::conventions;
use super::error::text_of;
use super::folder::Folder;
use super::key::{extension, key, parent, stem};

/// Bytes of a file that say what it is.
pub const BEGINNING: u64 = 1 << 16;
/// Files of a kind in a folder that are looked into.
const LOOKED_INTO: usize = 8;
/// Folders within folders in which cameras of other programs are looked for.
const DEEPEST: usize = 2;
/// Programs whose cameras are read, the first that are there.
const READ: [(&str, Format); 4] = [
    ("Metashape", Format::Metashape),
    ("RealityScan", Format::RealityScan),
    ("OpenSfM", Format::OpenSfm),
    ("Bundler", Format::Bundler),
];

/// Programs whose cameras lie in a folder, with the files.
pub fn cameras(folder: &Folder) -> BTreeMap<&'static str, Vec<PathBuf>> {
    let mut found: BTreeMap<&'static str, Vec<PathBuf>> = BTreeMap::new();
    let mut kinds: BTreeMap<(&str, &str), (usize, Option<&'static str>)> = BTreeMap::new();
    let shallow = folder.files.iter().filter(|(key, _)| key.split('/').count() <= DEEPEST + 1);
    for (key, path) in shallow {
        if ["cameras", "images"].contains(&stem(parent(key).1)) && matches!(extension(key), "bin" | "txt") {
            found.entry("a model of COLMAP, in part or of other photographs").or_default().push(path.clone());
        } else if conventions::may_hold_cameras(key) {
            let (count, program) = kinds.entry((parent(key).0, extension(key))).or_default();
            *count += 1;
            if *count <= LOOKED_INTO {
                *program = beginning(path).and_then(|bytes| conventions::cameras_of(key, &bytes));
            }
            program.iter().for_each(|program| found.entry(program).or_default().push(path.clone()));
        }
    }
    found
}

fn beginning(path: &Path) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(BEGINNING).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

/// The format of a file that has all cameras of a program which are read.
pub fn format_of(path: &Path) -> Option<Format> {
    let key = key(&path.file_name()?.to_string_lossy());
    if !["xml", "csv", "json", "out"].contains(&extension(&key)) {
        return None;
    }
    let bytes = beginning(path)?;
    let program = conventions::cameras_of(&key, &bytes)?;
    let (_, format) = READ.into_iter().find(|(name, _)| *name == program)?;
    // other files of OpenSfM are no lists of reconstructions
    (format != Format::OpenSfm || text_of(&bytes).trim_start().starts_with('[')).then_some(format)
}

/// The cameras in a folder, outside the places that are `apart`, which are read though they are those of another program: their
/// format and file, or files if there is one for each photograph.
pub fn first(folder: &Folder, is_apart: impl Fn(&str) -> bool) -> Option<(Format, Vec<PathBuf>)> {
    let mut found = cameras(folder);
    READ.into_iter().find_map(|(program, format)| {
        let mut files = found.remove(program)?;
        files.retain(|path| !is_apart(parent(&folder.key_of(path)).0));
        let length = |path: &&PathBuf| {
            let key = folder.key_of(path);
            (key.split('/').count(), key.len(), key)
        };
        if let Some(file) = files.iter().filter(|path| format_of(path) == Some(format)).min_by_key(length) {
            return Some((format, vec![file.clone()]));
        }
        files.retain(|path| extension(&folder.key_of(path)) == "xmp");
        (!files.is_empty()).then_some((format, files))
    })
}

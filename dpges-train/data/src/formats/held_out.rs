//! Training and held-out views.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use super::source::{Source, Split};
use crate::conventions::subject;
use crate::error::{Result, read_text};
use crate::finding::Kind;
use crate::key::{key, stem};

/// Every `test_every`-th of `count` views in name order is held out, beginning with the first; 0 holds none out.
pub(super) fn every_nth(count: usize, test_every: usize) -> Vec<Split> {
    (0..count).map(|index| if test_every > 0 && index % test_every == 0 { Split::Test } else { Split::Train }).collect()
}

/// The split that `train.txt` and `test.txt` (one image name a line, `#` comments) in one of `folders` ask for, or `None` where
/// no folder has either. A view in neither list is left out, or trains where there is no `train.txt`. Names may lack their
/// folder `images` and their extension; those of no view are said.
///
/// # Errors
/// [`crate::DatasetError::Read`].
pub(super) fn from_lists(folders: &[&Path], names: &[&str], source: &mut Source) -> Result<Option<Vec<Split>>> {
    let Some(folder) = folders.iter().find(|f| f.join("test.txt").is_file() || f.join("train.txt").is_file()) else {
        return Ok(None);
    };
    let keys: Vec<[String; 2]> = names.iter().map(|name| [key(name), subject(&key(name))]).collect();
    let mut views: HashMap<&str, usize> = HashMap::new();
    for (view, key) in keys.iter().flatten().enumerate() {
        views.entry(stem(key)).or_insert(view / 2);
        views.insert(key, view / 2);
    }
    let mut list = |name: &str| -> Result<Option<BTreeSet<usize>>> {
        let path = folder.join(name);
        if !path.is_file() {
            return Ok(None);
        }
        let text = read_text(&path)?;
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        let view_of = |line: &str| {
            let key = key(line);
            views.get(key.as_str()).or_else(|| views.get(subject(&key).as_str()))
        };
        let (found, strangers): (Vec<_>, Vec<_>) =
            lines.map(|line| (line, view_of(line))).partition(|(_, view)| view.is_some());
        let strangers: Vec<&str> = strangers.into_iter().map(|(line, _)| line).collect();
        let what = format!("names in {} are those of no view", path.display());
        source.notices.add_names(Kind::Missing, &what, &strangers, "correct or remove them");
        source.used.push(path);
        Ok(Some(found.into_iter().filter_map(|(_, view)| view.copied()).collect()))
    };
    let (train, test) = (list("train.txt")?, list("test.txt")?);
    let of = |view: usize| match (&train, &test) {
        (_, Some(test)) if test.contains(&view) => Split::Test,
        (Some(train), _) if train.contains(&view) => Split::Train,
        (Some(_), None) => Split::Test,
        (Some(_), Some(_)) => Split::Neither,
        (None, _) => Split::Train,
    };
    Ok(Some((0..names.len()).map(of).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Format;

    #[test]
    fn lists_decide_and_leave_out() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["a.png", "sub/b.png", "c.png"];
        let source = || Source::new(Format::Colmap, folder.path().to_owned(), "");
        let split = || from_lists(&[folder.path()], &names, &mut source()).unwrap();
        assert!(split().is_none());
        std::fs::write(folder.path().join("test.txt"), "# held out\nsub/b.png\r\n\n").unwrap();
        assert_eq!(split().unwrap(), [Split::Train, Split::Test, Split::Train]);
        std::fs::write(folder.path().join("train.txt"), "c.png\n").unwrap();
        assert_eq!(split().unwrap(), [Split::Neither, Split::Test, Split::Train]);
        std::fs::remove_file(folder.path().join("test.txt")).unwrap();
        assert_eq!(split().unwrap(), [Split::Test, Split::Test, Split::Train]);
        // as other programs write names
        std::fs::write(folder.path().join("test.txt"), b"\xef\xbb\xbfimages\\sub\\B\nc.jpg\nd.png\n").unwrap();
        let mut said = source();
        let found = from_lists(&[folder.path()], &names, &mut said).unwrap().unwrap();
        assert_eq!(found, [Split::Neither, Split::Test, Split::Train]);
        let [notice] = said.notices.0.as_slice() else { panic!("{:?}", said.notices) };
        assert!(notice.message.ends_with("test.txt are those of no view (2): c.jpg, d.png"), "{notice:?}");
    }
}

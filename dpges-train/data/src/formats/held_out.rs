//! Training and held-out views.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use super::source::{Source, Split};
use crate::conventions::subject;
use crate::error::{Result, read_text};
use crate::finding::Kind;
use crate::key::{key, stem};

/// Letters of a line that are shown.
const SHOWN: usize = 60;

/// Every `test_every`-th of `count` views in name order is held out, beginning with the first; 0 holds none out.
pub(super) fn every_nth(count: usize, test_every: usize) -> Vec<Split> {
    (0..count).map(|index| if test_every > 0 && index % test_every == 0 { Split::Test } else { Split::Train }).collect()
}

/// Views by what lists call them.
pub(super) struct Named(HashMap<String, usize>);

impl Named {
    /// By their `names`, with or without their folder `images` and their extension; the first of those that are called alike.
    pub fn new<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        let keys: Vec<String> = names.into_iter().map(key).collect();
        let forms: [fn(&str) -> String; 4] =
            [str::to_owned, subject, |key| stem(key).to_owned(), |key| stem(&subject(key)).to_owned()];
        let mut views = HashMap::new();
        for form in forms {
            for (view, key) in keys.iter().enumerate() {
                views.entry(form(key)).or_insert(view);
            }
        }
        Self(views)
    }

    /// Without the `dropped` first folders of its path.
    fn view(&self, name: &str, dropped: usize) -> Option<usize> {
        let name = name.split('/').skip(dropped).collect::<Vec<_>>().join("/");
        // photographs may have other extensions than the list, or none
        let forms = [name.clone(), subject(&name), stem(&name).to_owned(), stem(&subject(&name)).to_owned()];
        forms.iter().find_map(|form| self.0.get(form)).copied()
    }

    /// The views of a list, which may have been written on another machine, below other folders.
    pub fn views(&self, list: &[&str]) -> Vec<Option<usize>> {
        let keys: Vec<String> = list.iter().map(|name| key(name)).collect();
        let known = |dropped: usize| keys.iter().filter(|key| self.view(key, dropped).is_some()).count();
        let deepest = keys.iter().map(|key| key.split('/').count()).max().unwrap_or(0);
        let dropped = (1..deepest).rev().max_by_key(|&dropped| known(dropped)).unwrap_or(0);
        keys.iter().map(|key| self.view(key, 0).or_else(|| self.view(key, dropped))).collect()
    }
}

/// The split that `train.txt` and `test.txt` (one image name a line, `#` comments) in the first of `folders` with either ask for,
/// or `None` where no folder has one. A view in neither list is left out, or trains where there is no `train.txt`. Names may be
/// those of another machine, lack their folder `images`, and have another extension or none; those of no view are said, and a file
/// without any other is none.
///
/// # Errors
/// [`crate::DatasetError::Read`].
pub(super) fn from_lists(folders: &[&Path], names: &[&str], source: &mut Source) -> Result<Option<Vec<Split>>> {
    let named = Named::new(names.iter().copied());
    for folder in
        folders.iter().enumerate().filter(|&(at, folder)| !folders[..at].contains(folder)).map(|(_, folder)| folder)
    {
        let [train, test] = ["train.txt", "test.txt"].map(|name| list(&folder.join(name), &named, names, source));
        let (train, test) = (train?, test?);
        if train.is_none() && test.is_none() {
            continue;
        }
        let of = |view: usize| match (&train, &test) {
            (_, Some(test)) if test.contains(&view) => Split::Test,
            (Some(train), _) if train.contains(&view) => Split::Train,
            (Some(_), None) => Split::Test,
            (Some(_), Some(_)) => Split::Neither,
            (None, _) => Split::Train,
        };
        return Ok(Some((0..names.len()).map(of).collect()));
    }
    Ok(None)
}

/// The views that the file at `path` lists, if it is such a list.
fn list(path: &Path, named: &Named, names: &[&str], source: &mut Source) -> Result<Option<BTreeSet<usize>>> {
    if !path.is_file() {
        return Ok(None);
    }
    source.used.push(path.to_owned());
    let text = read_text(path)?;
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let lines: Vec<&str> = lines.collect();
    let views = named.views(&lines);
    if let Some(first) = lines.first().filter(|_| views.iter().all(Option::is_none)) {
        let first: String = first.chars().take(SHOWN).collect();
        let view = names.first().unwrap_or(&"");
        let message = format!(
            "{} is not used: no line of it, from `{first}` on, is the name of a view, such as `{view}`",
            path.display()
        );
        source.notices.add(Kind::Unused, message, "write one such name a line, or remove the file");
        return Ok(None);
    }
    let strangers: Vec<&str> =
        lines.iter().zip(&views).filter(|(_, view)| view.is_none()).map(|(line, _)| *line).collect();
    let what = format!("names in {} are those of no view", path.display());
    source.notices.add_names(Kind::Missing, &what, &strangers, "correct or remove them");
    Ok(Some(views.into_iter().flatten().collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Format;
    use crate::fixtures::assert_says;

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
        assert_eq!(found, [Split::Neither, Split::Test, Split::Test]);
        let [notice] = said.notices.0.as_slice() else { panic!("{:?}", said.notices) };
        assert!(notice.message.ends_with("test.txt are those of no view (1): d.png"), "{notice:?}");
    }

    #[test]
    fn views_without_extensions_are_in_lists_with_them() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("test.txt"), "C:\\proj\\images\\v1.2.jpg\n").unwrap();
        let mut source = Source::new(Format::Metashape, folder.path().to_owned(), "");
        let names = ["v1.1", "v1.2", "v1.3"];
        // a folder of cameras may be that of the dataset
        let found = from_lists(&[folder.path(), folder.path()], &names, &mut source).unwrap().unwrap();
        assert_eq!((found[1], source.notices.0.len()), (Split::Test, 0));
        assert_eq!(found.iter().filter(|&&split| split == Split::Test).count(), 1);
        std::fs::write(folder.path().join("test.txt"), "9\n").unwrap();
        assert_eq!(from_lists(&[folder.path(), folder.path()], &names, &mut source).unwrap(), None);
        let [notice] = source.notices.0.as_slice() else { panic!("{:?}", source.notices) };
        assert_says(notice, &["from `9` on", "such as `v1.1`"]);
    }

    #[test]
    fn lists_of_another_machine_are_matched_by_the_ends_of_their_paths() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["a.png", "sub/b.png", "c.png", "other/c.png"];
        let lists = "D:\\data\\scene\\images\\sub\\b.png\nD:\\data\\scene\\images\\c.png\n";
        std::fs::write(folder.path().join("test.txt"), lists).unwrap();
        let mut source = Source::new(Format::Colmap, folder.path().to_owned(), "");
        let found = from_lists(&[folder.path()], &names, &mut source).unwrap().unwrap();
        assert_eq!(found, [Split::Train, Split::Test, Split::Test, Split::Train]);
        assert_eq!(source.notices.0, []);
    }

    #[test]
    fn a_file_that_lists_no_view_is_no_list() {
        let folder = tempfile::tempdir().unwrap();
        let below = folder.path().join("sparse");
        std::fs::create_dir(&below).unwrap();
        std::fs::write(folder.path().join("train.txt"), "# log\npython train.py -s data\n30000 steps\n").unwrap();
        let mut source = Source::new(Format::Colmap, folder.path().to_owned(), "");
        let mut split = || from_lists(&[folder.path(), &below], &["a.png", "b.png"], &mut source).unwrap();
        assert_eq!(split(), None);
        std::fs::write(below.join("test.txt"), "b.png\n").unwrap();
        assert_eq!(split().unwrap(), [Split::Train, Split::Test]);
        assert_says(&source.notices.0[0], &["train.txt is not used", "`python train.py -s data`"]);
        assert_eq!(source.used.len(), 3);
    }
}

//! Training and held-out views.

use std::collections::BTreeSet;
use std::path::Path;

use super::source::Split;
use crate::dataset::error::{Result, read};

/// Every `test_every`-th of `count` views in name order is held out, beginning with the first; 0 holds none out.
pub(super) fn every_nth(count: usize, test_every: usize) -> Vec<Split> {
    (0..count).map(|index| if test_every > 0 && index % test_every == 0 { Split::Test } else { Split::Train }).collect()
}

/// The split that `train.txt` and `test.txt` (one image name a line, `#` comments) in one of `folders` ask for,
/// or `None` where no folder has either. A view in neither list is left out, or trains where there is no `train.txt`.
///
/// # Errors
/// [`crate::dataset::DatasetError::Read`].
pub(super) fn from_lists(folders: &[&Path], names: &[&str]) -> Result<Option<Vec<Split>>> {
    let Some(folder) = folders.iter().find(|f| f.join("test.txt").is_file() || f.join("train.txt").is_file()) else {
        return Ok(None);
    };
    let (train, test) = (list(&folder.join("train.txt"))?, list(&folder.join("test.txt"))?);
    let of = |name: &&str| match (&train, &test) {
        (_, Some(test)) if test.contains(*name) => Split::Test,
        (Some(train), _) if train.contains(*name) => Split::Train,
        (Some(_), None) => Split::Test,
        (Some(_), Some(_)) => Split::Neither,
        (None, _) => Split::Train,
    };
    Ok(Some(names.iter().map(of).collect()))
}

fn list(path: &Path) -> Result<Option<BTreeSet<String>>> {
    if !path.is_file() {
        return Ok(None);
    }
    let text = String::from_utf8_lossy(&read(path)?).into_owned();
    let names = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    Ok(Some(names.map(str::to_owned).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_decide_and_leave_out() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["a.png", "sub/b.png", "c.png"];
        let split = || from_lists(&[folder.path()], &names).unwrap();
        assert!(split().is_none());
        std::fs::write(folder.path().join("test.txt"), "# held out\nsub/b.png\r\n\n").unwrap();
        assert_eq!(split().unwrap(), [Split::Train, Split::Test, Split::Train]);
        std::fs::write(folder.path().join("train.txt"), "c.png\n").unwrap();
        assert_eq!(split().unwrap(), [Split::Neither, Split::Test, Split::Train]);
        std::fs::remove_file(folder.path().join("test.txt")).unwrap();
        assert_eq!(split().unwrap(), [Split::Test, Split::Test, Split::Train]);
    }
}

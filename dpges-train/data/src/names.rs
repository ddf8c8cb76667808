//! Names in folders, and lists of names in messages.

use std::path::Path;

/// Names that are listed before the rest is counted.
const LISTED: usize = 8;

/// Names of the files and folders in `folder`, sorted.
pub fn in_folder(folder: &Path) -> std::io::Result<Vec<String>> {
    let entries = std::fs::read_dir(folder)?.flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    Ok(names)
}

/// The content of `folder` for a message.
pub fn listing(folder: &Path) -> String {
    match in_folder(folder) {
        Err(error) if folder.is_dir() => error.to_string(),
        Err(_) => "no such folder".to_owned(),
        Ok(names) if names.is_empty() => "an empty folder".to_owned(),
        Ok(names) => list(&names),
    }
}

/// The names, or the first eight and how many more there are.
pub fn list(names: &[impl AsRef<str>]) -> String {
    list_up_to(LISTED, names)
}

/// The names, or the first `most` and how many more there are.
pub fn list_up_to(most: usize, names: &[impl AsRef<str>]) -> String {
    let listed: Vec<&str> = names.iter().take(most).map(AsRef::as_ref).collect();
    match names.len().saturating_sub(most) {
        0 => listed.join(", "),
        more => format!("{} and {more} more", listed.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lists_are_cut() {
        assert_eq!(list(&["a", "b"]), "a, b");
        let many: Vec<String> = (0..10).map(|number| number.to_string()).collect();
        assert_eq!(list(&many), "0, 1, 2, 3, 4, 5, 6, 7 and 2 more");
        assert_eq!(list(&many[..8]), "0, 1, 2, 3, 4, 5, 6, 7");
    }
}

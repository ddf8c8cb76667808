//! The user's data folder, where networks are found without being named.

use std::ffi::OsString;
use std::path::PathBuf;

use super::Network;

/// Where the file of `network` is looked for: `dpges/lpips/NETWORK.safetensors` in `XDG_DATA_HOME`, or in `.local/share` of
/// the home folder if that is unset or no absolute path. `None` without a home folder.
pub fn path(network: Network) -> Option<PathBuf> {
    let folder = data_folder(std::env::var_os("XDG_DATA_HOME"), std::env::home_dir())?;
    Some(folder.join("dpges/lpips").join(file_name(network)))
}

/// [`path`], if there is a file.
pub fn installed(network: Network) -> Option<PathBuf> {
    path(network).filter(|path| path.is_file())
}

/// Name of the file of `network` in the data folder.
pub fn file_name(network: Network) -> String {
    format!("{network}.safetensors")
}

/// After the XDG Base Directory Specification, which has relative paths ignored.
fn data_folder(xdg_data_home: Option<OsString>, home: Option<PathBuf>) -> Option<PathBuf> {
    let named = xdg_data_home.map(PathBuf::from).filter(|path| path.is_absolute());
    let of_home = || Some(home.filter(|home| !home.as_os_str().is_empty())?.join(".local/share"));
    named.or_else(of_home)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_data_folder_is_the_one_that_is_named_or_in_the_home_folder() {
        let folder = |named: Option<&str>, home: Option<&str>| data_folder(named.map(Into::into), home.map(Into::into));
        let absolute = std::env::temp_dir();
        assert_eq!(folder(absolute.to_str(), Some("/home/a")), Some(absolute));
        for named in [None, Some(""), Some("data")] {
            assert_eq!(folder(named, Some("/home/a")), Some("/home/a/.local/share".into()), "{named:?}");
            assert_eq!(folder(named, None), None, "{named:?}");
            assert_eq!(folder(named, Some("")), None, "{named:?}");
        }
    }
}

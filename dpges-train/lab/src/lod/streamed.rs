//! Levels of detail as splats: a folder of Streamed SOG.

use std::fs;
use std::path::Path;

use dpges_core::scene::{Rendering, SceneData};
use dpges_render::export::SplatCloud;
use dpges_render::export::sog::{INDEX, to_streamed_sog};
use dpges_train::eval::export::ExportFailure;

use super::{LodError, Options};

/// Checks that a scene of `rendering` has levels, and that `out` is absent, an empty folder, or an older export.
///
/// # Errors
/// [`LodError::NotPeeled`], [`LodError::Taken`].
pub fn check(rendering: Rendering, out: &Path) -> Result<(), LodError> {
    if rendering != Rendering::Peeled {
        return Err(LodError::NotPeeled(rendering));
    }
    let is_empty = || fs::read_dir(out).is_ok_and(|mut files| files.next().is_none());
    let is_free = !out.exists() || is_empty() || out.join(INDEX).is_file();
    if is_free { Ok(()) } else { Err(LodError::Taken(out.to_owned())) }
}

/// Writes `finest`, the splats of `scene`, and `splats` of its coarser levels of detail as the folder `out`, which appears when
/// it is complete. An older one takes its place until then. Leaves have at most `leaf_splats`. Returns what was written.
///
/// # Errors
/// Those of [`check`], [`LodError::Export`] from `splats`, [`LodError::Io`].
pub fn write(
    scene: &SceneData,
    finest: SplatCloud,
    splats: impl Fn(&SceneData) -> Result<SplatCloud, ExportFailure>,
    leaf_splats: usize,
    out: &Path,
) -> Result<Vec<(&'static str, String)>, LodError> {
    check(scene.info.rendering, out)?;
    let io = |source| LodError::Io { action: "cannot write", path: out.to_owned(), source };
    let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(io)?;
    let partial = tempfile::Builder::new().prefix(".dpges-sog-").tempdir_in(parent).map_err(io)?;
    let options = Options { cell_primitives: leaf_splats, cameras: &[], fit: None };
    let index = super::write(scene.clone(), &options, &partial.path().join("levels"))?;
    let mut levels = vec![finest];
    for level in 1..index.level_count() {
        levels.push(splats(&super::level(&index, level)?)?);
    }
    let files = to_streamed_sog(&levels, leaf_splats);
    let folder = partial.path().join("sog");
    for (path, bytes) in &files {
        let path = folder.join(path);
        fs::create_dir_all(path.parent().unwrap_or(&folder)).and_then(|()| fs::write(&path, bytes)).map_err(io)?;
    }
    if out.exists() {
        fs::rename(out, partial.path().join("old")).map_err(io)?;
    }
    fs::rename(&folder, out).map_err(io)?;
    let bytes: usize = files.iter().map(|(_, bytes)| bytes.len()).sum();
    let counts: Vec<String> = levels.iter().map(|level| level.len().to_string()).collect();
    Ok(vec![
        ("folder", out.display().to_string()),
        ("size", format!("{:.2} MB", bytes as f64 / 1e6)),
        ("levels", format!("{} splats", counts.join(", "))),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_folders_of_its_own_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("city");
        assert!(check(Rendering::Peeled, &out).is_ok() && check(Rendering::Peeled, folder.path()).is_ok());
        fs::create_dir(&out).unwrap();
        fs::write(out.join("notes.txt"), "mine").unwrap();
        assert!(check(Rendering::Peeled, &out).unwrap_err().to_string().contains("city is there already"));
        fs::write(out.join(INDEX), "{}").unwrap();
        assert!(check(Rendering::Peeled, &out).is_ok());
        assert!(matches!(check(Rendering::Ellipsoids, &out), Err(LodError::NotPeeled(_))));
    }
}

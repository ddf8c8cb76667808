//! A folder that any web server can serve: the browser viewer's page, a scene, a poster picture and cameras.
//!
//! The page is not part of the program, because it is built for another target. `dpges-render/web/build.sh` builds it. The
//! [`guide`](crate::guide) tells how it is used.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::scene::atomic::write_atomically;
use dpges_core::scene::lod;

use crate::error::RenderError;
use crate::path::CameraPath;

/// Names the folder of the built page where no option does.
pub const PAGE_VARIABLE: &str = "DPGES_WEB_PAGE";
const BESIDE_PROGRAM: &str = "dpges-web";
const BUILD_COMMAND: &str = "dpges-render/web/build.sh";

const INDEX: &str = "index.html";
const SCENE: &str = "scene.safetensors";
const POSTER: &str = "poster.jpg";
const CAMERAS: &str = "cameras.json";
/// Placeholders of `index.html` for the scene, the poster and the title.
const NO_SCENE: &str = r#"<meta name="dpges-scene" content="">"#;
const NO_POSTER: &str = r#"<meta name="dpges-poster" content="">"#;
const NO_TITLE: &str = "<title>dpges</title>";
const PACKAGE: &str = "pkg";

/// Errors of a page or of the folder it is written to.
#[derive(Debug, thiserror::Error)]
pub enum HtmlError {
    #[error(
        "the browser viewer is not built: none of {} has an {INDEX}. Run {BUILD_COMMAND}, or name the folder that it \
         wrote (--page, or the variable {PAGE_VARIABLE})",
        listed(.0)
    )]
    NoPage(Vec<PathBuf>),
    #[error("{path} is not of this version of the browser viewer: {missing} is missing. Run {BUILD_COMMAND} again", path = .path.display())]
    ForeignPage { path: PathBuf, missing: &'static str },
    #[error("{path} is the built page itself: choose another folder to write to", path = .0.display())]
    SameFolder(PathBuf),
    #[error("{action} {path}: {source}", path = .path.display())]
    Io { action: &'static str, path: PathBuf, source: io::Error },
    #[error(transparent)]
    Scene(#[from] RenderError),
    #[error(transparent)]
    Write(#[from] dpges_core::Error),
}

fn listed(folders: &[PathBuf]) -> String {
    folders.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// The parts of a page besides the scene.
#[derive(Clone, Copy, Debug, Default)]
pub struct Page<'a> {
    pub title: &'a str,
    /// A picture in the JPEG format, shown until the scene has been loaded.
    pub poster_jpeg: Option<&'a [u8]>,
    /// In the scene's coordinates. The page starts at the first, and takes its up direction from all if the scene has none.
    pub cameras: &'a [Camera],
}

/// A file that was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenFile {
    pub path: PathBuf,
    pub bytes: u64,
}

/// The folder of the built page: `given`, or that of the environment variable [`PAGE_VARIABLE`], or else the first that is
/// there of `dpges-web` beside the program and `dpges-render/web/dist` in the sources that the program was built from.
///
/// # Errors
/// [`HtmlError::NoPage`] with every folder that was looked at.
pub fn find_page(given: Option<&Path>) -> Result<PathBuf, HtmlError> {
    let named = given.map(Path::to_owned).or_else(|| std::env::var_os(PAGE_VARIABLE).map(PathBuf::from));
    let folders = match named {
        Some(folder) => vec![folder],
        None => {
            let program = std::env::current_exe().ok();
            let beside = program.and_then(|program| Some(program.parent()?.join(BESIDE_PROGRAM)));
            beside.into_iter().chain([Path::new(env!("CARGO_MANIFEST_DIR")).join("web/dist")]).collect()
        }
    };
    let found = folders.iter().find(|folder| folder.join(INDEX).is_file()).cloned();
    found.ok_or(HtmlError::NoPage(folders))
}

/// Writes to `folder`, which is created, the page built in `page_folder`, what `page` says, and `scene`; without it, the page
/// shows the scene in levels of detail whose index is in `folder`. Files of the same names are replaced; `index.html` comes last.
/// Returns the files.
///
/// # Errors
/// [`HtmlError::ForeignPage`] if `page_folder` has another page, [`HtmlError::SameFolder`], [`HtmlError::Io`], or [`HtmlError::Write`] if the scene is
/// not valid or the folder cannot be written.
pub fn write_html(
    folder: &Path,
    page_folder: &Path,
    scene: Option<&SceneData>,
    page: &Page,
) -> Result<Vec<WrittenFile>, HtmlError> {
    let shown = if scene.is_some() { SCENE } else { lod::INDEX };
    let index = filled_index(&page_folder.join(INDEX), page, shown)?;
    let package = page_folder.join(PACKAGE);
    let package_files = files_in(&package)?;
    if !package_files.iter().any(|path| path.extension().is_some_and(|extension| extension == "wasm")) {
        return Err(HtmlError::ForeignPage { path: package, missing: "the WebAssembly file" });
    }
    fs::create_dir_all(folder.join(PACKAGE)).map_err(failed("cannot create", folder))?;
    let canonical = |folder: &Path| folder.canonicalize().ok();
    if canonical(folder).is_some_and(|folder| canonical(page_folder) == Some(folder)) {
        return Err(HtmlError::SameFolder(folder.to_owned()));
    }
    let mut paths = Vec::new();
    let page_files = files_in(page_folder)?;
    for path in package_files.iter().chain(page_files.iter().filter(|path| !path.ends_with(INDEX))) {
        let bytes = fs::read(path).map_err(failed("cannot read", path))?;
        write(&mut paths, folder.join(path.strip_prefix(page_folder).unwrap_or(path)), &bytes)?;
    }
    if let Some(scene) = scene {
        scene.save(&folder.join(SCENE))?;
        paths.push(folder.join(SCENE));
    }
    if let Some(poster) = page.poster_jpeg {
        write(&mut paths, folder.join(POSTER), poster)?;
    }
    // Without cameras too: an older file would be taken for this scene's.
    let cameras = CameraPath::new(page.cameras.to_vec(), false).map_or_else(|_| "[]".to_owned(), |path| path.to_json());
    write(&mut paths, folder.join(CAMERAS), cameras.as_bytes())?;
    write(&mut paths, folder.join(INDEX), index.as_bytes())?;
    let written = |path: PathBuf| {
        let bytes = fs::metadata(&path).map_err(failed("cannot read", &path))?.len();
        Ok(WrittenFile { path, bytes })
    };
    paths.into_iter().map(written).collect()
}

fn write(paths: &mut Vec<PathBuf>, path: PathBuf, bytes: &[u8]) -> Result<(), HtmlError> {
    write_atomically(&path, |file| file.write_all(bytes))?;
    paths.push(path);
    Ok(())
}

/// The page's `index.html` with the names of the files, `scene` among them, and the title.
fn filled_index(path: &Path, page: &Page, scene: &str) -> Result<String, HtmlError> {
    let index = fs::read_to_string(path).map_err(failed("cannot read", path))?;
    if let Some(&missing) = [NO_SCENE, NO_POSTER, NO_TITLE].iter().find(|part| !index.contains(**part)) {
        return Err(HtmlError::ForeignPage { path: path.to_owned(), missing });
    }
    let named = |empty: &str, name: &str| empty.replace(r#"content="""#, &format!(r#"content="{name}""#));
    let poster = if page.poster_jpeg.is_some() { POSTER } else { "" };
    let title = if page.title.is_empty() { "dpges".to_owned() } else { escaped(page.title) };
    let index = index.replace(NO_SCENE, &named(NO_SCENE, scene)).replace(NO_POSTER, &named(NO_POSTER, poster));
    Ok(index.replace(NO_TITLE, &format!("<title>{title}</title>")))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Files in `folder`, not in folders of it, in the order of their names.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>, HtmlError> {
    let read = || -> io::Result<Vec<PathBuf>> {
        let entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
        Ok(entries.iter().map(fs::DirEntry::path).filter(|path| path.is_file()).collect())
    };
    let mut files = read().map_err(failed("cannot read", folder))?;
    files.sort();
    Ok(files)
}

fn failed(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> HtmlError {
    move |source| HtmlError::Io { action, path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::SceneInfo;

    use super::*;
    use crate::fixtures::{camera, neutral};

    fn scene() -> SceneData {
        neutral(SceneInfo { offset: [100.0, 0.0, -5.0], ..SceneInfo::default() }, [2, 3])
    }

    fn built_page(folder: &Path) {
        for path in files_in(&Path::new(env!("CARGO_MANIFEST_DIR")).join("web/page")).unwrap() {
            fs::copy(&path, folder.join(path.file_name().unwrap())).unwrap();
        }
        fs::create_dir(folder.join(PACKAGE)).unwrap();
        fs::write(folder.join(PACKAGE).join("dpges_web_bg.wasm"), b"\0asm").unwrap();
        fs::write(folder.join(PACKAGE).join("dpges_web.js"), b"export {}").unwrap();
    }

    #[test]
    fn a_folder_has_the_page_the_scene_the_poster_and_the_cameras() {
        let [built, out] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        built_page(built.path());
        let (folder, camera) = (out.path().join("new/page"), camera([1.0, 2.0, 3.0], 50.0));
        let page = Page { title: "Fox & <friends>", poster_jpeg: Some(b"jpeg"), cameras: &[camera] };
        let files = write_html(&folder, built.path(), Some(&scene()), &page).unwrap();
        assert!(files.iter().all(|file| fs::metadata(&file.path).unwrap().len() == file.bytes));
        assert!(files.last().unwrap().path.ends_with(INDEX));
        for name in ["viewer.js", "camera.js", "style.css", "pkg/dpges_web.js", "pkg/dpges_web_bg.wasm", POSTER] {
            assert!(files.iter().any(|file| file.path == folder.join(name)), "{name}");
        }
        assert_eq!(SceneData::load(&folder.join(SCENE)).unwrap(), scene());
        let index = fs::read_to_string(folder.join(INDEX)).unwrap();
        for part in [
            r#"<meta name="dpges-scene" content="scene.safetensors">"#,
            r#"<meta name="dpges-poster" content="poster.jpg">"#,
            "<title>Fox &amp; &lt;friends&gt;</title>",
        ] {
            assert!(index.contains(part), "{part}");
        }
        let cameras = CameraPath::load(&folder.join(CAMERAS), &scene().info).unwrap();
        assert!((cameras.keys()[0].centre() - camera.centre()).length() < 1e-12, "{cameras:?}");
        assert_eq!((cameras.keys()[0].fx, cameras.keys()[0].width), (50.0, 64));
        // beside the index of levels of detail
        let files = write_html(&folder, built.path(), None, &page).unwrap();
        assert!(files.iter().all(|file| !file.path.ends_with(SCENE)));
        let index = fs::read_to_string(folder.join(INDEX)).unwrap();
        assert!(index.contains(r#"<meta name="dpges-scene" content="index.json">"#));
    }

    #[test]
    fn a_page_that_is_missing_or_of_another_version_is_named() {
        let [built, out] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let missing = find_page(Some(built.path())).unwrap_err().to_string();
        assert!(missing.contains(&*built.path().to_string_lossy()) && missing.contains(BUILD_COMMAND), "{missing}");
        built_page(built.path());
        assert_eq!(find_page(Some(built.path())).unwrap(), built.path());
        let write = || write_html(out.path(), built.path(), Some(&scene()), &Page::default()).map(|_| ());
        write().unwrap();
        assert_eq!(fs::read(out.path().join(CAMERAS)).unwrap(), b"[]");
        assert!(!out.path().join(POSTER).exists());
        let itself = write_html(built.path(), built.path(), Some(&scene()), &Page::default()).unwrap_err().to_string();
        assert!(itself.contains("is the built page itself"), "{itself}");
        fs::remove_file(built.path().join("pkg/dpges_web_bg.wasm")).unwrap();
        assert!(write().unwrap_err().to_string().contains("WebAssembly"));
        fs::write(built.path().join(INDEX), "<title>dpges</title>").unwrap();
        assert!(write().unwrap_err().to_string().contains("dpges-scene"));
    }
}

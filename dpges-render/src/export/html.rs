//! A folder that any web server can serve: the browser viewer's page, a scene, a poster picture, views and a camera path; or
//! one file with all of them, which a browser opens from a disk.
//!
//! The page is not part of the program, because it is built for another target. `dpges-render/web/build.sh` builds it. The
//! [`guide`](crate::guide) tells how it is used.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use dpges_core::scene::SceneData;
use dpges_core::scene::atomic::write_atomically;
use dpges_core::scene::lod;
use flate2::Compression;
use flate2::write::GzEncoder;

use crate::error::RenderError;
use crate::path::{CameraPath, NamedCamera, to_json};

/// Names the folder of the built page where no option does.
pub const PAGE_VARIABLE: &str = "DPGES_WEB_PAGE";
const BESIDE_PROGRAM: &str = "dpges-web";
const BUILD_COMMAND: &str = "dpges-render/web/build.sh";

const INDEX: &str = "index.html";
const SCENE: &str = "scene.safetensors";
const POSTER: &str = "poster.jpg";
const CAMERAS: &str = "cameras.json";
const PATH: &str = "path.json";
/// Parts of `index.html` that are replaced.
const NO_SCENE: &str = r#"<meta name="dpges-scene" content="">"#;
const NO_POSTER: &str = r#"<meta name="dpges-poster" content="">"#;
const NO_PATH: &str = r#"<meta name="dpges-path" content="">"#;
const NO_TITLE: &str = "<title>dpges</title>";
const STYLE: &str = r#"<link rel="stylesheet" href="style.css">"#;
const PRELOAD: &str = "<link rel=\"modulepreload\" href=\"pkg/dpges_web.js\">\n";
const SCRIPT: &str = r#"<script type="module" src="viewer.js"></script>"#;
const PACKAGE: &str = "pkg";
/// Scripts that import from those before them, in a folder of the built page.
const MODULES: [&str; 4] = ["download.js", "levels.js", "controls.js", "pkg/dpges_web.js"];
const VIEWER: &str = "viewer.js";
const WASM: &str = "pkg/dpges_web_bg.wasm";

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
    /// In the scene's coordinates. The page starts at the first, lists all by name, and takes its up direction from them if the
    /// scene has none.
    pub views: &'a [NamedCamera],
    /// Played on demand, in the scene's coordinates.
    pub path: Option<&'a CameraPath>,
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
    let files =
        Places { scene: shown, poster: page.poster_jpeg.map_or("", |_| POSTER), path: page.path.map_or("", |_| PATH) };
    let index = filled_index(&page_folder.join(INDEX), page, &files)?;
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
    write(&mut paths, folder.join(CAMERAS), to_json(page.views).as_bytes())?;
    if let Some(path) = page.path {
        write(&mut paths, folder.join(PATH), path.to_json().as_bytes())?;
    }
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

/// Where the page finds what; empty where there is nothing.
struct Places<'a> {
    scene: &'a str,
    poster: &'a str,
    path: &'a str,
}

/// The page's `index.html` with the places of its parts, and the title.
fn filled_index(path: &Path, page: &Page, places: &Places) -> Result<String, HtmlError> {
    let index = read_text(path)?;
    let parts = [NO_SCENE, NO_POSTER, NO_PATH, NO_TITLE, STYLE, PRELOAD, SCRIPT];
    if let Some(&missing) = parts.iter().find(|part| !index.contains(**part)) {
        return Err(HtmlError::ForeignPage { path: path.to_owned(), missing });
    }
    let title = if page.title.is_empty() { "dpges".to_owned() } else { escaped(page.title) };
    let mut index = index.replace(NO_TITLE, &format!("<title>{title}</title>"));
    for (empty, place) in [(NO_SCENE, places.scene), (NO_POSTER, places.poster), (NO_PATH, places.path)] {
        index = index.replace(empty, &empty.replace(r#"content="""#, &format!(r#"content="{place}""#)));
    }
    Ok(index)
}

/// The page built in `page_folder` as one file that needs no other: `scene` holds the bytes of a scene file, whole or compressed.
///
/// # Errors
/// [`HtmlError::ForeignPage`] if `page_folder` has another page, or [`HtmlError::Io`].
pub fn single_file(page_folder: &Path, scene: &[u8], page: &Page) -> Result<String, HtmlError> {
    let poster = page.poster_jpeg.map_or_else(String::new, |bytes| data_url("image/jpeg", bytes));
    let places = Places { scene: "#scene", poster: &poster, path: page.path.map_or("", |_| "#path") };
    let index = filled_index(&page_folder.join(INDEX), page, &places)?;
    let style = read_text(&page_folder.join("style.css"))?.replace("</style", r"<\/style");
    let wasm = page_folder.join(WASM);
    let wasm = fs::read(&wasm).map_err(failed("cannot read", &wasm))?;
    let views = to_json(page.views);
    let mut contents = embedded("wasm", &wasm) + &embedded("scene", scene) + &embedded("cameras", views.as_bytes());
    if let Some(path) = page.path {
        contents += &embedded("path", path.to_json().as_bytes());
    }
    let script = inline_script(page_folder)?;
    let index = index.replace(STYLE, &format!("<style>\n{style}</style>")).replace(PRELOAD, "");
    Ok(index.replace(SCRIPT, &format!("{contents}<script type=\"module\">\n{script}</script>")))
}

/// The page's script, which imports the others from addresses that hold them: browsers load no modules from a disk.
fn inline_script(page_folder: &Path) -> Result<String, HtmlError> {
    let mut urls: Vec<(&str, String)> = Vec::new();
    let resolved = |name: &str, urls: &[(&str, String)]| -> Result<String, HtmlError> {
        let text = read_text(&page_folder.join(name))?;
        Ok(urls.iter().fold(text, |text, (name, url)| text.replace(&format!("\"./{name}\""), &format!("\"{url}\""))))
    };
    for name in MODULES {
        let text = resolved(name, &urls)?;
        urls.push((name, data_url("text/javascript", text.as_bytes())));
    }
    // in strings and templates of scripts, these mean the same
    Ok(resolved(VIEWER, &urls)?.replace("</script", r"<\/script").replace("<!--", r"<\!--"))
}

/// Content that the page's script finds by `name`, packed.
fn embedded(name: &str, bytes: &[u8]) -> String {
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(bytes).expect("memory takes all");
    let text = STANDARD.encode(packed.finish().expect("memory takes all"));
    format!("<script type=\"application/gzip\" id=\"file-{name}\">{text}</script>\n")
}

fn data_url(kind: &str, bytes: &[u8]) -> String {
    format!("data:{kind};base64,{}", STANDARD.encode(bytes))
}

fn read_text(path: &Path) -> Result<String, HtmlError> {
    fs::read_to_string(path).map_err(failed("cannot read", path))
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
    use std::io::Read;

    use dpges_core::scene::SceneInfo;

    use super::*;
    use crate::fixtures::{camera, neutral};
    use crate::path::load_cameras;

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
        let (views, path) = ([("door".to_owned(), camera)], CameraPath::new(vec![camera; 2], false).unwrap());
        let page = Page { title: "Fox & <friends>", poster_jpeg: Some(b"jpeg"), views: &views, path: Some(&path) };
        let files = write_html(&folder, built.path(), Some(&scene()), &page).unwrap();
        assert!(files.iter().all(|file| fs::metadata(&file.path).unwrap().len() == file.bytes));
        assert!(files.last().unwrap().path.ends_with(INDEX));
        for name in ["viewer.js", "controls.js", "style.css", "pkg/dpges_web.js", "pkg/dpges_web_bg.wasm", POSTER] {
            assert!(files.iter().any(|file| file.path == folder.join(name)), "{name}");
        }
        assert_eq!(SceneData::load(&folder.join(SCENE)).unwrap(), scene());
        let index = fs::read_to_string(folder.join(INDEX)).unwrap();
        for part in [
            r#"<meta name="dpges-scene" content="scene.safetensors">"#,
            r#"<meta name="dpges-poster" content="poster.jpg">"#,
            r#"<meta name="dpges-path" content="path.json">"#,
            "<title>Fox &amp; &lt;friends&gt;</title>",
        ] {
            assert!(index.contains(part), "{part}");
        }
        let found = load_cameras(&folder.join(CAMERAS), &scene().info).unwrap();
        let (name, found) = &found[0];
        assert!((found.centre() - camera.centre()).length() < 1e-12, "{found:?}");
        assert_eq!((name.as_str(), found.fx, found.width), ("door", 50.0, 64));
        assert_eq!(CameraPath::load(&folder.join(PATH), &scene().info).unwrap().keys().len(), 2);
        // beside the index of levels of detail
        let files = write_html(&folder, built.path(), None, &page).unwrap();
        assert!(files.iter().all(|file| !file.path.ends_with(SCENE)));
        let index = fs::read_to_string(folder.join(INDEX)).unwrap();
        assert!(index.contains(r#"<meta name="dpges-scene" content="index.json">"#));
    }

    /// The content that is embedded under `name`.
    fn unpacked(html: &str, name: &str) -> Vec<u8> {
        let (_, rest) = html.split_once(&format!(r#"id="file-{name}">"#)).unwrap();
        let packed = STANDARD.decode(rest.split_once("</script>").unwrap().0).unwrap();
        let mut bytes = Vec::new();
        flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn a_single_file_holds_everything_and_names_no_other() {
        let built = tempfile::tempdir().unwrap();
        built_page(built.path());
        let hostile = "export const a = \"</script><!--\"; import \"./download.js\";";
        let viewer = built.path().join(VIEWER);
        fs::write(&viewer, fs::read_to_string(&viewer).unwrap() + hostile).unwrap();
        let views = [("</script>".to_owned(), camera([1.0, 2.0, 3.0], 50.0))];
        let path = CameraPath::new(vec![views[0].1; 2], false).unwrap();
        let page = Page { title: "</title>", poster_jpeg: Some(b"jpeg"), views: &views, path: Some(&path) };
        let scene = scene().to_bytes("scene".as_ref()).unwrap();
        let html = single_file(built.path(), &scene, &page).unwrap();
        assert_eq!((unpacked(&html, "scene"), unpacked(&html, "wasm")), (scene, b"\0asm".to_vec()));
        assert_eq!(unpacked(&html, "cameras"), to_json(&views).into_bytes());
        assert_eq!(unpacked(&html, "path"), path.to_json().into_bytes());
        assert!(
            html.contains(r#"content="data:image/jpeg;base64,anBlZw==""#) && html.contains("<title>&lt;/title&gt;")
        );
        for part in ["href=", "src=", "from ", "import ", "import("] {
            for (at, _) in html.match_indices(part) {
                let rest = html[at + part.len()..].trim_start_matches(|c: char| c != '"' && c != '\n');
                assert!(!rest.starts_with("\"./") && !rest.starts_with("\"pkg"), "{part} at byte {at}");
            }
        }
        assert!(!html.contains(".css\""));
        // every script that begins also ends, and no text ends one early
        assert_eq!(html.matches("<script").count(), html.matches("</script>").count());
        assert!(html.contains(r#""<\/script><\!--""#) && html.trim_end().ends_with("</html>"));
        let others = single_file(built.path(), b"", &Page::default()).unwrap();
        assert!(!others.contains("file-path\">") && unpacked(&others, "scene").is_empty());
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

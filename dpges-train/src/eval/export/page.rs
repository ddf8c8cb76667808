//! A scene as a page for browsers, with a poster picture, views and a camera path.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use dpges_core::camera::Camera;
use dpges_core::scene::atomic::write_atomically;
use dpges_core::scene::{Quality, SceneData, SceneInfo};
use dpges_render::export::html::{HtmlError, Page, find_page, single_file, write_html};
use dpges_render::path::{CameraPath, NamedCamera, PathError, load_cameras};
use dpges_render::{Headless, RenderOptions, check_drawn};

use super::format::ExportFormat;
use crate::dataset::Dataset;
use crate::eval::compress::{CompressError, within_size};
use crate::eval::pictures::jpeg;
use crate::eval::rendered::scaled;

/// Longer side of the poster picture, px.
const POSTER_PX: usize = 1280;
const POSTER_QUALITY: u8 = 85;
/// Largest single file, bytes: what mail takes, and what a phone opens at once.
const LARGEST_FILE: usize = 25_000_000;
/// Share of a file by which packing may make what has no pattern longer.
const PACKING: f64 = 1e-3;
/// Views that an unknown name is answered with.
const NEAREST: usize = 3;

/// The parts of a page besides its scene.
#[derive(Clone, Debug, Default, Args)]
pub struct PageArgs {
    /// Folder of the browser viewer for html and lod, as dpges-render/web/build.sh builds it [default: DPGES_WEB_PAGE,
    /// dpges-web beside the program, or that of its sources]
    #[arg(long = "page", value_name = "DIR")]
    pub folder: Option<PathBuf>,
    /// One file in place of a folder for html, which opens by a double click; a scene that would make it larger than 25 MB is
    /// compressed
    #[arg(long)]
    pub single_file: bool,
    /// View that the page of html and lod opens at: a photograph, or a named camera of --path [default: the first]
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,
    /// Camera path that the page of html and lod plays, as the window saves it; its cameras with names are views
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    #[error(transparent)]
    Html(#[from] HtmlError),
    #[error(transparent)]
    Path(#[from] PathError),
    #[error("--view {name}: no view has this name{}", nearest_text(.nearest))]
    View { name: String, nearest: Vec<String> },
    #[error(
        "the scene does not fit into one file of {} MB, as --single-file writes it: at the lowest quality it has {:.1} MB, and \
         there is room for {:.1} MB. Leave --single-file out, which writes a folder for a web server, or train a scene of fewer \
         primitives (--budget)",
        LARGEST_FILE / 1_000_000, *.smallest as f64 / 1e6, *.largest as f64 / 1e6
    )]
    TooLarge { smallest: usize, largest: usize },
    #[error(transparent)]
    Scene(#[from] dpges_core::Error),
}

impl PageError {
    /// Whether it was asked for wrongly, and nothing failed.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::View { .. })
    }
}

fn nearest_text(nearest: &[String]) -> String {
    match nearest {
        [] => ": without the dataset there are no photographs, and --path FILE names no camera".to_owned(),
        names => format!(". The nearest are {}", names.join(", ")),
    }
}

impl PageArgs {
    /// Checks that `format` has what is asked for, and that `out` is called as it is.
    ///
    /// # Errors
    /// A sentence that names the option.
    pub fn check(&self, format: ExportFormat, out: &Path) -> Result<(), String> {
        let has_page = matches!(format, ExportFormat::Html | ExportFormat::Lod);
        let options = [("--view", self.view.is_some()), ("--path", self.path.is_some())];
        if let Some((option, _)) = options.iter().find(|(_, given)| *given && !has_page) {
            return Err(format!("{option} is for the page of --format html and lod: leave it out"));
        }
        if !self.single_file {
            return format.check_ending(out);
        }
        if format != ExportFormat::Html {
            return Err("--single-file is for --format html: leave it out".to_owned());
        }
        let is_html = out.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("html"));
        match is_html {
            true if out.is_dir() => {
                Err(format!("--single-file writes a file, and --out {} is a folder", out.display()))
            }
            true => Ok(()),
            false => Err(format!("--single-file writes a .html file: name --out {} so", out.display())),
        }
    }

    /// The views of `dataset` and of the path, the one to open first, and the path, in the coordinates of a scene.
    ///
    /// # Errors
    /// [`PageError::Path`], [`PageError::View`].
    pub fn tour(&self, dataset: Option<&Dataset>, info: &SceneInfo) -> Result<Tour, PageError> {
        let cameras = self.path.as_ref().map(|file| load_cameras(file, info)).transpose()?.unwrap_or_default();
        let path = CameraPath::new(cameras.iter().map(|(_, camera)| *camera).collect(), false).ok();
        if let (None, Some(file)) = (&path, &self.path) {
            return Err(PathError::File { path: file.clone(), reason: PathError::Empty.to_string() }.into());
        }
        // the window numbers cameras, which says nothing to a visitor
        let is_name = |name: &str| name.contains(|c: char| !c.is_ascii_digit());
        let named = cameras.into_iter().filter(|(name, _)| is_name(name));
        let of_dataset =
            dataset.into_iter().flat_map(|data| data.train.iter().chain(&data.validation).chain(&data.test));
        let mut views: Vec<NamedCamera> =
            named.chain(of_dataset.map(|view| (view.name.clone(), view.camera))).collect();
        if let Some(name) = &self.view {
            let found = views.iter().position(|(other, _)| other == name);
            let first = found.ok_or_else(|| PageError::View { name: name.clone(), nearest: nearest(name, &views) })?;
            views[..=first].rotate_right(1);
        }
        Ok(Tour { views, path })
    }
}

/// The names that are most like `name`.
fn nearest(name: &str, views: &[NamedCamera]) -> Vec<String> {
    let mut likest: Vec<_> = views.iter().map(|(known, _)| (strsim::jaro_winkler(name, known), known)).collect();
    likest.sort_by(|a, b| b.0.total_cmp(&a.0));
    likest.into_iter().take(NEAREST).map(|(_, known)| known.clone()).collect()
}

/// The cameras of a page, in the coordinates of its scene.
#[derive(Clone, Debug, Default)]
pub struct Tour {
    /// The first is that of the poster picture and of the first view.
    pub views: Vec<NamedCamera>,
    pub path: Option<CameraPath>,
}

impl Tour {
    fn page<'a>(&'a self, title: &'a str, poster_jpeg: Option<&'a [u8]>) -> Page<'a> {
        Page { title, poster_jpeg, views: &self.views, path: self.path.as_ref() }
    }
}

/// Writes `scene` and `tour` to `out`: a folder, or a single file. Returns what was written, as names and values.
///
/// # Errors
/// [`PageError`].
pub fn write(
    scene: &SceneData,
    tour: &Tour,
    args: &PageArgs,
    out: &Path,
) -> Result<Vec<(&'static str, String)>, PageError> {
    check_drawn(&scene.info).map_err(HtmlError::from)?;
    let built = find_page(args.folder.as_deref())?;
    let poster = tour.views.first().and_then(|(_, camera)| match poster(scene, camera) {
        Ok(poster) => Some(poster),
        Err(cause) => {
            tracing::warn!("the page has no poster picture: {cause}");
            None
        }
    });
    let name = if args.single_file { out.file_stem() } else { out.file_name() };
    let title = name.unwrap_or_default().to_string_lossy();
    let page = tour.page(&title, poster.as_deref());
    let mut rows = if args.single_file {
        write_file(scene, &built, &page, out)?
    } else {
        write_folder(scene, &built, &page, out)?
    };
    rows.push((
        "views",
        format!("{}{}", tour.views.len(), if tour.path.is_some() { ", and a camera path" } else { "" }),
    ));
    if tour.views.is_empty() {
        rows.push((
            "note",
            "without the dataset there are no cameras: the page looks at the scene from outside".into(),
        ));
    }
    Ok(rows)
}

fn write_folder(
    scene: &SceneData,
    built: &Path,
    page: &Page,
    out: &Path,
) -> Result<Vec<(&'static str, String)>, PageError> {
    let files = write_html(out, built, Some(scene), page)?;
    let bytes: u64 = files.iter().map(|file| file.bytes).sum();
    Ok(vec![
        ("folder", out.display().to_string()),
        ("size", format!("{} files, {:.2} MB", files.len(), bytes as f64 / 1e6)),
        ("to look at", format!("python3 -m http.server --directory {}, then http://localhost:8000", out.display())),
    ])
}

fn write_file(
    scene: &SceneData,
    built: &Path,
    page: &Page,
    out: &Path,
) -> Result<Vec<(&'static str, String)>, PageError> {
    let frame = single_file(built, &[], page)?.len();
    let (bytes, stored) = fitted(scene, LARGEST_FILE.saturating_sub(frame), out)?;
    let html = single_file(built, &bytes, page)?;
    write_atomically(out, |file| file.write_all(html.as_bytes()))?;
    Ok(vec![
        ("file", out.display().to_string()),
        ("size", format!("{:.2} MB", html.len() as f64 / 1e6)),
        ("scene", stored),
        ("to look at", "open it in a browser: a double click, or from any web server".to_owned()),
    ])
}

/// The bytes of `scene` for `room` bytes of text: as it is, or else at the best quality that fits; and how it is stored.
fn fitted(scene: &SceneData, room: usize, out: &Path) -> Result<(Vec<u8>, String), PageError> {
    // four letters stand for three bytes
    let largest = (room as f64 * 0.75 * (1.0 - PACKING)) as usize;
    let whole = scene.to_bytes(out)?;
    if whole.len() <= largest {
        return Ok((whole, "as it is".to_owned()));
    }
    match within_size(scene, largest, out) {
        Ok(fits) => {
            let (before, after) = (whole.len() as f64 / 1e6, fits.bytes.len() as f64 / 1e6);
            let level =
                Quality::LEVELS.iter().find(|(_, quality)| *quality == fits.quality).map_or("", |(name, _)| name);
            let stored = format!("compressed, quality {level}: {before:.1} MB → {after:.1} MB, to stay below 25 MB");
            Ok((fits.bytes, stored))
        }
        Err(CompressError::TooLarge { smallest, largest }) => Err(PageError::TooLarge { smallest, largest }),
        Err(CompressError::Scene(error)) => Err(error.into()),
        Err(CompressError::TooDifferent { .. }) => unreachable!("no loss is asked for"),
    }
}

/// Writes the page with `tour` beside the index of levels of detail in the folder `out`. Returns a row about it; without a page that
/// is built, and none named, there is only the row.
///
/// # Errors
/// [`PageError::Html`].
pub fn write_beside_levels(tour: &Tour, args: &PageArgs, out: &Path) -> Result<(&'static str, String), PageError> {
    let built = match find_page(args.folder.as_deref()) {
        Err(error @ HtmlError::NoPage(_)) if args.folder.is_none() => return Ok(("page", format!("none: {error}"))),
        built => built?,
    };
    write_html(out, &built, None, &tour.page(&out.file_name().unwrap_or_default().to_string_lossy(), None))?;
    Ok(("page", format!("{}, on a web server that serves ranges of bytes", out.join("index.html").display())))
}

/// The picture of `camera`, in the JPEG format.
fn poster(scene: &SceneData, camera: &Camera) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let camera = scaled(camera, POSTER_PX as f64 / camera.width.max(camera.height) as f64);
    let picture = Headless::new()?.picture(scene, &camera, &RenderOptions::from(&scene.info))?;
    Ok(jpeg(&picture, POSTER_QUALITY)?)
}

#[cfg(test)]
mod tests {
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;
    use crate::dataset::builtin;
    use crate::run::fixtures::options;

    #[test]
    fn options_of_a_page_are_refused_where_there_is_none() {
        let args = |single_file, view: Option<&str>| PageArgs {
            single_file,
            view: view.map(Into::into),
            ..PageArgs::default()
        };
        let refused = |args: &PageArgs, format, out: &str| args.check(format, out.as_ref()).unwrap_err();
        assert!(refused(&args(true, None), ExportFormat::Ply, "a.ply").contains("--single-file is for --format html"));
        assert!(refused(&args(true, None), ExportFormat::Lod, "a").contains("--single-file is for --format html"));
        assert!(refused(&args(true, None), ExportFormat::Html, "folder").contains("a .html file"));
        assert!(refused(&args(false, Some("a")), ExportFormat::Spz, "a.spz").contains("--view is for the page"));
        assert!(refused(&args(false, None), ExportFormat::Html, "a.html").contains("a folder"));
        assert_eq!(args(true, None).check(ExportFormat::Html, "a.html".as_ref()), Ok(()));
        assert_eq!(args(false, Some("a")).check(ExportFormat::Lod, "a".as_ref()), Ok(()));
    }

    #[test]
    fn the_view_that_is_named_comes_first_and_an_unknown_one_is_answered_with_the_nearest() {
        let (data, info) = (builtin(&options(4, [7, 1], 0)), SceneInfo::default());
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("path.json");
        let keys: Vec<NamedCamera> = data.train[..2].iter().map(|view| (view.name.clone(), view.camera)).collect();
        let named = [("00000".to_owned(), keys[0].1), ("entrance".to_owned(), keys[1].1)];
        std::fs::write(&file, dpges_render::path::to_json(&named)).unwrap();
        let args = PageArgs { path: Some(file.clone()), view: Some(data.train[1].name.clone()), ..PageArgs::default() };
        let tour = args.tour(Some(&data), &info).unwrap();
        assert_eq!((tour.views[0].0.as_str(), tour.views[1].0.as_str()), (data.train[1].name.as_str(), "entrance"));
        assert_eq!(tour.views.len(), 1 + data.train.len() + data.test.len() + data.validation.len());
        assert_eq!(tour.path.as_ref().unwrap().keys().len(), 2);
        let wrong = PageArgs { view: Some("entrnce".to_owned()), ..args.clone() };
        let error = wrong.tour(Some(&data), &info).unwrap_err().to_string();
        assert!(error.contains("--view entrnce") && error.contains("nearest are entrance, "), "{error}");
        let alone = PageArgs { path: None, ..wrong };
        assert!(alone.tour(None, &info).unwrap_err().to_string().contains("without the dataset"));
        for text in ["[]", "[{}]"] {
            std::fs::write(&file, text).unwrap();
            assert!(args.tour(Some(&data), &info).unwrap_err().to_string().contains("path.json"), "{text}");
        }
    }

    #[test]
    fn a_scene_is_stored_as_it_is_or_as_well_as_fits_or_refused_with_numbers() {
        let scene = random(1, &Recipe { surfels: 1000, gaussians: 1000, ..Recipe::default() }).into_scene().0;
        let out = Path::new("page.html");
        let whole = scene.to_bytes(out).unwrap();
        let (bytes, stored) = fitted(&scene, 2 * whole.len(), out).unwrap();
        assert_eq!((bytes, stored.as_str()), (whole.clone(), "as it is"));
        let (bytes, stored) = fitted(&scene, whole.len(), out).unwrap();
        assert!(bytes.len() <= whole.len() * 3 / 4 && stored.contains("quality highest"), "{stored}");
        SceneData::from_bytes(&bytes, "page").unwrap();
        let error = fitted(&scene, 1000, out).unwrap_err().to_string();
        assert!(error.contains("--single-file") && error.contains("25 MB"), "{error}");
    }
}

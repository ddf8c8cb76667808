//! A scene as a page for browsers, with a poster picture.

use std::path::Path;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::export::html::{HtmlError, Page, find_page, write_html};
use dpges_render::{Headless, RenderOptions, check_drawn};

use crate::eval::pictures::jpeg;
use crate::eval::rendered::scaled;

/// Longer side of the poster picture, px.
const POSTER_PX: usize = 1280;
const POSTER_QUALITY: u8 = 85;

/// Writes the folder `out` with the page built in `page` (see [`find_page`]), `scene`, and `cameras` in its coordinates.
/// The first is that of the poster picture and of the first view. Returns what was written, as names and values.
///
/// # Errors
/// The errors of [`check_drawn`], [`find_page`] and [`write_html`].
pub fn write(
    scene: &SceneData,
    cameras: &[Camera],
    title: &str,
    page: Option<&Path>,
    out: &Path,
) -> Result<Vec<(&'static str, String)>, HtmlError> {
    check_drawn(&scene.info)?;
    let built = find_page(page)?;
    let poster = cameras.first().and_then(|camera| match poster(scene, camera) {
        Ok(poster) => Some(poster),
        Err(cause) => {
            tracing::warn!("the page has no poster picture: {cause}");
            None
        }
    });
    let files = write_html(out, &built, Some(scene), &Page { title, poster_jpeg: poster.as_deref(), cameras })?;
    let bytes: u64 = files.iter().map(|file| file.bytes).sum();
    let mut rows = vec![
        ("folder", out.display().to_string()),
        ("size", format!("{} files, {:.2} MB", files.len(), bytes as f64 / 1e6)),
        ("to look at", format!("python3 -m http.server --directory {}, then http://localhost:8000", out.display())),
    ];
    if cameras.is_empty() {
        rows.push((
            "note",
            "without the dataset there are no cameras: the page looks at the scene from outside".into(),
        ));
    }
    Ok(rows)
}

/// Writes the page beside the index of levels of detail in the folder `out`, with the page built in `page` (see [`find_page`])
/// and `cameras`. Returns a row about it; without a page that is built, and none named, there is only the row.
///
/// # Errors
/// The errors of [`find_page`] and [`write_html`].
pub fn write_beside_levels(
    cameras: &[Camera],
    title: &str,
    page: Option<&Path>,
    out: &Path,
) -> Result<(&'static str, String), HtmlError> {
    let built = match find_page(page) {
        Err(error @ HtmlError::NoPage(_)) if page.is_none() => return Ok(("page", format!("none: {error}"))),
        built => built?,
    };
    write_html(out, &built, None, &Page { title, poster_jpeg: None, cameras })?;
    Ok(("page", format!("{}, on a web server that serves ranges of bytes", out.join("index.html").display())))
}

/// The picture of `camera`, in the JPEG format.
fn poster(scene: &SceneData, camera: &Camera) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let camera = scaled(camera, POSTER_PX as f64 / camera.width.max(camera.height) as f64);
    let picture = Headless::new()?.picture(scene, &camera, &RenderOptions::from(&scene.info))?;
    Ok(jpeg(&picture, POSTER_QUALITY)?)
}

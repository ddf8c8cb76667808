//! Cameras of Agisoft Metashape, exported as XML.
//!
//! Lenses are those of its user manual (appendix "Camera models"): a position (x', y') that is distorted as by OpenCV, but for p1 and
//! p2, which are the other way round, appears at `(w / 2 + cx + x' (f + b1) + y' b2, h / 2 + cy + y' f)`. Fisheyes are equidistant. The
//! `transform` of a camera maps camera, with axes of OpenCV, to chunk, that of a chunk or of its component chunk to world.

use std::collections::BTreeMap;
use std::path::Path;

use dpges_core::camera::{Distortion, Projection};
use glam::DVec3;
use roxmltree::{Document, Node};

use super::super::transforms::check_last_row;
use super::{Found, Optics, by_rows, numbers, refused};
use crate::error::{DatasetError, Result, read_text};
use crate::finding::{Kind, Notices};

/// Largest shift by pixels that are no rectangles that is left out, px, and that is not said.
const MOST_SHEAR_PX: f64 = 1.0;
const SILENT_SHEAR_PX: f64 = 0.05;

/// The cameras of the chunk and component with the most of them.
///
/// # Errors
/// [`DatasetError`] for XML that is cut short, numbers that are none and sensors that are neither frames nor equidistant fisheyes.
pub(super) fn read(path: &Path) -> Result<Found> {
    let text = read_text(path)?;
    let document = Document::parse(&text).map_err(|source| DatasetError::Xml { path: path.to_owned(), source })?;
    let mut found = Found::default();
    let mut off: Vec<&str> = Vec::new();
    // by the number of the chunk and the id of the component
    let mut parts: BTreeMap<(usize, &str), Vec<Node>> = BTreeMap::new();
    let chunks: Vec<Node> = document.descendants().filter(|node| node.has_tag_name("chunk")).collect();
    for (number, chunk) in chunks.iter().enumerate() {
        let cameras = child(*chunk, "cameras").into_iter().flat_map(|list| list.descendants());
        for camera in cameras.filter(|node| node.has_tag_name("camera")) {
            let label = camera.attribute("label").unwrap_or_default();
            let part = (number, camera.attribute("component_id").unwrap_or_default());
            match child(camera, "transform") {
                _ if matches!(camera.attribute("enabled"), Some("false" | "0")) => off.push(label),
                None => found.not_aligned.push(label.to_owned()),
                Some(_) => parts.entry(part).or_default().push(camera),
            }
        }
    }
    let Some((&part, _)) = parts.iter().rev().max_by_key(|(_, cameras)| cameras.len()) else { return Ok(found) };
    let cameras = parts.remove(&part).unwrap_or_default();
    let apart: Vec<&str> = parts.values().flatten().filter_map(|camera| camera.attribute("label")).collect();
    let advice = "merge chunks and align their cameras together to use all";
    found.notices.add_names(Kind::Unused, "cameras of other chunks or components are left out", &apart, advice);
    found.notices.add_names(Kind::Aside, "cameras that are not enabled are left out", &off, "enable them to use all");

    let chunk = chunks[part.0];
    let component = child(chunk, "components").into_iter().flat_map(|list| list.children());
    let component = component.filter(|node| node.attribute("id") == Some(part.1));
    let placed = component.chain([chunk]).find_map(|node| child(node, "transform"));
    let placed = |name: &str, or: &'static str| placed.and_then(|node| child_text(node, name)).unwrap_or(or);
    let turn = by_rows(numbers(path, "the rotation of the chunk", placed("rotation", "1 0 0 0 1 0 0 0 1"))?);
    let shift: [f64; 3] = numbers(path, "the translation of the chunk", placed("translation", "0 0 0"))?;
    let [scale] = numbers(path, "the scale of the chunk", placed("scale", "1"))?;
    if scale <= 0.0 {
        return Err(DatasetError::malformed(path, "the scale of the chunk".to_owned(), scale, "a positive number"));
    }
    let sensors = child(chunk, "sensors").into_iter().flat_map(|list| list.children());
    let sensors: BTreeMap<&str, Node> = sensors.filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let mut optics: BTreeMap<&str, Optics> = BTreeMap::new();
    for camera in cameras {
        let label = camera.attribute("label").unwrap_or_default();
        let id = camera.attribute("sensor_id").unwrap_or_default();
        let sensor = sensors.get(id).ok_or_else(|| {
            let what = format!("the sensor of camera `{label}`");
            DatasetError::malformed(path, what, format!("`{id}`, which is not there"), "the id of a sensor")
        })?;
        let optics = match optics.get(id) {
            Some(optics) => *optics,
            None => *optics.entry(id).or_insert(sensor_optics(path, *sensor, &mut found.notices)?),
        };
        let of = format!("the transform of camera `{label}`");
        let [xx, xy, xz, x, yx, yy, yz, y, zx, zy, zz, z, last @ ..]: [f64; 16] =
            numbers(path, &of, child_text(camera, "transform").unwrap_or(""))?;
        check_last_row(path, &of, &last)?;
        let rotation = turn * by_rows([xx, xy, xz, yx, yy, yz, zx, zy, zz]);
        let centre = scale * (turn * DVec3::new(x, y, z)) + DVec3::from(shift);
        found.add(path, label.to_owned(), rotation, centre, optics)?;
    }
    Ok(found)
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn child_text<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    child(node, name).and_then(|child| child.text())
}

fn sensor_optics(path: &Path, sensor: Node, notices: &mut Notices) -> Result<Optics> {
    let label = sensor.attribute("label").or(sensor.attribute("id")).unwrap_or_default();
    let refused = |kind: &str, reason| Err(refused(path, format!("sensor `{label}`"), kind, reason));
    let calibrations = || sensor.children().filter(|node| node.has_tag_name("calibration"));
    let adjusted = calibrations().find(|node| node.attribute("class") == Some("adjusted"));
    let calibration = adjusted.or_else(|| calibrations().next());
    let kind = calibration.and_then(|node| node.attribute("type")).or(sensor.attribute("type")).unwrap_or("frame");
    let resolution = calibration.and_then(|node| child(node, "resolution")).or_else(|| child(sensor, "resolution"));
    let side = |name: &str| resolution.and_then(|node| node.attribute(name)).and_then(|text| text.parse().ok());
    let size: Option<[usize; 2]> = side("width").zip(side("height")).map(<[usize; 2]>::from);
    let projection = match kind {
        "frame" => Projection::Perspective,
        "fisheye" | "equidistant_fisheye" => Projection::Equidistant,
        "spherical" => return Ok(Optics::panorama(size)),
        _ => return refused(kind, "only `frame`, the equidistant `fisheye` and `spherical` are read"),
    };
    let text = |name: &str| calibration.and_then(|node| child_text(node, name));
    let number = |name: &str| match text(name) {
        None => Ok(0.0),
        Some(text) => numbers(path, &format!("`{name}` of sensor `{label}`"), text).map(|[number]| number),
    };
    if number("p3")? != 0.0 || number("p4")? != 0.0 {
        return refused(kind, "its tangential coefficients p3 and p4 are not read; calibrate without them");
    }
    let (f, cx, cy) = (number("f")?, number("cx")?, number("cy")?);
    if f <= 0.0 {
        let what = format!("`f` of sensor `{label}`");
        return Err(DatasetError::malformed(path, what, text("f").unwrap_or("not there"), "a focal length, px"));
    }
    let height = size.map_or(f, |[_, height]| height as f64);
    let shear_px = 0.5 * height / f * number("b2")?.abs();
    if shear_px > MOST_SHEAR_PX {
        return refused(kind, "its pixels are no rectangles; optimise the cameras without b2");
    } else if shear_px > SILENT_SHEAR_PX {
        let message = format!("`b2` of sensor `{label}`, up to {shear_px:.2} px, is left out");
        notices.add(Kind::Changed, message, "optimise the cameras without b2 to be exact");
    }
    let distortion = Distortion {
        numerator: [number("k1")?, number("k2")?, number("k3")?, number("k4")?, 0.0, 0.0],
        tangential: [number("p2")?, number("p1")?],
        ..Distortion::new(projection)
    };
    let focal = [f + number("b1")?, f];
    Ok(Optics { focal, centre: [cx, cy], is_in_sides: false, distortion: Some(distortion), size })
}

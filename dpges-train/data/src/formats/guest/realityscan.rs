//! Cameras of RealityScan, once RealityCapture: the CSV "Internal/External camera parameters", or an XMP file for each photograph.
//!
//! Conventions are those of Epic's "Camera Geometry in RealityScan". Lengths are in longer sides of the picture, in 36ths of them
//! where they are called 35 mm equivalents, and the principal point is seen from the middle of the picture. Heading, pitch and roll
//! (ZYX) turn a body from north, east and down; the camera looks down from it, its upper side to the front. Coefficients t1 and t2
//! are p₂ and p₁ of OpenCV.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use dpges_core::camera::{Distortion, Projection};
use glam::{DMat3, DVec3};
use roxmltree::Document;

use super::{Found, Optics, by_rows, numbers, refused};
use crate::conventions::{OF_REALITYSCAN, columns_of_realityscan};
use crate::error::{DatasetError, Result, read_text};

/// Length of the longer side of a 35 mm film, in which focal lengths are given.
const FILM_MM: f64 = 36.0;
const NAMESPACE: &str = "http://www.capturingreality.com/ns/xcr/1.1#";

/// The lens of a focal length, a principal point and the coefficients k1 to k4, t1 and t2.
fn optics(focal_mm: f64, centre: [f64; 2], [k1, k2, k3, k4, t1, t2]: [f64; 6]) -> Optics {
    let distortion = Distortion {
        numerator: [k1, k2, k3, k4, 0.0, 0.0],
        tangential: [t2, t1],
        ..Distortion::new(Projection::Perspective)
    };
    Optics { focal: [focal_mm / FILM_MM; 2], centre, is_in_sides: true, distortion: Some(distortion), size: None }
}

/// The cameras of a CSV file.
///
/// # Errors
/// [`DatasetError::Malformed`] for missing columns and values that are no numbers, with the line.
pub(super) fn read(path: &Path) -> Result<Found> {
    let text = read_text(path)?;
    let mut lines = text.lines().zip(1..).filter(|(line, _)| !line.trim().is_empty());
    let (heads, part) = lines.by_ref().find_map(|(line, _)| columns_of_realityscan(line)).unwrap_or_default();
    let columns: HashMap<&str, usize> = heads.iter().map(String::as_str).zip(0..).collect();
    let missing: Vec<&str> = OF_REALITYSCAN.into_iter().filter(|name| !columns.contains_key(name)).collect();
    if !missing.is_empty() {
        let expected = "those of the export \"Internal/External camera parameters\"";
        return Err(DatasetError::malformed(
            path,
            "the header".to_owned(),
            format!("without {}", missing.join(", ")),
            expected,
        ));
    }
    let mut found = Found::default();
    for (line, number) in lines.filter(|(line, _)| !line.starts_with('#')) {
        let values: Vec<&str> = line.split(part).map(|value| value.trim().trim_matches('"')).collect();
        if values.len() != columns.len() {
            let expected = format!("{} values", columns.len());
            return Err(DatasetError::malformed(path, format!("line {number}"), format!("`{line}`"), expected));
        }
        let value = |name: &str| match columns.get(name).map(|&at| values[at]) {
            None => Ok(0.0),
            Some(text) => numbers(path, &format!("{name} in line {number}"), text).map(|[value]| value),
        };
        let centre = DVec3::new(value("x")?, value("y")?, value("alt")?);
        let [heading, pitch, roll] = [value("heading")?, value("pitch")?, value("roll")?].map(f64::to_radians);
        // a body with axes to the front, to the right and down, which at first point north, east and down
        let body = DMat3::from_rotation_z(heading) * DMat3::from_rotation_y(pitch) * DMat3::from_rotation_x(roll);
        let world_from_body = DMat3::from_cols(DVec3::Y, DVec3::X, -DVec3::Z) * body;
        let body_from_camera = DMat3::from_cols(DVec3::Y, -DVec3::X, DVec3::Z);
        let bent = [value("k1")?, value("k2")?, value("k3")?, value("k4")?, value("t1")?, value("t2")?];
        let optics = optics(value("f")?, [value("px")?, value("py")?], bent);
        found.add(path, values[columns["name"]].to_owned(), world_from_body * body_from_camera, centre, optics)?;
    }
    Ok(found)
}

/// The cameras of XMP files beside photographs below `root`, which are called as they are.
///
/// # Errors
/// [`DatasetError`] for XML that is cut short, numbers that are none and lenses other than those of Brown.
pub(super) fn read_sidecars(root: &Path, files: &[PathBuf]) -> Result<Found> {
    let mut found = Found::default();
    for path in files {
        let name = path.strip_prefix(root).unwrap_or(path).with_extension("").to_string_lossy().into_owned();
        let text = read_text(path)?;
        let document = Document::parse(&text).map_err(|source| DatasetError::Xml { path: path.clone(), source })?;
        // an attribute or an element
        let value = |name: &str| {
            document.descendants().find_map(|node| {
                let is_it = node.has_tag_name((NAMESPACE, name));
                node.attribute((NAMESPACE, name)).or(node.text().filter(|_| is_it)).map(str::to_owned)
            })
        };
        let number = |name: &str, or: f64| match value(name) {
            None => Ok(or),
            Some(text) => numbers(path, name, &text).map(|[number]| number),
        };
        let (Some(rotation), Some(position)) = (value("Rotation"), value("Position")) else {
            found.not_aligned.push(name);
            continue;
        };
        let rotation = by_rows(numbers(path, "Rotation", &rotation)?);
        let position: [f64; 3] = numbers(path, "Position", &position)?;
        let model = value("DistortionModel").unwrap_or_else(|| "none".to_owned());
        let are_square = number("AspectRatio", 1.0)? == 1.0 && number("Skew", 0.0)? == 0.0;
        let is_brown = ["brown3", "brown4", "brown3t2", "brown4t2"].contains(&model.as_str());
        if !are_square || !is_brown && !["none", "perspective"].contains(&model.as_str()) {
            let reason = "only square pixels and lenses of Brown are read; choose them before alignment";
            return Err(refused(path, format!("photograph `{name}`"), &model, reason));
        }
        let bent = value("DistortionCoeficients").filter(|_| is_brown).unwrap_or_else(|| "0 0 0 0 0 0".to_owned());
        let bent = numbers(path, "DistortionCoeficients", &bent)?;
        let centre = [number("PrincipalPointU", 0.0)?, number("PrincipalPointV", 0.0)?];
        let optics = optics(number("FocalLength35mm", 0.0)?, centre, bent);
        found.add(path, name, rotation.transpose(), position.into(), optics)?;
    }
    Ok(found)
}

//! `reconstruction.json` of OpenSfM and OpenDroneMap (<https://opensfm.org/docs/dataset.html>), with `tracks.csv` beside it.
//!
//! Lengths are in longer sides of the picture, from its middle; camera axes and coefficients are those of OpenCV. Shots have the
//! rotation vector and the translation from world to camera.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use dpges_core::camera::{Distortion, Projection};
use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;
use serde_json::Value;

use super::{Found, Optics, refused};
use crate::Tracks;
use crate::error::{DatasetError, Result, not_json, read_text};
use crate::finding::Kind;
use crate::formats::source::RawPoints;

#[derive(Deserialize)]
struct Reconstruction {
    cameras: BTreeMap<String, HashMap<String, Value>>,
    shots: BTreeMap<String, Shot>,
    #[serde(default)]
    points: BTreeMap<String, Point>,
}

#[derive(Deserialize)]
struct Shot {
    camera: String,
    rotation: [f64; 3],
    translation: [f64; 3],
}

#[derive(Deserialize)]
struct Point {
    coordinates: [f64; 3],
    /// 0..255.
    color: [f32; 3],
}

/// The cameras and points of the reconstruction with the most shots.
///
/// # Errors
/// [`DatasetError`] for JSON that is cut short, and for unknown lenses.
pub(super) fn read(path: &Path) -> Result<Found> {
    let text = read_text(path)?;
    let mut all: Vec<Reconstruction> = serde_json::from_str(&text).map_err(|error| not_json(path, &text, &error))?;
    let largest = (0..all.len()).rev().max_by_key(|&index| all[index].shots.len());
    let mut found = Found::default();
    let Some(largest) = largest else { return Ok(found) };
    let Reconstruction { cameras, shots, points } = all.swap_remove(largest);
    let others: Vec<&String> = all.iter().flat_map(|other| other.shots.keys()).collect();
    let what = format!("photographs of {} smaller reconstructions are left out", all.len());
    found.notices.add_names(Kind::Unused, &what, &others, "find more matches between the parts to use all");
    let names: Vec<String> = shots.keys().cloned().collect();
    for (name, shot) in shots {
        let camera = cameras.get(&shot.camera).ok_or_else(|| {
            let what = format!("the camera of shot `{name}`");
            DatasetError::malformed(path, what, format!("`{}`, which is not there", shot.camera), "one of `cameras`")
        })?;
        let optics = optics(path, &shot.camera, camera)?;
        let camera_from_world = DMat3::from_quat(DQuat::from_scaled_axis(shot.rotation.into()));
        let world_from_camera = camera_from_world.transpose();
        let centre = -(world_from_camera * DVec3::from(shot.translation));
        found.add(path, name, world_from_camera, centre, optics)?;
    }
    let seen_by = tracks(path, &names, &points, &mut found)?;
    let colour = |point: &Point| point.color.map(|channel| (channel / 255.0).clamp(0.0, 1.0));
    let (positions, colours) = points.values().map(|point| (DVec3::from(point.coordinates), colour(point))).unzip();
    found.points = RawPoints { positions, colours, seen_by };
    Ok(found)
}

/// The shots that saw each of the points, by the file of tracks beside `path`; none without one.
fn tracks(path: &Path, names: &[String], points: &BTreeMap<String, Point>, found: &mut Found) -> Result<Tracks> {
    let path = path.with_file_name("tracks.csv");
    if !path.is_file() {
        return Ok(Tracks::default());
    }
    let text = read_text(&path)?;
    let shots: HashMap<&str, u32> = names.iter().map(String::as_str).zip(0..).collect();
    let mut views: HashMap<&str, Vec<u32>> = HashMap::new();
    for line in text.lines().filter(|line| !line.starts_with("OPENSFM_TRACKS_VERSION")) {
        let mut words = line.split('\t');
        if let (Some(shot), Some(track)) = (words.next(), words.next())
            && points.contains_key(track)
        {
            views.entry(track).or_default().extend(shots.get(shot));
        }
    }
    found.used.push(path);
    Ok(points.keys().map(|point| views.remove(point.as_str()).unwrap_or_default()).collect())
}

fn optics(path: &Path, id: &str, camera: &HashMap<String, Value>) -> Result<Optics> {
    // what is no number is refused with the camera
    let number = |name: &str| camera.get(name).map_or(0.0, |value| value.as_f64().unwrap_or(f64::NAN));
    let model = camera.get("projection_type").and_then(Value::as_str).unwrap_or("perspective");
    let size = ["width", "height"].map(|side| number(side) as usize);
    let size = Some(size).filter(|sides| sides.iter().all(|&side| side > 0));
    let projection = match model {
        "perspective" | "brown" | "radial" | "simple_radial" => Projection::Perspective,
        "fisheye" | "fisheye_opencv" | "fisheye62" => Projection::Equidistant,
        "spherical" | "equirectangular" => return Ok(Optics::panorama(size)),
        _ => {
            let reason = "only perspective and equidistant ones and panoramas are read";
            return Err(refused(path, format!("camera `{id}`"), model, reason));
        }
    };
    let focal = match model {
        "perspective" | "fisheye" => [number("focal"); 2],
        _ => [number("focal_x"), number("focal_y")],
    };
    let distortion = Distortion {
        numerator: ["k1", "k2", "k3", "k4", "k5", "k6"].map(number),
        tangential: ["p1", "p2"].map(number),
        ..Distortion::new(projection)
    };
    Ok(Optics { focal, centre: ["c_x", "c_y"].map(number), is_in_sides: true, distortion: Some(distortion), size })
}

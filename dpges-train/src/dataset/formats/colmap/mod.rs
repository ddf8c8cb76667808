//! COLMAP's sparse models, binary and text (<https://colmap.github.io/format.html>).
//!
//! A dataset has `images/` beside `sparse/`. The model lies in `sparse/0`, in `sparse` itself, or, if mapping produced
//! several models, in the `sparse/N` with the most registered images.

mod binary;
mod camera_model;
mod text;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dpges_core::camera::CameraFromWorld;
use glam::DVec3;

use self::camera_model::CameraRecord;
use super::source::{Frame, RawPoints, Source};
use super::split;
use crate::dataset::error::{DatasetError, Result, unreadable};
use crate::dataset::names::listing;
use crate::dataset::{Format, LoadOptions, Tracks};

/// A registered image.
#[derive(Clone, Debug, PartialEq)]
struct ImageRecord {
    id: u32,
    camera_id: u32,
    /// Path within the images folder.
    name: String,
    /// Unit quaternion (w, x, y, z) and translation, world to camera.
    wxyz: [f64; 4],
    translation: [f64; 3],
}

/// A triangulated point.
#[derive(Clone, Debug, PartialEq)]
struct PointRecord {
    position: [f64; 3],
    rgb: [u8; 3],
    /// Ids of the images that observe it, one per observation.
    track: Vec<u32>,
}

/// The views and points of the COLMAP dataset in folder `root`.
///
/// # Errors
/// [`DatasetError`] for files that are missing, truncated or malformed, for unknown lenses, for a model without points.
pub(in crate::dataset) fn read(root: &Path, options: &LoadOptions) -> Result<Source> {
    let sparse = root.join("sparse");
    let (model, mut images) = largest_model(&sparse)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let described_in = file(&model, "images")?;
    let frames = frames(root, &model, &described_in, &images, options)?;
    let points = points(&model, &images)?;
    Ok(Source {
        format: Format::Colmap,
        frames,
        points,
        described_in,
        no_test_reason: "test.txt names no registered image",
    })
}

/// The content of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ModelContent {
    /// Names of the registered images, sorted.
    pub images: Vec<String>,
    pub points: usize,
}

/// The content of the model in folder `model`.
///
/// # Errors
/// [`DatasetError`] for files that are missing, truncated or malformed.
pub(crate) fn model_content(model: &Path) -> Result<ModelContent> {
    let mut images: Vec<String> = images(model)?.into_iter().map(|image| image.name).collect();
    images.sort();
    let mut points = 0;
    for record in records(&file(model, "points3D")?)?.records {
        record?;
        points += 1;
    }
    Ok(ModelContent { images, points })
}

/// The points of a file, read one by one: a large capture has gigabytes of them.
struct PointRecords<'a> {
    /// Their number, as far as it is known beforehand.
    count: usize,
    /// Likewise that of their observations.
    observations: usize,
    records: Box<dyn Iterator<Item = Result<PointRecord>> + 'a>,
}

fn records(path: &Path) -> Result<PointRecords<'_>> {
    if is_binary(path) { binary::points(path) } else { text::points(path) }
}

fn images(model: &Path) -> Result<Vec<ImageRecord>> {
    let path = file(model, "images")?;
    if is_binary(&path) { binary::images(&path) } else { text::images(&path) }
}

/// `stem`.bin in the model's folder, or else `stem`.txt.
fn file(model: &Path, stem: &str) -> Result<PathBuf> {
    let (binary, text) = (model.join(format!("{stem}.bin")), model.join(format!("{stem}.txt")));
    match (binary.is_file(), text.is_file()) {
        (true, _) => Ok(binary),
        (false, true) => Ok(text),
        (false, false) => Err(DatasetError::MissingModelFile { path: binary, alternative: "its .txt twin" }),
    }
}

fn is_binary(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "bin")
}

fn largest_model(sparse: &Path) -> Result<(PathBuf, Vec<ImageRecord>)> {
    let holds_model =
        |folder: &PathBuf| ["bin", "txt"].iter().any(|ext| folder.join("cameras").with_extension(ext).is_file());
    let mut folders: Vec<PathBuf> = std::fs::read_dir(sparse)
        .map_err(unreadable(sparse))?
        .flatten()
        .map(|entry| entry.path())
        .chain([sparse.to_owned()])
        .filter(holds_model)
        .collect();
    folders.sort();
    let mut largest: Option<(PathBuf, Vec<ImageRecord>)> = None;
    for folder in folders {
        let images = images(&folder)?;
        if largest.as_ref().is_none_or(|(_, most)| images.len() > most.len()) {
            largest = Some((folder, images));
        }
    }
    largest.ok_or_else(|| DatasetError::NoModel { path: sparse.to_owned(), found: listing(sparse) })
}

fn frames(
    root: &Path,
    model: &Path,
    described_in: &Path,
    images: &[ImageRecord],
    options: &LoadOptions,
) -> Result<Vec<Frame>> {
    let cameras_path = file(model, "cameras")?;
    let records =
        if is_binary(&cameras_path) { binary::cameras(&cameras_path)? } else { text::cameras(&cameras_path)? };
    let cameras: BTreeMap<u32, CameraRecord> = records.into_iter().map(|camera| (camera.id, camera)).collect();
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    let splits = match split::from_lists(&[root, &root.join("sparse"), model], &names)? {
        Some(splits) => splits,
        None => split::every_nth(images.len(), options.test_every),
    };
    images
        .iter()
        .zip(splits)
        .map(|(image, split)| {
            let camera = cameras.get(&image.camera_id).ok_or_else(|| {
                let what = format!("the camera of image `{}`", image.name);
                let found = format!("{}, which {} does not hold", image.camera_id, cameras_path.display());
                DatasetError::malformed(described_in, what, found, "the id of a camera")
            })?;
            let camera_from_world = CameraFromWorld::from_quaternion(image.wxyz, image.translation.into());
            Ok(Frame {
                name: image.name.clone(),
                image: root.join("images").join(&image.name),
                mask: None,
                camera: camera.camera(&cameras_path, camera_from_world)?,
                split,
                described_in: described_in.to_owned(),
                depth: None,
            })
        })
        .collect()
}

fn points(model: &Path, images: &[ImageRecord]) -> Result<RawPoints> {
    let path = file(model, "points3D")?;
    let PointRecords { count, observations, records } = records(&path)?;
    let frame_of: BTreeMap<u32, u32> = images.iter().zip(0..).map(|(image, index)| (image.id, index)).collect();
    let (positions, colours) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let mut points = RawPoints { positions, colours, seen_by: Tracks::with_room(count, observations) };
    for (index, record) in records.enumerate() {
        let record = record?;
        let position = DVec3::from_array(record.position);
        if !position.as_vec3().is_finite() {
            let what = format!("the position of point {index}");
            return Err(DatasetError::malformed(&path, what, position, "finite coordinates"));
        }
        points.positions.push(position);
        points.colours.push(record.rgb.map(|channel| f32::from(channel) / 255.0));
        points.seen_by.push(record.track.iter().filter_map(|image| frame_of.get(image).copied()));
    }
    if points.positions.is_empty() {
        return Err(DatasetError::NoPoints { path });
    }
    Ok(points)
}

#[cfg(test)]
mod tests;

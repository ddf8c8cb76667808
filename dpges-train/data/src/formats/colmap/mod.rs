//! COLMAP's sparse models, binary and text (<https://colmap.github.io/format.html>).
//!
//! A dataset has `images/` beside `sparse/`; of several such folders the nearest above the model counts. The model lies in
//! `sparse/0`, in `sparse` itself, or, if mapping produced several models, in the `sparse/N` with the most registered images.
//! `images` has the pose of every camera of a rig, so that `rigs` and `frames` are not needed.

mod binary;
mod camera_model;
mod radial_fit;
mod text;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::DVec3;

use self::camera_model::CameraRecord;
use super::source::{Frame, PanoramaPart, RawPoints, Source, check_twins};
use super::{held_out, ply};
use crate::check::median;
use crate::error::{DatasetError, Result};
use crate::finding::Kind;
use crate::folder::Folder;
use crate::layout::Layout;
use crate::names::listing;
use crate::{Format, LoadOptions, Tracks};

/// Difference from 1 of the length of a quaternion that is said.
const MOST_SCALED: f64 = 1e-2;
/// Names of the files of a model.
const STEMS: [&str; 3] = ["cameras", "images", "points3D"];
/// Keypoints of an image by which its camera is judged: at least, at most.
const FEWEST_OBSERVED: usize = 16;
const MOST_OBSERVED: usize = 256;

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
    /// Some of its keypoints that are points: id of the point, position, px.
    observed: Vec<(u64, [f64; 2])>,
}

/// A triangulated point.
#[derive(Clone, Debug, PartialEq)]
struct PointRecord {
    id: u64,
    position: [f64; 3],
    rgb: [u8; 3],
    /// Ids of the images that observe it, one per observation.
    track: Vec<u32>,
}

/// The views and points of a COLMAP dataset with these `models`, of which the one with the most images is used.
///
/// # Errors
/// [`DatasetError`] for files that are missing, truncated or malformed, for unknown lenses.
pub(crate) fn read(layout: &Layout, models: &[PathBuf], options: &LoadOptions) -> Result<Source> {
    let root = &layout.folder.root;
    let (model, mut images) = largest_model(models, root)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let described_in = file(&model, "images")?;
    let mut source = Source::new(Format::Colmap, described_in, "test.txt names no registered image");
    let [used, other] = encodings(&model);
    let twins = STEMS.map(|stem| model.join(format!("{stem}.{other}")));
    let twins: Vec<PathBuf> = twins.into_iter().filter(|path| path.is_file()).collect();
    let advice = "remove those that are out of date";
    let what = format!("files of a model in another encoding are not used, those in .{used} are");
    source.notices.add_files(Kind::Aside, &what, root, &twins, advice);
    let scaled = images.iter().filter_map(|image| {
        let scale = image.wxyz.iter().map(|number| number * number).sum::<f64>().sqrt();
        ((scale - 1.0).abs() > MOST_SCALED).then(|| (image.name.clone(), scale))
    });
    source.say_scaled(&scaled.collect::<Vec<_>>());
    let cameras = Cameras::read(&model)?;
    let twins = drop_twins(&mut images, &cameras, &source.described_in)?;
    source.say_twins(&twins);
    let frame_of = read_frames(&mut source, layout, &model, &cameras, &images, options)?;
    let (points, observed) = points(layout, &model, &frame_of, &images, &mut source.used)?;
    source.points = points;
    source.reprojection_px = reprojection_px(&source.frames, &images, &frame_of, &observed);
    Ok(source)
}

/// The pictures that the `model` in a folder of a dataset calls `names`: those in the nearest `images` above it, for an undistorted
/// model has photographs of its own, whose names are those of the originals.
pub(crate) fn pictures(folder: &Folder, model: &Path, names: &[&str]) -> Vec<Option<PathBuf>> {
    let above = model.ancestors().map_while(|at| at.strip_prefix(&folder.root).ok());
    let bases: Vec<String> = above.map(|at| at.join("images").to_string_lossy().into_owned()).collect();
    folder.pictures(names, &bases.iter().map(String::as_str).chain([""]).collect::<Vec<_>>())
}

/// Names of the images in the model in a folder.
///
/// # Errors
/// [`DatasetError`] for files that are missing, truncated or malformed.
pub(crate) fn image_names(model: &Path) -> Result<Vec<String>> {
    Ok(images(model)?.into_iter().map(|image| image.name).collect())
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
    let mut images = image_names(model)?;
    images.sort();
    let mut points = 0;
    for record in records(&file(model, "points3D")?)?.records {
        record?;
        points += 1;
    }
    Ok(ModelContent { images, points })
}

/// The cameras of the images of the model in folder `model` and their names, in the order of the file.
///
/// # Errors
/// [`DatasetError`] for files that are missing, truncated or malformed, for unknown lenses.
pub(crate) fn model_cameras(model: &Path) -> Result<Vec<(String, Camera)>> {
    let (cameras, described_in) = (Cameras::read(model)?, file(model, "images")?);
    images(model)?.into_iter().map(|image| Ok((image.name.clone(), cameras.of(&image, &described_in)?.0))).collect()
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

/// `stem`.bin in the model's folder, or `stem`.txt: that of the encoding of which more files are there, binary if both are whole.
fn file(model: &Path, stem: &str) -> Result<PathBuf> {
    let [used, other] = encodings(model).map(|encoding| model.join(format!("{stem}.{encoding}")));
    if used.is_file() {
        return Ok(used);
    }
    let alternative = if other.is_file() {
        "its twin in the other encoding is of another model than the files beside it"
    } else {
        "so is its .txt twin"
    };
    Err(DatasetError::MissingModelFile { path: used, alternative })
}

/// The encoding of which the files in a model's folder are read, and the other.
fn encodings(model: &Path) -> [&'static str; 2] {
    let rank = |encoding: &str| {
        let [cameras, images, points] = STEMS.map(|stem| model.join(format!("{stem}.{encoding}")).is_file());
        (cameras && images, [cameras, images, points].iter().filter(|&&is_there| is_there).count())
    };
    if rank("txt") > rank("bin") { ["txt", "bin"] } else { ["bin", "txt"] }
}

fn is_binary(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "bin")
}

fn largest_model(models: &[PathBuf], root: &Path) -> Result<(PathBuf, Vec<ImageRecord>)> {
    let mut largest: Option<(PathBuf, Vec<ImageRecord>)> = None;
    for folder in models {
        let images = images(folder)?;
        if largest.as_ref().is_none_or(|(_, most)| images.len() > most.len()) {
            largest = Some((folder.clone(), images));
        }
    }
    let sparse = root.join("sparse");
    largest.ok_or_else(|| DatasetError::NoModel { found: listing(&sparse), path: sparse })
}

/// The cameras of a model by their ids, and the file that has them.
struct Cameras {
    path: PathBuf,
    records: BTreeMap<u32, CameraRecord>,
}

impl Cameras {
    fn read(model: &Path) -> Result<Self> {
        let path = file(model, "cameras")?;
        let all = if is_binary(&path) { binary::cameras(&path)? } else { text::cameras(&path)? };
        let mut records = BTreeMap::new();
        for camera in all {
            if records.get(&camera.id).is_some_and(|other| *other != camera) {
                let (what, found) = (format!("camera {}", camera.id), "there twice, with different parameters");
                return Err(DatasetError::malformed(&path, what, found, "one camera of an id"));
            }
            records.insert(camera.id, camera);
        }
        Ok(Self { path, records })
    }

    /// That of an image which `described_in` has.
    fn of(&self, image: &ImageRecord, described_in: &Path) -> Result<(Camera, Option<PanoramaPart>)> {
        let record = self.records.get(&image.camera_id).ok_or_else(|| {
            let what = format!("the camera of image `{}`", image.name);
            let found = format!("{}, which {} does not hold", image.camera_id, self.path.display());
            DatasetError::malformed(described_in, what, found, "the id of a camera")
        })?;
        let length = image.wxyz.iter().map(|number| number * number).sum::<f64>().sqrt();
        if !(length.is_finite() && length > 0.0) {
            let what = format!("the quaternion of image `{}`", image.name);
            let found = format!("{}, which is no rotation", image.wxyz.map(|number| number.to_string()).join(" "));
            return Err(DatasetError::malformed(described_in, what, found, "four finite numbers that are not all 0"));
        }
        let camera_from_world = CameraFromWorld::from_quaternion(image.wxyz, image.translation.into());
        record.camera(&self.path, camera_from_world)
    }
}

/// Keeps one of the `images`, which are sorted by name, of each name. Returns the names of the others.
///
/// # Errors
/// [`DatasetError`] if images of a name differ, or images of two names have one id.
fn drop_twins(images: &mut Vec<ImageRecord>, cameras: &Cameras, described_in: &Path) -> Result<Vec<String>> {
    let mut twins = Vec::new();
    for (first, second) in images.iter().zip(images.iter().skip(1)).filter(|(first, second)| first.name == second.name)
    {
        let [a, b] = [cameras.of(first, described_in)?.0, cameras.of(second, described_in)?.0];
        check_twins([(&first.name, described_in, &a), (&second.name, described_in, &b)])?;
        twins.push(first.name.clone());
    }
    images.dedup_by(|second, first| second.name == first.name);
    let mut of_id = HashMap::new();
    for image in &*images {
        if let Some(other) = of_id.insert(image.id, &image.name) {
            let (what, found) =
                (format!("image id {}", image.id), format!("that of `{other}` and of `{}`", image.name));
            return Err(DatasetError::malformed(described_in, what, found, "the id of one image"));
        }
    }
    Ok(twins)
}

/// Adds the frames whose pictures are there to `source`. Returns their indices by the ids of images.
fn read_frames(
    source: &mut Source,
    layout: &Layout,
    model: &Path,
    cameras: &Cameras,
    images: &[ImageRecord],
    options: &LoadOptions,
) -> Result<BTreeMap<u32, u32>> {
    let root = &layout.folder.root;
    let names: Vec<&str> = images.iter().map(|image| image.name.as_str()).collect();
    let splits = held_out::from_lists(&[root, &root.join("sparse"), model], &names, source)?;
    let splits = splits.unwrap_or_else(|| held_out::every_nth(images.len(), options.test_every));
    let pictures = pictures(&layout.folder, model, &names);
    let mut frame_of = BTreeMap::new();
    for ((image, split), picture) in images.iter().zip(splits).zip(pictures) {
        let (camera, panorama) = cameras.of(image, &source.described_in)?;
        let Some(picture) = picture else {
            source.missing.push(root.join("images").join(&image.name));
            continue;
        };
        frame_of.insert(image.id, source.frames.len() as u32);
        source.frames.push(Frame {
            name: image.name.replace('\\', "/"),
            image: picture,
            mask: None,
            camera,
            panorama,
            is_sized: true,
            header: None,
            split,
            described_in: source.described_in.clone(),
            depth: None,
        });
    }
    Ok(frame_of)
}

/// The points of the model, or those of a PLY file beside it; none if there are none. With them, by their ids, the positions of
/// those that keypoints of `images` name.
fn points(
    layout: &Layout,
    model: &Path,
    frame_of: &BTreeMap<u32, u32>,
    images: &[ImageRecord],
    used: &mut Vec<PathBuf>,
) -> Result<(RawPoints, HashMap<u64, DVec3>)> {
    let Ok(path) = file(model, "points3D") else {
        return Ok((ply::beside(&layout.folder, model, used)?, HashMap::new()));
    };
    let named: HashSet<u64> = images.iter().flat_map(|image| &image.observed).map(|(point, _)| *point).collect();
    let mut observed = HashMap::with_capacity(named.len());
    let PointRecords { count, observations, records } = records(&path)?;
    let (positions, colours) = (Vec::with_capacity(count), Vec::with_capacity(count));
    let mut points = RawPoints { positions, colours, seen_by: Tracks::with_room(count, observations) };
    for record in records {
        let record = record?;
        let position = DVec3::from_array(record.position);
        if named.contains(&record.id) {
            observed.insert(record.id, position);
        }
        points.positions.push(position);
        points.colours.push(record.rgb.map(|channel| f32::from(channel) / 255.0));
        points.seen_by.push(record.track.iter().filter_map(|image| frame_of.get(image).copied()));
    }
    if points.positions.is_empty() {
        points = ply::beside(&layout.folder, model, used)?;
    }
    Ok((points, observed))
}

/// Of each of the `frames` the median distance between its keypoints and the points that they are, px of its camera; `None`
/// without enough of them.
fn reprojection_px(
    frames: &[Frame],
    images: &[ImageRecord],
    frame_of: &BTreeMap<u32, u32>,
    points: &HashMap<u64, DVec3>,
) -> Vec<Option<f64>> {
    let mut errors = vec![None; frames.len()];
    for image in images {
        let Some(&frame) = frame_of.get(&image.id) else { continue };
        let camera = &frames[frame as usize].camera;
        let distances = image.observed.iter().filter_map(|(point, [x, y])| {
            let (shown_x, shown_y, _) = camera.project(*points.get(point)?)?;
            Some((shown_x - x).hypot(shown_y - y))
        });
        let distances: Vec<f64> = distances.collect();
        errors[frame as usize] = if distances.len() < FEWEST_OBSERVED { None } else { median(distances) };
    }
    errors
}

/// At most [`MOST_OBSERVED`] of the keypoints of an image, evenly spread.
fn some_observed(mut all: Vec<(u64, [f64; 2])>) -> Vec<(u64, [f64; 2])> {
    let step = all.len().div_ceil(MOST_OBSERVED).max(1);
    let mut index = 0;
    all.retain(|_| {
        index += 1;
        (index - 1) % step == 0
    });
    all.shrink_to_fit();
    all
}

#[cfg(test)]
mod tests;

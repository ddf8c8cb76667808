//! Cameras of other programs: their readers say what a file holds, and it is brought together with the photographs here.

mod bundler;
mod metashape;
mod opensfm;
mod realityscan;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use dpges_core::camera::{Camera, CameraFromWorld, Distortion};
use glam::{DMat3, DVec3};

use super::source::{Frame, PanoramaPart, RawPoints, Source, lens};
use super::transforms::{ROTATION, rigid};
use super::{held_out, ply};
use crate::error::{DatasetError, Result};
use crate::finding::{Kind, Notices};
use crate::image::codec;
use crate::key::extension;
use crate::layout::Layout;
use crate::{Format, LoadOptions};

/// Intrinsics, as far as they are known without the picture.
#[derive(Clone, Copy, Debug)]
struct Optics {
    /// Focal lengths, px or longer sides of the picture.
    pub focal: [f64; 2],
    /// Principal point from the middle of the picture, to the right and down, in the unit of `focal`.
    pub centre: [f64; 2],
    pub is_in_sides: bool,
    /// `None` of a panorama, which has no focal lengths either.
    pub distortion: Option<Distortion>,
    /// Width and height, px; `None` for those of the picture.
    pub size: Option<[usize; 2]>,
}

impl Optics {
    fn panorama(size: Option<[usize; 2]>) -> Self {
        Self { focal: [0.0; 2], centre: [0.0; 2], is_in_sides: true, distortion: None, size }
    }

    /// Of a panorama the front.
    fn camera(
        &self,
        [width, height]: [usize; 2],
        camera_from_world: CameraFromWorld,
    ) -> (Camera, Option<PanoramaPart>) {
        let Some(distortion) = self.distortion else {
            let (front, camera) = PanoramaPart::front([width, height], camera_from_world);
            return (camera, Some(front));
        };
        let (w, h) = (width as f64, height as f64);
        let unit = if self.is_in_sides { w.max(h) } else { 1.0 };
        let [fx, fy] = self.focal.map(|focal| unit * focal);
        let [cx, cy] = [0.5 * w + unit * self.centre[0], 0.5 * h + unit * self.centre[1]];
        let lens = lens(distortion);
        (Camera { camera_from_world, fx, fy, cx, cy, width, height, near: 0.0, lens }, None)
    }
}

/// A photograph with a pose.
#[derive(Clone, Debug)]
struct Shot {
    pub name: String,
    pub camera_from_world: CameraFromWorld,
    pub optics: Optics,
    pub described_in: PathBuf,
}

/// The content of a file of cameras.
#[derive(Debug, Default)]
struct Found {
    pub shots: Vec<Shot>,
    /// Names of cameras without a pose.
    pub not_aligned: Vec<String>,
    /// Seen by indices into `shots`.
    pub points: RawPoints,
    /// Files that were read, too.
    pub used: Vec<PathBuf>,
    pub notices: Notices,
    /// Of rotations that were scaled or rounded.
    scaled: Vec<(String, f64)>,
}

impl Found {
    /// Adds a camera at `centre` with these OpenCV axes as columns; an error unless they are a rotation, up to scale.
    pub fn add(
        &mut self,
        path: &Path,
        name: String,
        world_from_camera: DMat3,
        centre: DVec3,
        optics: Optics,
    ) -> Result<()> {
        let (camera_from_world, scale) = rigid(world_from_camera, centre).ok_or_else(|| {
            let found = format!("{:?}", world_from_camera.to_cols_array());
            DatasetError::malformed(path, format!("the rotation of camera `{name}`"), found, ROTATION)
        })?;
        self.scaled.extend(scale.map(|scale| (name.clone(), scale)));
        self.shots.push(Shot { name, camera_from_world, optics, described_in: path.to_owned() });
        Ok(())
    }
}

/// So many finite numbers of a text that says `what`; an error for another text.
fn numbers<const N: usize>(path: &Path, what: &str, text: &str) -> Result<[f64; N]> {
    let numbers = text.split_whitespace().map(|word| word.parse().ok().filter(|number: &f64| number.is_finite()));
    let numbers = numbers.collect::<Option<Vec<f64>>>().and_then(|numbers| numbers.try_into().ok());
    let expected = if N == 1 { "a number".to_owned() } else { format!("{N} numbers") };
    numbers.ok_or_else(|| DatasetError::malformed(path, what.to_owned(), format!("`{text}`"), expected))
}

/// The error of a lens that is not read.
fn refused(path: &Path, camera: String, model: &str, reason: &'static str) -> DatasetError {
    DatasetError::CameraModel { path: path.to_owned(), camera, model: model.to_owned(), reason }
}

/// The matrix of nine numbers, row by row.
fn by_rows(rows: [f64; 9]) -> DMat3 {
    DMat3::from_cols_array(&rows).transpose()
}

/// The views and points of a dataset whose cameras are those of another program.
///
/// # Errors
/// [`DatasetError`] for files that are cut short or malformed, for cameras without a position and for unknown lenses.
pub(crate) fn read(layout: &Layout, format: Format, files: &[PathBuf], options: &LoadOptions) -> Result<Source> {
    let (folder, path) = (&layout.folder, &files[0]);
    let Found { mut shots, not_aligned, points, used, notices, scaled } = match format {
        Format::Metashape => metashape::read(path)?,
        Format::OpenSfm => opensfm::read(path)?,
        Format::Bundler => bundler::read(path)?,
        _ if extension(&folder.key_of(path)) == "xmp" => realityscan::read_sidecars(&folder.root, files)?,
        _ => realityscan::read(path)?,
    };
    if shots.is_empty() {
        return Err(DatasetError::NotAligned { path: path.clone(), all: not_aligned.len() });
    }
    let mut source = Source::new(format, path.clone(), "test.txt names no camera with a position");
    source.notices = notices;
    source.used = used.into_iter().chain(files.iter().cloned()).collect();
    source.say_scaled(&scaled);
    let what = "cameras have no position, and are left out";
    source.notices.add_names(Kind::Missing, what, &not_aligned, "align their photographs too, or remove them");

    let mut order: Vec<usize> = (0..shots.len()).collect();
    order.sort_by(|&a, &b| shots[a].name.cmp(&shots[b].name));
    let names: Vec<String> = order.iter().map(|&shot| std::mem::take(&mut shots[shot].name)).collect();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        let what = format!("the name `{}`", pair[0]);
        return Err(DatasetError::malformed(path, what, "that of several cameras", "a name for each photograph"));
    }
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let beside = path.parent().unwrap_or(path);
    let splits = held_out::from_lists(&[&folder.root, beside], &names, &mut source)?;
    let splits = splits.unwrap_or_else(|| held_out::every_nth(names.len(), options.test_every));
    let pictures = folder.pictures(&names, &["images", ""]);
    let mut frame_of = vec![None; shots.len()];
    for (((&index, name), split), image) in order.iter().zip(names).zip(splits).zip(pictures) {
        let Some(image) = image else {
            source.missing.push(folder.root.join("images").join(name));
            continue;
        };
        let Shot { camera_from_world, optics, described_in, .. } = shots[index].clone();
        let size = match optics.size {
            Some(size) => size,
            None => codec::header(&image).map(|header| [header.width, header.height])?,
        };
        let (camera, panorama) = optics.camera(size, camera_from_world);
        frame_of[index] = Some(source.frames.len() as u32);
        source.frames.push(Frame {
            name: name.replace('\\', "/"),
            image,
            mask: None,
            camera,
            panorama,
            is_sized: optics.size.is_some(),
            header: None,
            split,
            described_in,
            depth: None,
        });
    }
    let of_frames = |views: &[u32]| -> Vec<u32> { views.iter().filter_map(|&shot| frame_of[shot as usize]).collect() };
    source.points = RawPoints { seen_by: points.seen_by.iter().map(of_frames).collect(), ..points };
    if source.points.positions.is_empty() {
        source.points = cloud(layout, beside, &mut source.used)?;
    }
    Ok(source)
}

/// The points of the PLY file with one of the usual names, or of the only one that lies in the folder of the cameras or in that of
/// the dataset.
fn cloud(layout: &Layout, beside: &Path, used: &mut Vec<PathBuf>) -> Result<RawPoints> {
    let points = ply::beside(&layout.folder, beside, used)?;
    let places = [layout.folder.key_of(beside), String::new()];
    let clouds: BTreeSet<&str> = places.iter().flat_map(|place| layout.folder.within(place)).collect();
    match clouds.into_iter().filter(|key| extension(key) == "ply").collect::<Vec<_>>().as_slice() {
        [only] if points.positions.is_empty() => {
            used.push(layout.folder.files[*only].clone());
            ply::points(&layout.folder.files[*only])
        }
        _ => Ok(points),
    }
}

#[cfg(test)]
mod tests;

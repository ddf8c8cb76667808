//! The binary files of a model: little-endian, counts first (COLMAP `src/colmap/scene/reconstruction_io_binary.cc`).

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::camera_model::{self, CameraRecord};
use super::{ImageRecord, PointRecord, PointRecords, some_observed};
use crate::error::{DatasetError, Result, unreadable};

const CAMERA_BYTES: usize = 24;
const IMAGE_BYTES: usize = 4 + 7 * 8 + 4 + 1 + 8;
const KEYPOINT_BYTES: usize = 24;
/// The id of a keypoint that is no point.
const NO_POINT: u64 = u64::MAX;
const POINT_BYTES: usize = 8 + 3 * 8 + 3 + 8 + 8;
const OBSERVATION_BYTES: usize = 8;

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Truncated`], [`DatasetError::CameraModel`] for an id without a known layout.
pub(super) fn cameras(path: &Path) -> Result<Vec<CameraRecord>> {
    let mut bytes = Bytes::open(path)?;
    let count = bytes.count(CAMERA_BYTES, || "the list of cameras".to_owned())?;
    (0..count)
        .map(|index| {
            let mut fields = bytes.record(CAMERA_BYTES, || format!("camera {index} of {count}"))?;
            let (id, model_id) = (fields.u32(), fields.u32() as i32);
            let (width, height) = (fields.u64(), fields.u64());
            let (model, params) = camera_model::by_id(model_id).ok_or_else(|| DatasetError::CameraModel {
                path: path.to_owned(),
                camera: format!("camera {id}"),
                model: format!("number {model_id}"),
                reason: "it is unknown here",
            })?;
            let mut fields = bytes.record(8 * params, || format!("the parameters of camera {id}"))?;
            let params = (0..params).map(|_| fields.f64()).collect();
            Ok(CameraRecord { id, model: model.to_owned(), width, height, params })
        })
        .collect()
}

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Truncated`].
pub(super) fn images(path: &Path) -> Result<Vec<ImageRecord>> {
    let mut bytes = Bytes::open(path)?;
    let count = bytes.count(IMAGE_BYTES, || "the list of images".to_owned())?;
    (0..count)
        .map(|index| {
            let what = || format!("image {index} of {count}");
            let mut fields = bytes.record(4 + 7 * 8 + 4, what)?;
            let id = fields.u32();
            let wxyz = std::array::from_fn(|_| fields.f64());
            let translation = std::array::from_fn(|_| fields.f64());
            let camera_id = fields.u32();
            let name = bytes.name(what)?;
            let keypoints = || format!("the keypoints of image `{name}`");
            let count = bytes.count(KEYPOINT_BYTES, keypoints)?;
            let mut fields = bytes.record(count * KEYPOINT_BYTES, keypoints)?;
            let keypoint = |_| {
                let position = [fields.f64(), fields.f64()];
                Some((fields.u64(), position)).filter(|(point, _)| *point != NO_POINT)
            };
            let observed = some_observed((0..count).filter_map(keypoint).collect());
            Ok(ImageRecord { id, camera_id, name, wxyz, translation, observed })
        })
        .collect()
}

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Truncated`].
pub(super) fn points(path: &Path) -> Result<PointRecords<'_>> {
    let mut bytes = Bytes::open(path)?;
    let count = bytes.count(POINT_BYTES, || "the list of points".to_owned())?;
    // what is no point is a track
    let observations = (bytes.left as usize - count * POINT_BYTES) / OBSERVATION_BYTES;
    let records = (0..count).map(move |index| {
        let mut fields = bytes.record(POINT_BYTES - 8, || format!("point {index} of {count}"))?;
        let id = fields.u64();
        let position = std::array::from_fn(|_| fields.f64());
        let rgb = fields.array();
        let track = || format!("the track of point {index} of {count}");
        let observations = bytes.count(OBSERVATION_BYTES, track)?;
        let mut fields = bytes.record(observations * OBSERVATION_BYTES, track)?;
        // each is the number of an image, then that of a keypoint
        let track = (0..observations).map(|_| [fields.u32(), fields.u32()][0]).collect();
        Ok(PointRecord { id, position, rgb, track })
    });
    Ok(PointRecords { count, observations, records: Box::new(records) })
}

/// The unread bytes of a file.
struct Bytes<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    left: u64,
    /// The last record.
    record: Vec<u8>,
}

impl<'a> Bytes<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let open = || {
            let file = File::open(path)?;
            let left = file.metadata()?.len();
            Ok(Self { path, reader: BufReader::new(file), left, record: Vec::new() })
        };
        open().map_err(unreadable(path))
    }

    /// The next `length` bytes.
    fn record(&mut self, length: usize, what: impl Fn() -> String) -> Result<Fields<'_>> {
        self.take(length as u64, what)?;
        self.record.resize(length, 0);
        self.reader.read_exact(&mut self.record).map_err(unreadable(self.path))?;
        Ok(Fields(&self.record))
    }

    fn take(&mut self, length: u64, what: impl Fn() -> String) -> Result<()> {
        self.left = self.left.checked_sub(length).ok_or_else(|| self.truncated(what(), length))?;
        Ok(())
    }

    /// A 64-bit count of entries of at least `entry_bytes` each. The file must be long enough to hold them, so that a
    /// corrupt count is found before memory is allocated for it.
    fn count(&mut self, entry_bytes: usize, what: impl Fn() -> String) -> Result<usize> {
        let count = self.record(8, &what)?.u64();
        let needed = count.saturating_mul(entry_bytes as u64);
        if needed > self.left { Err(self.truncated(what(), needed)) } else { Ok(count as usize) }
    }

    /// A name that ends with a zero byte.
    fn name(&mut self, what: impl Fn() -> String) -> Result<String> {
        let mut name = Vec::new();
        self.reader.read_until(0, &mut name).map_err(unreadable(self.path))?;
        if name.pop() != Some(0) {
            return Err(self.truncated(what(), self.left + 1));
        }
        self.left = self.left.saturating_sub(name.len() as u64 + 1);
        Ok(String::from_utf8_lossy(&name).into_owned())
    }

    fn truncated(&self, what: String, needed: u64) -> DatasetError {
        DatasetError::Truncated { path: self.path.to_owned(), what, needed, left: self.left as usize }
    }
}

/// The fields of a record whose length was checked.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn array<const N: usize>(&mut self) -> [u8; N] {
        let (field, rest) = self.0.split_first_chunk().expect("records are as long as their fields");
        self.0 = rest;
        *field
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.array())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.array())
    }

    fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.array())
    }
}

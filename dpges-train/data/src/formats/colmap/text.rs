//! The text files of a model: one entry per line, comments after `#`.

use std::path::Path;
use std::str::FromStr;

use super::camera_model::CameraRecord;
use super::{ImageRecord, PointRecord, PointRecords, some_observed};
use crate::error::{DatasetError, Result, read_text};

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Malformed`] with the line.
pub(super) fn cameras(path: &Path) -> Result<Vec<CameraRecord>> {
    let text = read_text(path)?;
    let camera = |mut line: Line| {
        Ok(CameraRecord {
            id: line.next()?,
            model: line.next()?,
            width: line.next()?,
            height: line.next()?,
            params: line.rest()?,
        })
    };
    let lines = lines(path, &text, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]");
    lines.filter(Line::is_entry).map(camera).collect()
}

/// An image has two lines; the second, its keypoints, may be empty or missing.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Malformed`] with the line.
pub(super) fn images(path: &Path) -> Result<Vec<ImageRecord>> {
    let text = read_text(path)?;
    let mut lines = lines(path, &text, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME").peekable();
    let mut images = Vec::new();
    while let Some(mut line) = lines.by_ref().find(Line::is_entry) {
        let mut image = ImageRecord {
            id: line.next()?,
            wxyz: [line.next()?, line.next()?, line.next()?, line.next()?],
            translation: [line.next()?, line.next()?, line.next()?],
            camera_id: line.next()?,
            name: line.remainder()?,
            observed: Vec::new(),
        };
        // some programs write no line for an image without keypoints
        let is_number = |word: &str| word.parse::<f64>().is_ok();
        if let Some(keypoints) = lines.next_if(|line| line.text.split_whitespace().all(is_number)) {
            let numbers: Vec<f64> = keypoints.rest()?;
            let (triples, rest) = numbers.as_chunks::<3>();
            if !rest.is_empty() {
                let layout = "X Y POINT3D_ID triples or an empty line after each image";
                return Err(Line { layout, ..keypoints }.malformed());
            }
            // -1 stands for no point
            let points = triples.iter().filter(|[_, _, point]| *point >= 0.0);
            image.observed = some_observed(points.map(|&[x, y, point]| (point as u64, [x, y])).collect());
        }
        images.push(image);
    }
    Ok(images)
}

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Malformed`] with the line.
pub(super) fn points(path: &Path) -> Result<PointRecords<'_>> {
    let text = read_text(path)?;
    let point = |mut line: Line| {
        let id: u64 = line.next()?;
        let position = [line.next()?, line.next()?, line.next()?];
        if line.unread.trim().is_empty() {
            return Ok(PointRecord { id, position, rgb: [128; 3], track: Vec::new() });
        }
        let rgb = [line.next()?, line.next()?, line.next()?];
        let _error: f64 = line.next()?;
        let track: Vec<u32> = line.rest()?.chunks(2).map(|observation: &[u32]| observation[0]).collect();
        Ok(PointRecord { id, position, rgb, track })
    };
    let lines = lines(path, &text, "POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)");
    let records = lines.filter(Line::is_entry).map(point).collect::<Result<Vec<PointRecord>>>()?;
    let observations = records.iter().map(|record| record.track.len()).sum();
    Ok(PointRecords { count: records.len(), observations, records: Box::new(records.into_iter().map(Ok)) })
}

/// `layout` is that of the entries, for messages.
fn lines<'a>(path: &'a Path, text: &'a str, layout: &'static str) -> impl Iterator<Item = Line<'a>> {
    text.lines().map(str::trim).zip(1..).map(move |(text, number)| Line { path, layout, number, text, unread: text })
}

struct Line<'a> {
    path: &'a Path,
    layout: &'static str,
    number: usize,
    text: &'a str,
    unread: &'a str,
}

impl Line<'_> {
    fn is_entry(&self) -> bool {
        !self.text.is_empty() && !self.text.starts_with('#')
    }

    fn malformed(&self) -> DatasetError {
        let shown: String = self.text.chars().take(60).collect();
        DatasetError::malformed(self.path, format!("line {}", self.number), format!("`{shown}`"), self.layout)
    }

    /// The next word.
    fn next<T: FromStr>(&mut self) -> Result<T> {
        let unread = self.unread.trim_start();
        let (word, unread) = unread.split_at(unread.find(char::is_whitespace).unwrap_or(unread.len()));
        self.unread = unread;
        word.parse().map_err(|_| self.malformed())
    }

    /// All words that are left.
    fn rest<T: FromStr>(&self) -> Result<Vec<T>> {
        self.unread.split_whitespace().map(str::parse).collect::<Result<_, _>>().map_err(|_| self.malformed())
    }

    /// The rest of the line, unchanged: names may contain spaces.
    fn remainder(&self) -> Result<String> {
        match self.unread.trim() {
            "" => Err(self.malformed()),
            text => Ok(text.to_owned()),
        }
    }
}

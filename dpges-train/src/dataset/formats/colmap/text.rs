//! The text files of a model: one entry per line, comments after `#`.

use std::path::Path;
use std::str::FromStr;

use super::camera_model::CameraRecord;
use super::{ImageRecord, PointRecord, PointRecords};
use crate::dataset::error::{DatasetError, Result, read};

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Malformed`] with the line.
pub(super) fn cameras(path: &Path) -> Result<Vec<CameraRecord>> {
    let text = text(path)?;
    lines(&text)
        .filter(|line| line.is_entry())
        .map(|line| {
            let mut words = line.words(path, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]");
            Ok(CameraRecord {
                id: words.next()?,
                model: words.next()?,
                width: words.next()?,
                height: words.next()?,
                params: words.rest()?,
            })
        })
        .collect()
}

/// An image has two lines; the second, its keypoints, may be empty.
///
/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Malformed`] with the line.
pub(super) fn images(path: &Path) -> Result<Vec<ImageRecord>> {
    let text = text(path)?;
    let mut lines = lines(&text);
    let mut images = Vec::new();
    while let Some(line) = lines.by_ref().find(|line| line.is_entry()) {
        let mut words = line.words(path, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
        images.push(ImageRecord {
            id: words.next()?,
            wxyz: [words.next()?, words.next()?, words.next()?, words.next()?],
            translation: [words.next()?, words.next()?, words.next()?],
            camera_id: words.next()?,
            name: words.remainder()?,
        });
        if let Some(keypoints) = lines.next()
            && keypoints.text.split_whitespace().count() % 3 != 0
        {
            return Err(keypoints.malformed(path, "X Y POINT3D_ID triples or an empty line after each image"));
        }
    }
    Ok(images)
}

/// # Errors
/// [`DatasetError::Read`], [`DatasetError::Malformed`] with the line.
pub(super) fn points(path: &Path) -> Result<PointRecords<'_>> {
    let text = text(path)?;
    let records: Result<Vec<PointRecord>> = lines(&text)
        .filter(|line| line.is_entry())
        .map(|line| {
            let mut words = line.words(path, "POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)");
            let _id: u64 = words.next()?;
            let position = [words.next()?, words.next()?, words.next()?];
            let rgb = [words.next()?, words.next()?, words.next()?];
            let _error: f64 = words.next()?;
            let track: Vec<u32> = words.rest()?.chunks(2).map(|observation: &[u32]| observation[0]).collect();
            Ok(PointRecord { position, rgb, track })
        })
        .collect();
    let records = records?;
    let observations = records.iter().map(|record| record.track.len()).sum();
    Ok(PointRecords { count: records.len(), observations, records: Box::new(records.into_iter().map(Ok)) })
}

fn text(path: &Path) -> Result<String> {
    Ok(String::from_utf8_lossy(&read(path)?).into_owned())
}

fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
    text.lines().zip(1..).map(|(text, number)| Line { number, text: text.trim() })
}

#[derive(Clone, Copy)]
struct Line<'a> {
    number: usize,
    text: &'a str,
}

impl<'a> Line<'a> {
    fn is_entry(self) -> bool {
        !self.text.is_empty() && !self.text.starts_with('#')
    }

    fn words(self, path: &'a Path, layout: &'static str) -> Words<'a> {
        Words { line: self, path, layout, rest: self.text }
    }

    fn malformed(self, path: &Path, expected: &'static str) -> DatasetError {
        let shown: String = self.text.chars().take(60).collect();
        DatasetError::malformed(path, format!("line {}", self.number), format!("`{shown}`"), expected)
    }
}

/// The unread words of a line.
struct Words<'a> {
    line: Line<'a>,
    path: &'a Path,
    layout: &'static str,
    rest: &'a str,
}

impl Words<'_> {
    fn next<T: FromStr>(&mut self) -> Result<T> {
        let rest = self.rest.trim_start();
        let (word, rest) = rest.split_at(rest.find(char::is_whitespace).unwrap_or(rest.len()));
        self.rest = rest;
        word.parse().map_err(|_| self.line.malformed(self.path, self.layout))
    }

    /// All words that are left.
    fn rest<T: FromStr>(&mut self) -> Result<Vec<T>> {
        let words = std::mem::take(&mut self.rest).split_whitespace().map(str::parse);
        words.collect::<Result<_, _>>().map_err(|_| self.line.malformed(self.path, self.layout))
    }

    /// The rest of the line, unchanged: names may contain spaces.
    fn remainder(&mut self) -> Result<String> {
        match std::mem::take(&mut self.rest).trim() {
            "" => Err(self.line.malformed(self.path, self.layout)),
            text => Ok(text.to_owned()),
        }
    }
}

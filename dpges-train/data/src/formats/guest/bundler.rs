//! Bundle files of Bundler, version 0.3 (<https://www.cs.cornell.edu/~snavely/bundler>), and the list of their photographs.
//!
//! A point P = R X + t of camera axes (x right, y up, the camera looks along −z) appears at p = −P / P.z, in focal lengths from the
//! middle of the picture, times 1 + k1 |p|² + k2 |p|⁴.

use std::path::{Path, PathBuf};
use std::str::{FromStr, SplitWhitespace};

use dpges_core::camera::{Distortion, Projection};
use glam::{DMat3, DVec3};

use super::{Found, Optics, by_rows};
use crate::error::{DatasetError, Result, read_text};
use crate::names::in_folder;

const FIRST_LINE: &str = "# Bundle file v0.3";

/// The cameras of a file, of which those with a focal length of 0 have no pose, and its points.
///
/// # Errors
/// [`DatasetError::Malformed`] for a file of another version, one that ends too early or has no list of photographs.
pub(super) fn read(path: &Path) -> Result<Found> {
    let text = read_text(path)?;
    let (first, rest) = text.split_once('\n').unwrap_or((&text, ""));
    if first.trim() != FIRST_LINE {
        return Err(DatasetError::malformed(path, "the first line".to_owned(), format!("`{first}`"), FIRST_LINE));
    }
    let mut words = Words { path, words: rest.split_whitespace() };
    let [cameras, points] = words.next("the number of cameras or points")?;
    let (list, names) = photographs(path, cameras)?;
    let mut found = Found { used: vec![list], ..Found::default() };
    let mut shot_of: Vec<Option<u32>> = Vec::new();
    for name in names {
        let what = format!("the camera of `{name}`");
        let ([f, k1, k2], rows, translation) = (words.next(&what)?, words.next(&what)?, words.next::<f64, 3>(&what)?);
        if f == 0.0 {
            shot_of.push(None);
            found.not_aligned.push(name);
            continue;
        }
        shot_of.push(Some(found.shots.len() as u32));
        let bent = Distortion::new(Projection::Perspective);
        let distortion = Distortion { numerator: [k1, k2, 0.0, 0.0, 0.0, 0.0], ..bent };
        let optics =
            Optics { focal: [f; 2], centre: [0.0; 2], is_in_sides: false, distortion: Some(distortion), size: None };
        let world_from_camera = by_rows(rows).transpose();
        let centre = -(world_from_camera * DVec3::from(translation));
        let to_opencv = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        found.add(path, name, world_from_camera * to_opencv, centre, optics)?;
    }
    for point in 0..points {
        let what = format!("point {point}");
        let [x, y, z, colour @ ..]: [f64; 6] = words.next(&what)?;
        found.points.positions.push(DVec3::new(x, y, z));
        found.points.colours.push(colour.map(|channel| (channel / 255.0).clamp(0.0, 1.0) as f32));
        let [count] = words.next(&what)?;
        let mut views: Vec<u32> = Vec::new();
        for _ in 0..count {
            let [camera]: [usize; 1] = words.next(&what)?;
            let _keypoint: [f64; 3] = words.next(&what)?;
            let shot = shot_of.get(camera).ok_or_else(|| {
                DatasetError::malformed(path, format!("a camera that sees {what}"), camera, format!("one of {cameras}"))
            });
            views.extend(shot?);
        }
        found.points.seen_by.push(views);
    }
    Ok(found)
}

/// The list of the photographs beside a bundle file or above it, and their names.
fn photographs(path: &Path, cameras: usize) -> Result<(PathBuf, Vec<String>)> {
    for folder in path.ancestors().skip(1).take(2) {
        let mut lists = in_folder(folder).unwrap_or_default();
        lists.retain(|name| name.to_lowercase().contains("list") && name.to_lowercase().ends_with(".txt"));
        lists.sort_by_key(|name| name.to_lowercase() != "list.txt");
        for list in lists.iter().map(|name| folder.join(name)) {
            let text = read_text(&list)?;
            let names: Vec<String> = text.lines().map(name).filter(|name| !name.is_empty()).collect();
            if names.len() == cameras {
                return Ok((list, names));
            }
        }
    }
    let expected = format!("a file list.txt beside it or above, with a line for each of its {cameras} cameras");
    Err(DatasetError::malformed(path, "the list of its photographs".to_owned(), "not there", expected))
}

/// That of a line `NAME`, `NAME 0` or `NAME 0 FOCAL_LENGTH`.
fn name(line: &str) -> String {
    let with_focal = line.trim().rsplit_once(" 0 ").filter(|(_, focal)| focal.trim().parse::<f64>().is_ok());
    let name = with_focal.map_or(line, |(name, _)| name).trim();
    let name = name.strip_suffix(" 0").unwrap_or(name).replace('\\', "/");
    name.trim_start_matches("./").to_owned()
}

struct Words<'a> {
    path: &'a Path,
    words: SplitWhitespace<'a>,
}

impl Words<'_> {
    /// The next numbers, for messages of `what`.
    fn next<T: FromStr + Copy + Default, const N: usize>(&mut self, what: &str) -> Result<[T; N]> {
        let mut numbers = [T::default(); N];
        for number in &mut numbers {
            let word = self.words.next().unwrap_or("the end of the file");
            *number = word.parse().map_err(|_| {
                DatasetError::malformed(self.path, format!("a number of {what}"), format!("`{word}`"), "a number")
            })?;
        }
        Ok(numbers)
    }
}

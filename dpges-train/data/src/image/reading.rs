//! Reads the photographs of a dataset, in parallel and within a budget of memory.

use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use dpges_core::camera::Camera;
use rayon::prelude::*;

use super::cache::{ImageCache, reading_threads};
use super::decoder::ImageDecoder;
use super::photograph::{ImageFile, ImageInfo, Photograph};
use crate::error::{DatasetError, Result};
use crate::formats::source::Frame;
use crate::{DepthMap, Picture, SAMPLED_VIEWS, View};

/// Memory that reading a photograph takes for a while, bytes per pixel: the decoded image, and what is made of it.
const WORKING_BYTES_PER_PIXEL: usize = 16;
/// Share of a budget that not all photographs fit into for those that were read again lately.
const FOR_RECENT: f64 = 0.25;

/// Properties of a frame once the dataset is loaded.
struct Found {
    camera: Camera,
    info: ImageInfo,
    /// `None` if it was not read yet, or if there was no room left for it.
    picture: Option<Arc<Picture>>,
    was_read: bool,
    depth: Option<DepthMap>,
}

/// The views of `frames`, in their order, without faces of panoramas on which nothing counts. The photographs of up to [`SAMPLED_VIEWS`] frames are read now, those of more when
/// they are needed, unless only their pixels say what has to be known of them. The first photographs stay in memory, `memory`
/// bytes of them at most; others are read again and again if need be. Returns the bytes that are left over, too.
///
/// # Errors
/// The errors of reading: the error of the first frame that has one, whatever the number of threads.
pub(crate) fn views(frames: &[&Frame], memory: usize, decoder: &Arc<ImageDecoder>) -> Result<(Vec<View>, usize)> {
    let kept_bytes = AtomicUsize::new(0);
    let fits = |bytes: usize| {
        let with = |kept: usize| kept.checked_add(bytes).filter(|&kept| kept <= memory);
        kept_bytes.fetch_update(Ordering::SeqCst, Ordering::SeqCst, with).is_ok()
    };
    let first = |frame: &Frame| -> Result<Option<Found>> {
        if frames.len() > SAMPLED_VIEWS
            && let Some((camera, info)) = decoder.survey(frame)?
        {
            return Ok(Some(Found { camera, info, picture: None, was_read: false, depth: None }));
        }
        let (camera, picture) = match decoder.photograph(frame) {
            // such as the stand below a panorama
            Err(DatasetError::NothingCounts { .. }) if frame.panorama.is_some() => return Ok(None),
            read => read?,
        };
        let (info, depth) = (ImageInfo::of(&picture), decoder.depth(frame, &camera, &picture)?);
        let picture = fits(info.bytes).then(|| Arc::new(picture));
        Ok(Some(Found { camera, info, picture, was_read: true, depth }))
    };
    let threads = reading_threads(thread_count(frames, memory));
    // a bridge begins with the first frames, whose photographs shall stay
    let first = || (0..frames.len()).par_bridge().map(|index| (index, first(frames[index]))).collect();
    let mut found: Vec<(usize, Result<Option<Found>>)> = threads.install(first);
    found.sort_by_key(|(index, _)| *index);
    let found = found.into_iter().map(|(_, found)| found).collect::<Result<Vec<Option<Found>>>>()?;
    let seen: HashSet<&PathBuf> =
        frames.iter().zip(&found).filter(|(_, found)| found.is_some()).map(|(frame, _)| &frame.image).collect();
    if let Some(frame) = frames.iter().find(|frame| !seen.contains(&frame.image)) {
        return Err(DatasetError::NothingCounts { path: frame.image.clone(), view: frame.name.clone() });
    }
    let bytes = || found.iter().flatten().map(|found| found.info.bytes);
    let all: usize = bytes().sum();
    let all_fit = all <= memory;
    let most_kept = if all_fit { memory } else { (memory as f64 * (1.0 - FOR_RECENT)) as usize };
    let largest_bytes = bytes().max().unwrap_or(0);
    let cache = ImageCache::new(memory - most_kept, largest_bytes, threads);
    let (mut sum, mut kept, mut kept_sum) = (0, 0, 0);
    let mut views = Vec::with_capacity(frames.len());
    for (key, (frame, found)) in frames.iter().zip(found).enumerate() {
        let Some(found) = found else { continue };
        let face = frame.panorama.map(|part| part.face);
        let Found { camera, info, picture, was_read, depth } = found;
        sum += info.bytes;
        let stays = sum <= most_kept;
        if stays {
            (kept, kept_sum) = (kept + 1, sum);
        }
        let photograph = match picture {
            Some(picture) if stays => Photograph::kept(picture, info),
            _ => {
                let (decoder, own) = (Arc::clone(decoder), (*frame).clone());
                let read = Box::new(move || decoder.photograph(&own).map(|(_, picture)| picture));
                let file = ImageFile { key, path: frame.image.clone(), read, stays, was_read };
                Photograph::in_file(file, info, Arc::clone(&cache))
            }
        };
        views.push(View { name: frame.name.clone(), camera, photograph, depth, face });
    }
    if !all_fit {
        tracing::info!(
            "{kept} of {} photographs stay in memory, {:.1} MB of {:.1} MB; the others are read again from their files when \
             they are needed (data.memory)",
            frames.len(),
            kept_sum as f64 / 1e6,
            all as f64 / 1e6
        );
    }
    Ok((views, if all_fit { memory - all } else { 0 }))
}

/// Number of threads that read photographs, so that what they take meanwhile, and one more that is needed now, fits into
/// `memory`, bytes.
fn thread_count(frames: &[&Frame], memory: usize) -> usize {
    let largest = frames.iter().map(|frame| frame.size()[0].saturating_mul(frame.size()[1])).max().unwrap_or(0);
    let each = largest.saturating_mul(WORKING_BYTES_PER_PIXEL).max(1);
    (memory / each).saturating_sub(1).clamp(1, rayon::current_num_threads())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, Encoding, assert_refused, assert_says, colmap_folder, write_mask};
    use crate::{Dataset, LoadOptions, load};

    /// Nine photographs of 24 × 16 px, one of them with a mask: 1152 bytes each, and 384 more.
    fn written() -> tempfile::TempDir {
        let folder = colmap_folder(&fixtures::scene(9), Encoding::Binary);
        write_mask(&folder.path().join("masks/left/001.png"), [24, 16], 3);
        folder
    }

    fn read(folder: &tempfile::TempDir, memory: usize) -> Dataset {
        load(folder.path(), &LoadOptions { memory, test_every: 4, ..Default::default() }).unwrap()
    }

    fn was_read(data: &Dataset) -> usize {
        data.views().filter(|view| view.photograph.was_read()).count()
    }

    fn kept(data: &Dataset) -> Vec<&str> {
        let views = data.views().filter(|view| view.photograph.is_kept());
        views.map(|view| view.name.as_str()).collect()
    }

    #[test]
    fn what_does_not_fit_is_read_again_and_is_the_same() {
        let folder = written();
        let whole = read(&folder, 9 * 1152 + 384);
        assert_eq!((kept(&whole).len(), whole.spare_memory), (9, 0));
        // three quarters of it, the one with the mask and two others
        let some = read(&folder, 6000);
        assert_eq!((kept(&some), some.spare_memory), (vec!["left/001.png", "left/002.png", "left/003.png"], 0));
        let none = read(&folder, 0);
        assert_eq!(kept(&none), [""; 0]);
        for data in [&some, &none] {
            let pairs = data.train.iter().zip(&whole.train).chain(data.test.iter().zip(&whole.test));
            for (found, expected) in pairs {
                assert_eq!((&found.name, found.camera), (&expected.name, expected.camera));
                assert_eq!(found.picture().unwrap(), expected.picture().unwrap());
                assert_eq!(found.photograph.ignored_pixels(), expected.photograph.ignored_pixels());
            }
            assert_eq!(data.masked(), whole.masked());
            let [found, expected] = [data, &whole].map(|data| data.halved().unwrap());
            for (found, expected) in found.train.iter().zip(&expected.train) {
                assert_eq!(found.picture().unwrap(), expected.picture().unwrap());
                assert_eq!(found.camera.width, expected.picture().unwrap().width);
            }
            assert_eq!(kept(&found), kept(data));
        }
        assert_eq!(read(&folder, 20_000).spare_memory, 20_000 - 9 * 1152 - 384);
    }

    #[test]
    fn files_that_change_are_noticed_when_they_are_read_again() {
        let folder = written();
        let data = read(&folder, 0);
        std::fs::remove_file(folder.path().join("images/left/003.png")).unwrap();
        let view = data.train.iter().find(|view| view.name == "left/003.png").unwrap();
        assert_says(view.picture().unwrap_err(), &["left/003.png", "cannot read"]);
    }

    #[test]
    fn of_many_photographs_only_those_are_read_whose_header_does_not_say_all() {
        let folder = colmap_folder(&fixtures::scene(SAMPLED_VIEWS + 6), Encoding::Binary);
        let hole = image::RgbaImage::from_fn(24, 16, |x, _| image::Rgba([200, 100, 0, if x < 3 { 0 } else { 255 }]));
        fixtures::save(&folder.path().join("images/left/011.png"), hole);
        write_mask(&folder.path().join("masks/left/017.png"), [24, 16], 3);
        let bytes = (SAMPLED_VIEWS + 6) * 1152 + 2 * 384;
        for (memory, stay, spare) in [(bytes + 5, SAMPLED_VIEWS + 6, 5), (bytes - 1, 52, 0), (0, 0, 0)] {
            let data = read(&folder, memory);
            assert_eq!((was_read(&data), kept(&data).len(), data.spare_memory), (2, stay, spare));
            let mut seen = 2;
            for view in data.views() {
                let index = view.name[5..8].parse::<usize>().unwrap();
                seen += usize::from(!view.photograph.was_read());
                let picture = view.picture().unwrap();
                assert_eq!(picture.counted.is_some(), index == 17 || index == 11);
                assert_eq!((picture.bytes[0] == index as u8, view.photograph.was_read()), (index != 11, true));
                assert_eq!(view.photograph.size_bytes(), picture.size_bytes());
                assert_eq!(was_read(&data), seen);
            }
            assert_eq!(data.masked().masked_views, 2);
        }
    }

    #[test]
    fn a_broken_photograph_of_many_is_named_when_it_is_needed() {
        let folder = colmap_folder(&fixtures::scene(SAMPLED_VIEWS + 6), Encoding::Binary);
        let path = folder.path().join("images/left/013.png");
        let mut broken = std::fs::read(&path).unwrap();
        // within the pixels
        broken[45] ^= 0xff;
        std::fs::write(&path, &broken).unwrap();
        let data = read(&folder, 0);
        let failed: Vec<_> = data.views().filter_map(|view| view.picture().err()).collect();
        assert_eq!(failed.len(), 1, "{failed:?}");
        assert_says(&failed[0], &["cannot read the photograph", "left/013.png", "cannot be decoded"]);
        // another size, and an end that is missing, are noticed at once
        std::fs::write(&path, &broken[..46]).unwrap();
        assert_refused(folder.path(), &LoadOptions::default(), &["left/013.png", "cut short"]);
        fixtures::write_png(&path, 24, 20, [0; 3]);
        assert_refused(folder.path(), &LoadOptions::default(), &["left/013.png", "24x20"]);
    }
}

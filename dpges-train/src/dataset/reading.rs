//! Reads the photographs of a dataset, in parallel and within a budget of memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use dpges_core::camera::Camera;

use super::error::Result;
use super::photograph::{About, Photograph, Shelf};
use super::source::Frame;
use super::{DepthMap, Picture, View};

/// Memory that reading a photograph takes for a while, bytes per pixel: the decoded image, and what is between it and a
/// smaller one.
const WORKING_BYTES_PER_PIXEL: usize = 24;
/// Share of a budget that not all photographs fit into for those that were read again lately.
const FOR_RECENT: f64 = 0.25;

/// A photograph that was read for the first time.
struct Read {
    /// `None` if there was no room left for it.
    picture: Option<Arc<Picture>>,
    about: About,
    depth: Option<DepthMap>,
}

/// The views of `frames`, in their order. `read` reads a photograph and its camera, again and again if need be. The first
/// photographs are kept, `memory` bytes of them at most. `depth` reads the depth map that belongs to a photograph and its camera,
/// once. Returns the bytes that are left over, too.
///
/// # Errors
/// Those of `read` and `depth`: the error of the first frame that has one, whatever the number of threads.
pub(super) fn views<F, D>(frames: &[&Frame], memory: usize, read: F, depth: D) -> Result<(Vec<View>, usize)>
where
    F: Fn(&Frame) -> Result<(Camera, Picture)> + Clone + Send + Sync + 'static,
    D: Fn(&Frame, &Camera, &Picture) -> Result<Option<DepthMap>> + Sync,
{
    let kept_bytes = AtomicUsize::new(0);
    let fits = |bytes: usize| {
        let with = |kept: usize| kept.checked_add(bytes).filter(|&kept| kept <= memory);
        kept_bytes.fetch_update(Ordering::SeqCst, Ordering::SeqCst, with).is_ok()
    };
    let first = |index: usize| -> Result<(Camera, Read)> {
        let (camera, picture) = read(frames[index])?;
        let (about, depth) = (About::of(&picture), depth(frames[index], &camera, &picture)?);
        Ok((camera, Read { picture: fits(about.bytes).then(|| Arc::new(picture)), about, depth }))
    };
    let found: Result<Vec<_>> = in_parallel(frames.len(), threads(frames, memory), first).into_iter().collect();
    let mut found = found?;
    let all: usize = found.iter().map(|(_, read)| read.about.bytes).sum();
    let all_fit = all <= memory;
    let most_kept = if all_fit { memory } else { (memory as f64 * (1.0 - FOR_RECENT)) as usize };
    let mut sum = 0;
    for (_, read) in &mut found {
        sum += read.about.bytes;
        if sum > most_kept {
            read.picture = None;
        }
    }
    let shelf = (!all_fit).then(|| Shelf::new(memory - most_kept));
    if !all_fit {
        let kept: Vec<usize> =
            found.iter().filter(|(_, read)| read.picture.is_some()).map(|(_, read)| read.about.bytes).collect();
        tracing::info!(
            "{} of {} photographs stay in memory, {:.1} MB of {:.1} MB; the others are read again from their files when \
             they are needed (data.memory)",
            kept.len(),
            frames.len(),
            kept.iter().sum::<usize>() as f64 / 1e6,
            all as f64 / 1e6
        );
    }
    let view = |(key, (frame, (camera, found))): (usize, (&&Frame, (Camera, Read)))| {
        let photograph = match (found.picture, &shelf) {
            (None, Some(shelf)) => {
                let (again, own) = (read.clone(), (*frame).clone());
                let path = frame.image.clone();
                Photograph::in_file(key, path, found.about, move || Ok(again(&own)?.1), Arc::clone(shelf))
            }
            (picture, _) => Photograph::kept(picture.expect("all that fits is kept"), found.about),
        };
        View { name: frame.name.clone(), camera, photograph, depth: found.depth }
    };
    let views = frames.iter().zip(found).enumerate().map(view).collect();
    Ok((views, if all_fit { memory - all } else { 0 }))
}

/// Number of photographs that are read at the same time, so that what they take meanwhile fits into `memory`, bytes.
fn threads(frames: &[&Frame], memory: usize) -> usize {
    let largest =
        frames.iter().map(|frame| frame.calibration.width.saturating_mul(frame.calibration.height)).max().unwrap_or(0);
    let each = largest.saturating_mul(WORKING_BYTES_PER_PIXEL).max(1);
    (memory / each).clamp(1, rayon::current_num_threads())
}

/// `of` 0..`count`, by so many threads.
fn in_parallel<T: Send>(count: usize, threads: usize, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let work = || {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return done;
            }
            done.push((index, of(index)));
        }
    };
    let mut all: Vec<(usize, T)> = thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.min(count)).map(|_| scope.spawn(work)).collect();
        let finished = workers.into_iter().map(|worker| worker.join());
        finished.flat_map(|done| done.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    all.sort_by_key(|(index, _)| *index);
    all.into_iter().map(|(_, value)| value).collect()
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{self, Encoding};
    use super::super::{Dataset, LoadOptions, load};
    use super::*;

    #[test]
    fn work_in_parallel_comes_back_in_order() {
        for threads in [1, 2, 7] {
            assert_eq!(in_parallel(20, threads, |index| index * index), (0..20).map(|i| i * i).collect::<Vec<_>>());
        }
        assert!(in_parallel(0, 3, |index| index).is_empty());
    }

    /// Nine photographs of 24 × 16 px, one of them with a mask: 1152 bytes each, and 384 more.
    fn written() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        fixtures::write_colmap(folder.path(), &fixtures::scene(9), Encoding::Binary);
        let mask = folder.path().join("masks/left/001.png");
        std::fs::create_dir_all(mask.parent().unwrap()).unwrap();
        image::GrayImage::from_fn(24, 16, |x, _| image::Luma([u8::from(x > 2)])).save(mask).unwrap();
        folder
    }

    fn read(folder: &tempfile::TempDir, memory: usize) -> Dataset {
        load(folder.path(), &LoadOptions { memory, test_every: 4, ..Default::default() }).unwrap()
    }

    fn kept(data: &Dataset) -> Vec<&str> {
        let views = data.train.iter().chain(&data.test).filter(|view| view.photograph.is_kept());
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
        }
        assert_eq!(read(&folder, 20_000).spare_memory, 20_000 - 9 * 1152 - 384);
    }

    #[test]
    fn files_that_change_are_noticed_when_they_are_read_again() {
        let folder = written();
        let data = read(&folder, 0);
        std::fs::remove_file(folder.path().join("images/left/003.png")).unwrap();
        let view = data.train.iter().find(|view| view.name == "left/003.png").unwrap();
        let message = view.picture().unwrap_err().to_string();
        assert!(message.contains("left/003.png") && message.contains("cannot read"), "{message}");
    }
}

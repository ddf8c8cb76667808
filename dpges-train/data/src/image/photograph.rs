//! Photographs of views: in memory, or in their files and read when they are needed.
//!
//! Which it is changes nothing but time and memory: a file is read, undistorted and made smaller in the same way each time.

use std::fmt;
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use moka::sync::Cache;

use super::cache::ImageCache;
use crate::error::{DatasetError, Result};
use crate::{Picture, View};

/// Photographs that are read ahead, at most.
pub const MOST_PREFETCHED: usize = 16;

/// The photograph of a view.
#[derive(Clone, Debug)]
pub struct Photograph {
    place: Place,
    info: ImageInfo,
}

/// Properties of a photograph without its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ImageInfo {
    /// Size in memory, bytes.
    pub bytes: usize,
    /// Number of pixels that do not count; `None` without a mask, which a lens that does not fill the picture makes too.
    pub ignored_pixels: Option<usize>,
    /// Whether a pixel shows the background rather than what is before it.
    pub has_transparency: bool,
}

impl ImageInfo {
    pub fn of(picture: &Picture) -> Self {
        Self {
            bytes: picture.size_bytes(),
            ignored_pixels: picture.counted.is_some().then(|| picture.ignored_pixels()),
            has_transparency: picture.alpha.is_some() && (0..picture.area()).any(|pixel| picture.is_transparent(pixel)),
        }
    }
}

#[derive(Clone, Debug)]
enum Place {
    Memory(Arc<Picture>),
    File(Arc<InFile>),
    Smaller(Arc<Smaller>),
}

/// A photograph made smaller from one in its file, whenever that is read.
#[derive(Debug)]
struct Smaller {
    full: Photograph,
    width: usize,
    height: usize,
    /// `None` if it does not stay in memory.
    kept: Option<OnceLock<Arc<Picture>>>,
}

impl Smaller {
    fn picture(&self) -> dpges_core::Result<Arc<Picture>> {
        if let Some(picture) = self.kept.as_ref().and_then(OnceLock::get) {
            return Ok(Arc::clone(picture));
        }
        let full = Arc::unwrap_or_clone(self.full.picture()?);
        let picture = Arc::new(full.downscaled(self.width, self.height));
        if let Some(kept) = &self.kept {
            // another thread has the same
            let _ = kept.set(Arc::clone(&picture));
        }
        Ok(picture)
    }
}

/// A photograph in its file, and in memory at times.
struct InFile {
    bytes: usize,
    file: ImageFile,
    was_read: AtomicBool,
    cache: Arc<ImageCache>,
}

/// Where the picture of a photograph comes from, and how long it stays.
pub(crate) struct ImageFile {
    /// Unique in its cache.
    pub key: usize,
    pub path: PathBuf,
    /// Reads the picture.
    pub read: Box<dyn Fn() -> Result<Picture> + Send + Sync>,
    /// Whether it stays in memory once it was read.
    pub stays: bool,
    /// Whether it was read before and not kept.
    pub was_read: bool,
}

impl fmt::Debug for InFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("InFile").field("path", &self.file.path).field("bytes", &self.bytes).finish_non_exhaustive()
    }
}

impl InFile {
    fn picture(&self) -> Result<Arc<Picture>, Arc<DatasetError>> {
        let read = || -> Result<Arc<Picture>> {
            let picture = (self.file.read)()?;
            self.was_read.store(true, Ordering::Relaxed);
            Ok(Arc::new(picture))
        };
        let pictures = self.pictures();
        let picture = pictures.try_get_with(self.file.key, read)?;
        pictures.run_pending_tasks();
        Ok(picture)
    }

    /// Where its picture is, once it was read.
    fn pictures(&self) -> &Cache<usize, Arc<Picture>> {
        if self.file.stays { &self.cache.kept } else { &self.cache.cached }
    }
}

impl From<Picture> for Photograph {
    /// In memory.
    fn from(picture: Picture) -> Self {
        let info = ImageInfo::of(&picture);
        Self { place: Place::Memory(Arc::new(picture)), info }
    }
}

impl Photograph {
    /// The `picture`, which stays in memory.
    pub(crate) fn kept(picture: Arc<Picture>, info: ImageInfo) -> Self {
        Self { place: Place::Memory(picture), info }
    }

    /// A picture that is read when it is needed, with others in the `cache`.
    pub(crate) fn in_file(file: ImageFile, info: ImageInfo, cache: Arc<ImageCache>) -> Self {
        let was_read = AtomicBool::new(file.was_read);
        Self { place: Place::File(Arc::new(InFile { bytes: info.bytes, file, was_read, cache })), info }
    }

    /// The photograph with `width` × `height` px, which stays in memory if this one does.
    pub(crate) fn smaller(&self, width: usize, height: usize) -> Self {
        if let Place::Memory(picture) = &self.place {
            return Picture::clone(picture).downscaled(width, height).into();
        }
        let kept = self.is_kept().then(OnceLock::new);
        let place = Place::Smaller(Arc::new(Smaller { full: self.clone(), width, height, kept }));
        Self { place, info: ImageInfo { bytes: 3 * width * height, ..self.info } }
    }

    /// Whether it stays in memory once it was read.
    pub fn is_kept(&self) -> bool {
        match &self.place {
            Place::Memory(_) => true,
            Place::File(in_file) => in_file.file.stays,
            Place::Smaller(smaller) => smaller.kept.is_some(),
        }
    }

    /// Whether its pixels were ever read.
    pub fn was_read(&self) -> bool {
        match &self.place {
            Place::Memory(_) => true,
            Place::File(in_file) => in_file.was_read.load(Ordering::Relaxed),
            Place::Smaller(smaller) => smaller.full.was_read(),
        }
    }

    /// Size in memory, bytes.
    pub fn size_bytes(&self) -> usize {
        self.info.bytes
    }

    /// Number of pixels that do not count; `None` without a mask, which a lens that does not fill the picture makes too.
    pub fn ignored_pixels(&self) -> Option<usize> {
        self.info.ignored_pixels
    }

    /// Whether a pixel that counts shows the background rather than what is before it.
    pub fn has_transparency(&self) -> bool {
        self.info.has_transparency
    }

    /// The picture. It is read from its file if it is not in memory.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if the file cannot be read, or is not what it was when the dataset was loaded.
    pub fn picture(&self) -> dpges_core::Result<Arc<Picture>> {
        match &self.place {
            Place::Memory(picture) => Ok(Arc::clone(picture)),
            Place::Smaller(smaller) => smaller.picture(),
            Place::File(in_file) => in_file.picture().map_err(|error| dpges_core::Error::Io {
                action: if self.was_read() { "cannot read again the photograph" } else { "cannot read the photograph" },
                path: in_file.file.path.clone(),
                source: io::Error::other(error),
            }),
        }
    }
}

/// Begins to read in the background those of `photographs` that are not in memory, the first first, as far as there is room
/// for them. Earlier requests that have not begun are forgotten.
pub fn prefetch<'a>(photographs: impl IntoIterator<Item = &'a Photograph>) {
    let (mut wanted, mut cache, mut passing_bytes) = (Vec::new(), None, 0usize);
    for photograph in photographs {
        let in_file = match &photograph.place {
            Place::File(in_file) => in_file,
            Place::Smaller(smaller) if smaller.kept.as_ref().is_none_or(|kept| kept.get().is_none()) => {
                let Place::File(in_file) = &smaller.full.place else { continue };
                in_file
            }
            _ => continue,
        };
        if !in_file.file.stays {
            // beside them is the one in use
            passing_bytes = passing_bytes.saturating_add(in_file.bytes);
            if passing_bytes.saturating_add(in_file.bytes) > in_file.cache.most_cached_bytes {
                break;
            }
        }
        cache = Some(&in_file.cache);
        if !in_file.pictures().contains_key(&in_file.file.key) {
            let in_file = Arc::downgrade(in_file);
            wanted.push(move || {
                if let Some(in_file) = in_file.upgrade() {
                    // whoever needs it tries again, and is told what is wrong
                    let _ = in_file.picture();
                }
            });
        }
    }
    if let Some(cache) = cache {
        cache.prefetch(wanted);
    }
}

/// `views` and their pictures, one after another. The next are read in the background if they are not in memory.
pub fn pictures<'a>(
    views: impl IntoIterator<Item = &'a View>,
) -> impl Iterator<Item = (&'a View, dpges_core::Result<Arc<Picture>>)> {
    let views: Vec<&View> = views.into_iter().collect();
    (0..views.len()).map(move |at| {
        let picture = views[at].picture();
        prefetch(views[at + 1..].iter().take(MOST_PREFETCHED).map(|view| &view.photograph));
        (views[at], picture)
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;
    use std::thread;

    use super::super::cache::reading_threads;
    use super::*;

    /// `count` photographs of 3 bytes, each of its own grey, and how often any was read.
    fn in_files(count: usize, most_bytes: usize, stays: bool) -> (Vec<Photograph>, Arc<AtomicUsize>) {
        let (cache, reads) = (ImageCache::new(most_bytes, 3, reading_threads(2)), Arc::new(AtomicUsize::new(0)));
        let photograph = |key: usize| {
            let grey = Picture { width: 1, height: 1, bytes: vec![key as u8; 3], alpha: None, counted: None };
            let (info, reads) = (ImageInfo::of(&grey), Arc::clone(&reads));
            let read = move || {
                reads.fetch_add(1, Ordering::SeqCst);
                Ok(grey.clone())
            };
            let path = PathBuf::from("a.png");
            let file = ImageFile { key, path, read: Box::new(read), stays, was_read: false };
            Photograph::in_file(file, info, Arc::clone(&cache))
        };
        ((0..count).map(photograph).collect(), reads)
    }

    fn wait_for(reads: &AtomicUsize, count: usize) {
        while reads.load(Ordering::SeqCst) < count {
            thread::yield_now();
        }
    }

    #[test]
    fn a_photograph_is_read_again_unless_it_was_in_use_lately() {
        let (photographs, reads) = in_files(3, 0, false);
        for key in [0, 1, 0, 1, 2, 0] {
            assert_eq!(photographs[key].picture().unwrap().bytes, [key as u8; 3]);
        }
        assert_eq!(reads.load(Ordering::SeqCst), 4);
        assert!(!photographs[0].is_kept() && Photograph::from((*photographs[0].picture().unwrap()).clone()).is_kept());
    }

    #[test]
    fn what_stays_is_read_once_when_it_is_needed() {
        let (photographs, reads) = in_files(3, 0, true);
        assert!(photographs.iter().all(|photograph| photograph.is_kept() && !photograph.was_read()));
        for key in [0, 1, 0, 1, 1, 0] {
            assert_eq!(photographs[key].picture().unwrap().bytes, [key as u8; 3]);
        }
        assert_eq!(reads.load(Ordering::SeqCst), 2);
        assert_eq!([0, 1, 2].map(|key| photographs[key].was_read()), [true, true, false]);
    }

    #[test]
    fn what_is_prefetched_is_read_once() {
        for stays in [false, true] {
            let (photographs, reads) = in_files(5, 15, stays);
            prefetch(&photographs[1..4]);
            wait_for(&reads, 3);
            for (key, photograph) in photographs.iter().enumerate().take(4).skip(1) {
                // waits for the other thread where that has not finished
                assert_eq!(photograph.picture().unwrap().bytes, [key as u8; 3]);
            }
            prefetch(&photographs[..4]);
            wait_for(&reads, 4);
            assert_eq!(photographs[0].picture().unwrap().bytes, [0; 3]);
            assert_eq!(reads.load(Ordering::SeqCst), 4);
        }
    }

    #[test]
    fn no_more_is_prefetched_than_there_is_room_for() {
        // two beside the one in use; without any room one
        for (most_bytes, expected) in [(9, 2), (0, 1)] {
            let (photographs, reads) = in_files(6, most_bytes, false);
            photographs[0].picture().unwrap();
            prefetch(&photographs[1..]);
            wait_for(&reads, 1 + expected);
            (1..=expected).for_each(|key| drop(photographs[key].picture().unwrap()));
            assert_eq!(reads.load(Ordering::SeqCst), 1 + expected);
            assert!(photographs[expected + 1..].iter().all(|photograph| !photograph.was_read()));
        }
    }

    #[test]
    fn a_file_that_is_gone_is_named() {
        let info = ImageInfo { bytes: 3, ignored_pixels: None, has_transparency: false };
        for (was_read, action) in [(true, "cannot read again"), (false, "cannot read")] {
            let read = || -> Result<Picture> {
                let path = PathBuf::from("images/a.png");
                Err(DatasetError::Read { path, source: io::Error::from(io::ErrorKind::NotFound) })
            };
            let path = PathBuf::from("images/a.png");
            let file = ImageFile { key: 0, path, read: Box::new(read), stays: !was_read, was_read };
            let message = Photograph::in_file(file, info, ImageCache::new(0, 3, reading_threads(1)))
                .picture()
                .unwrap_err()
                .to_string();
            assert!(message.contains(&format!("{action} the photograph images/a.png: cannot read")), "{message}");
        }
    }
}

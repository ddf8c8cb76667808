//! Photographs of views: in memory, or in their files and read again when they are needed.
//!
//! Which it is changes nothing but time and memory: a file is read, undistorted and made smaller in the same way each time.

use std::fmt;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use super::error::Result;
use super::{Picture, View};
use crate::recent::Recent;

/// Pictures from files that are kept in any case: the one in use and the next.
const LEAST_RECENT: usize = 2;

/// The photograph of a view.
#[derive(Clone, Debug)]
pub struct Photograph {
    place: Place,
    about: About,
}

/// What is known of a photograph without its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct About {
    /// What it takes in memory.
    pub bytes: usize,
    /// Number of pixels that do not count; `None` without a mask, which a lens that does not fill the picture makes too.
    pub ignored_pixels: Option<usize>,
    /// Whether a pixel shows the background rather than what is before it.
    pub has_transparency: bool,
}

impl About {
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
}

/// A photograph that is read again.
struct InFile {
    /// Unique on its shelf.
    key: usize,
    bytes: usize,
    /// Of the image.
    path: PathBuf,
    read: Box<dyn Fn() -> Result<Picture> + Send + Sync>,
    shelf: Arc<Shelf>,
}

impl fmt::Debug for InFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("InFile").field("path", &self.path).field("bytes", &self.bytes).finish_non_exhaustive()
    }
}

impl InFile {
    fn picture(&self) -> Result<Arc<Picture>> {
        self.shelf.recent.get(self.key, self.bytes, || (self.read)())
    }
}

/// The pictures that were read from files lately, and a thread that reads ahead.
pub(super) struct Shelf {
    recent: Recent<Picture>,
    /// `None` if there can be no further thread.
    ahead: Option<SyncSender<Arc<InFile>>>,
}

impl Shelf {
    /// Keeps up to `most_bytes` of pictures.
    pub fn new(most_bytes: usize) -> Arc<Self> {
        let (ahead, asked_for) = sync_channel::<Arc<InFile>>(1);
        let read = move || {
            for photograph in asked_for {
                // whoever needs it tries again, and is told what is wrong
                let _ = photograph.picture();
            }
        };
        let thread = thread::Builder::new().name("photographs".to_owned()).spawn(read);
        Arc::new(Self { recent: Recent::new(most_bytes, LEAST_RECENT), ahead: thread.is_ok().then_some(ahead) })
    }
}

impl From<Picture> for Photograph {
    /// In memory.
    fn from(picture: Picture) -> Self {
        let about = About::of(&picture);
        Self { place: Place::Memory(Arc::new(picture)), about }
    }
}

impl Photograph {
    /// The `picture`, which stays in memory.
    pub(super) fn kept(picture: Arc<Picture>, about: About) -> Self {
        Self { place: Place::Memory(picture), about }
    }

    /// The picture that `read` reads from the image at `path`. `key` is unique on the `shelf`.
    pub(super) fn in_file(
        key: usize,
        path: PathBuf,
        about: About,
        read: impl Fn() -> Result<Picture> + Send + Sync + 'static,
        shelf: Arc<Shelf>,
    ) -> Self {
        let in_file = InFile { key, bytes: about.bytes, path, read: Box::new(read), shelf };
        Self { place: Place::File(Arc::new(in_file)), about }
    }

    /// Whether it stays in memory.
    pub fn is_kept(&self) -> bool {
        matches!(self.place, Place::Memory(_))
    }

    /// What it takes in memory, bytes.
    pub fn size_bytes(&self) -> usize {
        self.about.bytes
    }

    /// Number of pixels that do not count; `None` without a mask, which a lens that does not fill the picture makes too.
    pub fn ignored_pixels(&self) -> Option<usize> {
        self.about.ignored_pixels
    }

    /// Whether a pixel that counts shows the background rather than what is before it.
    pub fn has_transparency(&self) -> bool {
        self.about.has_transparency
    }

    /// The picture. It is read from its file if it is not in memory.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if the file is not what it was when the dataset was loaded.
    pub fn picture(&self) -> dpges_core::Result<Arc<Picture>> {
        match &self.place {
            Place::Memory(picture) => Ok(Arc::clone(picture)),
            Place::File(in_file) => in_file.picture().map_err(|error| dpges_core::Error::Io {
                action: "cannot read again the photograph",
                path: in_file.path.clone(),
                source: io::Error::other(error),
            }),
        }
    }

    /// Begins to read the picture in the background, if it is not in memory and nothing else is being read.
    pub fn read_ahead(&self) {
        if let Place::File(in_file) = &self.place
            && let Some(ahead) = &in_file.shelf.ahead
        {
            // busy: whoever needs the picture reads it then
            let _ = ahead.try_send(Arc::clone(in_file));
        }
    }
}

/// `views` and their pictures, one after another. The next is read in the background if it is not in memory.
pub fn pictures<'a>(
    views: impl IntoIterator<Item = &'a View>,
) -> impl Iterator<Item = (&'a View, dpges_core::Result<Arc<Picture>>)> {
    let mut views = views.into_iter().peekable();
    std::iter::from_fn(move || {
        let view = views.next()?;
        let picture = view.picture();
        if let Some(next) = views.peek() {
            next.photograph.read_ahead();
        }
        Some((view, picture))
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::dataset::DatasetError;

    /// `count` photographs, each of its own grey, and how often any was read.
    fn in_files(count: usize, most_bytes: usize) -> (Vec<Photograph>, Arc<AtomicUsize>) {
        let (shelf, reads) = (Shelf::new(most_bytes), Arc::new(AtomicUsize::new(0)));
        let photograph = |key: usize| {
            let grey = Picture { width: 1, height: 1, bytes: vec![key as u8; 3], alpha: None, counted: None };
            let (about, reads) = (About::of(&grey), Arc::clone(&reads));
            let read = move || {
                reads.fetch_add(1, Ordering::SeqCst);
                Ok(grey.clone())
            };
            Photograph::in_file(key, PathBuf::from("a.png"), about, read, Arc::clone(&shelf))
        };
        ((0..count).map(photograph).collect(), reads)
    }

    #[test]
    fn a_photograph_is_read_again_unless_it_was_in_use_lately() {
        let (photographs, reads) = in_files(3, 0);
        for key in [0, 1, 0, 1, 2, 0] {
            assert_eq!(photographs[key].picture().unwrap().bytes, [key as u8; 3]);
        }
        assert_eq!(reads.load(Ordering::SeqCst), 4);
        assert!(!photographs[0].is_kept() && Photograph::from((*photographs[0].picture().unwrap()).clone()).is_kept());
    }

    #[test]
    fn what_is_read_ahead_is_read_once() {
        let (photographs, reads) = in_files(2, 6);
        photographs[1].read_ahead();
        while reads.load(Ordering::SeqCst) == 0 {
            thread::yield_now();
        }
        // waits for the other thread where that has not finished
        assert_eq!(photographs[1].picture().unwrap().bytes, [1; 3]);
        assert_eq!(reads.load(Ordering::SeqCst), 1);
    }

    #[test]
    fn a_file_that_is_gone_is_named() {
        let about = About { bytes: 3, ignored_pixels: None, has_transparency: false };
        let gone = || {
            let path = PathBuf::from("images/a.png");
            Err(DatasetError::Read { path, source: io::Error::from(io::ErrorKind::NotFound) })
        };
        let photograph = Photograph::in_file(0, PathBuf::from("images/a.png"), about, gone, Shelf::new(0));
        let message = photograph.picture().unwrap_err().to_string();
        assert!(message.contains("cannot read again the photograph images/a.png: cannot read"), "{message}");
    }
}
